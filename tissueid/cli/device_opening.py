"""Haptic devices for sub-commands: made from options, opened, asked for consent, calibrated."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import click

from tissueid.cli.flags import PATH, Flags, OutputFlags, argument, option
from tissueid.cli.output import note
from tissueid.errors import DeviceError, UsageError

if TYPE_CHECKING:
    from tissueid.haptics.device import AskedDevice, HapticDevice

HANDS_OFF = (
    "The motors will move the grip by themselves, with at most {clamp:.1f} N. Keep hands, hair and cables "
    "away from it. If anything goes wrong, pull the power plug."
)
#: Time to hang the mass where no key can be pressed [s].
HANG_S = 20.0


FIRMWARE_HELP = "Firmware of a Falcon that has none running. [default: $TISSUEID_FALCON_FIRMWARE]"
CALIBRATION_HELP = "Calibration of a Falcon. [default: falcon.toml in the user's configuration directory]"


class WayLike(Protocol):
    """Anything that names the way to a device."""

    @property
    def firmware(self) -> str | None:
        """Firmware of a device that has none running."""

    @property
    def port(self) -> str | None:
        """Serial port or pseudo-terminal."""

    @property
    def calibration(self) -> str | None:
        """File of the calibration."""


class WayFlags(Flags):
    """Flags of the way to a device."""

    firmware: str | None = option(FIRMWARE_HELP, type=PATH, metavar="FILE")
    port: str | None = option("Serial port or pseudo-terminal instead of USB.", metavar="PATH")
    calibration: str | None = option(CALIBRATION_HELP, type=PATH, metavar="FILE")


class DeviceFlags(WayFlags, OutputFlags):
    """Flags of a command that takes one device."""

    name: str = argument(default="auto")


class MovedFlags(WayFlags, OutputFlags):
    """Flags of a command that moves the grip of one device by itself: not one that is merely there."""

    name: str = argument(default="falcon")
    yes: bool = option("Do not ask: nobody holds the grip.")


def made_device(
    flags: DeviceFlags | MovedFlags, *, hands_off: bool = False, stand_in: bool = False
) -> HapticDevice:
    """The device that was named, with its options; not opened.

    ``flags``: of the command line; ``hands_off``: for measurements of the free grip; ``stand_in``: whether
    the simulated device may be taken where none was named and none is there.  Raises UsageError: no such
    device, or an option of another; DeviceError: none was named and none is there.
    """
    from tissueid.haptics.registry import choose_device, configured, device_class, owners_of

    asked = asked_device(flags, hands_off=hands_off)
    name = flags.name
    if name == "auto" and asked.port is not None:
        name = owners_of("port")[0]
    choice = choose_device(name)
    if name == "auto" and choice.name == "sim" and not stand_in:
        msg = f"{choice.why.partition(': ')[2]}. Name one that needs no hardware: emulator or sim"
        raise DeviceError(msg)
    if name == "auto":
        note(choice.why, quiet=flags.quiet)
    device = device_class(choice.name)(**configured(choice.name, asked))
    device.tell = lambda sentence: note(sentence, quiet=flags.quiet)
    return device


def asked_device(flags: WayLike, *, hands_off: bool = False) -> AskedDevice:
    """Options of the way to a device, of those on the command line."""
    from tissueid.haptics.device import AskedDevice

    file = flags.calibration
    return AskedDevice(
        port=flags.port,
        firmware=flags.firmware,
        calibration=None if file is None else Path(file),
        hands_off=hands_off,
        homing_timeout_s=getattr(flags, "timeout", None),
    )


@contextlib.contextmanager
def opened(device: HapticDevice) -> Iterator[HapticDevice]:
    """The device, open; it is closed with zero force on every way out, that of a signal too."""

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    signals = (signal.SIGTERM, signal.SIGHUP)
    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, interrupt) for number in signals}
    try:
        with device:
            yield device
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def ask_consent(device: HapticDevice, flags: MovedFlags) -> None:
    """Consent to a grip that moves by itself."""
    warning = HANDS_OFF.format(clamp=device.limits.clamp_N)
    if flags.yes:
        note(warning, quiet=flags.quiet)
        return
    if not sys.stdin.isatty():
        msg = f"{warning} Give --yes where nobody can be asked"
        raise UsageError(msg)
    click.confirm(f"{warning} Go on?", abort=True, err=True)


def hang_mass(mass_g: float, *, quiet: int) -> Callable[[], None]:
    """Ask for the mass to be hung; where nobody can answer, wait."""

    def ask() -> None:
        if sys.stdin.isatty():
            click.prompt(f"Hang {mass_g:g} g on the grip, then press Enter", default="", err=True)
        else:
            note(f"hang {mass_g:g} g on the grip now: {HANG_S:g} s", quiet=quiet)
            time.sleep(HANG_S)

    return ask


def made_for_calibration(flags: DeviceFlags | MovedFlags) -> HapticDevice:
    """The device that was named, for a measurement of the free grip that its calibration keeps."""
    device = made_device(flags, hands_off=True)
    if "calibration" not in device.takes:
        msg = f"the device {device.name} has no calibration that could keep a measurement; name a falcon"
        raise UsageError(msg)
    return device


def check_savable(device: HapticDevice, flags: DeviceFlags | MovedFlags, *, wanted: bool) -> None:
    """Refuse to keep the measurement of a device that has no calibration of its own, before it is made."""
    if wanted and not device.keeps(asked_device(flags).calibration):
        msg = f"--save keeps the calibration of a real device, and the device is {device.name}"
        raise UsageError(msg)


def save(device: HapticDevice, flags: DeviceFlags | MovedFlags, **changes: Any) -> None:
    """Put what was measured into the calibration file."""
    file = asked_device(flags).calibration
    if device.keeps(file):
        note(f"kept in {device.keep(file, changes)}", quiet=flags.quiet)
    else:
        note(
            f"not kept: the device {device.name} has no calibration; name a file with --calibration",
            quiet=flags.quiet,
        )
