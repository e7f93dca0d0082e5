"""Density of (contact, branch length) of one loading ramp, its linear coefficients integrated out.

Nothing is compiled: the first look at a file must not wait for a compiler.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray

#: Of bins: depth [mm], its variance [mm2], one over the noise of the mean force [1/N], and the force over it.
_Columns = tuple[FloatArray, FloatArray, FloatArray, FloatArray]

#: Powers of depth in the static curve of every ramp.
POWERS = 3


class _Static(NamedTuple):
    """Orthonormal static columns (n, k, b), their part in the prior rows (n, k, k), and log volume (n,)."""

    basis: FloatArray
    beside: FloatArray
    volume: FloatArray

    def outside(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Remainder of rows (n, m, b) beside the static columns, and what that leaves in prior rows."""
        along = rows @ self.basis.transpose(0, 2, 1)
        return rows - along @ self.basis, -along @ self.beside


def _static(bins: _Columns, prior: FloatArray, contact: FloatArray, window: float) -> _Static:
    """Static columns over the noise, made orthonormal."""
    depth, variance, weight, _ = bins
    beyond = (depth - contact[:, None]) / window
    z = np.maximum(beyond, 0.0)
    within = (z > 0.0) * (variance / window**2)
    # the mean of a power over a bin exceeds that of its mean by half its second derivative times the variance
    columns = [z, z * z + within, z * (z * z + 3.0 * within)]
    if prior.size > POWERS:
        root = np.sqrt(z)
        bent = np.divide(0.375 * within, root, out=np.zeros_like(z), where=z > np.sqrt(variance) / window)
        columns += [z * root + bent, beyond, np.ones_like(beyond)]
    rows = np.stack(columns, axis=1) * (prior[:, None] * weight)
    unit = np.broadcast_to(np.eye(prior.size), (contact.size, prior.size, prior.size))
    orthonormal, triangle = np.linalg.qr(np.concatenate([rows.transpose(0, 2, 1), unit], axis=1))
    turned = orthonormal.transpose(0, 2, 1)
    volume = np.log(np.abs(np.diagonal(triangle, axis1=1, axis2=2))).sum(axis=1)
    return _Static(turned[:, :, : depth.size], turned[:, :, depth.size :], volume)


def _branch(
    bins: _Columns, from_mm: FloatArray, length: FloatArray, window: float, scale: float
) -> FloatArray:
    """Rise of the branch over the noise, shape (n, m, b)."""
    depth, variance, weight, _ = bins
    of = length[:, :, None]
    ratio = np.maximum(depth - from_mm[:, None], 0.0)[:, None, :] / of
    blurred = (ratio > 0.0) * np.minimum(0.5 * variance / of**2, 1.0)
    return np.asarray((-np.expm1(-ratio) - blurred * np.exp(-ratio)) * (of / window * (scale * weight)))


def _products(one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Products of what is left of rows, with what they leave in the priors' rows; shape (n, m)."""
    beside = (one[1] * other[1]).sum(axis=-1)
    return np.asarray(np.einsum("nmb,nmb->nm", *np.broadcast_arrays(one[0], other[0])) + beside)


#: Bins of equal width next to the centre, on each side, and the growth of those further out.
NEAR_BINS = 24
BIN_GROWTH = 1.25


@dataclass(frozen=True, slots=True)
class Bins:
    """Means over bins of successive samples."""

    #: (m,): means [mm], [N].
    depth_mm: FloatArray
    variance_mm2: FloatArray  # (m,), variance of depth within each bin [mm2]
    force_N: FloatArray  # (m,)
    count: FloatArray  # (m,), samples in each bin
    fine_mm: float  # how far from the centre the bins are narrow [mm]
    spacing_mm: float  # mean distance of two samples [mm]


def bin_samples(depth_mm: FloatArray, force_N: FloatArray, *, centre_mm: float, balance: float) -> Bins:
    """Average samples in bins along the record, narrow about ``centre_mm``.

    ``balance``: (noise / slope)^(2/3): the sd of a bin mean falls as 1/sqrt(m), what m samples blur grows as
    m, and the two balance at m^(3/2) = noise / (slope x spacing).
    """
    n = depth_mm.size
    at = int(np.searchsorted(np.maximum.accumulate(depth_mm), centre_mm))
    step = max(float(np.ptp(depth_mm)) / max(n - 1, 1), 1e-300)
    width = max(1, int(min(balance / step ** (2.0 / 3.0), float(n))))
    width = min(width, max(1, n // (4 * NEAR_BINS)))
    growing = np.full(NEAR_BINS, float(width))
    while growing.sum() < n:
        growing = np.append(growing, growing[-1] * BIN_GROWTH)
    side = np.unique(np.concatenate([[0.0], np.cumsum(growing)]).round()).astype(int)
    edges = np.unique(np.clip(np.concatenate([at - side, at + side, [0, n]]), 0, n))[:-1]
    count = np.diff(np.append(edges, n)).astype(float)
    mean = np.add.reduceat(depth_mm, edges) / count
    off = depth_mm - np.repeat(mean, count.astype(int))
    variance = np.add.reduceat(off * off, edges) / count
    force = np.add.reduceat(force_N, edges) / count
    return Bins(mean, variance, force, count, fine_mm=NEAR_BINS * width * step, spacing_mm=step)


# The force at displacement u of a tool that meets relaxed tissue at c and moves on at constant speed is
#     F = b + d (u - c) + p1 z + p2 z^2 + p3 z^3 + h z^1.5 + A (1 - exp(-w/l)),
#     z = max(0, u - c),  w = max(0, u - max(c, u0)):
# a load cell that drifts a little, a cubic static curve, which begins like that of a ball where the record
# shows air (b, d and h are 0 where it shows none), and one branch of length l = speed x relaxation time; u0
# is where the record starts.  All but c and l are integrated out, with the normal priors below, at every
# (c, l):
#     density = marginal likelihood x P(p1 + A/l >= -s) / (1 + (l / 3 L)^2).
# Their volume is what keeps a shape that may bend from beginning early, in the noise of the air.  (A weight
# by the information about c, Jeffreys' rule, leans to kinks, which noise has: of simulated ramps of 6 to 50
# noise sd it put one in fifteen beyond 3 of its sd, by up to 20.)  A has either sign, so that a branch too
# small to be seen does not push the contact to one side.  The initial slope may be negative by no more than
# the slope s of the ramp.  Lengths far above the resolution L, where a branch can't be told from the static
# curve, count less.
#: Prior standard deviation of what the shape's parts reach at the end of the window, in force ranges of it:
#: those that begin with a slope, of which kinks are made, and those that bend, which may cancel out in air.
SLOPE_PRIOR = 10.0
BEND_PRIOR = 1.0
#: ... and of the force in air about the first one: in effect none ...
BASELINE_PRIOR = 100.0
#: ... and of what a load cell drifts over the window.
DRIFT_PRIOR = 0.003
#: Lengths above so many resolutions of the contact count less.
RESOLVED = 3.0
#: Part of the window over which the stiffness at contact is quoted.
EARLY_SHARE = 0.02
#: Part of the window over which the slope is taken that says what noise can resolve.
SLOPE_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Posterior:
    """Log density at nodes, and the least-squares shape at each."""

    log_density: FloatArray  # (n, m)
    misfit: FloatArray  # (n, m), chi-square at each node
    #: (n, m, k): p1 W, p2 W^2, p3 W^3 [N], and, where the force in air is free, h W^1.5, its drift over W and
    #: its value at contact [N]; W the window.
    static_N: FloatArray
    branch_N: FloatArray  # (n, m), a W/l [N]


@dataclass(frozen=True, slots=True)
class RampShape:
    """A binned ramp and what is known of it before the contact is looked for."""

    bins: Bins
    noise_N: float
    noise_freedom: float  # degrees of freedom with which the noise is known
    window_mm: float  # from the first guess of contact to the end
    start_mm: float  # first displacement of the record
    slope_N_per_mm: float  # slope of the ramp near contact, as guessed [N/mm]
    baseline: bool  # whether the force in air is free

    @property
    def freedom(self) -> int:
        """Bins beyond the parameters: contact, length, branch, static curve, force in air."""
        return max(self.bins.count.size - 6 - self.baseline, 1)

    @property
    def resolution_mm(self) -> float:
        """Length over which a kink stands out of the noise, and not below the spacing [mm]."""
        spacing, ratio = self.bins.spacing_mm, self.noise_N / self.slope_N_per_mm
        return float(np.cbrt(ratio * ratio * spacing + spacing**3))

    def posterior(self, contact_mm: FloatArray, length_mm: FloatArray) -> Posterior:
        """Density over (contact, ln length)."""
        bins, window = self.bins, self.window_mm
        weight = np.sqrt(bins.count) / self.noise_N
        span = max(float(np.ptp(bins.force_N)), self.noise_N)
        scale, bend = SLOPE_PRIOR * span, BEND_PRIOR * span
        air = [bend, DRIFT_PRIOR * span, BASELINE_PRIOR * span]
        prior = np.array([scale, bend, bend] + air * self.baseline)
        zero_N = float(bins.force_N[0]) if self.baseline else 0.0
        columns = (bins.depth_mm, bins.variance_mm2, weight, (bins.force_N - zero_N) * weight)
        length = np.ascontiguousarray(length_mm)
        # the linear coefficients are integrated out; in units of their prior sd
        static = _static(columns, prior, contact_mm, window)
        rose = static.outside(_branch(columns, np.maximum(contact_mm, self.start_mm), length, window, scale))
        force = static.outside(np.broadcast_to(columns[3], (contact_mm.size, 1, columns[3].size)))
        own, unexplained = 1.0 + _products(rose, rose), _products(rose, force)
        branch = unexplained / own
        misfit = np.maximum(_products(force, force) - unexplained * branch, 0.0)
        coefficients = rose[1] * branch[:, :, None] - force[1]
        known = self.noise_freedom
        log_density = -0.5 * (known + self.freedom) * np.log1p(misfit / known)
        log_density -= static.volume[:, None] + 0.5 * np.log(own)
        # the initial slope and its variance, the latter in prior variances
        first = scale * (coefficients[:, :, 0] + branch) + self.slope_N_per_mm * window
        spread = (static.beside[:, :, 0] ** 2).sum(axis=1)[:, None] + (1.0 + rose[1][:, :, 0]) ** 2 / own
        log_density += _log_normal_mass(first / (scale * np.sqrt(spread)))
        log_density -= np.log1p((length_mm / (RESOLVED * self.resolution_mm)) ** 2)
        static_N = coefficients * prior
        if self.baseline:
            static_N[:, :, -1] += zero_N
        return Posterior(log_density, misfit, static_N, branch * scale)

    def slopes(
        self, found: Posterior, mass: FloatArray, contact_mm: FloatArray, length_mm: FloatArray
    ) -> tuple[float, float, float]:
        """Mean stiffness right at contact, and over the part of the window that noise is judged by [N/mm].

        Third, the share of the latter that the branch has over that part from the first sample on, below 1.
        """
        window = self.window_mm
        answer, relaxes = [], 0.0
        for share in (EARLY_SHARE, SLOPE_SHARE):
            early = min(share * window, float(np.ptp(self.bins.depth_mm)))
            branch = found.branch_N * (-np.expm1(-early / length_mm) * length_mm / early)
            answer.append(float((mass * (found.static_N[:, :, 0] + branch)).sum()) / window)
            relaxes = max(float((mass * branch).sum()) / window, 0.0)
        least = 1e-3 * float(np.ptp(self.bins.force_N)) / window
        z = (np.maximum(self.start_mm - contact_mm, 0.0) / window)[:, None]
        bend = z * (2.0 * found.static_N[:, :, 1] + 3.0 * z * found.static_N[:, :, 2])
        static = max(float((mass * (found.static_N[:, :, 0] + bend)).sum()) / window, least)
        return max(answer[0], least), max(answer[1], least), relaxes / (static + relaxes)


def _log_normal_mass(x: FloatArray) -> FloatArray:
    """Logarithm of the standard normal distribution function (tanh form, error of the function 3e-4)."""
    x = np.clip(x, -8.0, 8.0)
    argument: FloatArray = -2.0 * np.sqrt(2.0 / np.pi) * (x + 0.044715 * x**3)
    return np.asarray(-np.log1p(np.exp(argument)))
