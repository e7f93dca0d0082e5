"""Density of (contact, branch length) of one loading ramp, its linear coefficients estimated at each.

The force at displacement u of a tool that meets relaxed tissue at c and moves on at constant speed is

    F = b + d (u - c) + p1 z + p2 z^2 + p3 z^3 + A (1 - exp(-w/l)),
    z = max(0, u - c),  w = max(0, u - max(c, u0)),

a load cell that drifts a little, a cubic static curve and one branch of length l = speed x relaxation time;
u0 is where the record starts.  b, d, p and A are linear.  At every (c, l) they are taken at their
least-squares values, and

    density = likelihood x sqrt(I_c) x I_l^(1/4) x P(p1 + A/l >= -s) / (1 + (l / 3 L)^2).

I_c and I_l are the Fisher information of c and of ln l with the linear coefficients projected out: Jeffreys'
rule (1946) for c makes the interval one that covers as often as it says; half that weight for ln l keeps
lengths that data can't tell from none out of the way.  A has either sign, so that a branch too small to be
seen (A > 0 by nature) does not push the contact to one side.  The initial slope may be negative by no more
than the slope s of the ramp itself.  Lengths far above the resolution L of the record, where a branch can't
be told from the static curve, count less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.segment.bins import Bins

__all__ = ["Posterior", "RampShape"]

FloatArray = NDArray[np.float64]

#: Prior standard deviation of the shape's coefficients, in force ranges of the window.
SHAPE_PRIOR = 10.0
#: ... of the force in air about the first one: in effect none ...
BASELINE_PRIOR = 100.0
#: ... and of what a load cell drifts over the window.
DRIFT_PRIOR = 0.003
#: Exponents of the square roots of the information about contact and about the logarithm of the length.
CONTACT_WEIGHT = 1.0
LENGTH_WEIGHT = 0.5
#: The initial slope may be negative by so many slopes of the ramp.
PULL = 1.0
#: Lengths above so many resolutions of the contact count less.
RESOLVED = 3.0
#: Share of the way by which the first bin in contact is moved to the middle of its gap where information is
#: weighed: 0 leans to contacts just before a sample, 1 to those before the gap.
PHASE_SHARE = 0.15
#: Largest change of force with contact, in noise sd: its square is a number.
LARGEST = 1e75
#: Part of the window over which the stiffness at contact is quoted.
EARLY_SHARE = 0.02
#: Part of the window over which the slope is taken that says what noise can resolve.
SLOPE_SHARE = 0.1


@dataclass(frozen=True, slots=True)
class Posterior:
    """Log density at nodes, and the least-squares shape at each.

    Attributes
    ----------
    log_density : ndarray, shape (n, m)
    misfit : ndarray, shape (n, m)
        Chi-square at each node.
    static_N : ndarray, shape (n, m, k)
        p1 W, p2 W^2, p3 W^3 [N], and, where the force in air is free, its drift over W and its value at
        contact [N]; W the window.
    branch_N : ndarray, shape (n, m)
        A W/l [N].
    """

    log_density: FloatArray
    misfit: FloatArray
    static_N: FloatArray
    branch_N: FloatArray


@dataclass(frozen=True, slots=True)
class RampShape:
    """A binned ramp and what is known of it before the contact is looked for.

    Attributes
    ----------
    bins : Bins
    noise_N : float
    noise_freedom : float
        Degrees of freedom with which the noise is known.
    window_mm : float
        From the first guess of contact to the end.
    start_mm : float
        First displacement of the record.
    slope_N_per_mm : float
        Slope of the ramp near contact, as guessed [N/mm].
    baseline : bool
        Whether the force in air is free.
    """

    bins: Bins
    noise_N: float
    noise_freedom: float
    window_mm: float
    start_mm: float
    slope_N_per_mm: float
    baseline: bool

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
        """Density over (contact, ln length).

        The static columns depend on the contact alone: their part is solved once a contact, and the branch is
        one more column each.

        Parameters
        ----------
        contact_mm : ndarray, shape (n,)
        length_mm : ndarray, shape (n, m)
            Lengths at each contact.

        Returns
        -------
        Posterior
        """
        bins, window = self.bins, self.window_mm
        weight = np.sqrt(bins.count) / self.noise_N
        scale = SHAPE_PRIOR * max(float(np.ptp(bins.force_N)), self.noise_N)
        static, static_moves, prior = self._static(contact_mm[:, None], scale)
        # priors are k further samples of 0; orthogonal columns keep what is left exact at any noise
        size, count = weight.size, prior.size
        design = np.zeros((contact_mm.size, size + count, count))
        design[:, :size] = (static * weight).swapaxes(1, 2)
        design[:, size:] = np.eye(count)
        basis, triangle = np.linalg.qr(design)
        across = basis.swapaxes(1, 2)
        inverse = np.linalg.inv(triangle)

        def outside(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
            """Shares of rows (n, m, b) along the static columns, and what is left of them (n, m, b + k)."""
            along = rows @ basis[:, :size]
            left = -along @ across
            left[:, :, :size] += rows
            return along, left

        zero_N = float(bins.force_N[0]) if self.baseline else 0.0
        force = (bins.force_N - zero_N) * weight
        along, rest = outside(np.broadcast_to(force, (contact_mm.size, 1, size)))
        alone = along @ inverse.swapaxes(1, 2)
        left, rise, by_length = self._branch(contact_mm[:, None, None], length_mm[:, :, None])
        along, branch_rows = outside(rise * (scale * weight))
        spread = along @ inverse.swapaxes(1, 2)
        own = 1.0 + (branch_rows * branch_rows).sum(axis=2)
        unexplained = (branch_rows * rest).sum(axis=2)
        branch = unexplained / own
        coefficients = alone - spread * branch[:, :, None]
        misfit = np.maximum((rest * rest).sum(axis=2) - unexplained * branch, 0.0)

        def information(moves: FloatArray) -> FloatArray:
            """Fisher information of what moves the force so, linear coefficients projected out."""
            _, kept = outside(np.clip(moves * weight, -LARGEST, LARGEST))
            shared = (kept * branch_rows).sum(axis=2) / np.sqrt(own)
            return np.asarray(np.maximum((kept * kept).sum(axis=2) - shared * shared, 1e-12))

        freedom = self.freedom
        known = self.noise_freedom
        log_density = -0.5 * (known + freedom) * np.log1p(misfit / known)
        moves = coefficients[:, :, :3] @ static_moves + (branch * scale / window)[:, :, None] * left
        log_density += 0.5 * CONTACT_WEIGHT * np.log(information(moves))
        moves = by_length * (branch * scale)[:, :, None]
        log_density += 0.5 * LENGTH_WEIGHT * np.log(information(moves))
        first = scale * (coefficients[:, :, 0] + branch) + PULL * self.slope_N_per_mm * window
        variance = (inverse[:, None, 0] ** 2).sum(axis=2) + (1.0 - spread[:, :, 0]) ** 2 / own
        log_density += _log_normal_mass(first / (scale * np.sqrt(variance)))
        log_density -= np.log1p((length_mm / (RESOLVED * self.resolution_mm)) ** 2)
        static_N = coefficients * prior
        if self.baseline:
            static_N[:, :, -1] += zero_N
        return Posterior(log_density, misfit, static_N, branch * scale)

    def _static(self, contact: FloatArray, scale: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Static columns (n, k, b) scaled by their priors, how they move with contact (n, 3, b), the priors.

        Squares and cubes are means over each bin, from the mean and variance of depth in it.
        """
        bins, window = self.bins, self.window_mm
        beyond = (bins.depth_mm - contact) / window
        z = np.maximum(beyond, 0.0)
        touching = (z > 0.0).astype(float)
        within = touching * (bins.variance_mm2 / window**2)
        span = scale / SHAPE_PRIOR
        prior = np.array([scale] * 3 + [DRIFT_PRIOR * span, BASELINE_PRIOR * span] * self.baseline)
        columns = np.empty((z.shape[0], prior.size, z.shape[1]))
        columns[:, 0], columns[:, 1], columns[:, 2] = z, z * z + within, z * (z * z + 3.0 * within)
        if self.baseline:
            columns[:, 3], columns[:, 4] = beyond, 1.0
        moves = np.empty((z.shape[0], 3, z.shape[1]))
        moves[:, 0], moves[:, 1], moves[:, 2] = touching, 2.0 * z, 3.0 * z * z
        columns *= prior[:, None]
        return columns, moves * (scale / window), prior

    def _branch(self, contact: FloatArray, length: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """exp(-w/l) in contact, mean rise of the branch over each bin, its change with ln l; (n, m, b) each.

        A = K l: the prior is on the stiffness K of the branch, of the size of the static one.
        """
        bins, window = self.bins, self.window_mm
        w = np.maximum(bins.depth_mm - np.maximum(contact, self.start_mm), 0.0)
        touching = w > 0.0
        left = np.exp(-w / length)
        rise = 1.0 - left
        rise -= touching * np.minimum(0.5 * bins.variance_mm2 / length**2, 1.0) * left
        rise *= length / window
        # information as if the first bin in contact lay nearer to half a bin behind it, wherever it lies: a
        # contact just before a sample is seen sharply, and is no likelier for it
        ahead = self._half_bin(touching, w)
        w = w + ahead * touching
        left *= np.exp(np.clip(-ahead / length, -600.0, 600.0)) * touching
        by_length = (1.0 - left - w / length * left) * touching * (length / window)
        return left * (contact >= self.start_mm), rise, by_length

    def _half_bin(self, touching: NDArray[np.bool_], w: FloatArray) -> FloatArray:
        """How far the first bin in contact is moved towards half a bin behind contact [mm], (n, 1, 1)."""
        first = touching.argmax(axis=2)[:, :, None]
        u = self.bins.depth_mm
        gap = u[first] - u[np.maximum(first - 1, 0)]
        moved = 0.5 * np.abs(gap) - np.take_along_axis(w, first, axis=2)
        return np.where(first > 0, PHASE_SHARE * moved, 0.0)

    def slopes(self, found: Posterior, mass: FloatArray, length_mm: FloatArray) -> tuple[float, float]:
        """Mean stiffness right at contact, and over the part of the window that noise is judged by [N/mm]."""
        window = self.window_mm
        answer = []
        for share in (EARLY_SHARE, SLOPE_SHARE):
            early = min(share * window, float(np.ptp(self.bins.depth_mm)))
            rise = -np.expm1(-early / length_mm) * length_mm / early
            answer.append(float((mass * (found.static_N[:, :, 0] + found.branch_N * rise)).sum()) / window)
        least = 1e-3 * float(np.ptp(self.bins.force_N)) / window
        return max(answer[0], least), max(answer[1], least)


def _log_normal_mass(x: FloatArray) -> FloatArray:
    """Logarithm of the standard normal distribution function (tanh form, error of the function 3e-4)."""
    x = np.clip(x, -8.0, 8.0)
    argument: FloatArray = -2.0 * np.sqrt(2.0 / np.pi) * (x + 0.044715 * x**3)
    return np.asarray(-np.log1p(np.exp(argument)))
