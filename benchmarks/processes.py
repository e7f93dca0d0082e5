"""Processes of this interpreter, and what they cost."""

from __future__ import annotations

import resource
import subprocess
import sys
import time
from pathlib import Path

#: Exit codes of a command that was finished; 4 is a result with something that is not identified.
FINISHED = (0, 4)


def run(*arguments: str) -> tuple[float, float, str]:
    """Wall time, processor time of it and its children [s], and output of one whole process."""
    start, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_CHILDREN)
    ended = subprocess.run([sys.executable, *arguments], check=False, capture_output=True, text=True)
    wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if ended.returncode not in FINISHED:
        sys.exit(ended.stderr)
    return wall, sum(after[:2]) - sum(before[:2]), ended.stdout


def peak_MB(pid: int | str = "self") -> float:
    """Largest resident memory of a process alone [MB] (getrusage carries the parent's over an exec)."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return float(line.split()[1]) / 1024.0
    return 0.0
