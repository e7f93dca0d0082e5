"""Speed along a log over the speed at which each contact began.

Speeds are slopes of a line through a short stretch of displacement that never reaches over the corner of a
phase: a machine's speed changes at corners, and a window across one would blur them.  They are those of the
recorded travel: what a frame gives way to changes the depth of the tip, not this ratio.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.window import FittedLog, LogData, chain_breaks
from tissueid.signal_noise import white_noise_sd
from tissueid.trial import Segmentation, Trial, contact_frame

#: Half of the stretch, in samples, and as a share of its phase: a line through at least eleven samples has an
#: eighth of the error of a difference.
HALF_SAMPLES = 5
HALF_SHARE = 0.05
#: Root mean square distance from a line that is straight, over the noise of the travel and over the travel.
STRAIGHT, STRAIGHT_SHARE = 1.3, 1e-5
#: Samples beside a corner that say when it was, not how the tissue resists.
CORNER = 2


def with_speed_ratio(trial: Trial, segmentation: Segmentation, log: FittedLog) -> FittedLog | None:
    """A log from its samples in air on, with its speed ratio; None where no contact begins at a speed.

    Nothing relaxes under these laws, so that samples near the contact and in air before it count as well:
    they say where the contact is not.  Samples beside a corner have no speed and stay out.
    """
    depth, force = contact_frame(trial, segmentation)
    speed = _speeds(trial.time_s, depth, segmentation)
    measured = np.flatnonzero(np.isfinite(speed))
    touching = depth > 0.0
    begins = np.flatnonzero(touching & ~np.append(False, touching[:-1]))
    # a corner leaves samples without a speed inside a contact, which begins no other one
    begins = begins[begins <= measured[-1]] if measured.size else begins[:0]
    at_begin = speed[measured[np.searchsorted(measured, begins)]]
    begins, at_begin = begins[at_begin > 0.0], at_begin[at_begin > 0.0]
    if not begins.size:
        return None
    contacts = np.maximum(np.searchsorted(begins, np.arange(depth.size), side="right") - 1, 0)
    ratio = np.clip(speed / at_begin[contacts], -1.0, 1.0)
    # at a corner the ratio jumps: between the samples that are left out, which a skew does not reach over
    nearest = np.rint(np.interp(np.arange(ratio.size), measured, np.arange(float(measured.size))))
    ratio = ratio[measured[nearest.astype(np.int64)]]
    first, stop = min(log.first, measured[0]), log.first + log.data.time_s.size - int(log.inserted)
    rows, include = slice(first, stop), np.isfinite(speed[first:stop])
    data = LogData(
        time_s=np.ascontiguousarray(trial.time_s[rows]),
        depth_mm=np.ascontiguousarray(depth[rows]),
        force_N=np.ascontiguousarray(force[rows]),
        include=include,
        fold=np.zeros(include.size, dtype=np.int64),
        breaks=chain_breaks(trial.time_s[rows]),
        speed_ratio=np.ascontiguousarray(ratio[rows]),
    )
    return replace(log, data=data, first=int(first), inserted=False, n_samples=int(include.sum()))


def _speeds(time: FloatArray, depth: FloatArray, segmentation: Segmentation) -> FloatArray:
    """Speed at every sample [mm/s]; NaN outside of all phases, and at corners, where it jumps."""
    speed = np.full(depth.size, np.nan)
    corners = _corners(segmentation)
    for start, last in corners:
        inner = slice(start + CORNER, last - CORNER + 1)
        if inner.stop - inner.start < 3:
            inner = slice(start, last + 1)
        speed[inner] = _slopes(time[inner], depth[inner])
    near = np.ravel([one for _, one in corners])[:, None] + np.arange(-CORNER, CORNER + 1)
    speed[near[(near >= 0) & (near < depth.size)]] = np.nan
    return speed


def _corners(segmentation: Segmentation) -> list[tuple[int, int]]:
    """First and last samples between corners; a machine keeps its speed as it meets the tissue."""
    out, met = list[tuple[int, int]](), False
    for phase in segmentation.phases:
        ends = (
            [phase.start, phase.stop - 1] if phase.peak is None else [phase.start, phase.peak, phase.stop - 1]
        )
        if met and out:
            ends[0] = out.pop()[0]
        out += pairwise(ends)
        met = phase.kind == "approach"
    return out


def _slopes(time: FloatArray, depth: FloatArray) -> FloatArray:
    """Speed of a stretch that is straight, else slope of the line through the neighbours of each sample."""
    size = time.size
    t, x = time - time.mean(), depth - depth.mean()
    whole = float(t @ x) / max(float(t @ t), 1e-300)
    noise = white_noise_sd(time, depth)
    if (
        float(np.mean((x - whole * t) ** 2))
        <= (STRAIGHT * noise) ** 2 + (STRAIGHT_SHARE * float(np.ptp(x))) ** 2
    ):
        return np.full(size, whole)
    half = max(HALF_SAMPLES, int(HALF_SHARE * size))
    at = np.arange(size)
    low, high = np.maximum(at - half, 0), np.minimum(at + half + 1, size)
    sums = [np.concatenate([[0.0], np.cumsum(one)]) for one in (t, x, t * t, t * x)]
    st, sx, stt, stx = (one[high] - one[low] for one in sums)
    count = high - low
    spread = stt - st * st / count
    return np.asarray(np.divide(stx - st * sx / count, spread, out=np.zeros(size), where=spread > 0.0))
