"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# as the command does: threads of the linear algebra library make small matrices ten times slower
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# settings of whoever runs the tests are no part of them
os.environ["TISSUEID_CONFIG"] = ""

REPOSITORY = Path(__file__).resolve().parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of the tests that need a real device; see docs/hardware-checklist.md."""
    group = parser.getgroup("falcon", "a real Novint Falcon (docs/hardware-checklist.md)")
    group.addoption("--falcon", action="store_true", help="run the tests that move a real Falcon")
    group.addoption("--falcon-port", metavar="PATH", help="serial port or pseudo-terminal instead of USB")
    group.addoption("--falcon-firmware", metavar="FILE", help="firmware, where the device has none running")
    group.addoption(
        "--falcon-report",
        metavar="FILE",
        default="hardware-report.json",
        help="where the readings are written",
    )


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder with openly licensed real recordings, which are not part of this repository."""
    named = os.environ.get("TISSUEID_SHARED_DATA")
    folder = Path(named) if named else REPOSITORY.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder}; set TISSUEID_SHARED_DATA to a folder that has them")
    return folder


@pytest.fixture(scope="session")
def datasets() -> Path:
    """Folder of the synthetic sets that the repository carries."""
    return REPOSITORY / "datasets_synthetic"
