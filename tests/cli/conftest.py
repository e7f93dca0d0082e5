"""One fitted recording for all commands, and what a machine without devices looks like to them."""

import os
import shutil
from typing import Any

import pytest
from command_line import QUICK, run, write_log

from tissueid.haptics.falcon import transport as libusb


class EmptyUsb:
    """libusb where nothing is plugged in: every call succeeds, and no device is listed."""

    def __getattr__(self, name: str) -> Any:
        if name == "libusb_error_name":
            return lambda _code: b"LIBUSB_ERROR_ACCESS"
        return lambda *_: 0


@pytest.fixture
def empty_usb(monkeypatch):
    """No Falcon, whatever is plugged in and whether or not libusb is installed here.

    A library that a test names itself is loaded.
    """
    load = libusb._load

    def chosen() -> Any:
        return load() if libusb.LIBRARY_VARIABLE in os.environ else EmptyUsb()

    monkeypatch.setattr(libusb, "_load", chosen)


@pytest.fixture(scope="session")
def fitted_once(tmp_path_factory):
    """A folder with ``lab/log.csv`` and its quickest fit ``out``; nobody writes into it."""
    folder = tmp_path_factory.mktemp("fitted")
    ended = run("fit", write_log(folder / "lab" / "log.csv"), "-o", folder / "out", "-q", *QUICK)
    assert ended.code == 0, ended.stderr
    return folder


@pytest.fixture
def fitted_log(fitted_once, tmp_path):
    """A copy of them, to spoil."""
    return shutil.copytree(fitted_once, tmp_path / "fitted", symlinks=True)
