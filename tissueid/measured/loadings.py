"""The loading that is fitted, and the surface behind it, as far as the record itself tells them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.measured.pushes import usable_until
from tissueid.trial import Segmentation

#: Measured force, over the peak and in standard deviations of its noise, below which the tool is in air.
AIR_SHARE, AIR_SD = 0.01, 3.0
#: Samples of the running mean that is compared with it; shorter stays in air or contact are noise.
SMOOTHED = 5
#: Depth, over the largest, that a surface is back at.
LEAST_BACK = 1e-3


def first_of_test(segmentation: Segmentation) -> int:
    """The first sample of the test proper; 0 without preconditioning, or where it broke the tissue."""
    if not segmentation.test:
        return 0
    start = segmentation.phases[segmentation.test].start
    return start if usable_until(segmentation, start + 1) > start else 0


def first_turn(segmentation: Segmentation, depth: FloatArray, first: int) -> int:
    """One past the last sample before the tool first turns back, or the tissue breaks."""
    stop = usable_until(segmentation, depth.size)
    begins = first_of_test(segmentation)
    last = first
    for phase in segmentation.phases:
        if phase.stop <= first + 1 or phase.stop <= begins + 1:
            continue
        if phase.kind == "cycle":
            peak = phase.start + int(np.argmax(depth[phase.start : phase.stop]))
            return min(max(last, peak + 1), stop)
        if phase.kind == "retract":
            return min(max(last, phase.start + 1), stop)
        last = phase.stop
    return min(last, stop) if last > first else stop


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
