"""``tissueid devices``: which haptic devices are there, and what they measure of themselves."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.flags import FROM_0, PATH, Flags, OutputFlags, argument, example_lines, option, subcommand
from tissueid.cli.output import note, tell
from tissueid.digits import with_error
from tissueid.documents import plain, typed
from tissueid.documents.devices import Info
from tissueid.errors import DeviceError, refuse

if TYPE_CHECKING:
    from tissueid.haptics.device import AskedDevice, HapticDevice

HANDS_OFF = (
    "The motors will move the grip by themselves, with at most {clamp:.1f} N. Keep hands, hair and cables "
    "away from it. If anything goes wrong, pull the power plug."
)
#: Time to hang the mass where no key can be pressed [s].
HANG_S = 20.0


class WayFlags(Flags):
    """Flags of the way to a device."""

    firmware: str | None = option(
        "Firmware of a Falcon that has none running. [default: $TISSUEID_FALCON_FIRMWARE]",
        type=PATH,
        metavar="FILE",
    )
    port: str | None = option("Serial port or pseudo-terminal instead of USB.", metavar="PATH")
    calibration: str | None = option(
        "Calibration of a Falcon. [default: falcon.toml in the user's configuration directory]",
        type=PATH,
        metavar="FILE",
    )


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
    """The device that was named, not opened; ``stand_in``: sim may be taken where none is there."""
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


def asked_device(flags: WayFlags, *, hands_off: bool = False) -> AskedDevice:
    """Options of the way to a device, of those on the command line."""
    from tissueid.haptics.device import AskedDevice

    file = flags.calibration
    keeps = hands_off or getattr(flags, "save", False)  # a measurement makes the file
    if file is not None and not keeps and not Path(file).exists():
        refuse(f"--calibration {file}: there is no such file; without it the user's own is taken")
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
    from tissueid.haptics.device import WAYS_OUT

    def interrupt(_number: int, _frame: object) -> None:
        raise KeyboardInterrupt

    before = {}
    if threading.current_thread() is threading.main_thread():
        before = {number: signal.signal(number, interrupt) for number in WAYS_OUT}
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
        refuse(f"{warning} Give --yes where nobody can be asked")
    click.confirm(f"{warning} Go on?", abort=True, err=True)


def hang_mass(mass_g: float, quiet: int) -> None:
    """Ask for the mass to be hung; where nobody can answer, wait."""
    if sys.stdin.isatty():
        click.prompt(f"Hang {mass_g:g} g on the grip, then press Enter", default="", err=True)
    else:
        note(f"hang {mass_g:g} g on the grip now: {HANG_S:g} s", quiet=quiet)
        time.sleep(HANG_S)


@contextlib.contextmanager
def homed_for_calibration(flags: MovedFlags) -> Iterator[HapticDevice]:
    """The device that was named, open and homed with consent, for a measurement its calibration keeps."""
    made = made_device(flags, hands_off=True)
    if "calibration" not in made.takes:
        refuse(f"the device {made.name} has no calibration that could keep a measurement; name a falcon")
    ask_consent(made, flags)
    with opened(made) as device:
        device.home()
        yield device


def save(device: HapticDevice, flags: DeviceFlags | MovedFlags, **changes: Any) -> None:
    """Put what was measured into the calibration file."""
    file = asked_device(flags, hands_off=True).calibration
    said = f"not kept: the device {device.name} has no calibration; name a file with --calibration"
    if device.keeps(file):
        said = f"kept in {device.keep(file, changes)}"
    note(said, quiet=flags.quiet)


EXAMPLES = """
tissueid devices list
tissueid devices info falcon
tissueid devices home
tissueid devices test falcon
tissueid devices emulate
"""

#: Hands of the emulator; importing them would cost numpy.
HANDS = ("step", "slow press", "tap", "release", "tremor", "hold")


@click.group("devices", epilog=example_lines(EXAMPLES))
def command() -> None:
    """Find, home, test and calibrate haptic devices, or emulate one.

    No real device has confirmed what tissueid knows of it: docs/hardware-checklist.md says how to check. The
    motors stay without force in list, info, home and test.
    """


@subcommand("list", "", "--json", group=command)
def list_devices(flags: OutputFlags) -> int:
    """List the devices of this machine, with what stands in the way of each."""
    from tissueid.haptics.registry import detect_all, device_names

    found = list(detect_all())
    lines = [
        line for one in found for line in (f"{one.name:16}{one.where}", f"{'':16}{one.note}") if line.strip()
    ]
    missing = sorted(set(device_names()) - {one.name for one in found})
    lines += [f"not found: {', '.join(missing)}"] if missing else []
    tell(flags, {"known": device_names(), "found": [asdict(one) for one in found]}, lines)
    return 0


@subcommand("info", "", "falcon --json", group=command)
def info(flags: DeviceFlags) -> int:
    """Say what a device can do, and how much of it was measured."""
    device = made_device(flags, stand_in=True)
    described = asdict(device.capabilities)
    described["workspace_mm"] = [[1e3 * low, 1e3 * high] for low, high in described.pop("workspace_m")]
    described |= device.facts()
    tell(flags, described, _info_lines(typed(described, Info), described.get("calibration", {})))
    return 0


def _info_lines(document: Info, calibration: Mapping[str, Any]) -> Iterator[str]:
    yield f"{document.name}: force at most {document.clamp_N:.2f} N, nominal"
    yield f"damping {document.damping_N_s_per_m:g} N s/m, delay {document.delay_ticks:g} ticks"
    for axis, (low, high) in zip("xyz", document.workspace_mm, strict=True):
        yield f"{axis} from {low:.0f} to {high:.0f} mm"
    yield from (f"{key} = {value}" for key, value in calibration.items())
    if document.hardware and not document.calibrated:
        yield "not calibrated: a newton of this device may be anything from 0.5 to 2 N"


class _HomeFlags(DeviceFlags):
    timeout: float = option(
        "Give up after so many seconds.", type=click.FloatRange(min=1.0), default=60.0, metavar="S"
    )


@subcommand("home", "", "falcon --firmware firmware.bin --timeout 120", group=command)
def home(flags: _HomeFlags) -> int:
    """Load firmware if needed, and home the device with your hand; the motors stay without force."""
    with opened(made_device(flags)) as device:
        device.home()
        place = device.read().position_m
    millimetres = [round(1e3 * float(value), 2) for value in place]
    lines = [f"{device.name} is homed; the grip is at {millimetres} mm"]
    tell(flags, {"name": device.name, "homed": True, "position_mm": millimetres}, lines)
    return 0


class _TestFlags(DeviceFlags):
    seconds: float = option(
        "Time to measure for.", type=click.FloatRange(0.1, 3600.0), default=5.0, metavar="S"
    )
    save: bool = option("Keep the measured delay in the calibration.")


@subcommand("test", "", "falcon --seconds 30 --save", "falcon --port /dev/ttyUSB0 --json", group=command)
def test(flags: _TestFlags) -> int:
    """Measure rate, delay and errors of the link, without force and without homing."""
    from tissueid.haptics.measure import measure_link

    made = made_device(flags)
    if flags.save and not made.keeps(asked_device(flags).calibration):
        refuse(f"--save keeps the calibration of a real device, and the device is {made.name}")
    with opened(made) as device:
        report = measure_link(device, flags.seconds)
    median, high, largest = report.round_trip_ms
    unanswered = report.commands - report.replies
    lines = [
        f"{report.rate_hz:.0f} replies a second, each command waiting for its answer",
        f"round trip {median:.3f} ms, 95 % below {high:.3f} ms, longest {largest:.3f} ms",
        f"delay {report.delay_ticks:.2f} ticks of 1 ms, with half a tick for the device itself",
        f"{report.commands} commands, {unanswered} unanswered, {report.damaged} damaged replies",
    ]
    tell(flags, plain(report), lines)
    if flags.save:
        save(device, flags, delay_ticks=report.delay_ticks, delay_measured=True)
    return 0


class _CalibrateForceFlags(MovedFlags):
    mass: float = option(
        "Mass hung on the grip [g].", type=click.FloatRange(10.0, 1000.0), required=True, metavar="G"
    )


@subcommand("calibrate-force", "--mass 100", "falcon --mass 100 --yes --json", group=command)
def calibrate_force(flags: _CalibrateForceFlags) -> int:
    """Weigh a known mass with the device, and keep how many motor units make a newton.

    The device holds the grip, first alone, then with the mass hung on it. 50 to 150 g suit a device that was
    never calibrated. The result goes into the calibration file.
    """
    from tissueid.haptics.measure import weigh

    with homed_for_calibration(flags) as device:
        found = weigh(device, 1e-3 * flags.mass, lambda: hang_mass(flags.mass, flags.quiet))
    before = float(device.facts()["calibration"]["units_per_Nm"])
    units = before * found.ratio
    document = {**asdict(found), "units_per_Nm": units, "units_per_Nm_before": before}
    ratio = with_error(found.ratio, found.stderr)
    lines = [
        f"held {found.empty_N:.3f} N without and {found.loaded_N:.3f} N with {found.weight_N:.3f} N",
        f"{ratio} nominal newton for one true newton: {units:.0f} motor units for one N m",
    ]
    tell(flags, document, lines)
    # a weight in the newtons of before is none
    save(device, flags, units_per_Nm=units, force_calibrated=True, weight_measured=False)
    return 0


@subcommand("calibrate-damping", "", "falcon --yes --json", group=command)
def calibrate_damping(flags: MovedFlags) -> int:
    """Let the free grip swing on a weak spring, and keep the damping of the arm.

    Calibrate the force first: damping is as wrong as the newton it is measured with.
    """
    from tissueid.haptics.measure import TICK_S, ring_down

    with homed_for_calibration(flags) as device:
        found = ring_down(device, device.capabilities.delay_ticks * TICK_S)
    damping = with_error(found.damping_N_s_per_m, found.damping_stderr)
    lines = [
        f"damping {damping} N s/m, of which {found.safe_damping:.3f} are relied on",
        f"mass {found.mass_kg:.3f} kg, friction {found.friction_N:.3f} N",
    ]
    tell(flags, {**asdict(found), "safe_damping_N_s_per_m": found.safe_damping}, lines)
    save(device, flags, damping_N_s_per_m=found.safe_damping, damping_measured=True)
    return 0


@subcommand("calibrate-weight", "", "falcon --yes --json", group=command)
def calibrate_weight(flags: MovedFlags) -> int:
    """Hold the free grip at nine places, and keep the force that carries it there.

    A guided session carries the tool with it. Calibrate the force first: the weight is as wrong as the newton
    it is measured with.
    """
    from tissueid.haptics.measure import weigh_poses

    with homed_for_calibration(flags) as device:
        found = weigh_poses(device)
    words = ", ".join(f"{value:.3f}" for value in found.weight_N)
    lines = [
        f"held with ({words}) N in the middle, each to {found.stderr_N:.3f} N",
        f"{found.poses} poses; a plane leaves {found.residual_N:.3f} N",
    ]
    tell(flags, asdict(found), lines)
    slope = tuple(value for row in found.slope_N_per_m for value in row)
    save(device, flags, weight_N=found.weight_N, weight_slope_N_per_m=slope, weight_measured=True)
    return 0


class _EmulateFlags(OutputFlags):
    no_firmware: bool = option("Switched on without firmware, as a real one.")
    failing_tries: int = option(
        "Uploads that fail first.", type=FROM_0, default=0, show_default=False, metavar="N"
    )
    never_homes: bool = option("The emulated user does not home it.")
    hand: str | None = option("What the hand does after homing.", type=click.Choice(HANDS))
    depth_mm: float = option("Depth the hand aims at.", default=10.0)
    script: str | None = option('Carried like a machine: "indent 8 mm at 250 mm/min; hold 2 s".')
    fault: tuple[str, ...] = option("Scripted fault, e.g. unplug@6 or jump@6:300.", metavar="KIND@S")


@subcommand(
    "emulate", "", "--no-firmware --failing-tries 2", '--hand "slow press" --fault unplug@6', group=command
)
def emulate(flags: _EmulateFlags) -> int:
    """Emulate a Falcon on a pseudo-terminal, print its path, and serve it until Ctrl-C.

    Any program that speaks the Falcon's protocol may open the path; tissueid does with --port. Nobody has
    compared the emulator with a real Falcon.
    """
    from tissueid.haptics.falcon.emulator.__main__ import main

    words = [f"--{key.replace('_', '-')}" for key in ("no_firmware", "never_homes") if getattr(flags, key)]
    for key in ("failing_tries", "hand", "depth_mm", "script"):
        if getattr(flags, key) is not None:
            words += [f"--{key.replace('_', '-')}", str(getattr(flags, key))]
    for fault in flags.fault:
        words += ["--fault", fault]
    return main(words)
