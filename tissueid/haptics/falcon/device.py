"""The Falcon as a device, as others reported of it: no unit has confirmed it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tissueid.errors import DeviceError
from tissueid.haptics.device import (
    HOMING_TIMEOUT_S,
    AskedDevice,
    Capabilities,
    CompiledIO,
    DetectedDevice,
    DeviceSample,
    HapticDevice,
)
from tissueid.haptics.falcon.calibration import Calibration, load_calibration, save_calibration
from tissueid.haptics.falcon.firmware import Firmware, ensure_running, find_firmware
from tissueid.haptics.falcon.kinematics import GUESS_M, angles_of_counts, forward_kernel, motor_units
from tissueid.haptics.falcon.packets import ALL_HOMED, PacketParser, Reply, encode_command, leds_of_state
from tissueid.haptics.falcon.transport import FileTransport, LibUsb, Transport
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.measure import UNSEEN_TICKS
from tissueid.haptics.states import State

#: What a user does to home a Falcon, in order.
HOMING_STEPS = (
    "Homing: pull the grip all the way out, then push it all the way in.",
    "Now pull the grip out towards you, until the light is green.",
)
#: Forces come only after the grip was pulled out this far: the end of homing leaves it deep inside [m].
PULLED_OUT_M = 0.170
#: How long a reading waits for a reply [s].
REPLY_WAIT_S = 0.002
#: Reach of the grip within the stops of the legs [m].
WORKSPACE_M = ((-0.090, 0.090), (-0.090, 0.090), (0.066, 0.183))
#: Sustained force the motors are trusted with, as a share of the clamp.
SUSTAINED_SHARE = 0.75
#: Time for a force that builds up slowly to lift the grip from its stop [s].
AT_STOP_S = 5.0


class FalconDevice(HapticDevice):
    """A Novint Falcon over USB, a serial port, or the emulator's descriptor.

    ``limits``, ``calibration``: by default the user's; ``port``: path of a terminal, or a descriptor of which
    a copy is used; USB by default; ``firmware``: a file; by default the environment names it;
    ``homing_timeout_s``: for each of the two movements of homing.
    """

    name = "falcon"
    takes = ("port", "firmware", "calibration")
    #: Calibration of a grip that must be free, where no file was named: the user's.
    own_calibration: ClassVar[Callable[[], Calibration]] = staticmethod(load_calibration)

    def __init__(
        self,
        limits: GuardLimits | None = None,
        *,
        port: str | int | None = None,
        firmware: str | os.PathLike[str] | None = None,
        calibration: Calibration | None = None,
        homing_timeout_s: float = HOMING_TIMEOUT_S,
    ) -> None:
        self.calibration = load_calibration() if calibration is None else calibration
        super().__init__(limits_of(self.calibration) if limits is None else limits)
        self._port = port
        self._firmware = firmware
        self._homing_timeout_s = homing_timeout_s
        self._geometry = self.calibration.legs().block()
        self._transport: Transport | None = None
        self._usb: LibUsb | None = None
        self._parser = PacketParser()
        self._invalid = 0
        self._quarter = 0
        self._reply = Reply((0, 0, 0), 0, 0)
        self._grip = np.array(GUESS_M)
        self._angles = np.empty(3)
        self._motor = np.zeros(3, np.int64)
        self._left = np.zeros(3)

    @classmethod
    def configured(cls, asked: AskedDevice) -> dict[str, Any]:
        """Arguments of the constructor for what was asked."""
        named = {"port": asked.port, "firmware": asked.firmware, "homing_timeout_s": asked.homing_timeout_s}
        found: dict[str, Any] = {key: value for key, value in named.items() if value is not None}
        if asked.calibration is not None:
            found["calibration"] = load_calibration(asked.calibration)
        if asked.hands_off:
            found.setdefault("calibration", cls.own_calibration())
            found["limits"] = limits_of(found["calibration"], hands_off=True)
        return found

    @classmethod
    def typical(cls) -> Capabilities:
        """Abilities before any calibration."""
        return cls(calibration=Calibration()).capabilities

    def facts(self) -> dict[str, Any]:
        """Its calibration."""
        return {"calibration": asdict(self.calibration)}

    def keeps(self, file: Path | None) -> bool:
        """Always: in the user's own file where none is named."""
        del file
        return True

    def keep(self, file: Path | None, changes: Mapping[str, Any]) -> Path:
        """Put what was measured into the calibration file; its path."""
        return save_calibration(replace(self.calibration, **changes), file)

    @classmethod
    def detect(cls) -> list[DetectedDevice]:
        """Falcons on the USB; a missing library or permission stands in the note."""
        try:
            usb = LibUsb()
        except DeviceError as error:
            return [DetectedDevice(cls.name, "USB, not searched", error.message)]
        try:
            return [DetectedDevice(cls.name, node, _hindrance(usb, node)) for node in usb.falcons()]
        finally:
            usb.close()

    @property
    def capabilities(self) -> Capabilities:
        """Reach, clamp and calibration."""
        return Capabilities(
            name=self.name,
            clamp_N=self.limits.clamp_N,
            calibrated=self.calibration.force_calibrated,
            damping_N_s_per_m=self.calibration.damping_N_s_per_m,
            delay_ticks=self.calibration.delay_ticks,
            workspace_m=WORKSPACE_M,
        )

    def home(self) -> None:
        """Wait with zero force until the user homed it and pulled the grip out; DeviceError late or lost."""
        self.tell(HOMING_STEPS[0])
        self._wait_until(lambda: self.state is State.ARMED, self._homing_timeout_s, self._not_homed)
        self.tell(HOMING_STEPS[1])
        self._wait_until(lambda: bool(self._grip[2] > PULLED_OUT_M), self._homing_timeout_s, self._not_pulled)

    def compiled(self) -> CompiledIO | None:
        """Descriptor or libusb's addresses, for the compiled loop; None when closed."""
        if self._transport is None:
            return None
        name, handles = self._transport.handles
        constants = np.concatenate([[self.calibration.units_per_Nm], self._geometry])
        return CompiledIO(f"tissueid.haptics.falcon.servo_io:{name}", np.array(handles, np.int64), constants)

    def _open(self) -> None:
        self._parser = PacketParser()
        self._invalid = 0
        try:
            self._transport = ensure_running(self._open_transport, self._find_firmware, self._tell_progress)
            self._command()
        except BaseException:
            self._close()
            raise

    def _close(self) -> None:
        transport, self._transport = self._transport, None
        usb, self._usb = self._usb, None
        if transport is not None:
            transport.close()
        if usb is not None:
            usb.close()

    def _read(self) -> DeviceSample:
        transport = self._opened()
        deadline = time.monotonic() + REPLY_WAIT_S
        replies: list[Reply] = []
        while not replies and (left := deadline - time.monotonic()) > 0.0:
            replies = self._parser.feed(transport.read(left))
            if self._parser.invalid > self._invalid:
                # the answer came, and was damaged: there is no other to wait for
                break
        damaged, self._invalid = self._parser.invalid - self._invalid, self._parser.invalid
        if replies:
            self._reply = replies[-1]
        counts = np.array(self._reply.encoders, np.int64)
        homed = self._reply.homed == ALL_HOMED
        angles_of_counts(counts, self._geometry, self._angles)
        found = forward_kernel(self._angles, self._geometry, self._grip) >= 0
        valid = bool(replies)
        if valid and homed and not found:
            # counts that no grip position has: as good as a damaged reply
            valid, damaged = False, damaged + 1
        return DeviceSample(
            time_s=time.monotonic(),
            position_m=self._grip.copy(),
            counts=counts,
            buttons=self._reply.buttons,
            homed=homed,
            valid=valid,
            damaged=damaged,
        )

    def _write(self, force_N: NDArray[np.float64]) -> None:
        motor_units(
            force_N,
            self._grip,
            self._geometry,
            self.calibration.units_per_Nm,
            self.limits.motor_clamp,
            self._motor,
            self._left,
        )
        self._command()

    def _command(self) -> None:
        """Send the motor values with the light of the state; homing mode stays, or homing is lost."""
        self._opened().write(encode_command(self._motor, leds=leds_of_state(int(self.state)), homing=True))

    def _opened(self) -> Transport:
        if self._transport is None:
            raise DeviceError("the Falcon is closed")
        return self._transport

    def _open_transport(self) -> Transport:
        if self._port is None:
            if self._usb is None:
                self._usb = LibUsb()
            return self._usb.open()
        if isinstance(self._port, int):
            return FileTransport(os.dup(self._port), f"descriptor {self._port}")
        return FileTransport.open(self._port)

    def _find_firmware(self) -> Firmware:
        firmware = find_firmware(self._firmware)
        if firmware.warning is not None:
            self.tell(firmware.warning)
        self.tell(f"loading firmware {firmware.path}")
        return firmware

    def _tell_progress(self, message: str, done: int, total: int) -> None:
        """Tell of a failed try, and of every quarter of an upload."""
        self.while_waiting()
        quarter = 4 * done // total
        if done == 0:
            self.tell(message)
        elif quarter != self._quarter:
            self.tell(f"{message}: {done} of {total} bytes")
        self._quarter = quarter

    def _not_homed(self) -> str:
        missing = [str(leg + 1) for leg in range(3) if not self._reply.homed >> leg & 1]
        if not self._parser.packets:
            return "homing never completed: the device does not answer. Is its power supply plugged in?"
        which = f"leg {' and '.join(missing)}" if missing else "steadiness"
        return (
            f"homing never completed ({which} missing after {self._parser.packets} replies): "
            "pull the grip all the way out, push it all the way in, and try again"
        )

    def _not_pulled(self) -> str:
        return (
            f"the grip was not pulled out: it is at {1e3 * self._grip[2]:.0f} mm and forces wait for "
            f"{1e3 * PULLED_OUT_M:.0f} mm. If it is all the way out, set the zero angle (docs/devices.md)"
        )


def limits_of(calibration: Calibration, *, hands_off: bool = False) -> GuardLimits:
    """Limits that a calibration allows; ``hands_off``: for a free grip, which may rest at its stop."""
    clamp = calibration.clamp_N
    limits = GuardLimits(
        clamp_N=clamp,
        rms_limit_N=SUSTAINED_SHARE * clamp,
        motor_clamp=calibration.clamp_units,
        dead_man=True,
        delay_ticks=max(calibration.delay_ticks, UNSEEN_TICKS),
    )
    return replace(limits, dead_man=False, frozen_s=AT_STOP_S) if hands_off else limits


def _hindrance(usb: LibUsb, node: str) -> str:
    """Why a Falcon that is there can't be opened; empty if it can."""
    try:
        usb.open(node).close()
    except DeviceError as error:
        return error.message
    return ""
