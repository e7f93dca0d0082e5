"""Processor seconds and memory of ``tissueid fit`` as a command, beside the imports that it needs."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from real_recordings import tell, workbooks

import tissueid

IMPORTS = "import numpy, scipy.optimize, scipy.stats, pandas, lmfit, emcee, h5py, click"
#: A synthetic log at 100 Hz.
LOG = Path("datasets_synthetic") / "paper-a-hold-100Hz" / "hold-8-1.csv"
#: The tissueid of this process (-P), not one in the working directory.
FIT = ("-P", "-m", "tissueid", "fit")
#: Exit codes of a fit that was finished.
FINISHED = (0, 4, 7)
REPEATS = 3
#: ``ru_maxrss`` is told in kilobytes, by macOS in bytes.
RSS_UNIT = 1.0 if sys.platform == "darwin" else 1024.0


def cost_of(command: Sequence[str], environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Processor and wall time [s], largest resident memory of one process [MB], exit code and last error.

    ``command``: arguments of this interpreter, whose children are waited for; ``environment``: added to ours.
    """
    with tempfile.TemporaryFile() as errors:
        start = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, *command],
            stdout=subprocess.DEVNULL,
            stderr=errors,
            env={**os.environ, **(environment or {})},
        )
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        errors.seek(0)
        last = errors.read().decode(errors="replace").strip().rpartition("\n")[2][-300:]
    spent = {"cpu_s": usage.ru_utime + usage.ru_stime, "wall_s": wall}
    spent |= {"peak_MB": usage.ru_maxrss * RSS_UNIT / 1e6, "exit": process.returncode}
    return spent if process.returncode in FINISHED or not last else {**spent, "error": last}


def _fit(inputs: Sequence[str], environment: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Cost of one fit into an empty folder; decisions beside the recordings are left aside."""
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "out")
        return cost_of([*FIT, *inputs, "-o", out, "--no-study", "-q"], environment)


def _sheets(data: Path, limit: int | None) -> list[dict[str, Any]]:
    """Rows of the workbooks: seconds a sheet, and peak memory; a few sheets alone where there is a limit."""
    rows = []
    for path in workbooks(data):
        sheets = [str(one.source.sheet) for one in tissueid.read_trials(path)]
        chosen = sheets[:limit]
        inputs = [str(path)] if limit is None else [f"{path}::{sheet}" for sheet in chosen]
        tell(f"speed: {path.name}, {len(chosen)} sheets")
        cost = _fit(inputs)
        rows.append(
            {
                "workbook": path.name,
                "sheets": len(chosen),
                "cpu_s_per_sheet": cost["cpu_s"] / max(len(chosen), 1),
                **cost,
            }
        )
    return rows


def _cold_and_warm(root: Path) -> dict[str, Any]:
    """First fit of one 100 Hz log with an empty folder of kernels, and the second, beside bare imports."""
    log = str(root / LOG)
    tell("speed: bare imports")
    bare = min((cost_of(["-c", IMPORTS]) for _ in range(REPEATS)), key=itemgetter("cpu_s"))
    with tempfile.TemporaryDirectory() as kernels:
        environment = {"NUMBA_CACHE_DIR": kernels}
        tell("speed: first fit of a 100 Hz log, no kernels compiled")
        first = _fit([log], environment)
        tell("speed: the same again")
        second = min((_fit([log], environment) for _ in range(REPEATS)), key=itemgetter("cpu_s"))
    return {
        "log": LOG.as_posix(),
        "imports": bare,
        "first": first,
        "second": second,
        "first_over_imports": first["cpu_s"] / bare["cpu_s"],
        "second_over_imports": second["cpu_s"] / bare["cpu_s"],
    }


def speed(data: Path, root: Path, *, sheets: int | None) -> dict[str, Any]:
    """Cost of the meat workbooks, at most ``sheets`` of each or as they are, and of one synthetic log."""
    # a log first: it leaves nothing compiled for the sheets, whose kernels are those of this installation
    log = _cold_and_warm(root)
    return {"one_log": log, "workbooks": _sheets(data, sheets)}
