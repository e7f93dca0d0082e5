"""The mechanical twin: the program that pushed a tissue pushes the device that renders its bundle.

The program is a recording's own travel or the strokes of a script; the devices are an emulated Falcon, with
its counts and delay, and the simulated device.  A machine at the grip would record the arm's true position
and force, with the scales undone: that is fitted by the same engine, beside what went in.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.contrast.decision import LEAST_FORCE_N, LIMITS
from tissueid.documents import twin as document
from tissueid.errors import DeviceError, refuse
from tissueid.haptics.falcon.calibration import Calibration as FalconCalibration
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.falcon.emulator import EmulatedLink, EmulatorSettings
from tissueid.haptics.hand import SCRIPT_CLEARANCE_MM, Hand, along, way_of
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.parameter_block import COMMAND_ENGAGE
from tissueid.haptics.shared_hand import MAX_KNOTS
from tissueid.haptics.sim import carried
from tissueid.haptics.states import State
from tissueid.inference.posterior import PosteriorOptions
from tissueid.inference.specimen import FitOptions
from tissueid.ingest import read_trials
from tissueid.manifest import Calibration, Study
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.model.frame import linear_frame
from tissueid.model.passivity import Scaling
from tissueid.notebook import drawing
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.rendering.options import ASSUMED_DEVICE, RenderOptions, as_tissue
from tissueid.rendering.passivity_control import PassivityLimits
from tissueid.rendering.plan import plan_session
from tissueid.rendering.recorder import Recorder
from tissueid.rendering.servo_tick import compiled_tick, servo_here
from tissueid.rendering.session import Session
from tissueid.rendering.session_plan import Script, SessionPlan, read_script
from tissueid.rendering.tissue_block import Plane, Tissue, tissue_block
from tissueid.result import Estimate, SpecimenFit
from tissueid.segment import SegmentOptions, segment
from tissueid.store.bundle import Bundle
from tissueid.trial import Source, Trial, contact_frame

#: Rest above the tissue before the motion [s]: longer than the ramp of a start; speed on the way down [mm/s].
REST_S, APPROACH_MM_S = 0.7, 2.0
#: Deviation of straight stretches from a recording's travel that is tried first, over its depth.
FINEST = 2e-4
#: Claimed over travelled depth from which a travel is taken as it is, and below which it is of other tissue:
#: between them a frame gave way.
SAME_DEPTH, MOST_SCALED = 0.99, 0.67


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """Depth by time, straight between knots."""

    #: (k,): from rest above the tissue on.
    time_s: FloatArray
    depth_mm: FloatArray  # (k,)
    contact_s: float  # when the surface is crossed
    words: str
    recorded: FloatArray | None = None  # (n, 2), time [s] and force [N] of the recording that it is of

    @property
    def duration_s(self) -> float:
        """Time of the last knot [s]."""
        return float(self.time_s[-1])

    @property
    def speed_mm_s(self) -> float:
        """Fastest way into the tissue."""
        return float((np.diff(self.depth_mm) / np.diff(self.time_s)).max())

    def hand(self, *, motion_scale: float, surface_m: FloatArray, inward: FloatArray) -> Hand:
        """A machine that carries the grip along it."""
        travel_m = self.depth_mm * motion_scale * 1e-3
        return replace(along(surface_m, inward, self.time_s.tolist(), travel_m), rigid=True)


def program_of_script(script: Script) -> Program:
    """Strokes of a script, from above the tissue on; UsageError where they never touch it."""
    if script.depth_mm <= 0.0:
        refuse(f"the script goes {script.depth_mm:g} mm deep, to no tissue: add 'indent 4 mm at 250 mm/min'")
    return _whole(*way_of(script.strokes, REST_S), script.text)


def program_of_recording(trial: Trial, depth_mm: float) -> Program:
    """A recording's own travel from contact on.

    ``depth_mm``: to which the tissue is claimed; the travel of a recording that is a little deeper (its frame
    gave way) is scaled to it, and its force is not compared.  Raises UsageError: it has no contact, goes much
    deeper than that, or needs more straight stretches than a grip is led by.
    """
    segmentation = segment(trial)
    if segmentation.contact is None:
        refuse(f"{trial.name}: there is no contact in it; name a recording that touches tissue")
    depth, force = contact_frame(trial, segmentation)
    start = segmentation.contact.index
    time, depth, force = trial.time_s[start:] - trial.time_s[start], depth[start:], force[start:]
    scale = min(depth_mm / float(depth.max()), 1.0)
    if scale < MOST_SCALED:
        refuse(f"{trial.name} is {depth.max():.3g} mm deep, the bundle is claimed to {depth_mm:.3g} mm")
    deeper = scale < SAME_DEPTH
    depth = scale * depth if deeper else depth
    words = f"travel of {trial.name}" + f", scaled to {depth_mm:.3g} mm" * deeper
    path = np.column_stack([time, np.maximum(depth, -SCRIPT_CLEARANCE_MM)])
    tolerance = FINEST * float(depth.max())
    knots = _simplified(path, tolerance)
    while len(knots) > MAX_KNOTS - 3:
        tolerance *= 1.5
        knots = _simplified(path, tolerance)
    came_s = SCRIPT_CLEARANCE_MM / APPROACH_MM_S
    time = np.concatenate([[0.0, REST_S], REST_S + came_s + knots[:, 0]])
    depths = np.concatenate([[-SCRIPT_CLEARANCE_MM, -SCRIPT_CLEARANCE_MM], knots[:, 1]])
    depths[2] = 0.0
    whole = _whole(time, depths, words)
    recorded = np.column_stack([REST_S + came_s + path[:, 0], force])
    return whole if deeper else replace(whole, recorded=recorded)


def _whole(time_s: FloatArray, depth_mm: FloatArray, words: str) -> Program:
    rising = np.concatenate([[True], np.diff(time_s) > 1e-6])
    time, depth = time_s[rising], depth_mm[rising]
    first = int(np.argmax(depth > 0.0))
    share = -depth[first - 1] / (depth[first] - depth[first - 1])
    return Program(time, depth, float(time[first - 1] + share * (time[first] - time[first - 1])), words)


def _simplified(path: FloatArray, tolerance: float) -> FloatArray:
    """Fewest points between which a path is straight to a tolerance (Ramer 1972, Douglas & Peucker 1973)."""
    keep, stack = np.zeros(len(path), dtype=bool), [(0, len(path) - 1)]
    keep[[0, -1]] = True
    while stack:
        first, last = stack.pop()
        if last <= first + 1:
            continue
        time, depth = path[first : last + 1].T
        off = np.abs(depth - np.interp(time, time[[0, -1]], depth[[0, -1]]))
        at = int(np.argmax(off))
        if off[at] > tolerance:
            keep[first + at] = True
            stack += [(first, first + at), (first + at, last)]
    return path[keep]


TICK_S = 1e-3
#: From a position to the middle of the force it causes: what a session states of its device [s].
LATE_S = (ASSUMED_DEVICE.delay_ticks + 0.5) * TICK_S
GUARD = GuardLimits(clamp_N=5.0, rms_limit_N=5.0, dead_man=False, ramp_s=0.5)
#: Travel of one encoder count at the grip (docs/devices.md) [mm].
COUNT_MM = 0.0635
#: Emulated time of homing [s], and where the machine meets the surface, in the Falcon's frame [m]: 20 mm
#: beside the axis, on which three legs would count at one moment and a hold be known to a whole count.
HOMED_S, SURFACE_M = 3.0, (0.011, 0.017, 0.1445)
INWARD = (0.0, 0.0, -1.0)
#: Device of a recording that a test machine made at a real grip.
MACHINE = "test machine at the grip"


@dataclass(frozen=True, slots=True, eq=False)
class Felt:
    """Recording at the grip, in tissue units."""

    device: str
    #: (n,): from the rest before contact on; the force is as late as the device makes it.
    time_s: FloatArray
    depth_mm: FloatArray  # (n,)
    force_N: FloatArray  # (n,)
    late_s: float  # delay that the device states
    step_mm: float  # depth of one count of its encoders; a position is known to half of it

    def undone(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Time, depth and force with the stated delay undone."""
        force = np.interp(self.time_s + self.late_s, self.time_s, self.force_N)
        kept = self.time_s <= self.time_s[-1] - self.late_s
        return self.time_s[kept], self.depth_mm[kept], force[kept]


def emulated_falcon(tissue: Tissue, program: Program, scale: Scaling) -> Felt:
    """The program on an emulated Falcon: counts, wire, kinematics, motors, delay; DeviceError on a fault."""
    surface = np.array(SURFACE_M)
    hand = program.hand(motion_scale=scale.motion, surface_m=surface, inward=np.array(INWARD))
    felt = tissue_block(tissue, Plane(SURFACE_M), force_scale=scale.force, motion_scale=scale.motion)
    link = EmulatedLink(EmulatorSettings(hand=hand, period_s=TICK_S))
    falcon, now, rows = link.falcon, 0.0, []
    # a machine holds still: encoders that do not move are then in good health
    device = FalconDevice(carried(GUARD), port=link.descriptor(), calibration=FalconCalibration())
    with link, servo_here(device) as (io, servo, _ring, block):
        link.step()
        falcon.advance(HOMED_S - falcon.time_s)
        block.write(np.concatenate([felt, PassivityLimits(on=False).block()]))
        block.order(COMMAND_ENGAGE)
        start = falcon.time_s
        while falcon.time_s < HOMED_S + program.duration_s + 0.1 and not falcon.gone:
            now += TICK_S
            compiled_tick(io, servo, now, TICK_S, 0.0, 0)
            link.step()
            depth = (surface[2] - falcon.position_m[2]) / scale.motion * 1e3
            rows.append((falcon.time_s - start, depth, falcon.force_N[2] / scale.force))
        if device.state is not State.ENGAGED:
            raise DeviceError(f"the emulated session ended in {device.fault.name.lower()}")
    time, depth, force = np.array(rows).T
    return Felt("emulated Falcon", time, depth, force, LATE_S, COUNT_MM / scale.motion)


@dataclass(frozen=True, slots=True)
class Setup:
    """A program, the scales that were asked for, and a test machine's recording at a real device's grip."""

    program: Program
    force_scale: float | None = None
    motion_scale: float | None = None
    felt: Trial | None = None


def felt_by_a_machine(trial: Trial, scale: Scaling) -> Felt:
    """A recording at a real Falcon's grip, scales undone; UsageError where there is no contact in it."""
    segmentation = segment(trial, options=SegmentOptions(rupture=False))
    if segmentation.contact is None:
        refuse(f"{trial.name}: no contact is found in it; name what the test machine recorded at the grip")
    depth, force = contact_frame(trial, segmentation)
    at_grip = trial.time_s, depth / scale.motion, force / scale.force
    return Felt(MACHINE, *at_grip, LATE_S, COUNT_MM / scale.motion)


def simulated(plan: SessionPlan, folder: Path) -> Felt:
    """A session of the simulated device, as ``render`` runs it; its log is ``felt.h5``."""
    with TemporaryDirectory(dir=folder) as made:
        log = Path(made) / "felt.h5"
        Session(plan, recorder=Recorder(log, plan.head)).run()
        (trial,) = read_trials(log)
        log.replace(folder / "felt.h5")
    return Felt("simulated device", trial.time_s, trial.displacement_mm, trial.force_N, 0.0, 0.0)


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
    program = asked.program
    options = RenderOptions(
        bundle=path, device="sim", virtual=True, program=program, force_scale=asked.force_scale,
        motion_scale=asked.motion_scale,
    )  # fmt: skip
    # the scale of the simulated device's session is that of all
    plan = plan_session(options)
    assert plan.check is not None  # noqa: S101 -- a tissue is always checked
    tissue, scale = as_tissue(bundle), plan.check.scaling
    steps = 5 if asked.felt is None else 6
    progress("emulated Falcon", 0, steps)
    felt = [emulated_falcon(tissue, program, scale)]
    progress("simulated device", 1, steps)
    felt.append(simulated(plan, folder))
    if asked.felt is not None:
        felt.append(felt_by_a_machine(asked.felt, scale))
    devices, curves = [], []
    for k, one in enumerate(felt):
        progress(f"fit of the {one.device}", 2 + k, steps)
        curves.append(_against_law(bundle, one))
        devices.append(_device(bundle, program, one, curves[-1], folder, scale.force))
    progress("a speed that was not seen", steps - 1, steps)
    other = _unseen_program(bundle)
    again = emulated_falcon(tissue, other, scale)
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
    late = 0.5 * math.hypot(TICK_S, felt.step_mm / program.speed_mm_s)
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
    found = identify(
        [trial],
        study=Study("twin", calibration=_machine(felt, program)),
        # a device does not break: steps of counts are no rupture
        options=IdentifyOptions(
            fit=FitOptions().of_law(bundle.model),
            segment=SegmentOptions(rupture=False),
            posterior=PosteriorOptions(draws=DRAWS),
        ),
    )
    if not found.specimens:
        raise DeviceError(f"the recording at the grip can't be fitted: {found.exit.reasons[0]}")
    return found.specimens[0]


def _widest(one: Estimate | None) -> tuple[float, float] | None:
    """Interval with the machine, else the statistical one."""
    sure = None if one is None else one.uncertainty
    return None if sure is None else sure.ci95_total or sure.ci95


def _rows(bundle: Bundle, fit: SpecimenFit) -> list[document.Row]:
    found, rows = {one.name: one for one in fit.parameters}, []
    for one in bundle.parameters:
        out = found.get(one.name)
        inner, outer = _widest(one), _widest(out)
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
