"""Loadings of a recording, and the surface between them, as far as the record itself tells them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.measured.pushes import usable_until
from tissueid.trial import SEVERAL_SPEEDS, Segmentation

#: Measured force, over the peak and in standard deviations of its noise, below which the tool is in air.
AIR_SHARE, AIR_SD = 0.01, 3.0
#: Samples of the running mean that is compared with it; shorter stays in air or contact are noise.
SMOOTHED = 5
#: Depth, over the largest, that a surface is back at.
LEAST_BACK = 1e-3
#: Depth over the largest from which a loading tells a speed.
LEAST_LOADING = 0.1


def first_of_test(segmentation: Segmentation) -> int:
    """The first sample of the test proper; 0 without preconditioning, or where it broke the tissue."""
    if not segmentation.test:
        return 0
    start = segmentation.phases[segmentation.test].start
    return start if usable_until(segmentation, start + 1) > start else 0


def _loadings(segmentation: Segmentation, depth: FloatArray, first: int) -> list[slice]:
    """Samples of each loading from contact on, with the holds behind it: until the tool turns back."""
    begins, stop = max(first, first_of_test(segmentation)) + 1, usable_until(segmentation, depth.size)
    ends, starts = [first], [begins - 1]
    for phase in segmentation.phases:
        if phase.stop <= begins or phase.start >= stop:
            continue
        turned = len(ends) > len(starts)
        if turned and phase.kind in ("approach", "ramp", "cycle"):
            starts.append(phase.start)
            turned = False
        if turned:
            continue
        if phase.kind == "cycle":
            ends[-1] = max(ends[-1], phase.start + int(np.argmax(depth[phase.start : phase.stop])) + 1)
        else:
            ends[-1] = max(ends[-1], phase.start + 1 if phase.kind == "retract" else phase.stop)
        if phase.kind in ("cycle", "retract"):
            ends.append(0)
    if ends[0] <= first:
        return [slice(first, stop)]
    found = [slice(one, min(other, stop)) for one, other in zip(starts, ends, strict=False)]
    return [one for one in found if one.stop > one.start + 1] or found[:1]


def _several(
    segmentation: Segmentation, time_s: FloatArray, depth: FloatArray, loadings: list[slice]
) -> bool:
    """True where loadings are of several speeds, and none ends in a hold, which tells as much by itself."""
    deep = np.array([depth[one].max(initial=0.0) for one in loadings])
    real = [one for one, far in zip(loadings, deep, strict=True) if far > LEAST_LOADING * deep.max()]
    holds = segmentation.of_kind("hold")
    if not real or any(hold.start < one.stop <= hold.stop for hold in holds for one in loadings):
        return False
    speeds = [loading_speed(time_s, depth, one) for one in real]
    return max(speeds) > SEVERAL_SPEEDS * min(speeds)


def loadings_of(segmentation: Segmentation, time_s: FloatArray, depth: FloatArray, first: int) -> list[slice]:
    """Loadings from contact on that make one test; of repetitions the first."""
    found = _loadings(segmentation, depth, first)
    return found if len(found) > 1 and _several(segmentation, time_s, depth, found) else found[:1]


def loading_speed(time_s: FloatArray, depth_mm: FloatArray, loading: slice) -> float:
    """Mean speed of a loading from a tenth of its depth on [mm/s]."""
    time, depth = time_s[loading], depth_mm[loading]
    begins = int(np.argmax(depth >= LEAST_LOADING * depth.max()))
    return mean_speed(time[begins:], depth[begins:])


def mean_speed(time_s: FloatArray, depth_mm: FloatArray) -> float:
    """Mean speed up to the deepest sample [mm/s]."""
    peak = int(np.argmax(depth_mm))
    span = float(time_s[peak] - time_s[0])
    return float((depth_mm[peak] - depth_mm[0]) / span) if span > 0.0 else 0.0


def air_limit(force_N: FloatArray, noise_N: float) -> float:
    """Mean force over :data:`SMOOTHED` samples below which the tool counts as in air [N]."""
    return max(AIR_SHARE * float(force_N.max()), AIR_SD * noise_N / float(np.sqrt(SMOOTHED)))


def measured_surface(
    time_s: FloatArray, tool_mm: FloatArray, *, force_N: FloatArray, turn: int, noise_N: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The first path: in air where the force says so, the surface coming back as an exponential does."""
    # imported here because a command that fits nothing never needs it
    from scipy.ndimage import find_objects, label, median_filter

    mean = np.convolve(force_N, np.ones(SMOOTHED) / SMOOTHED, mode="same")
    air = (mean < air_limit(force_N, noise_N)) & (np.arange(force_N.size) >= turn)
    air = median_filter(air, 2 * SMOOTHED - 1, mode="nearest")
    surface, least = tool_mm.copy(), LEAST_BACK * float(np.abs(tool_mm).max())
    for (run,) in find_objects(label(air)[0]):
        ends = np.array([max(run.start - 1, 0), min(run.stop, tool_mm.size - 1)])
        ends_mm = tool_mm[[ends[0], ends[0] if run.stop == tool_mm.size else ends[1]]]
        ln_mm = np.interp(time_s[run], time_s[ends], np.log(np.maximum(ends_mm, least)))
        surface[run] = np.maximum(np.exp(ln_mm), tool_mm[run])
    return surface, ~air
