"""``tissueid control``: the adaptive controller of the source papers against any tissue, simulated."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from tissueid.cli.completion_command import presets
from tissueid.cli.flags import (
    ABOVE_0,
    FILE_THERE,
    FROM_0,
    REAL_FROM_0,
    OutputFlags,
    argument,
    option,
    subcommand,
)
from tissueid.cli.output import progress_bar, tell
from tissueid.documents import typed
from tissueid.documents.control import Control
from tissueid.errors import NotIdentifiedError, refuse

if TYPE_CHECKING:
    from tissueid.rendering.control.settings import ControlSettings
    from tissueid.rendering.control.simulation import ControlRun
    from tissueid.rendering.tissue_block import Tissue


class _ControlFlags(OutputFlags):
    # fmt: off
    bundle: Path | None = argument(required=False, type=FILE_THERE)
    # the simulated loop
    preset: str | None = option(
        "A tissue that comes along: paper-a, meat.", metavar="NAME", shell_complete=presets
    )
    variant: Literal["A", "B"] = option(
        "A estimates device and hand; B uses the measured force and estimates the device.", default="B"
    )
    environment: Literal["admittance", "impedance"] = option(
        "What touches the tissue: the virtual tool, or the device itself.", default="admittance"
    )
    stiffness_scale: float = option(
        "Factor on the tissue's stiffness.", type=ABOVE_0, default=1.0, metavar="S"
    )
    task: Literal["sustained", "free-contact", "impacts"] = option(
        "How the hand pushes.", default="sustained"
    )
    seconds: float = option(
        "Length of the run.", type=click.FloatRange(1.0, 600.0), default=12.0, metavar="T"
    )
    rate: float = option(
        "Of the controller.", type=click.FloatRange(100.0, 20000.0), default=1000.0, metavar="HZ"
    )
    operator: tuple[float, float, float] | None = option(
        "Hand: kg, N s/m, N/m. [default: 1.25 2 30, Table 3 as read]",
        nargs=3, type=REAL_FROM_0, metavar="M B K",
    )
    interface: tuple[float, float, float] | None = option(
        "Device: kg, N s/m, N/m. [default: 1.158 115.4 31.46, Table 3 as read]",
        nargs=3, type=REAL_FROM_0, metavar="M B K",
    )
    virtual_mass: float = option("Of the virtual tool.", type=ABOVE_0, default=2.0, metavar="KG")
    virtual_damping: float = option("N s/m.", type=REAL_FROM_0, default=0.0, metavar="B")
    # the controller
    frozen: bool = option("Ask for the controller that does not adapt.")
    start: Literal["half", "zero", "true"] = option("First estimates, of what is true.", default="half")
    gamma: tuple[float, float, float] | None = option(
        "Gains of the adaptation.", nargs=3, type=REAL_FROM_0, metavar="M B K"
    )
    kr: float = option("Gain K_r.", type=REAL_FROM_0, default=100.0, metavar="N s/m")
    bound: float | None = option(
        "Bound delta of what the estimates don't cover. [default: A 25, B 3]", type=REAL_FROM_0, metavar="N"
    )
    no_projection: bool = option("Let the estimates go anywhere.")
    saturation: float | None = option("Largest control force. [default: none]", type=ABOVE_0, metavar="N")
    noise: float = option("Of the sensor.", type=REAL_FROM_0, default=0.0, metavar="N")
    seed: int = option("Of that noise.", type=FROM_0, default=0)
    device: str | None = option("Render on a device with a force sensor as well: sim.", metavar="NAME")
    # fmt: on


@subcommand(
    "control",
    "bundle.h5",
    "--preset paper-a --variant A --stiffness-scale 100",
    "bundle.h5 --task impacts --no-projection",
    "bundle.h5 --bound 1 --kr 20 --gamma 5 500 5000 --start zero --task free-contact",
    "bundle.h5 --device sim",
)
def command(flags: _ControlFlags) -> int:
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
    on_device = None
    with progress_bar(show=not flags.quiet) as progress:
        runs: dict[str, ControlRun] = {}
        for name, one in _beside(settings).items():
            progress(f"loop {name}; the first of a machine is compiled", len(runs), 0)
            runs[name] = simulate(one)
        if flags.device is not None:
            progress("rendering on the device", len(runs), 0)
            on_device = render_on_simulated(tissue, stiffness_scale=flags.stiffness_scale).as_json()
    written = as_document(runs, source=source, device=on_device)
    document = typed(written, Control)
    tell(flags, written, _lines(document))
    return 0 if document.runs[0].measures.diverged_s is None else NotIdentifiedError.exit_status


def _tissue(flags: _ControlFlags) -> tuple[Tissue, str]:
    from tissueid.rendering.options import as_tissue, preset_tissue
    from tissueid.store.bundle import load_bundle

    if (flags.bundle is None) == (flags.preset is None):
        refuse("give a bundle, or --preset, and not both: tissueid control bundle.h5")
    if flags.preset is not None:
        return preset_tissue(flags.preset), f"preset {flags.preset}"
    assert flags.bundle is not None  # noqa: S101  (one of both was given)
    return as_tissue(load_bundle(flags.bundle)), "the fitted values of a bundle"


def _settings(flags: _ControlFlags, tissue: Tissue) -> ControlSettings:
    from tissueid.rendering.control import settings as own

    gains = own.Gains(
        damping_N_s_per_m=flags.kr,
        disturbance_bound_N=flags.bound,
        adaptation=flags.gamma or own.Gains().adaptation,
        projection=not flags.no_projection,
        adaptation_sign=0 if flags.frozen else 1,
        saturation_N=math.inf if flags.saturation is None else flags.saturation,
    )
    settings = own.ControlSettings(
        tissue,
        stiffness_scale=flags.stiffness_scale,
        variant=flags.variant,
        environment=flags.environment,
        device=own.Mechanics(*flags.interface) if flags.interface else own.TABLE_3_DEVICE,
        operator=own.Mechanics(*flags.operator) if flags.operator else own.TABLE_3_OPERATOR,
        tool=own.VirtualTool(flags.virtual_mass, flags.virtual_damping),
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
        one = run.measures
        errors = f"{one.error_rms_mm:>9.4f} mm{one.error_max_mm:>7.3f} mm"
        forces = f"{one.environment_force_max_N:>7.4g} N{one.control_force_max_N:>7.4g} N"
        violated = f"{one.violated_share:.2%}, at most {one.violation_max_W:.3g} W"
        diverged = "" if one.diverged_s is None else f"; DIVERGED at {one.diverged_s:.3f} s"
        speed = f"{one.velocity_error_rms_mm_s:>8.3f} mm/s"
        lines.append(f"{run.name:<10}{errors}{speed}{forces}  {violated}{diverged}")
        if one.outside_share > 0.0:
            share = f"{one.outside_share:.1%} of it"
            lines.append(f"{'':<10}{share} deeper than the {tissue.depth_mm:.3g} mm that were identified")
    if document.environment == "impedance":
        lines.append("an impedance-type loop leads by velocity alone: its error of position means nothing")
    device = document.device
    if device is not None:
        felt = f"{device.hand_less_tissue_rms_N:.3f} N rms of {device.environment_force_max_N:.3g} N"
        lines += [
            f"on sim    error {device.error_rms_mm:.3f} mm rms, {device.error_max_mm:.3f} at most",
            f"{'':<10}hand less tissue {felt}; {device.clipped_share:.2%} shaped by the guard",
            f"{'':<10}forces x {device.force_scale:.3g}, travel x {device.motion_scale:.3g}",
        ]
    return lines
