"""Spreads and correlations of a population, drawn in many chains at once from sums of squares.

A covariance is D R D with ln D_k normal and R of the LKJ distribution (Lewandowski, Kurowicka & Joe 2009, J
Multivariate Anal 100:1989, doi 10.1016/j.jmva.2009.04.008): its canonical partial correlations w are
independent, beta distributed on (-1, 1), and make the rows of R's Cholesky factor.  All of ln D and arctanh w
move together by Hamiltonian dynamics (Neal 2011, doi 10.1201/b10905-6).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray

#: arctanh of the largest partial correlation.
MOST_Z = 8.0
#: Share of a variance that rounding may hide.
ROUNDING = 1e-9
#: Steps of a trajectory: fewest, and one more than the most.
STEPS = (6, 16)
#: Acceptance that lengths of steps are brought to, and change of their logarithm for an acceptance too much.
WANTED_ACCEPTANCE = 0.8
ADAPTATION = 0.5
#: Share of a covariance that is taken without its correlations.
RIDGE = 0.01
#: Each chain's steps are between these times the common length; a share is shorter, down to e to this.
JITTER = (0.4, 1.2)
SHORT, SHORTEST = 0.2, -7.0


def transposed(a: FloatArray) -> FloatArray:
    """Matrices of a stack, each transposed."""
    return np.swapaxes(a, -1, -2)


def factor(a: FloatArray) -> FloatArray:
    """Cholesky factors of a stack; all a little wider where rounding leaves one of them without."""
    try:
        return np.asarray(np.linalg.cholesky(a))
    except np.linalg.LinAlgError:
        wider = ROUNDING * np.einsum("...ii->...i", a)[..., None] * np.eye(a.shape[-1])
        return np.asarray(np.linalg.cholesky(a + wider))


def accepted(rng: np.random.Generator, ratio: FloatArray) -> NDArray[np.bool_]:
    """True where a move of that ln ratio of densities is made; never where it is no number."""
    return np.asarray(-rng.standard_exponential(ratio.shape) < ratio)


@dataclass(frozen=True, slots=True, eq=False)
class Scales:
    """Spreads and correlations of each chain: ln D (c, p), and arctanh w (c, p, p), strictly lower."""

    log_sd: FloatArray
    z: FloatArray

    def factors(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Partial correlations, root of what columns before leave of a row, and factors of R."""
        w = np.tanh(np.clip(self.z, -MOST_Z, MOST_Z))
        left = np.ones_like(w)
        np.cumprod(1.0 - w[..., :-1] ** 2, axis=-1, out=left[..., 1:])
        left = np.sqrt(left)
        return w, left, (w + np.eye(w.shape[-1])) * left

    @property
    def vector(self) -> FloatArray:
        """All numbers of a chain in a row; ln D stands on the diagonal."""
        i, j = np.tril_indices(self.z.shape[-1])
        return np.where(i == j, self.log_sd[:, i], self.z[:, i, j])

    @classmethod
    def of(cls, vector: FloatArray, size: int) -> Scales:
        """Scales from their numbers in a row."""
        all_of = np.zeros((len(vector), size, size))
        all_of[:, *np.tril_indices(size)] = vector
        return cls(np.einsum("cii->ci", all_of).copy(), np.tril(all_of, -1))

    @property
    def low(self) -> FloatArray:
        """Cholesky factors of R."""
        return self.factors()[2]

    @property
    def unit(self) -> FloatArray:
        """Inverse Cholesky factors of D R D."""
        return np.asarray(np.linalg.inv(self.low) * np.exp(-self.log_sd)[..., None, :])


@dataclass(frozen=True, slots=True, eq=False)
class ScalesDensity:
    """Density of scales given ``count`` normal deviations (c,) and their sums of squares (c, p, p)."""

    squares: FloatArray
    count: FloatArray
    prior: FloatArray  # mean and sd of ln D, shape of LKJ

    def __call__(self, at: Scales) -> tuple[FloatArray, Scales]:
        """Ln density, (c,), and its gradient."""
        p, (w, left, low) = at.z.shape[-1], at.factors()
        inverse: FloatArray = np.asarray(np.linalg.inv(low))
        unit = inverse * np.exp(-at.log_sd)[:, None, :]
        inner = unit @ self.squares @ transposed(unit)
        # Beta(b, b) of each w on (-1, 1), times d w / d arctanh w
        b, rest = self.prior[2] + 0.5 * (p - 2.0 - np.arange(p)), 1.0 - w**2
        away = (at.log_sd - self.prior[0]) / self.prior[1]
        ends = np.einsum("cii->ci", low)
        value = -self.count * (at.log_sd + np.log(ends)).sum(axis=1) - 0.5 * np.einsum("cii->c", inner)
        value = value + (np.log(rest) @ b).sum(axis=1) - 0.5 * (away**2).sum(axis=1)
        pull = transposed(inverse) @ inner
        along = np.tril(pull * low) - self.count[:, None, None] * np.eye(p)
        sums = np.cumsum(along, axis=2)
        slope = rest * left * pull - w * (sums[..., -1:] - sums + 2.0 * b)
        return value, Scales(sums[..., -1] - away / self.prior[1], np.tril(slope, -1))


class ScalesMove:
    """Hamiltonian moves of scales; steps follow acceptance as long as they are adapted."""

    def __init__(self, size: int, count: int, prior: FloatArray) -> None:
        """Moves of about what ``count`` specimens leave open."""
        i, j = np.tril_indices(size)
        known = np.where(i == j, 2.0 * count + prior[1] ** -2, count + 2.0 * prior[2] + size - 2.0 - j)
        #: (d, d), factor of the covariance of all numbers.
        self.root, self.log_step = np.diag(known**-0.5), -1.0

    def learn(self, vectors: FloatArray) -> None:
        """Take the covariance of numbers that chains showed, (m, d): forces that go together stay so."""
        seen = np.cov(vectors, rowvar=False).reshape(self.root.shape)
        self.root = factor((1.0 - RIDGE) * seen + RIDGE * np.diag(seen.diagonal() + 1e-12))

    def __call__(
        self, rng: np.random.Generator, scales: Scales, density: ScalesDensity, *, adapt: bool
    ) -> Scales:
        """Scales after one trajectory."""
        x, size, at = scales.vector, scales.log_sd.shape[1], scales
        # a chain in a corner, where all others' steps are too long, leaves it by short ones
        one = (len(x), 1)
        shorter = np.where(rng.random(one) < SHORT, np.exp(rng.uniform(SHORTEST, 0.0, one)), 1.0)
        step = np.exp(self.log_step) * rng.uniform(*JITTER, one) * shorter
        speed, (value, slope) = rng.standard_normal(x.shape), density(scales)
        begun = value - 0.5 * (speed**2).sum(axis=1)
        # a trajectory that runs away is no number, and is refused
        with np.errstate(all="ignore"):
            for _ in range(rng.integers(*STEPS)):
                speed = speed + 0.5 * step * (slope.vector @ self.root)
                x = x + step * (speed @ self.root.T)
                at = Scales.of(x, size)
                value, slope = density(at)
                speed = speed + 0.5 * step * (slope.vector @ self.root)
            ratio = value - 0.5 * (speed**2).sum(axis=1) - begun
        ratio[np.abs(at.z).max(axis=(1, 2)) > MOST_Z] = -np.inf
        moved = accepted(rng, ratio)
        if adapt:
            self.log_step += ADAPTATION * (moved.mean() - WANTED_ACCEPTANCE)
        return Scales.of(np.where(moved[:, None], x, scales.vector), size)
