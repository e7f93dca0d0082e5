"""Input of a contact law with memory of its first touch: depth, force and speed over speed at contact.

Speeds are slopes of a line through a short stretch of displacement that never reaches over the corner of a
phase: a machine's speed changes at corners, and a window across one would blur them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tissueid.measured.pushes import usable_until
from tissueid.trial import Segmentation, Trial, contact_frame

__all__ = ["ContactLog", "contact_log"]

FloatArray = NDArray[np.float64]

#: Half of the stretch, in samples, and as a share of its phase: a line through at least eleven samples has an
#: eighth of the error of a difference.
HALF_SAMPLES = 5
HALF_SHARE = 0.05
#: Samples beside a corner that say when it was, not how the tissue resists.
CORNER = 2
#: Fewest samples of a log that are worth a fit.
MIN_SAMPLES = 20


@dataclass(frozen=True, slots=True, eq=False)
class ContactLog:
    """One recording, from its start to the end of its last contact.

    Attributes
    ----------
    path : str
    sheet : str or None
    depth_mm, force_N : ndarray, shape (n,)
        Below the segmented contact point, above the reading in air.
    ratio : ndarray, shape (n,)
        Speed over the speed at which this contact began, within +-1.
    breaks : ndarray of bool, shape (n,)
        True where a sample does not follow the one before it.
    speed_mm_s : float
        At the first contact.
    """

    path: str
    sheet: str | None
    depth_mm: FloatArray
    force_N: FloatArray
    ratio: FloatArray
    breaks: NDArray[np.bool_]
    speed_mm_s: float


def contact_log(trial: Trial, segmentation: Segmentation) -> ContactLog | None:
    """A trial in air before its first contact and in contact, up to a rupture; None for too few samples.

    Parameters
    ----------
    trial : Trial
    segmentation : Segmentation
    """
    if segmentation.contact is None:
        return None
    depth, force = contact_frame(trial, segmentation)
    speed = _speeds(trial.time_s, depth, segmentation)
    reach = np.arange(depth.size) < usable_until(segmentation, depth.size)
    touching = (depth > 0.0) & reach
    begins = np.flatnonzero(touching & ~np.concatenate([[False], touching[:-1]]))
    # a corner leaves samples without a speed inside a contact, which begins no other one
    measured = np.flatnonzero(np.isfinite(speed))
    begins = begins[begins <= measured[-1]] if measured.size else begins[:0]
    at_begin = speed[measured[np.searchsorted(measured, begins)]]
    begins, at_begin = begins[at_begin > 0.0], at_begin[at_begin > 0.0]
    if not begins.size:
        return None
    contacts = np.searchsorted(begins, np.arange(depth.size), side="right") - 1
    at_contact = at_begin[np.maximum(contacts, 0)]
    kept = touching & np.isfinite(speed) & (contacts >= 0)
    if int(kept.sum()) < MIN_SAMPLES:
        return None
    # in air the record says what the load cell reads there, and where the contact is not
    kept |= np.arange(depth.size) < begins[0]
    speed[np.isnan(speed)] = at_contact[0]
    rows = np.flatnonzero(kept)
    return ContactLog(
        path=trial.source.path,
        sheet=trial.source.sheet,
        depth_mm=depth[kept],
        force_N=force[kept],
        ratio=np.clip(speed / at_contact, -1.0, 1.0)[kept],
        breaks=np.concatenate([[True], np.diff(rows) > 1]),
        speed_mm_s=float(at_begin[0]),
    )


def _speeds(time: FloatArray, depth: FloatArray, segmentation: Segmentation) -> FloatArray:
    """Speed at every sample [mm/s]; NaN outside of all phases, and at corners, where it jumps."""
    speed = np.full(depth.size, np.nan)
    corners = []
    for phase in segmentation.phases:
        last = phase.stop - 1
        ends = [phase.start, last] if phase.peak is None else [phase.start, phase.peak, last]
        for start, stop in pairwise(ends):
            own = slice(start, stop + 1)
            speed[own] = _slopes(time[own], depth[own])
        # a machine does not change its speed because it meets the tissue
        corners += ends[1:] if phase.kind != "approach" else []
    near = np.asarray(corners)[:, None] + np.arange(-CORNER, CORNER + 1) if corners else np.zeros((0, 1), int)
    speed[near[(near >= 0) & (near < depth.size)]] = np.nan
    return speed


def _slopes(time: FloatArray, depth: FloatArray) -> FloatArray:
    """Slope of the line through the neighbours of each sample, by running sums."""
    size = time.size
    if size < 2:
        return np.zeros(size)
    half = max(HALF_SAMPLES, int(HALF_SHARE * size))
    at = np.arange(size)
    low, high = np.maximum(at - half, 0), np.minimum(at + half + 1, size)
    t, x = time - time.mean(), depth - depth.mean()
    sums = [np.concatenate([[0.0], np.cumsum(one)]) for one in (t, x, t * t, t * x)]
    st, sx, stt, stx = (one[high] - one[low] for one in sums)
    count = high - low
    spread = stt - st * st / count
    return np.asarray(np.divide(stx - st * sx / count, spread, out=np.zeros(size), where=spread > 0.0))
