"""A Falcon by the Force Dimension SDK, which is closed and neither shipped nor downloaded, by ctypes.

It homes the device, computes its kinematics and carries its firmware.  Frame and buttons are mapped to ours
here and nowhere else, from documentation; no unit has confirmed them.  It is looked for by
``TISSUEID_FORCEDIM``, below ``FDSDK`` and ``FORCEDIM_SDK``, and where the loader looks.
"""

from __future__ import annotations

import ctypes
import os
import platform
import time
from collections.abc import Iterator
from ctypes import POINTER, byref, c_byte, c_char_p, c_double, c_int, c_ubyte, c_uint, c_void_p
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.compiled import tick_part
from tissueid.errors import DeviceError
from tissueid.haptics.device import (
    HOMING_TIMEOUT_S,
    AskedDevice,
    Capabilities,
    CompiledIO,
    DetectedDevice,
    DeviceSample,
    HapticDevice,
    declared,
    steps_of,
)
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.states import State

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
    "dhdGetStatus": (c_int, [POINTER(c_int), c_byte]),
    "dhdGetPosition": (c_int, [POINTER(c_double)] * 3 + [c_byte]),
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
    """The loaded SDK with one open device; DeviceError where there is none of :data:`OLDEST` or newer."""

    def __init__(self) -> None:
        self.path, library = _load()
        self.library = declared(library, _PROTOTYPES, f"{self.path} is no Force Dimension SDK of use")
        numbers = [c_int() for _ in range(4)]
        self.library.dhdGetSDKVersion(*map(byref, numbers))
        version = tuple(number.value for number in numbers)
        if version[:2] < OLDEST:
            raise DeviceError(
                f"the Force Dimension SDK at {self.path} is {'.'.join(map(str, version))}; "
                f"{'.'.join(map(str, OLDEST))} or newer is needed"
            )
        self.identity = -1

    def open_falcon(self) -> None:
        """Open the first Falcon; DeviceError with what the SDK says."""
        identity = self.library.dhdOpenType(FALCON_TYPE)
        if identity < 0:
            raise DeviceError(f"the Force Dimension SDK opened no Falcon: {self.last_error()}")
        self.identity = identity

    def close(self) -> None:
        """Stop the device and let go of it; calling twice does no harm."""
        identity, self.identity = self.identity, -1
        if identity >= 0:
            self.library.dhdStop(identity)
            self.library.dhdClose(identity)

    def call(self, function: str, *arguments: Any) -> None:
        """Ask something of the open device; DeviceError with what the SDK says."""
        if getattr(self.library, function)(*arguments, self.identity) not in {DONE, TIME_GUARD, SATURATED}:
            raise DeviceError(f"{function} failed: {self.last_error()}")

    def last_error(self) -> str:
        """Words of the SDK on its last error."""
        return (self.library.dhdErrorGetLastStr() or b"unknown error").decode("utf-8", "replace")


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


def _load() -> tuple[str, Any]:
    for name in candidates():
        try:
            return name, ctypes.CDLL(name)
        except OSError:
            continue
    raise DeviceError(
        "the Force Dimension SDK is not installed, or in none of the usual places: set FDSDK to its folder, "
        f"or {LIBRARY_VARIABLE} to libdrd.so"
    )


#: Bits of the SDK's mask.
_CENTRE, _LEFT, _UP, _RIGHT = 0x1, 0x2, 0x4, 0x8


@tick_part
def wire_buttons(mask: int) -> int:
    """Bits of :data:`tissueid.haptics.falcon.packets.BUTTON_NAMES` for a mask of the SDK."""
    return (
        (0x04 if mask & _CENTRE else 0)
        | (0x08 if mask & _LEFT else 0)
        | (0x02 if mask & _UP else 0)
        | (0x01 if mask & _RIGHT else 0)
    )


#: Rows: our axes in the SDK's frame, which has x toward the user, y to the right and z up.
ROTATION = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
#: The SDK's origin, the middle of the workspace, in our frame [m].
ORIGIN_M = np.array([0.0, 0.0, 0.130])
#: Reach around the origin [m].
REACH_M = 0.040


class ForceDimensionDevice(HapticDevice):
    """The first Falcon that the SDK opens; by default at most 2 N with the dead-man button."""

    name = "forcedimension"

    def __init__(
        self, limits: GuardLimits | None = None, *, homing_timeout_s: float = HOMING_TIMEOUT_S
    ) -> None:
        super().__init__(GuardLimits() if limits is None else limits)
        self._homing_timeout_s = homing_timeout_s
        self._sdk: Sdk | None = None

    @classmethod
    def configured(cls, asked: AskedDevice) -> dict[str, Any]:
        """Only a time-out of homing."""
        return {} if asked.homing_timeout_s is None else {"homing_timeout_s": asked.homing_timeout_s}

    @classmethod
    def detect(cls) -> list[DetectedDevice]:
        """A Falcon that the SDK can open; without the SDK there is nothing to say."""
        try:
            sdk = Sdk()
            sdk.open_falcon()
        except DeviceError:
            return []
        sdk.close()
        return [DetectedDevice(cls.name, sdk.path)]

    @property
    def capabilities(self) -> Capabilities:
        """Reach and clamp; damping and delay are assumed."""
        reach = [(float(middle - REACH_M), float(middle + REACH_M)) for middle in ORIGIN_M]
        return Capabilities(
            name=self.name,
            clamp_N=self.limits.clamp_N,
            calibrated=False,
            damping_N_s_per_m=0.5,
            delay_ticks=1.5,
            workspace_m=(reach[0], reach[1], reach[2]),
        )

    def home(self) -> None:
        """Wait, with zero force, until the SDK knows the position; DeviceError after the time-out."""
        self.tell("Homing: pull the grip all the way out, then push it all the way in.")
        self._wait_until(
            lambda: self.state is State.ARMED, self._homing_timeout_s, lambda: "homing never completed"
        )

    def compiled(self) -> CompiledIO | None:
        """The addresses of three of the SDK's functions; None when closed."""
        if self._sdk is None:
            return None
        asked = ("dhdGetPosition", "dhdSetForce", "dhdGetButtonMask")
        addresses = [ctypes.cast(getattr(self._sdk.library, name), c_void_p).value or 0 for name in asked]
        handles = np.array([*addresses, self._sdk.identity], np.int64)
        return CompiledIO("tissueid.haptics.forcedimension.servo_io:SDK", handles)

    def _open(self) -> None:
        sdk = Sdk()
        sdk.open_falcon()
        self._sdk = sdk
        try:
            sdk.call("dhdSetGravityCompensation", 0)
            sdk.call("dhdSetMaxForce", self.limits.clamp_N)
            sdk.call("dhdEnableForce", 1)
        except DeviceError:
            self._close()
            raise

    def _close(self) -> None:
        sdk, self._sdk = self._sdk, None
        if sdk is not None:
            sdk.close()

    def _read(self) -> DeviceSample:
        sdk = self._opened()
        place, status = [c_double() for _ in range(3)], (c_int * STATUS_ENTRIES)()
        sdk.call("dhdGetPosition", *map(byref, place))
        sdk.call("dhdGetStatus", status)
        position = ROTATION @ [coordinate.value for coordinate in place] + ORIGIN_M
        return DeviceSample(
            time_s=time.monotonic(),
            position_m=position,
            counts=steps_of(position),
            buttons=wire_buttons(int(sdk.library.dhdGetButtonMask(sdk.identity))),
            homed=bool(status[STATUS_RESET]),
            valid=True,
        )

    def _write(self, force_N: FloatArray) -> None:
        self._opened().call("dhdSetForce", *(ROTATION.T @ force_N).tolist())

    def _opened(self) -> Sdk:
        if self._sdk is None:
            raise DeviceError("the device is closed")
        return self._sdk
