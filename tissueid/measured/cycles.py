"""Load-unload loops, measured from their samples: work, stiffness, drift, viscosity from the area.

Work and area are linear in the forces, ``sum w_i F_i`` by the trapezoidal rule over measured depth, and
polynomials in depth are fitted by least squares: standard errors follow from the white force noise alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from msgspec import structs

from tissueid.arrays import FloatArray, evenly
from tissueid.documents.quantities import AtDepth, Cycle, CycleKind, Measure
from tissueid.trial import Segmentation, Trial, contact_frame

#: Shares of a loop's depth, up to its deepest point, over which loading is described by a quadratic: the
#: first whose slope is known to this fraction by enough samples, because a narrow window has less bias.
PEAK_SHARES = (0.02, 0.05, 0.1, 0.25)
PEAK_PRECISION = 0.01
PEAK_SAMPLES = 12
#: Half width, as a share of the loop's depth, of the window that gives a stiffness at a stated depth.
DEPTH_SHARE = 0.1
#: Fewest samples for a quadratic and for a line.
QUADRATIC_SAMPLES, LINE_SAMPLES = 6, 3
#: Force, over that at the peak and in standard deviations of its noise, below which the tool has let go.
RESIDUAL_SHARE = 0.01
RESIDUAL_SD = 3.0
#: Standard deviations of the contact point above it that still count as air.
AIR_SD = 3.0
#: Loops whose amplitudes differ by more are not compared.
SAME_AMPLITUDE = 0.02
#: Stretches into which each direction is cut for its speeds: chords over many samples know no jitter.
STRETCHES = 40
FEWEST_SAMPLES = 6
#: Phases that a loading may consist of.
LOADING = ("ramp", "hold", "creep")


@dataclass(frozen=True, slots=True)
class Loop:
    """Sample numbers of one loop: ``[start, stop)`` with the end of its loading between."""

    kind: CycleKind
    start: int
    peak: int
    stop: int


def loops(segmentation: Segmentation, depth_mm: FloatArray) -> list[Loop]:
    """Cycles, and every loading that is followed by a retract, in time order.

    Loading ends with its last move: in a hold the force relaxes while noise alone chooses the deepest sample.
    """
    found: list[Loop] = []
    start, end, held = -1, -1, False
    for phase in segmentation.phases:
        if phase.kind == "cycle":
            peak = phase.peak
            if peak is None:
                peak = phase.start + int(np.argmax(depth_mm[phase.start : phase.stop]))
            found.append(Loop("cycle", phase.start, peak, phase.stop))
        elif phase.kind == "retract" and start >= 0:
            # without a standstill the move itself tells where it turned
            peak = end if held else start + int(np.argmax(depth_mm[start : phase.start + 1]))
            found.append(Loop("ramp-hold-retract" if held else "ramp-retract", start, peak, phase.stop))
        if phase.kind not in LOADING:
            start, end, held = -1, -1, False
            continue
        if phase.kind == "ramp" and start < 0:
            start = phase.start
        held = held or (start >= 0 and phase.kind != "ramp")
        if phase.kind != "hold":  # the tool still goes in while it creeps
            end = phase.stop - 1
    return found


def polynomial_at(
    depth_mm: FloatArray, force_N: FloatArray, at_mm: float, noise_N: float
) -> tuple[Measure, Measure]:
    """Force [N] and slope [N/mm] at a depth from a local quadratic; empty where samples are too few."""
    n = depth_mm.size
    spread = float(np.ptp(depth_mm)) if n else 0.0
    if n < LINE_SAMPLES or spread <= 0.0:
        return Measure(), Measure()
    degree = 2 if n >= QUADRATIC_SAMPLES else 1
    u = (depth_mm - at_mm) / spread
    design = u[:, None] ** np.arange(degree + 1.0)
    inverse = np.linalg.pinv(design)
    weights = inverse @ force_N
    sd = noise_N * np.sqrt((inverse**2).sum(axis=1))
    return (
        Measure(float(weights[0]), float(sd[0])),
        Measure(float(weights[1]) / spread, float(sd[1]) / spread),
    )


def end_of_loading(
    depth_mm: FloatArray, force_N: FloatArray, peak: int, start: int, noise_N: float
) -> tuple[Measure, Measure]:
    """Force and slope at the end of loading, from its last part."""
    x, f = depth_mm[start : peak + 1], force_N[start : peak + 1]
    found = (Measure(), Measure())
    for share in PEAK_SHARES:
        far = np.flatnonzero(x < x[-1] - share * (x[-1] - x.min()))
        # only the last uninterrupted approach: an earlier hold or step is not this loading
        first = int(far[-1]) + 1 if far.size else 0
        found = polynomial_at(x[first:], f[first:], float(x[-1]), noise_N)
        slope = found[1]
        known = slope.value is not None and (slope.stderr or 0.0) <= PEAK_PRECISION * abs(slope.value)
        if x.size - first >= PEAK_SAMPLES and known:
            break
    return found


def closed_area(depth_mm: FloatArray) -> FloatArray:
    """Weights w with ``sum w_i F_i`` the area of the closed polygon (depth_i, F_i), by trapezoids."""
    return np.asarray((np.roll(depth_mm, -1) - np.roll(depth_mm, 1)) / 2.0)


def _work(depth_mm: FloatArray) -> FloatArray:
    """Weights of the integral of F dx along an open path."""
    step = np.diff(depth_mm) / 2.0
    return np.asarray(np.append(step, 0.0) + np.append(0.0, step))


def _trimmed(depth: FloatArray, loop: Loop, floor: float) -> tuple[int, int]:
    """First and last sample of the part of a loop that lies below ``floor``."""
    above_in = np.flatnonzero(depth[loop.start : loop.peak] < floor)
    first = loop.start + (int(above_in[-1]) + 1 if above_in.size else 0)
    above_out = np.flatnonzero(depth[loop.peak : loop.stop] < floor)
    last = loop.peak + int(above_out[0]) - 1 if above_out.size else loop.stop - 1
    return first, max(last, loop.peak)


def _residual(
    depth: FloatArray, force: FloatArray, loop: Loop, last: int, limit: float, noise: float
) -> tuple[Measure, int]:
    """Depth at which unloading falls to ``limit``, and the last sample before it."""
    below = np.flatnonzero(force[loop.peak : last + 1] < limit)
    if below.size == 0:
        return Measure(), last
    at = loop.peak + int(below[0])
    width = DEPTH_SHARE * (depth[loop.peak] - depth[last])
    inside = np.arange(loop.peak, at + 1)
    inside = inside[depth[inside] <= depth[at] + width]
    _, slope = polynomial_at(depth[inside], force[inside], float(depth[at]), noise)
    steep = slope.value is not None and slope.value > 0.0
    return Measure(float(depth[at]), noise / slope.value if steep else None), at - 1  # type: ignore[operator]


def _speed_squared(time: FloatArray, depth: FloatArray) -> float:
    """Integral of v^2 dt of one direction [mm^2/s], from chords."""
    count = min(STRETCHES, max((time.size - 1) // FEWEST_SAMPLES, 1))
    knots = evenly(time.size, count + 1)
    span, rise = np.diff(time[knots]), np.diff(depth[knots])
    return float((rise[span > 0.0] ** 2 / span[span > 0.0]).sum())


def _viscosity(
    time: FloatArray, depth: FloatArray, force: FloatArray, loop: Loop, floor: float, noise: float
) -> Measure:
    """Area over the integral of v^2 dt of the part below ``floor``.

    Where v tau is much smaller than the depth the branch carries eta v, so that a closed loop dissipates eta
    times that integral on any path (derived); plastic flow, adhesion and drainage count as viscosity as well.
    """
    first, last = _trimmed(depth, loop, floor)
    if loop.peak - first < FEWEST_SAMPLES or last - loop.peak < FEWEST_SAMPLES:
        return Measure()
    weights = closed_area(depth[first : last + 1])
    way_in, way_out = slice(first, loop.peak + 1), slice(loop.peak, last + 1)
    squared = _speed_squared(time[way_in], depth[way_in]) + _speed_squared(time[way_out], depth[way_out])
    if not squared > 0.0:
        return Measure()
    area = float(weights @ force[first : last + 1])
    return Measure(area / squared, noise * float(np.linalg.norm(weights)) / squared)


def _at_depths(
    depth: FloatArray, force: FloatArray, loop: Loop, first: int, depths_mm: Sequence[float], noise: float
) -> tuple[AtDepth, ...]:
    """Secant and tangent of loading at stated depths that it passes."""
    rows = []
    x, f = depth[first : loop.peak + 1], force[first : loop.peak + 1]
    half = DEPTH_SHARE * float(np.ptp(x))
    for at in depths_mm:
        value, slope = Measure(), Measure()
        if x.min() <= at <= x[-1]:
            near = np.abs(x - at) <= half
            value, slope = polynomial_at(x[near], f[near], at, noise)
        rows.append(AtDepth(float(at), secant_N_per_mm=_over(value, at), tangent_N_per_mm=slope))
    return tuple(rows)


def _over(force: Measure, depth: float) -> Measure:
    """A force over a depth."""
    if force.value is None or force.stderr is None or not depth > 0.0:
        return Measure()
    return Measure(force.value / depth, force.stderr / depth)


def _row(
    trial: Trial,
    segmentation: Segmentation,
    frame: tuple[FloatArray, FloatArray],
    loop: Loop,
    number: int,
    depths_mm: Sequence[float],
) -> Cycle | None:
    depth, force = frame
    contact, noise = segmentation.contact, segmentation.force_noise_N
    assert contact is not None  # noqa: S101  (the caller has looked)
    floor = max(float(depth[loop.start]), float(depth[loop.stop - 1]), -AIR_SD * contact.sd_mm)
    first, last = _trimmed(depth, loop, floor)
    if loop.peak - first < LINE_SAMPLES or last - loop.peak < LINE_SAMPLES:
        return None
    x, f = depth[first : last + 1], force[first : last + 1]
    area = closed_area(x)
    loading = np.zeros(x.size)
    loading[: loop.peak - first + 1] = _work(depth[first : loop.peak + 1])
    dissipated, work = float(area @ f), float(loading @ f)
    ratio = dissipated / work if work > 0.0 else None
    peak_force, tangent = end_of_loading(depth, force, loop.peak, first, noise)
    top = float(f.max()) if peak_force.value is None else peak_force.value
    limit = max(RESIDUAL_SHARE * top, RESIDUAL_SD * noise)
    residual, attached = _residual(depth, force, loop, last, limit, noise)
    held = loop.kind == "ramp-hold-retract"
    let_go = max(floor, float(depth[attached])) if residual.value is not None else floor
    deepest = float(depth[loop.peak])
    norm = np.linalg.norm
    return Cycle(
        path=trial.source.path,
        sheet=trial.source.sheet,
        number=number,
        kind=loop.kind,
        start_s=float(trial.time_s[first]),
        peak_s=float(trial.time_s[loop.peak]),
        end_s=float(trial.time_s[last]),
        floor_mm=floor,
        peak_depth_mm=deepest,
        peak_force_N=peak_force,
        loading_work_mJ=Measure(work, noise * float(norm(loading))),
        dissipated_mJ=Measure(dissipated, noise * float(norm(area))),
        hysteresis=Measure()
        if ratio is None
        else Measure(ratio, noise * float(norm(area - ratio * loading)) / work),
        secant_N_per_mm=_over(peak_force, deepest),
        tangent_N_per_mm=tangent,
        residual_depth_mm=residual,
        viscosity_N_s_per_mm=Measure()
        if held
        else _viscosity(trial.time_s, depth, force, loop, let_go, noise),
        viscosity_model_N_s_per_mm=Measure(),
        peak_force_change=Measure(),
        dissipated_change=Measure(),
        at_depths=_at_depths(depth, force, loop, first, depths_mm, noise),
    )


def _change(now: Measure, before: Measure) -> Measure:
    """Relative change, errors of both independent."""
    if now.value is None or now.stderr is None or not before.value or before.stderr is None:
        return Measure()
    ratio = now.value / before.value
    spread = np.hypot(now.stderr, ratio * before.stderr) / abs(before.value)
    return Measure(ratio - 1.0, float(spread))


def _with_changes(rows: list[Cycle]) -> tuple[Cycle, ...]:
    """Each loop against the one before, where both go equally deep."""
    done = rows[:1]
    for before, now in pairwise(rows):
        changed = now
        spans = [row.peak_depth_mm - row.floor_mm for row in (before, now)]
        if before.kind == now.kind and abs(spans[1] - spans[0]) <= SAME_AMPLITUDE * max(spans):
            changed = structs.replace(
                now,
                peak_force_change=_change(now.peak_force_N, before.peak_force_N),
                dissipated_change=_change(now.dissipated_mJ, before.dissipated_mJ),
            )
        done.append(changed)
    return tuple(done)


def cycle_rows(
    trial: Trial, segmentation: Segmentation, *, depths_mm: Sequence[float] = ()
) -> tuple[Cycle, ...]:
    """One row for every load-unload loop; none where there is no contact or no unloading."""
    contact = segmentation.contact
    if contact is None:
        return ()
    frame = contact_frame(trial, segmentation)
    rows: list[Cycle] = []
    for loop in loops(segmentation, frame[0]):
        if not frame[0][loop.peak] > 0.0:
            continue
        # contact is that of the test: preconditioning comes before it, and so do moves through air
        if loop.peak <= contact.index:
            first, last = loop.peak - LINE_SAMPLES, loop.peak + LINE_SAMPLES + 1
            near = frame[1][max(first, loop.start) : min(last, loop.stop)]
            if not float(np.median(near)) > RESIDUAL_SD * segmentation.force_noise_N:
                continue
        row = _row(trial, segmentation, frame, loop, len(rows) + 1, depths_mm)
        if row is not None:
            rows.append(row)
    return _with_changes(rows)
