"""The functions of the Force Dimension SDK that are needed, by ctypes.

The SDK is closed and is neither shipped nor downloaded.  It is looked for, in this order: the file named by
``TISSUEID_FORCEDIM``; ``lib/release/<platform>`` below ``FDSDK`` and ``FORCEDIM_SDK``; ``~/.local/lib``,
``/usr/local/lib`` and the loader's own places.
"""

from __future__ import annotations

import ctypes
import os
import platform
from collections.abc import Iterator
from ctypes import POINTER, byref, c_byte, c_char_p, c_double, c_int, c_ubyte, c_uint, c_void_p
from pathlib import Path
from typing import Any

from tissueid.errors import DeviceError

LIBRARY_VARIABLE = "TISSUEID_FORCEDIM"
SDK_VARIABLES = ("FDSDK", "FORCEDIM_SDK")
LIBRARY_NAMES = ("libdrd.so", "libdhd.so")
#: Oldest release whose functions have these prototypes.
OLDEST = (3, 16)
#: The SDK's number of a Falcon.
FALCON_TYPE = 60
#: Entries of its status array, and the one that says "homed".
STATUS_ENTRIES = 16
STATUS_RESET = 3
#: Answers to a call: done; done, but faster than the device is read; done, but cut by the motors' limit.
DONE, TIME_GUARD, SATURATED = 0, 1, 2

_PROTOTYPES: dict[str, tuple[Any, list[Any]]] = {
    "dhdGetSDKVersion": (None, [POINTER(c_int)] * 4),
    "dhdOpenType": (c_int, [c_int]),
    "dhdGetSystemType": (c_int, [c_byte]),
    "dhdGetStatus": (c_int, [POINTER(c_int), c_byte]),
    "dhdGetPosition": (c_int, [POINTER(c_double)] * 3 + [c_byte]),
    "dhdGetLinearVelocity": (c_int, [POINTER(c_double)] * 3 + [c_byte]),
    "dhdSetForce": (c_int, [c_double] * 3 + [c_byte]),
    "dhdGetButtonMask": (c_uint, [c_byte]),
    "dhdEnableForce": (c_int, [c_ubyte, c_byte]),
    "dhdSetGravityCompensation": (c_int, [c_int, c_byte]),
    "dhdSetMaxForce": (c_int, [c_double, c_byte]),
    "dhdStop": (c_int, [c_byte]),
    "dhdClose": (c_int, [c_byte]),
    "dhdErrorGetLastStr": (c_char_p, []),
}


class Sdk:
    """The loaded SDK with one open device.

    ``library``: which library; searched for by default.  Raises DeviceError: if none is found, it lacks a
    function, or is older than :data:`OLDEST`.
    """

    def __init__(self, library: str | None = None) -> None:
        self.path, self.library = _load(library)
        for function, (result, arguments) in _PROTOTYPES.items():
            try:
                symbol = getattr(self.library, function)
            except AttributeError as error:
                msg = f"{self.path} is no Force Dimension SDK of use: it has no {function}"
                raise DeviceError(msg) from error
            symbol.restype, symbol.argtypes = result, arguments
        if self.version()[:2] < OLDEST:
            msg = (
                f"the Force Dimension SDK at {self.path} is {'.'.join(map(str, self.version()))}; "
                f"{'.'.join(map(str, OLDEST))} or newer is needed"
            )
            raise DeviceError(msg)
        self.identity = -1

    def version(self) -> tuple[int, int, int, int]:
        """Major, minor, release, revision."""
        numbers = [c_int() for _ in range(4)]
        self.library.dhdGetSDKVersion(*map(byref, numbers))
        return numbers[0].value, numbers[1].value, numbers[2].value, numbers[3].value

    def open_falcon(self) -> None:
        """Open the first Falcon.

        Raises DeviceError: with what the SDK says.
        """
        identity = self.library.dhdOpenType(FALCON_TYPE)
        if identity < 0:
            msg = f"the Force Dimension SDK opened no Falcon: {self.last_error()}"
            raise DeviceError(msg)
        self.identity = identity

    def close(self) -> None:
        """Stop the device and let go of it; calling twice does no harm."""
        identity, self.identity = self.identity, -1
        if identity >= 0:
            self.library.dhdStop(identity)
            self.library.dhdClose(identity)

    def is_homed(self) -> bool:
        """True where the device's position is known."""
        status = (c_int * STATUS_ENTRIES)()
        self._done("dhdGetStatus", self.library.dhdGetStatus(status, self.identity))
        return bool(status[STATUS_RESET])

    def position(self) -> tuple[float, float, float]:
        """Position in the SDK's frame [m]."""
        x, y, z = c_double(), c_double(), c_double()
        code = self.library.dhdGetPosition(byref(x), byref(y), byref(z), self.identity)
        self._done("dhdGetPosition", code)
        return x.value, y.value, z.value

    def velocity(self) -> tuple[float, float, float]:
        """Velocity in the SDK's frame [m/s]."""
        x, y, z = c_double(), c_double(), c_double()
        code = self.library.dhdGetLinearVelocity(byref(x), byref(y), byref(z), self.identity)
        self._done("dhdGetLinearVelocity", code)
        return x.value, y.value, z.value

    def buttons(self) -> int:
        """Bits of the buttons held, in the SDK's numbering."""
        return int(self.library.dhdGetButtonMask(self.identity))

    def set_force(self, x: float, y: float, z: float) -> None:
        """Force on the hand in the SDK's frame [N]."""
        self._done("dhdSetForce", self.library.dhdSetForce(x, y, z, self.identity))

    def prepare(self, largest_N: float) -> None:
        """No gravity compensation, no more than this force [N], and motors on."""
        self._done("dhdSetGravityCompensation", self.library.dhdSetGravityCompensation(0, self.identity))
        self._done("dhdSetMaxForce", self.library.dhdSetMaxForce(largest_N, self.identity))
        self._done("dhdEnableForce", self.library.dhdEnableForce(1, self.identity))

    def address(self, function: str) -> int:
        """Address of a function, for the compiled loop."""
        return ctypes.cast(getattr(self.library, function), c_void_p).value or 0

    def last_error(self) -> str:
        """Words of the SDK on its last error."""
        return (self.library.dhdErrorGetLastStr() or b"unknown error").decode("utf-8", "replace")

    def _done(self, function: str, code: int) -> None:
        if code not in {DONE, TIME_GUARD, SATURATED}:
            msg = f"{function} failed: {self.last_error()}"
            raise DeviceError(msg)


def candidates() -> Iterator[str]:
    """Names under which the library is looked for, in order."""
    named = os.environ.get(LIBRARY_VARIABLE)
    if named:
        # what the user names is not replaced by another
        yield named
        return
    folder = f"lin-{platform.machine()}-gcc"
    for variable in SDK_VARIABLES:
        if root := os.environ.get(variable):
            for name in LIBRARY_NAMES:
                yield str(Path(root) / "lib" / "release" / folder / name)
    for place in (Path.home() / ".local" / "lib", Path("/usr/local/lib")):
        for name in LIBRARY_NAMES:
            yield str(place / name)
    yield from LIBRARY_NAMES


def _load(library: str | None) -> tuple[str, Any]:
    for name in [library] if library else candidates():
        try:
            return name, ctypes.CDLL(name)
        except OSError:
            continue
    msg = (
        "the Force Dimension SDK is not installed, or in none of the usual places: set FDSDK to its folder, "
        f"or {LIBRARY_VARIABLE} to libdrd.so"
    )
    raise DeviceError(msg)
