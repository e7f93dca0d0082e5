"""Shared libraries that a test compiles from C beside it."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent


def compiled(name: str, folder: Path) -> Path:
    """Path of the shared library made of ``name``.c; the test is skipped, visibly, without a compiler."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (gcc or cc) to make the stand-in library with")
    library = folder / f"{name}.so"
    subprocess.run(
        [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o", library, FOLDER / f"{name}.c"],
        check=True,
    )
    return library
