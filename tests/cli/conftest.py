"""What a machine without devices looks like to the commands."""

from __future__ import annotations

import os
from typing import Any

import pytest

from tissueid.haptics.falcon import libusb


class EmptyUsb:
    """libusb where nothing is plugged in: every call succeeds, and no device is listed."""

    def __getattr__(self, name: str) -> Any:
        if name == "libusb_error_name":
            return lambda _code: b"LIBUSB_ERROR_ACCESS"
        return lambda *_: 0


@pytest.fixture
def empty_usb(monkeypatch: pytest.MonkeyPatch) -> None:
    """No Falcon, whatever is plugged in and whether or not libusb is installed here.

    A library that a test names itself is loaded.
    """
    load = libusb._load

    def chosen() -> Any:
        return load() if libusb.LIBRARY_VARIABLE in os.environ else EmptyUsb()

    monkeypatch.setattr(libusb, "_load", chosen)
