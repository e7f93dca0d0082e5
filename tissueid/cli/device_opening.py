"""Haptic devices for sub-commands: made from options, opened, asked for consent, calibrated."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.output import note
from tissueid.errors import DeviceError, UsageError

if TYPE_CHECKING:
    from tissueid.haptics.device import HapticDevice
    from tissueid.haptics.falcon.calibration import Calibration

__all__ = [
    "FALCONS",
    "ask_consent",
    "check_savable",
    "device_options",
    "hang_mass",
    "made_device",
    "opened",
    "save",
]

#: Devices whose driver is the Falcon's own, and takes a port, firmware and calibration.
FALCONS = ("falcon", "emulator")
HANDS_OFF = (
    "The motors will move the grip by themselves, with at most {clamp:.1f} N. Keep hands, hair and cables "
    "away from it. If anything goes wrong, pull the power plug."
)
#: Time to hang the mass where no key can be pressed [s].
HANG_S = 20.0


FIRMWARE_HELP = "Firmware of a Falcon that has none running. [default: $TISSUEID_FALCON_FIRMWARE]"
CALIBRATION_HELP = "Calibration of a Falcon. [default: falcon.toml in the user's configuration directory]"


def device_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """Options that name a device and the way to it."""
    for option in (
        click.option("--firmware", type=click.Path(), metavar="FILE", help=FIRMWARE_HELP),
        click.option("--port", metavar="PATH", help="Serial port or pseudo-terminal instead of USB."),
        click.option("--calibration", type=click.Path(), metavar="FILE", help=CALIBRATION_HELP),
    ):
        function = option(function)
    return function


def made_device(flags: dict[str, Any], *, hands_off: bool = False, stand_in: bool = False) -> HapticDevice:
    """The device that was named, with its options; not opened.

    Parameters
    ----------
    flags : dict
        Of the command line.
    hands_off : bool
        For measurements of the free grip.
    stand_in : bool
        Whether the simulated device may be taken where none was named and none is there.

    Raises
    ------
    UsageError
        No such device, or an option of another.
    DeviceError
        None was named and none is there.
    """
    from tissueid.haptics.falcon.device import limits_of
    from tissueid.haptics.registry import choose_device, device_class

    given = [key for key in ("port", "firmware", "calibration") if flags[key] is not None]
    name = flags["name"]
    if name == "auto" and flags["port"] is not None:
        name = "falcon"
    choice = choose_device(name)
    if name == "auto" and choice.name == "sim" and not stand_in:
        msg = f"{choice.why.partition(': ')[2]}. Name one that needs no hardware: emulator or sim"
        raise DeviceError(msg)
    if name == "auto":
        note(choice.why, quiet=flags["quiet"])
    options: dict[str, Any] = {}
    if choice.name in FALCONS:
        calibration = _calibration(choice.name, flags["calibration"])
        options = {"calibration": calibration, "firmware": flags["firmware"], "tell": _teller(flags)}
        options["limits"] = limits_of(calibration, hands_off=hands_off)
        if choice.name == "falcon":
            options["port"] = flags["port"]
        elif flags["port"] is not None:
            msg = "--port belongs to the device falcon: the emulator opens its own"
            raise UsageError(msg)
    elif given:
        msg = f"--{given[0]} belongs to a Falcon, and the device is {choice.name}"
        raise UsageError(msg)
    elif choice.name == "forcedimension":
        options = {"tell": _teller(flags)}
    if choice.name != "emulator" and "tell" in options and flags.get("timeout") is not None:
        options["homing_timeout_s"] = flags["timeout"]
    return device_class(choice.name)(**options)


def _calibration(name: str, file: str | None) -> Calibration:
    """The named calibration, or the user's; that is of a real device and says nothing of an emulated one."""
    from tissueid.haptics.falcon.calibration import Calibration, load_calibration

    if name == "emulator" and file is None:
        return Calibration()
    return load_calibration(None if file is None else Path(file))


def _teller(flags: dict[str, Any]) -> Callable[[str], None]:
    return lambda sentence: note(sentence, quiet=flags["quiet"])


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


def ask_consent(device: HapticDevice, flags: dict[str, Any]) -> None:
    """Consent to a grip that moves by itself."""
    warning = HANDS_OFF.format(clamp=device.limits.clamp_N)
    if flags["yes"]:
        note(warning, quiet=flags["quiet"])
        return
    if not sys.stdin.isatty():
        msg = f"{warning} Give --yes where nobody can be asked"
        raise UsageError(msg)
    click.confirm(f"{warning} Go on?", abort=True, err=True)


def hang_mass(flags: dict[str, Any]) -> Callable[[], None]:
    """Ask for the mass to be hung; where nobody can answer, wait."""

    def ask() -> None:
        if sys.stdin.isatty():
            click.prompt(f"Hang {flags['mass']:g} g on the grip, then press Enter", default="", err=True)
        else:
            note(f"hang {flags['mass']:g} g on the grip now: {HANG_S:g} s", quiet=flags["quiet"])
            time.sleep(HANG_S)

    return ask


def check_savable(device: HapticDevice, flags: dict[str, Any], *, wanted: bool) -> None:
    """A measurement of something else must not become a Falcon's calibration."""
    if wanted and not _is_savable(device, flags):
        msg = f"--save keeps the calibration of a Falcon, and the device is {device.name}"
        raise UsageError(msg)


def _is_savable(device: HapticDevice, flags: dict[str, Any]) -> bool:
    return device.name == "falcon" or (device.name in FALCONS and flags["calibration"] is not None)


def save(device: HapticDevice, flags: dict[str, Any], **changes: Any) -> None:
    """Put what was measured into the calibration file."""
    from tissueid.haptics.falcon.calibration import save_calibration

    if not _is_savable(device, flags):
        note(
            "not kept: an emulator has no calibration of its own; name a file with --calibration",
            quiet=flags["quiet"],
        )
        return
    calibration: Calibration = device.calibration  # type: ignore[attr-defined]
    file = None if flags["calibration"] is None else Path(flags["calibration"])
    path = save_calibration(replace(calibration, **changes), file)
    note(f"kept in {path}", quiet=flags["quiet"])
