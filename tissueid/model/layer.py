"""Frictionless indentation of an elastic layer on a rigid base: the equation of Hayes et al., solved.

Hayes, Keer, Herrmann & Mockros, doi 10.1016/0021-9290(72)90010-3 (layer bonded to its base), give tables
for a flat punch and a sphere; here the integral equation itself is solved, so that any Poisson's ratio,
any a/h and a cone are covered.  Derivation: with p(r) = int k P(k) J0(kr) dk the surface goes down by

    w(r) = 2/E* int P(k) M(kh) J0(kr) dk,       E* = E / (1 - nu^2),

    bonded      M(x) = [(3-4nu) sinh 2x - 2x] / [(3-4nu) cosh 2x + 2x^2 + 5 - 12nu + 8nu^2]
    slipping    M(x) = (cosh 2x - 1) / (sinh 2x + 2x)

(M -> 1 for a half-space).  P(k) = E*/pi int_0^a f(t) cos(kt) dt carries no pressure outside r = a, and Abel's
inversion of w(r) = d - profile(r) leaves, with u = t/a and e = a/h, a Fredholm equation of the second kind

    f(u) + int_0^1 f(s) N(u, s) ds = d - g(u),   N = 2e/pi int_0^inf [M(x) - 1] cos(xeu) cos(xes) dx,

g = 0 for a flat punch, a^2 u^2 / R for a sphere (paraboloid), (pi/2) a u cot(alpha) for a cone.  The force is
2 E* a int_0^1 f du, and a smooth tip has f(1) = 0, which gives the contact radius.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tissueid.arrays import FloatArray

#: Nodes in u, and in x up to where M - 1 ~ exp(-2x) is below rounding.
NODES_U = 32
NODES_X, END_X = 320, 24.0
#: Largest a/h solved: beyond it the nodes no longer resolve the kernel.
MOST_A_OVER_H = 6.0
#: Halvings of the bracket of the contact radius.
BISECTIONS = 60


def compliance(x: FloatArray, poisson: float, *, bonded: bool) -> FloatArray:
    """M(x) - 1 for x = k h, without cancellation at large x."""
    q = np.exp(-2.0 * x)
    if bonded:
        k = 3.0 - 4.0 * poisson
        rest = 2.0 * x**2 + 5.0 - 12.0 * poisson + 8.0 * poisson**2
        return np.asarray(-(k * q**2 + q * (2.0 * x + rest)) / (k * (1.0 + q**2) / 2.0 + rest * q))
    # (cosh 2x - 1) / (sinh 2x + 2x) -> x/2 at 0: both vanish there, expm1 keeps the digits
    above = np.expm1(-2.0 * x) ** 2 / 2.0
    below = -np.expm1(-4.0 * x) / 2.0 + 2.0 * x * q
    return np.asarray(above / below - 1.0)


@lru_cache(maxsize=4)
def _nodes() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Gauss-Legendre nodes and weights in u on (0, 1) and in x on (0, END_X)."""
    u, wu = np.polynomial.legendre.leggauss(NODES_U)
    x, wx = np.polynomial.legendre.leggauss(NODES_X)
    return (u + 1.0) / 2.0, wu / 2.0, (x + 1.0) * END_X / 2.0, wx * END_X / 2.0


def _solve(
    a_over_h: float, poisson: float, *, bonded: bool, power: int
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Solutions for the right sides 1 and u^power: (integral over u, value at u = 1) of each."""
    u, wu, x, wx = _nodes()
    kernel = wx * compliance(x, poisson, bonded=bonded) * 2.0 * a_over_h / np.pi
    cosine = np.cos(a_over_h * np.outer(u, x))
    edge = (np.cos(a_over_h * x) * kernel) @ cosine.T
    matrix = np.eye(u.size) + (cosine * kernel) @ cosine.T * wu
    solution = np.linalg.solve(matrix, np.column_stack([np.ones(u.size), u**power]))
    ends = 1.0 - (edge * wu) @ solution
    sums = wu @ solution
    return (float(sums[0]), float(ends[0])), (float(sums[1]), float(ends[1]))


def flat_factor(a_over_h: float, poisson: float, *, bonded: bool = True) -> float:
    """Hayes' kappa: force on a flat punch over that on a half-space, 2 E* a d.

    ``a_over_h``: punch radius over layer thickness, 0 to :data:`MOST_A_OVER_H`; ``bonded``: the layer sticks
    to its base; else it slips without friction.  Raises ValueError: ``a_over_h`` is outside the range that is
    solved.
    """
    _check(a_over_h)
    return _solve(a_over_h, poisson, bonded=bonded, power=2)[0][0]


def _check(a_over_h: float) -> None:
    if not 0.0 <= a_over_h <= MOST_A_OVER_H:
        msg = f"a/h = {a_over_h:.3g} is outside 0 to {MOST_A_OVER_H:g}, where the layer is solved"
        raise ValueError(msg)


def layer_contact(
    depth_mm: float,
    thickness_mm: float,
    poisson: float,
    *,
    radius_mm: float | None = None,
    half_angle_rad: float | None = None,
    bonded: bool = True,
) -> tuple[float, float]:
    """Contact radius and force over E* of a sphere or a cone on a layer.

    ``radius_mm``: of a sphere, taken as a paraboloid; ``half_angle_rad``: of a cone, from its axis.  Returns
    ``contact_mm``; ``factor_mm2``: F = E* times this.  Raises ValueError: the contact would be wider than
    :data:`MOST_A_OVER_H` times the thickness.
    """
    power = 2 if radius_mm is not None else 1

    def profile(a: float) -> float:
        """Depth of the profile at the edge of contact, in the scale of the right side u^power."""
        if radius_mm is not None:
            return a * a / radius_mm
        assert half_angle_rad is not None  # noqa: S101  (one of the two is given)
        return np.pi / 2.0 * a / float(np.tan(half_angle_rad))

    def depth_of(a: float) -> float:
        one, curved = _solve(a / thickness_mm, poisson, bonded=bonded, power=power)
        return profile(a) * curved[1] / one[1]

    low, high = 0.0, MOST_A_OVER_H * thickness_mm
    if depth_of(high) < depth_mm:
        _check(float("inf"))
    for _ in range(BISECTIONS):
        middle = (low + high) / 2.0
        low, high = (middle, high) if depth_of(middle) < depth_mm else (low, middle)
    a = (low + high) / 2.0
    one, curved = _solve(a / thickness_mm, poisson, bonded=bonded, power=power)
    return a, 2.0 * a * (depth_mm * one[0] - profile(a) * curved[0])
