"""Laws as the engine sees them: linear columns along a path, and a passive cone.

A law is a static law and channels, each a basis in depth times a relaxation kernel, inside or outside the
convolution.  The engine asks for the columns whose weights are the linear parameters, and for the rows that
keep these weights passive; whatever is not linear is differentiated numerically along the path.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt

__all__ = [
    "KelvinVoigtLaw",
    "Law",
    "Path",
    "Slopes",
    "driven",
    "passive_rows",
    "relaxation_states",
    "sudden_shares",
    "weighted",
]

FloatArray = NDArray[np.float64]

#: Depths at which a polynomial has to be non-negative; it dips by 1e-4 of its curvature in between.
PASSIVE_POINTS = 41
#: Coefficients below this share of the largest of their polynomial are rounding.
NONE = 1e-13
#: Keeps states of a long hold out of denormal numbers.
TINY = 1e-180


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """Depth below contact along all logs, one behind the other.

    Attributes
    ----------
    step_s : ndarray, shape (m,)
        Time since the point before; infinite at the first point of a log.
    depth_mm : ndarray, shape (m,) or (n, m)
        At least 0; of one point of the parameters or of n.
    share : ndarray, shape of ``depth_mm``
        Share of the step that was spent in contact.
    fresh : ndarray of int
        First point of each log.
    """

    step_s: FloatArray
    depth_mm: FloatArray
    share: FloatArray
    fresh: NDArray[np.int64]


def driven(decay: FloatArray, right: FloatArray) -> FloatArray:
    """States y with y_i = decay_i y_(i-1) + right_i along the last axis, in one banded solve.

    Parameters
    ----------
    decay : ndarray, shape (..., m)
        0 at the first point of each log.
    right : ndarray, shape (c, ..., m) or (..., m)

    Returns
    -------
    ndarray, shape of ``right``
    """
    band = np.empty((2, decay.size), order="F")
    band[0] = 1.0
    np.negative(decay.reshape(-1)[1:], out=band[1, :-1])
    two = np.ascontiguousarray(right).reshape(-1, decay.size)
    return np.asarray(dtbtrs(band, two.T, uplo="L", diag="U")[0].T.reshape(right.shape))


def relaxation_states(path: Path, value: FloatArray, tau_s: FloatArray) -> FloatArray:
    """Convolution of the rate of ``value`` with exp(-t / tau), exact where it is linear in between.

    Parameters
    ----------
    path : Path
    value : ndarray, shape (m,), (n, m) or (c, m)
        Basis function of depth along the path, or several.
    tau_s : ndarray, shape (j,) or (j, n)

    Returns
    -------
    ndarray, shape (j, m), (j, n, m) or (c, j, m)
    """
    change = np.empty(value.shape)
    change[..., 0] = 0.0
    np.subtract(value[..., 1:], value[..., :-1], out=change[..., 1:])
    change[..., path.fresh] = 0.0
    right = sudden_shares(path, tau_s) * np.expand_dims(change, value.ndim - path.depth_mm.ndim)
    right += TINY
    return driven(np.exp(-path.step_s / tau_s[..., None]), right)


def sudden_shares(path: Path, tau_s: FloatArray) -> FloatArray:
    """Share of a step's change that is left at its end by each relaxation time, (j, m) or (j, n, m)."""
    z = np.maximum(path.step_s * path.share / tau_s[..., None], 1e-12)
    right = np.expm1(-z)
    return np.asarray(np.divide(right, -z, out=right))


def weighted(columns: FloatArray, linear: FloatArray) -> FloatArray:
    """Force of columns: (p, m) and (p,) -> (m,), or (p, n, m) and (n, p) -> (n, m)."""
    if linear.ndim == 1:
        return np.asarray(linear @ columns)
    return np.asarray((columns * linear.T[:, :, None]).sum(axis=0))


@lru_cache
def passive_rows(powers: int) -> FloatArray:
    """Rows G with G @ c >= 0 where the polynomial c of that many powers is non-negative on [0, 1]."""
    u = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, PASSIVE_POINTS if powers > 2 else 2))
    rows = u[:, None] ** np.arange(float(powers)) if powers > 1 else np.ones((1, 1))
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True))


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Derivative of a force along a path by depth over the largest depth [N].

    The force changes by ``direct`` times the change at the same moment, and by ``outer`` times the
    convolution of the change with each relaxation time.

    Attributes
    ----------
    direct : ndarray, shape (m,)
    outer : ndarray, shape (j, m)
    tau_s : ndarray, shape (j,)
    """

    direct: FloatArray
    outer: FloatArray
    tau_s: FloatArray

    def sudden(self, path: Path) -> FloatArray:
        """Change of the force by a change of depth within one step, shape (m,)."""
        shares = sudden_shares(path, self.tau_s)
        shares[:, path.fresh] = 0.0
        return np.asarray(self.direct + (self.outer * shares).sum(axis=0))

    def change(self, path: Path, depth: FloatArray) -> FloatArray:
        """Changes of the force by changes of depth, (c, m) -> (c, m)."""
        states = relaxation_states(path, depth, self.tau_s)
        return np.asarray(self.direct * depth + (self.outer * states).sum(axis=1))


class Law(Protocol):
    """A law with given orders in scaled units: depth over the largest depth, forces in N."""

    @property
    def times(self) -> int:
        """Number of nonlinear parameters: logarithms of times."""
        ...

    @property
    def linear(self) -> int:
        """Number of linear parameters."""
        ...

    def columns(self, log_times: FloatArray, path: Path) -> FloatArray:
        """Columns of the linear parameters, shape (linear, m) [-].

        Of n points of the parameters, (n, t) and a path of (n, m), they are (linear, n, m).
        """
        ...

    def cone(self) -> FloatArray:
        """Rows G with G @ linear >= 0 for passive tissue."""
        ...

    def slopes(self, log_times: FloatArray, path: Path, linear: FloatArray) -> Slopes:
        """Answer of the force to small changes of depth along a path."""
        ...


@dataclass(frozen=True, slots=True)
class KelvinVoigtLaw:
    """Modified Kelvin-Voigt law: F_s(u) + sum_j K_j(u) s_j, the stiffness outside the convolution.

    Linear parameters: three static coefficients [N] of powers of u = x / depth, then for each branch the
    coefficients [N] of K_j depth by powers of u.
    """

    branches: int
    degree: int
    depth_mm: float

    @property
    def times(self) -> int:
        """Relaxation times."""
        return self.branches

    @property
    def linear(self) -> int:
        """Static and dynamic coefficients."""
        return STATIC_DEGREE + self.branches * (self.degree + 1)

    def columns(self, log_times: FloatArray, path: Path) -> FloatArray:
        """Columns along a path, shape (linear, m) or (linear, n, m)."""
        u = path.depth_mm / self.depth_mm
        out = np.empty((self.linear, *u.shape))
        out[0] = u
        np.multiply(u, u, out=out[1])
        np.multiply(out[1], u, out=out[2])
        at = STATIC_DEGREE
        for state in relaxation_states(path, u, np.exp(log_times.T)):
            out[at] = state
            for k in range(1, self.degree + 1):
                np.multiply(state, out[k - 1], out=out[at + k])
            at += self.degree + 1
        return out

    def slopes(self, log_times: FloatArray, path: Path, linear: FloatArray) -> Slopes:
        """F_s' + sum_j K_j' s_j at once, and K_j through the states."""
        u, tau = path.depth_mm / self.depth_mm, np.exp(log_times)
        a, b, c = linear[:STATIC_DEGREE]
        direct = a + u * (2.0 * b + 3.0 * c * u)
        rows = linear[STATIC_DEGREE:].reshape(self.branches, self.degree + 1).T
        outer = np.polynomial.polynomial.polyval(u, rows)
        if self.degree:
            bend = np.polynomial.polynomial.polyval(u, np.polynomial.polynomial.polyder(rows))
            direct = direct + (bend * relaxation_states(path, u, tau)).sum(axis=0)
        return Slopes(np.asarray(direct), np.asarray(outer), tau)

    def cone(self) -> FloatArray:
        """F_s / x and every K_j non-negative on [0, depth]."""
        return _cone(self.branches, self.degree)

    def model(self) -> KelvinVoigt:
        """The contact model with these orders."""
        return KelvinVoigt(branches=self.branches, stiffness_degree=self.degree, depth_mm=self.depth_mm)

    def lifted(self, linear: FloatArray) -> FloatArray:
        """Rows of linear parameters, each polynomial lifted by what its minimum on [0, 1] lacks of none."""
        out, at = np.array(linear), 0
        for powers in (STATIC_DEGREE, *[self.degree + 1] * self.branches):
            block = out[:, at : at + powers]
            least = np.minimum(block[:, 0], block.sum(axis=1))
            if powers == 3:
                with np.errstate(divide="ignore", invalid="ignore"):
                    turn = -block[:, 1] / (2.0 * block[:, 2])
                inside = (turn > 0.0) & (turn < 1.0)
                turn = np.where(inside, turn, 0.0)
                least = np.minimum(least, block[:, 0] + turn * (block[:, 1] + turn * block[:, 2]))
            scale = np.abs(block).max(axis=1)
            block[:, 0] += np.where(least < 0.0, -least + 1e-14 * scale, 0.0)
            block[np.abs(block) < NONE * scale[:, None]] = 0.0
            at += powers
        return out

    def theta(self, log_times: FloatArray, linear: FloatArray, *, exact: bool = False) -> FloatArray:
        """Theta of the contact model [N, mm, s], of one point or of rows of points.

        Parameters
        ----------
        log_times, linear : ndarray
        exact : bool
            Take linear parameters as they are, not lifted to the exact passive set.
        """
        log_times, linear = np.atleast_2d(log_times), np.atleast_2d(linear)
        linear = linear if exact else self.lifted(linear)
        static = linear[:, :STATIC_DEGREE] * self.depth_mm ** -np.arange(1.0, STATIC_DEGREE + 1)
        size = self.degree + 1
        stiffness = linear[:, STATIC_DEGREE:].reshape(len(linear), self.branches, size)
        stiffness = stiffness * self.depth_mm ** -np.arange(1.0, size + 1)
        branch = np.concatenate([stiffness, np.exp(log_times)[:, :, None]], axis=2)
        order = np.argsort(log_times, axis=1)
        branch = np.take_along_axis(branch, order[:, :, None], axis=1)
        return np.concatenate([static, branch.reshape(len(linear), -1)], axis=1)


@lru_cache
def _cone(branches: int, degree: int) -> FloatArray:
    """Rows of the passive cone of a modified Kelvin-Voigt law."""
    static, stiffness = passive_rows(STATIC_DEGREE), passive_rows(degree + 1)
    linear = STATIC_DEGREE + branches * (degree + 1)
    out = np.zeros((len(static) + branches * len(stiffness), linear))
    out[: len(static), :STATIC_DEGREE] = static
    for j in range(branches):
        rows = slice(len(static) + j * len(stiffness), len(static) + (j + 1) * len(stiffness))
        first = STATIC_DEGREE + j * (degree + 1)
        out[rows, first : first + degree + 1] = stiffness
    return out
