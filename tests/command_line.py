"""Run the command line, in this process or in its own, and make small folders of recordings."""

import contextlib
import io
import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissueid.arrays import FloatArray
from tissueid.cli.main import main
from tissueid.store.schema import first_problem

#: One branch, constant K and no posterior: the quickest fit.
QUICK = ("--branches", "1", "--stiffness-degree", "0", "--sampler", "none")
REPOSITORY = Path(__file__).resolve().parents[1]
#: Where an interpreter of its own finds this package, or a copy of it that is asked for.
PACKAGES = os.pathsep.join(filter(None, (os.environ.get("PYTHONPATH"), str(REPOSITORY))))
LOG = REPOSITORY / "datasets_synthetic" / "paper-a-hold-100Hz" / "hold-8-1.csv"
HEADER_LINES = 6
#: First line of a study file.
STUDY_HEAD = 'schema = "tissueid/study/1"'


@dataclass(frozen=True)
class Ended:
    code: int
    stdout: str
    stderr: str

    def json(self, schema: str | None = None) -> Any:
        """The document on stdout, valid by a schema where one is named."""
        document = json.loads(self.stdout)
        assert schema is None or first_problem(document, schema) is None
        return document


Words = str | tuple[str, ...]


def run(*args: Any, code: int | Collection[int] = (), said: Words = (), shown: Words = ()) -> Ended:
    """``tissueid ARGS`` in this process; whatever happens, no traceback, colour or progress in a pipe.

    ``code``: with which it must end, where that is told; ``said``, ``shown``: words that must stand on stderr
    and on stdout.
    """
    ended = run_on(io.TextIOWrapper, *args)
    allowed = {code} if isinstance(code, int) else code
    assert not allowed or ended.code in allowed, (args, ended.code, ended.stderr)
    for expected, stream in ((said, ended.stderr), (shown, ended.stdout)):
        for words in (expected,) if isinstance(expected, str) else expected:
            assert words in stream, args
    assert "Traceback" not in ended.stderr
    assert not {"\x1b", "\r"} & {*ended.stdout.replace("\r\n", "\n"), *ended.stderr}
    return ended


class Terminal(io.TextIOWrapper):
    def isatty(self) -> bool:
        return True


def run_on(kind: type[io.TextIOWrapper], *args: str | Path) -> Ended:
    """``tissueid ARGS`` in this process, on streams of a kind."""
    streams = [kind(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2)]
    with contextlib.redirect_stdout(streams[0]), contextlib.redirect_stderr(streams[1]):
        code = main([str(arg) for arg in args])
    out, err = (stream.buffer.getvalue().decode("utf-8") for stream in streams)  # type: ignore[attr-defined]
    return Ended(code, out, err)


def start(*args: str | Path, **options: Any) -> subprocess.Popen[str]:
    """``python -m tissueid ARGS`` in a process of its own, which Ctrl-C reaches.

    A shell starts jobs in the background with SIGINT ignored, and every child would inherit that.
    """
    if sys.platform != "win32":
        options.setdefault("preexec_fn", lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
    options |= {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    words = [sys.executable, "-m", "tissueid", *map(str, args)]
    return subprocess.Popen(words, env=os.environ | {"PYTHONPATH": PACKAGES}, **options)


def python(*args: str | Path, check: bool = True, **environment: str) -> subprocess.CompletedProcess[str]:
    """An interpreter of its own that finds this package."""
    words, known = [sys.executable, "-P", *map(str, args)], {"PYTHONPATH": PACKAGES} | environment
    return subprocess.run(words, env=os.environ | known, capture_output=True, text=True, check=check)


def log_text(
    *, label: str | None = "tissue", head: str = "", stride: int = 4, force_times: float = 1.0
) -> str:
    """The 100 Hz ramp and hold, every ``stride``-th row of it, under another specimen label, head or none."""
    lines = LOG.read_text(encoding="ascii").splitlines()
    body = [line.split(",") for line in lines[HEADER_LINES : HEADER_LINES + 1600 : stride]]
    rows = [f"{t},{x},{float(f) * force_times:.4f}" for t, x, f in body]
    if label is not None:
        head = head or f'Text Inputs : Specimen label,"{label}"'
    return "\n".join([*([head, ""] if head else []), "Time,Extension,Load", "(sec),(mm),(N)", *rows, ""])


def write_log(path: Path, **options: Any) -> Path:
    """Write :func:`log_text` to a file; folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(log_text(**options), encoding="ascii")
    return path


def write_workbook(path: Path, *sheets: str, stride: int = 4) -> Path:
    """A workbook with :func:`log_text` on every sheet."""
    from openpyxl import Workbook

    book = Workbook()
    del book[book.sheetnames[0]]
    rows = [line.split(",") for line in log_text(label=None, stride=stride).splitlines()]
    for name in sheets:
        sheet = book.create_sheet(name)
        for number, cells in enumerate(rows):
            # names and units, then numbers
            sheet.append([cell if number < 2 else float(cell) for cell in cells])
    book.save(path)
    return path


def write_study(folder: Path, *tables: str) -> Path:
    path = folder / "study.toml"
    path.write_text("\n".join([STUDY_HEAD, *tables, ""]), encoding="utf-8")
    return path


def write_csv(path: Path, time_s: FloatArray, travel_mm: FloatArray, force_N: FloatArray) -> Path:
    """Samples to 1 ms, 0.01 um and 0.01 mN."""
    rows = [f"{t:.3f},{x:.5f},{f:.5f}" for t, x, f in zip(time_s, travel_mm, force_N, strict=True)]
    path.write_text("\n".join(["time (s),displacement (mm),force (N)", *rows, ""]), encoding="ascii")
    return path


def read_json(path: Path) -> Any:
    return json.loads(path.read_bytes())


def same_run(one: Path, other: Path) -> bool:
    """True where two output folders hold the same numbers, but for the rounding of the linear algebra.

    On some processors its sums depend on where an array lies in memory; along a valley that the data leave
    flat, Levenberg-Marquardt ends elsewhere then.
    """
    found = [read_json(folder / "identification.json") for folder in (one, other)]
    for document in found:
        for specimen in document["specimens"]:
            specimen["optimisers"] = {
                name: value for name, value in specimen["optimisers"].items() if name.startswith("vp")
            }
    return alike(*found)


def alike(one: Any, other: Any) -> bool:
    """True where two documents are equal, their numbers to 1e-9."""
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(alike(one[name], other[name]) for name in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(alike, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=1e-9, abs_tol=1e-12)
    return bool(one == other)


def until(condition: Callable[[], object], seconds: float = 60.0) -> None:
    """Wait for what another process does."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "nothing happened in time"
        time.sleep(0.01)
