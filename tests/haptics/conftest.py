"""Stand-ins for the libraries of devices, compiled once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from c_library import FOLDER, SdkStub, UsbStub, compiled


@pytest.fixture(scope="session")
def library(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Makes the shared library of a name, once."""
    folder = tmp_path_factory.mktemp("libraries")
    made: dict[str, Path] = {}
    return lambda name: made.get(name) or made.setdefault(name, compiled(FOLDER / f"{name}.c", folder))


@pytest.fixture
def usb(library: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch) -> UsbStub:
    return UsbStub(library("usb_stub"), monkeypatch)


@pytest.fixture
def sdk(library: Callable[[str], Path], monkeypatch: pytest.MonkeyPatch) -> SdkStub:
    return SdkStub(library("dhd_stub"), monkeypatch)
