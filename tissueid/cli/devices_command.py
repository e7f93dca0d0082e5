"""``tissueid devices``: which haptic devices are there, and what they measure of themselves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import click

from tissueid.cli.device_opening import (
    DeviceFlags,
    MovedFlags,
    ask_consent,
    check_savable,
    hang_mass,
    made_device,
    made_for_calibration,
    opened,
    save,
)
from tissueid.cli.flags import OutputFlags, option, takes
from tissueid.cli.output import echo, echo_json
from tissueid.digits import with_error
from tissueid.documents import typed
from tissueid.documents.devices import Info

if TYPE_CHECKING:
    from tissueid.haptics.device import HapticDevice

EPILOG = """\b
Examples:
  tissueid devices list
  tissueid devices info falcon
  tissueid devices home
  tissueid devices test falcon
  tissueid devices emulate
"""

GRAM = 1e-3
#: Hands of the emulator; importing them would cost numpy.
HANDS = ("step", "slow press", "tap", "release", "tremor", "hold")


@click.group("devices", epilog=EPILOG)
def command() -> None:
    """Find, home, test and calibrate haptic devices, or emulate one.

    No real device has confirmed what tissueid knows of it: docs/hardware-checklist.md says how to check. The
    motors stay without force in list, info, home and test.
    """


def _sub(name: str, examples: str) -> Callable[[Callable[..., int]], click.Command]:
    """A sub-command with its examples."""

    def decorate(function: Callable[..., int]) -> click.Command:
        lines = "".join(f"  tissueid devices {line}\n" for line in examples.splitlines())
        return command.command(name, epilog=f"\b\nExamples:\n{lines}")(function)

    return decorate


#: Not one that is merely there: the grip will move by itself.


@dataclass(frozen=True, kw_only=True)
class ListDevicesFlags(OutputFlags):
    """Flags of ``tissueid list-devices``."""


@_sub("list", "list\nlist --json")
@takes(ListDevicesFlags)
def list_devices(flags: ListDevicesFlags) -> int:
    """List the devices of this machine, with what stands in the way of each."""
    from tissueid.haptics.registry import detect_all, device_names

    found = list(detect_all())
    if flags.as_json:
        echo_json({"known": device_names(), "found": [asdict(one) for one in found]})
        return 0
    if flags.quiet:
        return 0
    for one in found:
        echo(f"{one.name:16}{one.where}")
        if one.note:
            echo(f"{'':16}{one.note}")
    missing = sorted(set(device_names()) - {one.name for one in found})
    if missing:
        echo(f"not found: {', '.join(missing)}")
    return 0


@dataclass(frozen=True, kw_only=True)
class InfoFlags(DeviceFlags):
    """Flags of ``tissueid info``."""


@_sub("info", "info\ninfo falcon --json")
@takes(InfoFlags)
def info(flags: InfoFlags) -> int:
    """Say what a device can do, and how much of it was measured."""
    device = made_device(flags, stand_in=True)
    described = _described(device)
    if flags.as_json:
        echo_json(described)
        return 0
    if flags.quiet:
        return 0
    document = typed(described, Info)
    echo(f"{document.name}: force at most {document.clamp_N:.2f} N, nominal")
    echo(f"damping {document.damping_N_s_per_m:g} N s/m, delay {document.delay_ticks:g} ticks")
    for axis, (low, high) in zip("xyz", document.workspace_mm, strict=True):
        echo(f"{axis} from {low:.0f} to {high:.0f} mm")
    for key, value in described.get("calibration", {}).items():
        echo(f"{key} = {value}")
    if document.hardware and not document.calibrated:
        echo("not calibrated: a newton of this device may be anything from 0.5 to 2 N")
    return 0


@dataclass(frozen=True, kw_only=True)
class HomeFlags(DeviceFlags):
    """Flags of ``tissueid home``."""

    # fmt: off
    timeout: float = option(
        "--timeout", type=click.FloatRange(min=1.0), default=60.0, show_default=True, metavar="S",
        help="Give up after so many seconds.",
    )
    # fmt: on


@_sub("home", "home\nhome falcon --firmware firmware.bin --timeout 120")
@takes(HomeFlags)
def home(flags: HomeFlags) -> int:
    """Load firmware if needed, and home the device with your hand; the motors stay without force."""
    with opened(made_device(flags)) as device:
        device.home()
        place = device.read().position_m
    millimetres = [round(1e3 * float(value), 2) for value in place]
    if flags.as_json:
        echo_json({"name": device.name, "homed": True, "position_mm": millimetres})
    elif not flags.quiet:
        echo(f"{device.name} is homed; the grip is at {millimetres} mm")
    return 0


@dataclass(frozen=True, kw_only=True)
class TestFlags(DeviceFlags):
    """Flags of ``tissueid test``."""

    # fmt: off
    seconds: float = option(
        "--seconds", type=click.FloatRange(0.1, 3600.0), default=5.0, show_default=True, metavar="S",
        help="Time to measure for.",
    )
    save: bool = option("--save", is_flag=True, help="Keep the measured delay in the calibration.")
    # fmt: on


@_sub("test", "test\ntest falcon --seconds 30 --save\ntest falcon --port /dev/ttyUSB0 --json")
@takes(TestFlags)
def test(flags: TestFlags) -> int:
    """Measure rate, delay and errors of the link, without force and without homing."""
    from tissueid.haptics.measure import measure_link

    made = made_device(flags)
    check_savable(made, flags, wanted=flags.save)
    with opened(made) as device:
        report = measure_link(device, flags.seconds)
    document = {"name": device.name, **asdict(report)}
    if flags.as_json:
        echo_json(document)
    elif not flags.quiet:
        median, high, largest = report.round_trip_ms
        echo(f"{report.rate_hz:.0f} replies a second, each command waiting for its answer")
        echo(f"round trip {median:.3f} ms, 95 % below {high:.3f} ms, longest {largest:.3f} ms")
        echo(f"delay {report.delay_ticks:.2f} ticks of 1 ms, with half a tick for the device itself")
        unanswered = report.commands - report.replies
        echo(f"{report.commands} commands, {unanswered} unanswered, {report.damaged} damaged replies")
    if flags.save:
        save(device, flags, delay_ticks=report.delay_ticks, delay_measured=True)
    return 0


@dataclass(frozen=True, kw_only=True)
class CalibrateForceFlags(MovedFlags):
    """Flags of ``tissueid calibrate-force``."""

    # fmt: off
    mass: float = option(
        "--mass", type=click.FloatRange(10.0, 1000.0), required=True, metavar="G",
        help="Mass hung on the grip [g].",
    )
    # fmt: on


@_sub("calibrate-force", "calibrate-force --mass 100\ncalibrate-force falcon --mass 100 --yes --json")
@takes(CalibrateForceFlags)
def calibrate_force(flags: CalibrateForceFlags) -> int:
    """Weigh a known mass with the device, and keep how many motor units make a newton.

    The device holds the grip, first alone, then with the mass hung on it. 50 to 150 g suit a device that was
    never calibrated. The result goes into the calibration file.
    """
    from tissueid.haptics.measure import weigh

    made = made_for_calibration(flags)
    ask_consent(made, flags)
    with opened(made) as device:
        device.home()
        found = weigh(device, flags.mass * GRAM, hang_mass(flags.mass, quiet=flags.quiet))
    before = float(made.facts()["calibration"]["units_per_Nm"])
    units = before * found.ratio
    document = {**asdict(found), "units_per_Nm": units, "units_per_Nm_before": before}
    if flags.as_json:
        echo_json(document)
    elif not flags.quiet:
        ratio = with_error(found.ratio, found.stderr)
        echo(f"held {found.empty_N:.3f} N without and {found.loaded_N:.3f} N with {found.weight_N:.3f} N")
        echo(f"{ratio} nominal newton for one true newton: {units:.0f} motor units for one N m")
    # a weight in the newtons of before is none
    save(made, flags, units_per_Nm=units, force_calibrated=True, weight_measured=False)
    return 0


@dataclass(frozen=True, kw_only=True)
class CalibrateDampingFlags(MovedFlags):
    """Flags of ``tissueid calibrate-damping``."""


@_sub("calibrate-damping", "calibrate-damping\ncalibrate-damping falcon --yes --json")
@takes(CalibrateDampingFlags)
def calibrate_damping(flags: CalibrateDampingFlags) -> int:
    """Let the free grip swing on a weak spring, and keep the damping of the arm.

    Calibrate the force first: damping is as wrong as the newton it is measured with.
    """
    from tissueid.haptics.measure import TICK_S, ring_down

    made = made_for_calibration(flags)
    ask_consent(made, flags)
    with opened(made) as device:
        device.home()
        found = ring_down(device, device.capabilities.delay_ticks * TICK_S)
    if flags.as_json:
        echo_json({**asdict(found), "safe_damping_N_s_per_m": found.safe_damping})
    elif not flags.quiet:
        damping = with_error(found.damping_N_s_per_m, found.damping_stderr)
        echo(f"damping {damping} N s/m, of which {found.safe_damping:.3f} are relied on")
        echo(f"mass {found.mass_kg:.3f} kg, friction {found.friction_N:.3f} N")
    save(made, flags, damping_N_s_per_m=found.safe_damping, damping_measured=True)
    return 0


@dataclass(frozen=True, kw_only=True)
class CalibrateWeightFlags(MovedFlags):
    """Flags of ``tissueid calibrate-weight``."""


@_sub("calibrate-weight", "calibrate-weight\ncalibrate-weight falcon --yes --json")
@takes(CalibrateWeightFlags)
def calibrate_weight(flags: CalibrateWeightFlags) -> int:
    """Hold the free grip at nine places, and keep the force that carries it there.

    A guided session carries the tool with it. Calibrate the force first: the weight is as wrong as the newton
    it is measured with.
    """
    from tissueid.haptics.measure import weigh_poses

    made = made_for_calibration(flags)
    ask_consent(made, flags)
    with opened(made) as device:
        device.home()
        found = weigh_poses(device)
    if flags.as_json:
        echo_json(asdict(found))
    elif not flags.quiet:
        words = ", ".join(f"{value:.3f}" for value in found.weight_N)
        echo(f"held with ({words}) N in the middle, each to {found.stderr_N:.3f} N")
        echo(f"{found.poses} poses; a plane leaves {found.residual_N:.3f} N")
    slope = tuple(value for row in found.slope_N_per_m for value in row)
    save(made, flags, weight_N=found.weight_N, weight_slope_N_per_m=slope, weight_measured=True)
    return 0


@dataclass(frozen=True, kw_only=True)
class EmulateFlags(OutputFlags):
    """Flags of ``tissueid emulate``."""

    # fmt: off
    no_firmware: bool = option(
        "--no-firmware", is_flag=True, help="Switched on without firmware, as a real one.",
    )
    failing_tries: int = option(
        "--failing-tries", type=click.IntRange(min=0), default=0, metavar="N",
        help="Uploads that fail first.",
    )
    never_homes: bool = option("--never-homes", is_flag=True, help="The emulated user does not home it.")
    hand: str | None = option("--hand", type=click.Choice(HANDS), help="What the hand does after homing.")
    depth_mm: float = option(
        "--depth-mm", type=float, default=10.0, show_default=True, help="Depth the hand aims at.",
    )
    script: str | None = option(
        "--script", metavar="TEXT", help='Carried like a machine: "indent 8 mm at 250 mm/min; hold 2 s".',
    )
    fault: tuple[str, ...] = option(
        "--fault", multiple=True, metavar="KIND@S", help="Scripted fault, e.g. unplug@6 or jump@6:300.",
    )
    # fmt: on


@_sub(
    "emulate",
    'emulate\nemulate --no-firmware --failing-tries 2\nemulate --hand "slow press" --fault unplug@6',
)
@takes(EmulateFlags)
def emulate(flags: EmulateFlags) -> int:
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


def _described(device: HapticDevice) -> dict[str, Any]:
    """Facts of a device."""
    found = device.capabilities
    document = asdict(found)
    document["workspace_mm"] = [[1e3 * low, 1e3 * high] for low, high in document.pop("workspace_m")]
    return document | device.facts()
