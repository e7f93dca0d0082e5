"""Paths, relaxation along them, and derivatives of a force by depth, as the engine's law takes them."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs
from scipy.special import comb

from tissueid.arrays import FloatArray

#: Depths at which a polynomial has to be non-negative; it dips by 1e-4 of its curvature in between.
PASSIVE_POINTS = 41
#: Keeps states of a long hold out of denormal numbers.
TINY = 1e-180
#: Shortest step over a relaxation time.
SHORTEST = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Depth below contact along all logs, one behind the other."""

    step_s: FloatArray  # (m,), time since the point before; infinite at the first point of a log
    depth_mm: FloatArray  # (m,) and (n, m), at least 0; of one point of the parameters or of n
    entered: NDArray[np.int64]  # places in ``depth_mm``, flat, that are reached from air
    share: FloatArray  # share of the step to each of these that was spent in contact
    fresh: NDArray[np.int64]  # first point of each log
    #: (m,): speed over that at which each contact began, as recorded; zero where no law follows it.
    speed_ratio: FloatArray = field(default_factory=lambda: np.zeros(1))
    gain: FloatArray | None = None  # (m,) and (n, m), of the logs

    def gained(self, values: FloatArray) -> FloatArray:
        """Values times the gain, in place."""
        return values if self.gain is None else np.multiply(values, self.gain, out=values)


def driven(decay: FloatArray, right: FloatArray) -> FloatArray:
    """States y_i = decay_i y_(i-1) + right_i along the last axis, in place of ``right``: one banded solve.

    ``decay`` (..., m): 0 at the first point of each log; ``right`` (c, ..., m) and (..., m).
    """
    band = np.zeros((2, decay.size), order="F")
    np.negative(decay.reshape(-1)[1:], out=band[1, :-1])
    two = np.ascontiguousarray(right).reshape(-1, decay.size)
    return np.asarray(dtbtrs(band, two.T, uplo="L", diag="U", overwrite_b=1)[0].T.reshape(right.shape))


def relaxation_states(path: Path, value: FloatArray, tau_s: FloatArray) -> FloatArray:
    """Convolution of the rate of ``value`` with exp(-t / tau), exact where it is linear in between.

    At rest at the first point of each log, whatever its depth: a preload has relaxed, as
    :mod:`tissueid.segment.preload` takes it.  ``value`` (m,) and (n, m) and (c, m); ``tau_s`` (j,) and
    (j, n).  Returns (j, m) (j, n, m) (c, j, m).
    """
    change = np.empty(value.shape)
    change[..., 0] = 0.0
    np.subtract(value[..., 1:], value[..., :-1], out=change[..., 1:])
    change[..., path.fresh] = 0.0
    right, decay = _steps(path, tau_s)
    change = np.expand_dims(change, value.ndim - path.depth_mm.ndim)
    right = np.multiply(right, change, out=right if change.ndim == right.ndim else None)
    right += TINY
    return driven(decay, right)


def _steps(path: Path, tau_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shares as :func:`sudden_shares` has them, and decays over a step."""
    down = np.minimum(path.step_s / -tau_s[..., None], -SHORTEST)
    decay = np.expm1(down)
    right = decay / down
    flat = len(tau_s), path.depth_mm.size
    entering = np.minimum(down.reshape(flat)[:, path.entered] * path.share, -SHORTEST)
    right.reshape(flat)[:, path.entered] = np.expm1(entering) / entering
    decay += 1.0
    return right, decay


def sudden_shares(path: Path, tau_s: FloatArray) -> FloatArray:
    """Share of a step's change that is left at its end by each relaxation time, (j, m) or (j, n, m)."""
    return _steps(path, tau_s)[0]


def weighted(columns: FloatArray, linear: FloatArray) -> FloatArray:
    """Force of columns: (p, m) and (p,) -> (m,), or (p, n, m) and (n, p) -> (n, m)."""
    if linear.ndim == 1:
        return np.asarray(linear @ columns)
    return np.asarray((linear[:, None] @ columns.swapaxes(0, 1))[:, 0])


@lru_cache
def bernstein(powers: int) -> FloatArray:
    """Matrix from monomial coefficients on [0, 1] to Bernstein coefficients."""
    k = np.arange(powers)
    return np.asarray(comb(k[:, None], k) / comb(powers - 1, k))


@lru_cache
def passive_rows(powers: int) -> FloatArray:
    """Rows G with G @ c >= 0 where the polynomial c of that many powers is non-negative on [0, 1]."""
    u = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, PASSIVE_POINTS if powers > 2 else 2))
    rows = u[:, None] ** np.arange(float(powers)) if powers > 1 else np.ones((1, 1))
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Derivative of a force along a path by depth over the largest depth [N].

    Of a change of depth: ``direct`` at once, ``outer`` times its convolution, and ``gain`` times the
    convolution of ``inner`` times it.
    """

    direct: FloatArray  # (m,)
    outer: FloatArray  # (j, m)
    tau_s: FloatArray  # (j,)
    inner: FloatArray | None = None  # (j, m); None where nothing stands inside the convolution
    gain: FloatArray | float = 1.0

    def sudden(self, path: Path) -> FloatArray:
        """Change of the force by a change of depth within one step, shape (m,)."""
        shares = sudden_shares(path, self.tau_s)
        shares[:, path.fresh] = 0.0
        steep = self.outer if self.inner is None else self.outer + self.gain * self.inner
        return np.asarray(self.direct + (steep * shares).sum(axis=0))

    def change(self, path: Path, depth: FloatArray) -> FloatArray:
        """Changes of the force by changes of depth, (c, m) -> (c, m)."""
        states = relaxation_states(path, depth, self.tau_s)
        out = self.direct * depth + (self.outer * states).sum(axis=1)
        for j, row in enumerate(() if self.inner is None else self.inner):
            out = out + self.gain * relaxation_states(path, row * depth, self.tau_s[j : j + 1])[:, 0]
        return np.asarray(out)
