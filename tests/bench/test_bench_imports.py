"""Every benchmark can be loaded: what the package no longer has, none of them asks for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


def test_every_benchmark_is_loaded():
    modules = sorted(file.stem for file in BENCHMARKS.glob("*.py"))
    assert len(modules) > 20
    ended = subprocess.run(
        [sys.executable, "-c", f"import {', '.join(modules)}"],
        cwd=BENCHMARKS, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
