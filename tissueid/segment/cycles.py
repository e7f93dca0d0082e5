"""Load-unload loops: peak force and work of each, and whether the tissue is preconditioned by the last.

Tissue is called preconditioned where peak force and loop work change by less than 2 % from loop to loop.
Loops are compared at one peak depth where their peaks agree within the sampling, and over the depths that
all of them cover.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.trial import Phase

#: Change from loop to loop below which tissue is preconditioned.
PRECONDITIONED_CHANGE = 0.02
#: Loops at the end whose changes count.
LAST_LOOPS = 3
#: Share of a loop's travel below its peak over which force is averaged by a straight line.
PEAK_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class Loop:
    """One loop."""

    #: Depth and force at its turn, as recorded but for sign.
    peak_mm: float
    peak_N: float
    work_N_mm: float  # work lost in the loop, over the depths that all loops cover


def loops_of(depth_mm: FloatArray, force_N: FloatArray, phases: tuple[Phase, ...]) -> tuple[Loop, ...]:
    """Peaks and work of the loops among the phases.

    ``depth_mm``, ``force_N`` (n,): growing into the tissue.
    """
    cycles = [phase for phase in phases if phase.kind == "cycle" and phase.peak is not None]
    if not cycles:
        return ()
    paths = [depth_mm[phase.start : phase.stop] for phase in cycles]
    bottom = max(max(float(path[0]), float(path[-1])) for path in paths)
    peaks = np.array([float(path.max()) for path in paths])
    steps = [float(np.abs(np.diff(path)).max(initial=0.0)) for path in paths]
    # peaks that differ by less than what moves between two samples are one peak, sampled differently
    common = float(peaks.min()) if np.ptp(peaks) <= max(steps) else None
    return tuple(
        Loop(
            float(peak),
            _force_at(depth_mm, force_N, phase, float(peak) if common is None else common),
            _work(depth_mm, force_N, phase, bottom),
        )
        for phase, peak in zip(cycles, peaks, strict=True)
    )


def _force_at(depth_mm: FloatArray, force_N: FloatArray, phase: Phase, level_mm: float) -> float:
    """Force of the loading branch at a depth near its peak, from a straight line through its end."""
    assert phase.peak is not None  # noqa: S101  (the caller has looked)
    x, f = depth_mm[phase.start : phase.peak + 1], force_N[phase.start : phase.peak + 1]
    near = np.flatnonzero(x >= level_mm - PEAK_SHARE * float(np.ptp(x)))
    if near.size < 3:
        near = np.arange(max(x.size - 3, 0), x.size)
    off = x[near] - x[near].mean()
    spread = float(off @ off)
    slope = float(off @ f[near]) / spread if spread > 0.0 else 0.0
    return float(f[near].mean() + slope * (level_mm - x[near].mean()))


def _work(depth_mm: FloatArray, force_N: FloatArray, phase: Phase, bottom_mm: float) -> float:
    """Area of the loop above a depth [N mm]."""
    x = np.maximum(depth_mm[phase.start : phase.stop], bottom_mm)
    return float(np.trapezoid(force_N[phase.start : phase.stop], x))


def cycle_flags(loops: tuple[Loop, ...], *, before_test: bool, baseline_N: float) -> list[Flag]:
    """Their number, and the verdict on preconditioning.

    ``before_test``: whether a ramp and hold follow the loops; ``baseline_N``: force in air, in the direction
    of the loops' forces.
    """
    if not loops:
        return []
    count = len(loops)
    flags = [Flag("cyclic", f"{count} load-unload loops", {"loops": count})]
    last = loops[-LAST_LOOPS:]
    if len(last) < 2:
        return flags
    force = _change([loop.peak_N - baseline_N for loop in last])
    work = _change([loop.work_N_mm for loop in last])
    depth = float(np.ptp([loop.peak_mm for loop in last]))
    still = max(force, work) < PRECONDITIONED_CHANGE
    message = (
        f"peak force changes by {100 * force:.2g} %, work by {100 * work:.2g} % a loop over the last "
        f"{len(last)} of {count}"
    )
    values = {
        "loops": count,
        "peak_force_change": force,
        "work_change": work,
        "peak_depth_range_mm": depth,
        "before_test": before_test,
    }
    return [*flags, Flag("preconditioned" if still else "not_preconditioned", message, values)]


def _change(values: list[float]) -> float:
    """Largest relative change from one value to the next; 1 where there is nothing to compare with."""
    return max((abs(b / a - 1.0) if a > 0.0 else 1.0) for a, b in pairwise(values))
