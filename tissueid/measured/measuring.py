"""Compose what one recording showed from its phases; forces of a hold at stated times.

Such a force is that of a parabola through the samples within a fifth of the time where there are enough of
them, without those far off it; else between the two neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents import measured as documents
from tissueid.measured.cycles import cycle_rows
from tissueid.measured.geometry import Geometry, modulus_of
from tissueid.measured.pushes import HELD, Move, after_rupture, braking_before, move_before, moves, peak_of
from tissueid.measured.relaxation import Ladders, hold_ladders
from tissueid.quantities import beyond_ramp
from tissueid.trial import Event, Phase, Segmentation, Trial

#: Half width of the window over the time, and fewest samples of a parabola.
SHARE, FEWEST = 0.2, 6
#: A sample at the edge of the window is in it, however times are rounded: by this share of the half width.
AT_EDGE = 1e-6
#: A hold that ends within this share before the time has reached it.
REACHED = 0.01
#: The nearest sample must lie within this factor of the time.
NEAR = 1.5
#: Samples farther off the parabola than this many of the middle deviations are left out, once.
FAR = 6.0


class ForceAt(NamedTuple):
    """Force and its standard deviation [N]; ``None`` with the reason where there is none."""

    force_N: float | None
    sd_N: float | None
    reason: str = ""


def force_at(time_s: FloatArray, force_N: FloatArray, at_s: float, noise_N: float) -> ForceAt:
    """The force so long after the start of a window."""
    if time_s.size < 2:
        return ForceAt(None, None, "it has one sample")
    last = float(time_s[-1])
    if last < (1.0 - REACHED) * at_s:
        return ForceAt(None, None, f"the hold lasts {last:.4g} s")
    later = time_s[time_s > 0.0]
    if later.size == 0 or float(np.abs(np.log(later / at_s)).min()) > np.log(NEAR):
        wide = float(np.diff(time_s)[max(int(np.searchsorted(time_s, at_s)) - 1, 0)]) if later.size else last
        return ForceAt(None, None, f"samples are {wide:.3g} s apart at {at_s:g} s")
    near = np.abs(time_s - at_s) <= (1.0 + AT_EDGE) * SHARE * at_s
    if int(near.sum()) < FEWEST:
        return ForceAt(float(np.interp(at_s, time_s, force_N)), noise_N)
    x, f = (time_s[near] - at_s) / (SHARE * at_s), force_N[near]
    design = x[:, None] ** np.arange(3.0)
    off = np.abs(f - design @ np.linalg.lstsq(design, f, rcond=None)[0])
    kept = off <= FAR * max(float(np.median(off)), noise_N, 1e-300)
    if int(kept.sum()) < FEWEST:
        kept = np.ones(x.size, dtype=np.bool_)
    inverse = np.linalg.pinv(design[kept])
    return ForceAt(float(inverse[0] @ f[kept]), noise_N * float(np.linalg.norm(inverse[0])))


#: Times after the stop at which the force of a hold is stated [s].
TIMES_S = (0.1, 1.0, 10.0, 100.0)
#: The time whose force the others are put over.
REFERENCE_S = 10.0
#: First digits of the depths at which the force of a loading is stated, how many of them at the most, and the
#: share of its depth that the last one may have.
ROUND_DEPTHS, MOST_DEPTHS, WITHIN = (1.0, 2.0, 5.0), 3, 0.98
#: Fewest samples at rest that give a base.
LEAST_REST = 2


@dataclass(frozen=True, slots=True, eq=False)
class _Record:
    """A recording with its force above the base, growing with loading."""

    trial: Trial
    segmentation: Segmentation
    base: documents.Base
    force_N: FloatArray
    depth_mm: FloatArray
    ladders: Ladders

    def recorded(self, force_N: float) -> float:
        """A force above the base, as the recording has it."""
        return self.base.recorded_N + self.segmentation.force_sign * force_N


def measure(
    trial: Trial,
    segmentation: Segmentation,
    *,
    geometry: Geometry | None = None,
    ladders: Ladders | None = None,
) -> documents.Measured:
    """Measure a recording, no model; ``ladders``: of its holds, where they are known."""
    base, contact, phases = _base(trial, segmentation), segmentation.contact, segmentation.phases
    zero = float(trial.displacement_mm[0]) if contact is None else contact.displacement_mm
    record = _Record(
        trial,
        segmentation,
        base,
        segmentation.force_sign * (trial.force_N - base.recorded_N),
        segmentation.compression_sign * (trial.displacement_mm - zero),
        hold_ladders(trial, segmentation) if ladders is None else ladders,
    )
    pushes = [_push(record, move, geometry) for move in moves(phases)]
    return documents.Measured(
        base=record.base,
        push=max(pushes, key=lambda one: one.peak.force_N, default=None),
        holds=tuple(
            _hold(record, number, geometry)
            for number, phase in enumerate(phases)
            if phase.kind in HELD and phase.end_s > phase.start_s
        ),
        loops=_loops(trial, segmentation),
    )


def _base(trial: Trial, segmentation: Segmentation) -> documents.Base:
    """The reading in air, else the force at rest before the first move, else the record's own zero."""
    contact = segmentation.contact
    if contact is not None and contact.in_record:
        return documents.Base(contact.baseline_N, "air")
    moving = next((phase for phase in segmentation.phases if phase.speed_mm_s != 0.0), None)
    # the last sample at rest is the first of the move
    if moving is not None and moving.start >= LEAST_REST:
        return documents.Base(float(np.median(trial.force_N[: moving.start])), "rest")
    if contact is not None and contact.baseline_N != 0.0:  # of rows at rest, where tissue can't pull
        return documents.Base(contact.baseline_N, "rest")
    return documents.Base(0.0, "recorded")


def _push(record: _Record, move: Move, geometry: Geometry | None) -> documents.MeasuredPush:
    trial, segmentation, phases = record.trial, record.segmentation, record.segmentation.phases
    start, moving = phases[move.first].start, phases[move.moving].start
    broke = _broke(record, start, move.stop)
    at, force = peak_of(trial.time_s, record.force_N, segmentation, move.last + 1, broke)
    stop = move.stop if broke is None else broke.index
    depth = float(record.depth_mm[stop])
    start_s, stop_s = float(trial.time_s[start]), float(trial.time_s[stop])
    held = phases[move.last + 1] if move.last + 1 < len(phases) else None
    last = held.stop - 1 if held is not None and held.kind == "hold" and broke is None else None
    return documents.MeasuredPush(
        start_s=start_s,
        stop_s=stop_s,
        ramp_time_s=stop_s - start_s,
        speed_mm_s=phases[move.last].speed_mm_s,
        travel_mm=depth - float(record.depth_mm[moving]),
        depth_mm=None if segmentation.contact is None else depth,
        braking_s=braking_before(segmentation, move) if broke is None else None,
        peak=documents.MeasuredPeak(float(trial.time_s[at]), force, record.recorded(force)),
        modulus=modulus_of(trial, segmentation, slice(start, stop + 1), last, geometry),
        forces=() if segmentation.contact is None else _loading(record, slice(start, stop + 1)),
    )


def _broke(record: _Record, start: int, stop: int) -> Event | None:
    """The rupture that ends a loading, as no force after it is as large."""
    for event in record.segmentation.events:
        if event.kind == "rupture" and start < event.index < stop:
            later = float(record.force_N[event.index + 1 : stop + 1].max())
            if later <= event.values.get("force_before_N", 0.0):
                return event
    return None


def _loading(record: _Record, inside: slice) -> tuple[documents.MeasuredDepth, ...]:
    """Forces at the last round depths of a loading, as :func:`force_at` of depths that grow."""
    depth, force = record.depth_mm[inside], record.force_N[inside]
    grown = np.append(True, depth[1:] > np.maximum.accumulate(depth)[:-1])
    deepest = float(depth[grown][-1])
    if not deepest > 0.0:
        return ()
    digits = int(np.floor(np.log10(deepest)))
    asked = [first * 10.0**power for power in (digits - 1, digits) for first in ROUND_DEPTHS]
    rows = []
    for one in [depth_mm for depth_mm in asked if depth_mm <= WITHIN * deepest][-MOST_DEPTHS:]:
        found, sd, _ = force_at(depth[grown], force[grown], one, record.segmentation.force_noise_N)
        if found is not None and sd is not None:
            rows.append(documents.MeasuredDepth(one, found, sd))
    return tuple(rows)


def _hold(record: _Record, number: int, geometry: Geometry | None) -> documents.MeasuredHold:
    segmentation, phase = record.segmentation, record.segmentation.phases[number]
    move = move_before(segmentation.phases, number)
    push = None if move is None else _push(record, move, geometry)
    position = phase.kind == "hold"
    # the sample that a hold shares with the next move may belong to that
    shared = number + 1 < len(segmentation.phases) and phase.stop - phase.start > 2
    last = phase.stop - 1 - int(shared)
    return documents.MeasuredHold(
        start_s=phase.start_s,
        end_s=phase.end_s,
        control="position" if position else "force",
        push=push,
        forces=_forces(record, number, phase, push) if position else (),
        end_N=float(record.force_N[last]),
        creep_mm=float(record.depth_mm[last] - record.depth_mm[phase.start]),
        tau=_tau(record, number) if position else None,
        after_rupture=after_rupture(segmentation, phase),
    )


def _forces(
    record: _Record, number: int, phase: Phase, push: documents.MeasuredPush | None
) -> tuple[documents.MeasuredForce, ...]:
    """Forces at the stated times after the stop."""
    trial, noise = record.trial, record.segmentation.force_noise_N
    peak = peak_of(trial.time_s, record.force_N, record.segmentation, number)
    peak_N = peak.force_N if push is not None and peak.force_N > 0.0 else None

    def said(start: int, wanted: float) -> tuple[float | None, float | None, str]:
        inside = slice(start, phase.stop)
        time = trial.time_s[inside] - trial.time_s[start]
        return force_at(time, record.force_N[inside], wanted, noise)

    reference, _, _ = said(phase.start, REFERENCE_S)
    rows = []
    for wanted in TIMES_S:
        force, sd, reason = said(phase.start, wanted)
        later, _, _ = said(peak.at, wanted)
        over_10s = None if force is None or not reference or reference <= 0.0 else force / reference
        rows.append(
            documents.MeasuredForce(
                time_s=wanted,
                after_stop_N=force,
                sd_N=sd,
                recorded_N=None if force is None else record.recorded(force),
                after_peak_N=later,
                over_10s=over_10s,
                over_peak=None if later is None or peak_N is None else later / peak_N,
                beyond_ramp=push is not None and beyond_ramp(wanted, push.ramp_time_s),
                reason=reason or None,
            )
        )
    return tuple(rows)


def _tau(record: _Record, number: int) -> documents.MeasuredTau | None:
    """Relaxation times from the stop to the end of the hold."""
    found, phase = record.ladders[number], record.segmentation.phases[number]
    if found is None:
        return None
    single, half = found.single_s, found.half_s
    slope = None if single is None or half is None else float(np.log(single / half) / np.log(2.0))
    return documents.MeasuredTau(
        window_s=(phase.start_s, phase.end_s),
        single_s=single,
        double_s=found.taus_s[1],
        nrmsd_single=found.nrmsd[0],
        log_slope=slope,
    )


def _loops(trial: Trial, segmentation: Segmentation) -> tuple[documents.MeasuredLoop, ...]:
    return tuple(
        documents.MeasuredLoop(
            row.number,
            row.kind,
            row.peak_depth_mm,
            row.dissipated_mJ.value,
            row.dissipated_mJ.stderr,
            row.hysteresis.value,
        )
        for row in cycle_rows(trial, segmentation)
    )
