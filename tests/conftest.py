"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

# as the command does: threads of the linear algebra library make small matrices ten times slower
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

REPOSITORY = Path(__file__).resolve().parent.parent


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
