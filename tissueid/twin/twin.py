"""One bundle felt by a machine: recordings at the grip, fitted by the same engine, beside what went in."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.contrast.decision import LEAST_FORCE_N, LIMITS
from tissueid.documents import twin as document
from tissueid.errors import DeviceError
from tissueid.inference.posterior import PosteriorOptions
from tissueid.inference.specimen import FitOptions
from tissueid.manifest import Calibration, Study
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.model.frame import linear_frame
from tissueid.model.grammar import KELVIN_VOIGT
from tissueid.notebook import drawing
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.rendering.choice import as_tissue
from tissueid.rendering.session_plan import read_script
from tissueid.result import SpecimenFit
from tissueid.segment import SegmentOptions
from tissueid.store.bundle import Bundle
from tissueid.trial import Source, Trial
from tissueid.twin.program import Program, program_of_script
from tissueid.twin.sessions import Felt, Setup, emulated_falcon, felt_by_a_machine, planned, simulated

#: Delay that is stated is known to half a tick [s].
HALF_TICK_S = 5e-4
#: Push at a speed that was not seen: share of the depth, hold [s], and ratio of the recordings' speeds from
#: which one lies between them.
PUSHED, HELD_S, BETWEEN = 0.9, 3.0, 1.5
#: Draws of the fits.
DRAWS = 1_000


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Recording at one grip, with the stated delay undone, beside the bundle's law: arrays (n,)."""

    device: str
    time_s: FloatArray  # from the crossing of the surface
    force_N: FloatArray
    law_N: FloatArray

    @property
    def touching(self) -> NDArray[np.bool_]:
        """True in contact."""
        return self.time_s >= 0.0

    @property
    def off_N(self) -> FloatArray:
        """Force less the law, in contact."""
        return (self.force_N - self.law_N)[self.touching]

    @property
    def nrmsd(self) -> float:
        """Root mean square of that over the range of the law."""
        return float(np.sqrt(np.mean(self.off_N**2)) / np.ptp(self.law_N[self.touching]))


@dataclass(frozen=True, slots=True, eq=False)
class Twin:
    """A bundle beside what its devices gave back: the document ``twin.json``, and its curves."""

    found: document.Twin
    curves: tuple[Curve, ...]


def run_twin(
    bundle: Bundle, path: Path, asked: Setup, folder: Path, progress: Callable[[str, int, int], None]
) -> Twin:
    """Let a machine feel a bundle on the emulated Falcon and on the simulated device, and fit both.

    ``path``: its file; ``asked``: the program, and what a real machine recorded, which is fitted as well;
    ``folder``: for the recordings at the grip and the session's log; ``progress``: ``progress(message, done,
    total)``.  Raises BundleError, UsageError, DeviceError: the bundle can't be rendered, or a session ended
    in a fault.
    """
    program, plan = asked.program, planned(path, asked)
    assert plan.check is not None  # noqa: S101 -- a tissue is always checked
    tissue, scale = as_tissue(bundle), plan.check.scaling
    steps = 5 if asked.felt is None else 6
    progress("emulated Falcon", 0, steps)
    felt = [emulated_falcon(tissue, program, force_scale=scale.force, motion=scale.motion)]
    progress("simulated device", 1, steps)
    felt.append(simulated(plan, folder))
    if asked.felt is not None:
        felt.append(felt_by_a_machine(asked.felt, force_scale=scale.force, motion=scale.motion))
    devices, curves = [], []
    for k, one in enumerate(felt):
        progress(f"fit of the {one.device}", 2 + k, steps)
        curves.append(_against_law(bundle, one))
        devices.append(_device(bundle, program, one, curves[-1], folder, scale.force))
    progress("a speed that was not seen", steps - 1, steps)
    other = _unseen_program(bundle)
    again = emulated_falcon(tissue, other, force_scale=scale.force, motion=scale.motion)
    progress("fit", steps, steps)
    found = document.Twin(
        schema="tissueid/twin/1",
        specimen=bundle.specimen,
        model=bundle.model.name or bundle.model.key,
        program=program.words,
        force_scale=scale.force,
        motion_scale=scale.motion,
        limit=LIMITS[0],
        unseen=document.Unseen(other.speed_mm_s, _against_law(bundle, again).nrmsd),
        devices=tuple(devices),
    )
    return Twin(found, tuple(curves))


def _unseen_program(bundle: Bundle) -> Program:
    """A push and a hold between the speeds of the recordings, or at half of their one speed."""
    slow, fast = bundle.speeds_mm_s
    speed = math.sqrt(slow * fast) if fast > BETWEEN * slow else 0.5 * fast
    text = f"indent {PUSHED * bundle.depth_mm:.4g} mm at {60.0 * speed:.4g} mm/min; hold {HELD_S:g} s"
    return program_of_script(read_script(text))


def _against_law(bundle: Bundle, felt: Felt) -> Curve:
    time, depth, force = felt.undone()
    law = bundle.contact_model().force(bundle.theta, ContactPath(time, np.maximum(depth, 0.0)))
    # the crossing of the surface, from depths up to a little behind contact
    first = int(np.argmax(depth > 0.0))
    rising = slice(max(first - 1, 0), first + 1)
    return Curve(felt.device, time - float(np.interp(0.0, depth[rising], time[rising])), force, law)


def _device(
    bundle: Bundle, program: Program, felt: Felt, curve: Curve, folder: Path, force_scale: float
) -> document.Device:
    """Findings at one grip."""
    touching = curve.touching
    recorded = None
    if program.recorded is not None:
        # in the program's time: both cross the surface together
        at = curve.time_s + program.contact_s
        there = touching & (at <= program.recorded[-1, 0])
        meant = np.interp(at[there], program.recorded[:, 0], program.recorded[:, 1])
        recorded = float(np.sqrt(np.mean((curve.force_N[there] - meant) ** 2)) / np.ptp(meant))
    fit = _refit(bundle, program, felt, folder / f"{felt.device.replace(' ', '-')}.csv")
    least = LIMITS[0].share * np.maximum(np.abs(curve.law_N[touching]) * force_scale, LEAST_FORCE_N)
    return document.Device(
        device=felt.device,
        nrmsd_model=curve.nrmsd,
        nrmsd_recording=recorded,
        fit_nrmsd=None if fit is None else fit.nrmsd.range,
        noticeable=float(np.max(np.abs(curve.off_N) * force_scale / least)),
        rows=() if fit is None else tuple(_rows(bundle, fit)),
    )


def _machine(felt: Felt, program: Program) -> Calibration:
    """The machine at the grip: rigid, unfiltered, and late to within half a tick and half a count."""
    late = math.hypot(HALF_TICK_S, 0.5 * felt.step_mm / program.speed_mm_s)
    values = {
        "load_cell_class": 0.1,
        "displacement_class": 0.1,
        "skew_s": 0.0,
        "skew_s_sd": late,
        "force_filter_s": 0.0,
        "force_filter_s_sd": 1e-6,
        **({"displacement_resolution_mm": felt.step_mm} if felt.step_mm else {}),
    }
    return Calibration(values=values, frame=linear_frame(1e6))


def _refit(bundle: Bundle, program: Program, felt: Felt, path: Path) -> SpecimenFit | None:
    """Fit what a machine at the grip recorded, written as a test machine's export."""
    time, depth, force = felt.undone()
    rows = [f"{t:.6f},{x:.7f},{f:.6f}" for t, x, f in zip(time, depth, force, strict=True)]
    path.write_text("\n".join(["Time (s),Displacement (mm),Force (N)", *rows, ""]), encoding="ascii")
    model = bundle.contact_model()
    if isinstance(model, ChannelModel) and model.fixed_s.size:
        # times of a spectrum, and of the yardstick, follow the recording: their numbers are other numbers
        return None
    trial = Trial(bundle.specimen, time, depth, force, source=Source(path=path.name))
    kelvin_voigt = bundle.model.key == KELVIN_VOIGT
    options = FitOptions(
        model=bundle.model.name or bundle.model.key,
        branches=bundle.model.branches if kelvin_voigt else None,
        stiffness_degree=bundle.model.stiffness_degree if kelvin_voigt else None,
    )
    found = identify(
        [trial],
        study=Study("twin", calibration=_machine(felt, program)),
        # a device does not break: steps of counts are no rupture
        options=IdentifyOptions(
            fit=options, segment=SegmentOptions(rupture=False), posterior=PosteriorOptions(draws=DRAWS)
        ),
    )
    if not found.specimens:
        msg = f"the recording at the grip can't be fitted: {found.exit.reasons[0]}"
        raise DeviceError(msg)
    return found.specimens[0]


def _rows(bundle: Bundle, fit: SpecimenFit) -> list[document.Row]:
    """Rows of what went in beside what came out."""
    found, rows = {one.name: one for one in fit.parameters}, []
    for one in bundle.parameters:
        out = found.get(one.name)
        inner = None if one.uncertainty is None else one.uncertainty.ci95_total or one.uncertainty.ci95
        outer = None
        if out is not None and out.uncertainty is not None:
            outer = out.uncertainty.ci95_total or out.uncertainty.ci95
        value = None if out is None else out.value
        if one.value is None:
            verdict: document.Verdict = "not identified"
        elif value is None or outer is None:
            verdict = "destroyed"
        else:
            held = (inner is not None and inner[0] <= value <= inner[1]) or outer[0] <= one.value <= outer[1]
            verdict = "inside" if held else "outside"
        rows.append(document.Row(one.name, one.symbol, one.unit, one.value, inner, value, outer, verdict))
    return rows


def twin_drawing(twin: Twin) -> str:
    """Force at the grips and of the law against time, as an SVG."""
    curves: list[tuple[str, FloatArray, FloatArray, str]] = []
    for one, colour in zip(twin.curves, ("#d55e00", "#009e73", "#cc79a7"), strict=False):
        if not curves:
            curves.append(("law of the bundle", one.time_s, one.law_N, "#56b4e9"))
        curves.append((one.device, one.time_s, one.force_N, colour))
    words = f"Force of {twin.found.specimen} and of its twins"
    return drawing(curves, across="time from contact [s]", up="[N]", words=words)
