"""A log on a hundred knots: what the likelihood needs to know of any smooth change of the model.

At the optimum a log leaves a residual e.  Another model differs from the optimum by a function of time that
is smooth between corners of the motion; on knots that are dense after each corner it is a sum of hat
functions H with the difference d at the knots as weights, and the sum of squares is

    (e - H d)'R^-1 (e - H d) = e'R^-1 e - 2 d'H'R^-1 e + d'H'R^-1 H d.

The three sums are one pass over the samples; after it nothing depends on their number, and the model may be
nonlinear in whatever one likes: a delay, a filter, a frame that gives.  R is the correlation of the noise
(:mod:`tissueid.likelihood.lag_sums`) with its parameters held.  Knots are samples, which keeps H'R^-1 H
tridiagonal under AR(1) noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.chains import chain_breaks
from tissueid.likelihood.instrument_kernels import Packed, instrument_force
from tissueid.likelihood.knot_kernels import accumulate, corner_flags
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.sums import LogData

__all__ = ["KnotSums", "choose_knots", "knot_sums", "packed"]

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: The depth is linear between corners to this fraction of its range, or to so many times its own noise.
CORNER_SHARE = 1e-4
CORNER_NOISE = 6.0
MAX_CORNERS = 60
#: Steps from one knot to the next after a corner: one sample, then this fraction of the time since it.  What
#: a filter does to a relaxation bends there: hats over a fourth of the time moved relaxation times by 0.03 of
#: their standard deviation at 1 kHz, over half of it at 100 Hz as much.
AFTER = 0.15
#: Steps before a corner grow by this factor away from it.
BEFORE = 1.5
#: Knots of equal spacing between two corners where the tool moves, and where it stands.
MOVING, STANDING = 36, 4
#: A stretch moves where it covers more than this fraction of the depth.
MOVES = 0.01
#: The last samples of a log stay out: with the force early by up to this, they would ask where the
#: tool went next [s].
END_MARGIN_S = 0.006


@dataclass(frozen=True, slots=True, eq=False)
class KnotSums:
    """Sums of one log on its knots.

    Attributes
    ----------
    time_s, depth_mm : ndarray, shape (m,)
        Knots, from contact on, and the tool's depth there.
    pull : ndarray, shape (m,)
        H'R^-1 e [N].
    band : ndarray, shape (m, w)
        H'R^-1 H by diagonals: ``band[k, d]`` is the entry (k, k + d).
    square : float
        e'R^-1 e [N^2].
    count : int
        Samples.
    """

    time_s: FloatArray
    depth_mm: FloatArray
    pull: FloatArray
    band: FloatArray
    square: float
    count: int

    def tempered(self, samples: float) -> KnotSums:
        """The same with what another model adds to the sum of squares divided by a number of samples."""
        return replace(self, pull=self.pull / samples, band=self.band / samples)


def _corners(time_s: FloatArray, depth_mm: FloatArray) -> IntArray:
    """Samples at which the motion changes."""
    tolerance = CORNER_SHARE * float(np.ptp(depth_mm))
    if depth_mm.size > 2:
        # second differences of white noise have six times its variance; the median is 0.67 sd
        noise = float(np.median(np.abs(np.diff(depth_mm, 2)))) / (0.6745 * 6.0**0.5)
        tolerance = max(tolerance, CORNER_NOISE * noise)
    while True:
        corners = np.flatnonzero(corner_flags(time_s, depth_mm, tolerance))
        if corners.size <= MAX_CORNERS or tolerance <= 0.0:
            return corners
        tolerance *= 2.0


def _since(step: float, length: float) -> FloatArray:
    """Offsets after a corner: every sample at first, then by a fraction of the time since it."""
    near = step * np.arange(1.0, round(1.0 / AFTER) + 1)
    count = int(np.log(max(length / near[-1], 1.0)) / np.log1p(AFTER)) + 1
    far = near[-1] * (1.0 + AFTER) ** np.arange(1, count + 1)
    every = np.concatenate([near, far])
    return np.asarray(every[every < length])


def _growing(first: float, length: float, factor: float) -> FloatArray:
    """Offsets whose steps grow by a factor, from ``first`` to ``length``."""
    if length <= first:
        return np.zeros(0)
    count = int(np.log1p((factor - 1.0) * length / first) / np.log(factor)) + 1
    return np.asarray(first * (factor ** np.arange(1, count + 1) - 1.0) / (factor - 1.0))


def choose_knots(time_s: FloatArray, depth_mm: FloatArray) -> IntArray:
    """Samples that are knots: dense after every corner, sparse elsewhere.

    Parameters
    ----------
    time_s, depth_mm : ndarray, shape (n,)
        At least two different times.

    Returns
    -------
    ndarray of int
        Ascending, first and last sample included, times strictly growing.
    """
    steps = np.diff(time_s)
    step = float(np.median(steps[steps > 0.0]))
    corners = _corners(time_s, depth_mm)
    moves = MOVES * float(np.ptp(depth_mm))
    wanted = [time_s[corners]]
    for low, high in pairwise(corners.tolist()):
        start, end = time_s[low], time_s[high]
        span = end - start
        count = MOVING if abs(depth_mm[high] - depth_mm[low]) > moves else STANDING
        after = _since(step, span)
        before = _growing(step, span, BEFORE)
        wanted += [start + after, end - before, np.linspace(start, end, count + 1)]
    times = np.unique(np.clip(np.concatenate(wanted), time_s[0], time_s[-1]))
    right = np.clip(np.searchsorted(time_s, times), 1, time_s.size - 1)
    nearest = np.where(times - time_s[right - 1] < time_s[right] - times, right - 1, right)
    index = np.unique(np.concatenate([[0], nearest, [time_s.size - 1]]))
    # of samples with one time the last stands
    return np.asarray(index[np.diff(time_s[index], append=np.inf) > 0.0])


def knot_sums(
    data: LogData,
    residual_N: FloatArray,
    *,
    phi: float,
    reference_step_s: float,
    moving_average: float = 0.0,
    end_margin_s: float = END_MARGIN_S,
) -> KnotSums:
    """Sum one log over its knots.

    Parameters
    ----------
    data : LogData
        In the contact frame.
    residual_N : ndarray, shape (n,)
        Force less that of the optimum, at every sample of ``data``.
    phi, reference_step_s, moving_average : float
        Noise, held at its estimate; see :class:`tissueid.uncertainty.NoiseFit`.
    end_margin_s : float
        Samples this near to the end stay out where the tool still moves there.

    Returns
    -------
    KnotSums
    """
    time, depth = data.time_s, data.depth_mm
    knots = choose_knots(time, depth)
    include = data.include.copy()
    if knots.size > 1 and depth[knots[-1]] != depth[knots[-2]]:
        late = time > time[-1] - end_margin_s
        if (include & ~late).any():
            include &= ~late
    breaks = chain_breaks(time) if data.breaks is None else data.breaks
    linked = include & ~breaks
    linked[1:] &= include[:-1] & (np.diff(time) > 0.0)
    linked[:1] = False
    gram, pull, square = accumulate(
        time, residual_N, include, linked, time[knots], phi, reference_step_s, moving_average
    )
    offsets = np.flatnonzero([np.any(np.diagonal(gram, d)) for d in range(knots.size)])
    width = int(offsets[-1]) + 1 if offsets.size else 1
    band = np.zeros((knots.size, width))
    for d in range(width):
        band[: knots.size - d, d] = np.diagonal(gram, d)
    return KnotSums(
        time_s=time[knots].copy(),
        depth_mm=depth[knots].copy(),
        pull=pull,
        band=band,
        square=float(square),
        count=int(include.sum()),
    )


def packed(knots: Sequence[KnotSums], optimum: Optimum, effects: tuple[str, ...]) -> Packed:
    """The logs of a specimen behind each other, as the kernels want them.

    Parameters
    ----------
    knots : sequence of KnotSums
        Residuals of ``optimum``.
    optimum : Optimum
    effects : tuple of str
        Of every log: some of ``gain`` and ``offset``, or ``static``.
    """
    width = max(one.band.shape[1] for one in knots)
    band = [np.pad(one.band, ((0, 0), (0, width - one.band.shape[1]))) for one in knots]
    unit = optimum.scale ** np.arange(float(optimum.own.shape[1]))
    data = Packed(
        time_s=np.concatenate([one.time_s for one in knots]),
        depth_mm=np.concatenate([one.depth_mm for one in knots]),
        first=np.cumsum([0, *(one.time_s.size for one in knots)]).astype(np.int64),
        pull=np.concatenate([one.pull for one in knots]),
        band=np.ascontiguousarray(np.concatenate(band)),
        square=np.array([one.square for one in knots]),
        base=np.zeros(sum(one.time_s.size for one in knots)),
        scale=float(optimum.scale),
        degree=int(optimum.degree),
        branches=optimum.branches,
        static=optimum.static,
        gamma=np.array(optimum.gamma, dtype=np.float64),
        delta=np.array(optimum.delta, dtype=np.float64),
        own=np.ascontiguousarray(optimum.own * unit),
        gain="gain" in effects,
        offset="offset" in effects,
        free="static" in effects,
    )
    rigid = np.zeros(3)
    theta, log_tau = np.ascontiguousarray(optimum.theta), np.ascontiguousarray(optimum.log_tau)
    return data._replace(base=instrument_force(data, theta, log_tau, rigid))
