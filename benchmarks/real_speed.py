"""Processor seconds and memory of ``tissueid fit`` as a command, beside the imports that it needs."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of a process with its children.

    Attributes
    ----------
    cpu_s, wall_s : float
        User and system time [s]; time on the wall [s].
    peak_MB : float
        Largest resident memory of one process among them [MB].
    exit : int
    error : str
        End of its stderr, where it failed.
    """

    cpu_s: float
    wall_s: float
    peak_MB: float
    exit: int
    error: str = ""

    def as_json(self) -> dict[str, Any]:
        """Plain numbers."""
        return {"cpu_s": self.cpu_s, "wall_s": self.wall_s, "peak_MB": self.peak_MB, "exit": self.exit} | (
            {"error": self.error} if self.error else {}
        )


def cost_of(command: Sequence[str], environment: Mapping[str, str] | None = None) -> Cost:
    """Run a command to its end and measure it, children that it waits for included.

    Parameters
    ----------
    command : sequence of str
        Arguments of this interpreter.
    environment : mapping, optional
        Added to that of this process.
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
    peak = usage.ru_maxrss * RSS_UNIT / 1e6
    failed = "" if process.returncode in FINISHED else last
    return Cost(usage.ru_utime + usage.ru_stime, wall, peak, process.returncode, failed)


def _fit(inputs: Sequence[str], environment: Mapping[str, str] | None = None) -> Cost:
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
                "cpu_s_per_sheet": cost.cpu_s / max(len(chosen), 1),
                **cost.as_json(),
            }
        )
    return rows


def _cold_and_warm(root: Path) -> dict[str, Any]:
    """First fit of one 100 Hz log with an empty folder of kernels, and the second, beside bare imports."""
    log = str(root / LOG)
    tell("speed: bare imports")
    bare = min((cost_of(["-c", IMPORTS]) for _ in range(REPEATS)), key=lambda one: one.cpu_s)
    with tempfile.TemporaryDirectory() as kernels:
        environment = {"NUMBA_CACHE_DIR": kernels}
        tell("speed: first fit of a 100 Hz log, no kernels compiled")
        first = _fit([log], environment)
        tell("speed: the same again")
        second = min((_fit([log], environment) for _ in range(REPEATS)), key=lambda one: one.cpu_s)
    return {
        "log": LOG.as_posix(),
        "imports": bare.as_json(),
        "first": first.as_json(),
        "second": second.as_json(),
        "first_over_imports": first.cpu_s / bare.cpu_s,
        "second_over_imports": second.cpu_s / bare.cpu_s,
    }


def speed(data: Path, root: Path, *, sheets: int | None) -> dict[str, Any]:
    """Cost of the meat workbooks and of one synthetic log.

    Parameters
    ----------
    data, root : Path
        Folder of the recordings; folder of the project.
    sheets : int, optional
        Most sheets of a workbook; ``None`` fits the workbooks as they are.
    """
    # a log first: it leaves nothing compiled for the sheets, whose kernels are those of this installation
    log = _cold_and_warm(root)
    return {"one_log": log, "workbooks": _sheets(data, sheets)}
