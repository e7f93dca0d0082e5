"""``tissueid control``: the adaptive controller of the source papers against any tissue, simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tissueid.cli.completing import presets
from tissueid.cli.flags import OutputFlags, argument, option, takes
from tissueid.cli.output import echo_json, echo_lines
from tissueid.documents import typed
from tissueid.documents.control import Control, Device, Run

if TYPE_CHECKING:
    from tissueid.rendering.control.settings import ControlSettings
    from tissueid.rendering.tissue_block import Tissue

EPILOG = """\b
Examples:
  tissueid control bundle.h5
  tissueid control --preset paper-a --variant A --stiffness-scale 100
  tissueid control bundle.h5 --task impacts --no-projection
  tissueid control bundle.h5 --bound 1 --kr 20 --gamma 5 500 5000 --start zero --task free-contact
  tissueid control bundle.h5 --device sim
"""
#: Exit code where the loop that was asked for did not stay bounded.
DIVERGED = 4
_ABOVE_0 = click.FloatRange(min=0.0, min_open=True)
_FROM_0 = click.FloatRange(min=0.0)


@dataclass(frozen=True, kw_only=True)
class _LoopFlags:
    """Flags of the simulated loop."""

    # fmt: off
    preset: str | None = option(
        "--preset", metavar="NAME", shell_complete=presets, help="A tissue that comes along: paper-a, meat.",
    )
    variant: str = option(
        "--variant", type=click.Choice(["A", "B"]), default="B", show_default=True,
        help="A estimates device and hand; B uses the measured force and estimates the device.",
    )
    environment: str = option(
        "--environment", type=click.Choice(["admittance", "impedance"]), default="admittance",
        show_default=True, help="What touches the tissue: the virtual tool, or the device itself.",
    )
    stiffness_scale: float = option(
        "--stiffness-scale", type=_ABOVE_0, default=1.0, show_default=True, metavar="S",
        help="Factor on the tissue's stiffness.",
    )
    task: str = option(
        "--task", type=click.Choice(["sustained", "free-contact", "impacts"]), default="sustained",
        show_default=True, help="How the hand pushes.",
    )
    seconds: float = option(
        "--seconds", type=click.FloatRange(1.0, 600.0), default=12.0, show_default=True, metavar="T",
        help="Length of the run.",
    )
    rate: float = option(
        "--rate", type=click.FloatRange(100.0, 20000.0), default=1000.0, show_default=True, metavar="HZ",
        help="Of the controller.",
    )
    operator: tuple[float, float, float] | None = option(
        "--operator", nargs=3, type=_FROM_0, metavar="M B K",
        help="Hand: kg, N s/m, N/m. [default: 1.25 2 30, Table 3 as read]",
    )
    interface: tuple[float, float, float] | None = option(
        "--interface", nargs=3, type=_FROM_0, metavar="M B K",
        help="Device: kg, N s/m, N/m. [default: 1.158 115.4 31.46, Table 3 as read]",
    )
    virtual_mass: float = option(
        "--virtual-mass", type=_ABOVE_0, default=2.0, show_default=True, metavar="KG",
        help="Of the virtual tool.",
    )
    virtual_damping: float = option(
        "--virtual-damping", type=_FROM_0, default=0.0, show_default=True, metavar="B", help="N s/m.",
    )
    # fmt: on


@dataclass(frozen=True, kw_only=True)
class _ControllerFlags:
    """Flags of the controller."""

    # fmt: off
    frozen: bool = option("--frozen", is_flag=True, help="Ask for the controller that does not adapt.")
    start: str = option(
        "--start", type=click.Choice(["half", "zero", "true"]), default="half", show_default=True,
        help="First estimates, of what is true.",
    )
    gamma: tuple[float, float, float] | None = option(
        "--gamma", nargs=3, type=_FROM_0, metavar="M B K", help="Gains of the adaptation.",
    )
    kr: float = option(
        "--kr", type=_FROM_0, default=100.0, show_default=True, metavar="N s/m", help="Gain K_r.",
    )
    bound: float | None = option(
        "--bound", type=_FROM_0, metavar="N",
        help="Bound delta of what the estimates don't cover. [default: A 25, B 3]",
    )
    no_projection: bool = option("--no-projection", is_flag=True, help="Let the estimates go anywhere.")
    saturation: float | None = option(
        "--saturation", type=_ABOVE_0, metavar="N", help="Largest control force. [default: none]",
    )
    noise: float = option(
        "--noise", type=_FROM_0, default=0.0, show_default=True, metavar="N", help="Of the sensor.",
    )
    seed: int = option(
        "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Of that noise.",
    )
    device: str | None = option(
        "--device", metavar="NAME", help="Render on a device with a force sensor as well: sim.",
    )
    # fmt: on


@dataclass(frozen=True, kw_only=True)
class ControlFlags(_LoopFlags, _ControllerFlags, OutputFlags):
    """Flags of ``tissueid control``."""

    # fmt: off
    bundle: Path | None = argument(
        required=False, type=click.Path(exists=True, dir_okay=False, path_type=Path),
    )
    # fmt: on


@click.command("control", epilog=EPILOG)
@takes(ControlFlags)
def command(flags: ControlFlags) -> int:
    """Simulate the adaptive controller for admittance-type rendering against an identified tissue.

    Beside the controller that was asked for runs the one that does not adapt (or the one that does, with
    --frozen), and the tissue at its own stiffness. Which numbers are published, read, derived or assumed is
    in --json. Exit code 4 where the loop does not stay bounded.
    """
    from tissueid.rendering.control.admittance import render_on_simulated, require_force_sensor
    from tissueid.rendering.control.document import as_document
    from tissueid.rendering.control.simulation import simulate

    if flags.device is not None:
        require_force_sensor(flags.device)
    tissue, source = _tissue(flags)
    settings = _settings(flags, tissue)
    runs = {name: simulate(one) for name, one in _beside(settings).items()}
    on_device = None
    if flags.device is not None:
        on_device = render_on_simulated(tissue, stiffness_scale=flags.stiffness_scale).as_json()
    written = as_document(runs, source=source, device=on_device)
    document = typed(written, Control)
    if flags.as_json:
        echo_json(written)
    elif not flags.quiet:
        echo_lines(_lines(document))
    return 0 if document.runs[0].measures.diverged_s is None else DIVERGED


def _tissue(flags: ControlFlags) -> tuple[Tissue, str]:
    from tissueid.errors import UsageError
    from tissueid.rendering.choice import as_tissue
    from tissueid.rendering.options import preset_tissue
    from tissueid.store.bundle import load_bundle

    if (flags.bundle is None) == (flags.preset is None):
        msg = "give a bundle, or --preset, and not both: tissueid control bundle.h5"
        raise UsageError(msg)
    if flags.preset is not None:
        return preset_tissue(flags.preset), f"preset {flags.preset}"
    assert flags.bundle is not None  # noqa: S101  (one of both was given)
    return as_tissue(load_bundle(flags.bundle)), "the fitted values of a bundle"


def _settings(flags: ControlFlags, tissue: Tissue) -> ControlSettings:
    import math

    from tissueid.rendering.control.settings import (
        TABLE_3_DEVICE,
        TABLE_3_OPERATOR,
        ControlSettings,
        Gains,
        Mechanics,
        VirtualTool,
    )

    gains = Gains(
        damping_N_s_per_m=flags.kr,
        disturbance_bound_N=flags.bound,
        adaptation=flags.gamma or Gains().adaptation,
        projection=not flags.no_projection,
        adaptation_sign=0 if flags.frozen else 1,
        saturation_N=math.inf if flags.saturation is None else flags.saturation,
    )
    settings = ControlSettings(
        tissue,
        stiffness_scale=flags.stiffness_scale,
        variant=flags.variant,
        environment=flags.environment,
        device=Mechanics(*flags.interface) if flags.interface else TABLE_3_DEVICE,
        operator=Mechanics(*flags.operator) if flags.operator else TABLE_3_OPERATOR,
        tool=VirtualTool(flags.virtual_mass, flags.virtual_damping),
        gains=gains,
        seconds=flags.seconds,
        rate_Hz=flags.rate,
        sensor_noise_N=flags.noise,
        seed=flags.seed,
    ).task(flags.task)
    share = {"half": 0.5, "zero": 0.0, "true": 1.0}[flags.start]
    return replace(settings, start_estimates=share * settings.estimated_truth())


def _beside(settings: ControlSettings) -> dict[str, ControlSettings]:
    """The requested run, the same with and without adaptation, and the tissue at its own stiffness."""
    asked_frozen = settings.gains.adaptation_sign == 0
    names = ("frozen", "adaptive") if asked_frozen else ("adaptive", "frozen")
    other = replace(settings, gains=replace(settings.gains, adaptation_sign=1 if asked_frozen else 0))
    found = {names[0]: settings, names[1]: other}
    if settings.stiffness_scale != 1.0:
        found["unscaled"] = replace(settings, stiffness_scale=1.0)
    return found


def _lines(document: Control) -> list[str]:
    """Printed lines."""
    mass, tissue = document.virtual_mass, document.tissue
    loop = f"variant {document.variant}, {document.environment} type"
    enough = "" if mass.enough else ": less than 1.5 times it, no margin for wrong estimates"
    columns = f"{'error rms':>12}{'max':>10}{'velocity':>13}{'tissue':>9}{'control':>9}"
    lines = [
        f"{tissue.name} x{document.stiffness_scale:g}, {loop}, {document.seconds:g} s simulated",
        f"virtual mass {mass.given_kg:.3g} kg; bound {mass.bound_kg:.3g} kg{enough}",
        f"{'':<10}{columns}  V' above its bound",
    ]
    for run in document.runs:
        lines += _run_lines(run, tissue.depth_mm)
    if document.environment == "impedance":
        lines.append("an impedance-type loop leads by velocity alone: its error of position means nothing")
    return lines + _device_lines(document.device)


def _run_lines(run: Run, depth_mm: float) -> list[str]:
    one = run.measures
    errors = f"{one.error_rms_mm:>9.4f} mm{one.error_max_mm:>7.3f} mm"
    forces = f"{one.environment_force_max_N:>7.4g} N{one.control_force_max_N:>7.4g} N"
    violated = f"{one.violated_share:.2%}, at most {one.violation_max_W:.3g} W"
    diverged = "" if one.diverged_s is None else f"; DIVERGED at {one.diverged_s:.3f} s"
    speed = f"{one.velocity_error_rms_mm_s:>8.3f} mm/s"
    lines = [f"{run.name:<10}{errors}{speed}{forces}  {violated}{diverged}"]
    if one.outside_share > 0.0:
        share = f"{one.outside_share:.1%} of it"
        lines.append(f"{'':<10}{share} deeper than the {depth_mm:.3g} mm that were identified")
    return lines


def _device_lines(device: Device | None) -> list[str]:
    if device is None:
        return []
    felt = f"{device.hand_less_tissue_rms_N:.3f} N rms of {device.environment_force_max_N:.3g} N"
    return [
        f"on sim    error {device.error_rms_mm:.3f} mm rms, {device.error_max_mm:.3f} at most",
        f"{'':<10}hand less tissue {felt}; {device.clipped_share:.2%} shaped by the guard",
        f"{'':<10}forces x {device.force_scale:.3g}, travel x {device.motion_scale:.3g}",
    ]
