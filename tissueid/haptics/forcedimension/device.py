"""A Falcon driven by the Force Dimension SDK.

The SDK homes the device, computes its kinematics and carries its firmware.  Its frame is mapped to ours here
and nowhere else; the mapping is from documentation, and no unit has confirmed it.

One bit means one button in every limit, log and message: 0x01 plus, 0x02 forward, 0x04 centre, 0x08 minus, so
that the dead-man button is the centre whoever drives the device.  The SDK numbers them centre 0, left 1,
up 2, right 3; from documentation, no unit has confirmed it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import tick_part
from tissueid.errors import DeviceError
from tissueid.haptics.device import (
    HANDLES_SIZE,
    HOMING_TIMEOUT_S,
    AskedDevice,
    Capabilities,
    CompiledIO,
    DetectedDevice,
    DeviceSample,
    HapticDevice,
    await_homed,
)
from tissueid.haptics.forcedimension.sdk import Sdk
from tissueid.haptics.limits import GuardLimits

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
    """The first Falcon that the SDK opens.

    ``limits``: by default at most 2 N with the dead-man button; ``library``: path of the SDK's library;
    searched for by default; ``tell``: told what the user has to do, ``tell(sentence)``.
    """

    name = "forcedimension"

    def __init__(
        self,
        limits: GuardLimits | None = None,
        *,
        library: str | None = None,
        tell: Callable[[str], None] | None = None,
        homing_timeout_s: float = HOMING_TIMEOUT_S,
    ) -> None:
        super().__init__(GuardLimits() if limits is None else limits)
        self._library = library
        if tell is not None:
            self.tell = tell
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
        except DeviceError:
            return []
        try:
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
        """Wait, with zero force, until the SDK knows the position.

        Raises DeviceError: after the time-out.
        """
        self.tell("Homing: pull the grip all the way out, then push it all the way in.")
        await_homed(self, self._homing_timeout_s)

    def compiled(self) -> CompiledIO | None:
        """The addresses of three of the SDK's functions; None when closed."""
        if self._sdk is None:
            return None
        handles = np.zeros(HANDLES_SIZE, np.int64)
        handles[:4] = (
            self._sdk.address("dhdGetPosition"),
            self._sdk.address("dhdSetForce"),
            self._sdk.address("dhdGetButtonMask"),
            self._sdk.identity,
        )
        constants = np.concatenate([ROTATION.ravel(), ORIGIN_M])
        return CompiledIO("tissueid.haptics.forcedimension.servo_io:SDK", handles, constants)

    def _open(self) -> None:
        sdk = Sdk(self._library)
        sdk.open_falcon()
        self._sdk = sdk
        try:
            sdk.prepare(self.limits.clamp_N)
        except DeviceError:
            self._close()
            raise

    def _close(self) -> None:
        sdk, self._sdk = self._sdk, None
        if sdk is not None:
            sdk.close()

    def _read(self) -> DeviceSample:
        sdk = self._opened()
        return DeviceSample(
            time_s=time.monotonic(),
            position_m=ROTATION @ np.array(sdk.position()) + ORIGIN_M,
            counts=np.zeros(3, np.int64),
            buttons=wire_buttons(sdk.buttons()),
            homed=sdk.is_homed(),
            valid=True,
        )

    def _write(self, force_N: NDArray[np.float64]) -> None:
        x, y, z = (ROTATION.T @ force_N).tolist()
        self._opened().set_force(x, y, z)

    def _opened(self) -> Sdk:
        if self._sdk is None:
            msg = "the device is closed"
            raise DeviceError(msg)
        return self._sdk
