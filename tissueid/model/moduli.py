"""Young's modulus from a force at a depth under a tip of known shape, with the range of each formula.

F = E* G with E* = E / (1 - nu^2) and G [mm^2] of the tip alone, in frictionless contact:

=============  ==========================================================  ================================
hertz          sphere: 4/3 sqrt(R) d^1.5                                   doi 10.1515/crll.1882.92.156
sneddon        flat: 2 a d; cone: 2/pi tan(alpha) d^2; sphere, exact in    doi 10.1016/0020-7225(65)90019-4
               a/R: (a^2+R^2)/2 L - a R, d = a/2 L, L = ln[(R+a)/(R-a)]
hayes          layer on a rigid base, any of the three (:func:`_solve`)     doi 10.1016/0021-9290(72)90010-3
dimitriadis    sphere on a thin layer: a series in sqrt(R d)/h              doi 10.1016/S0006-3495(02)75620-8
=============  ==========================================================  ================================

A structural stiffness becomes a modulus only by these assumptions: homogeneous, linear, isotropic, small
strain.  Where the numbers leave the range in which a formula holds, :func:`Contact.outside` says so.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tissueid.arrays import FloatArray

#: Nodes in u, and in x up to where M - 1 ~ exp(-2x) is below rounding.
NODES_U, NODES_X, END_X = 32, 320, 24.0
#: Largest a/h solved: beyond it the nodes no longer resolve the kernel.
MOST_A_OVER_H = 6.0
#: Halvings of the bracket of the contact radius.
BISECTIONS = 60


def compliance(x: FloatArray, poisson: float, *, bonded: bool) -> FloatArray:
    """M(x) - 1 for x = k h, without cancellation at large x; M -> 1 is a half-space.

    bonded      M(x) = [(3-4nu) sinh 2x - 2x] / [(3-4nu) cosh 2x + 2x^2 + 5 - 12nu + 8nu^2]
    slipping    M(x) = (cosh 2x - 1) / (sinh 2x + 2x)
    """
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
    """Solutions for the right sides 1 and u^power: (integral over u, value at u = 1) of each.

    A mode k goes down by 2/E* M(kh) times its pressure; the modes that carry none outside r = a, and Abel's
    inversion of w(r) = d - profile(r), leave with u = t/a and e = a/h (solved for any nu, a/h, and a cone)

        f(u) + int_0^1 f(s) N(u, s) ds = d - g(u),   N = 2e/pi int_0^inf [M(x) - 1] cos(xeu) cos(xes) dx,

    g = 0 (flat punch), a^2 u^2 / R (sphere), (pi/2) a u cot(alpha) (cone); the force is 2 E* a int_0^1 f du,
    and a smooth tip has f(1) = 0, which gives the contact radius.
    """
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
    """Hayes' kappa: force on a flat punch over that on a half-space, 2 E* a d; ValueError out of range."""
    _check(a_over_h)
    return _solve(a_over_h, poisson, bonded=bonded, power=2)[0][0]


def _check(a_over_h: float) -> None:
    if not 0.0 <= a_over_h <= MOST_A_OVER_H:
        raise ValueError(f"a/h = {a_over_h:.3g} is outside 0 to {MOST_A_OVER_H:g}, where the layer is solved")


def _bisected(grows: Callable[[float], float], value: float, high: float, halvings: int) -> float:
    """Place between 0 and ``high`` at which a function that grows has a value."""
    low = 0.0
    for _ in range(halvings):
        middle = (low + high) / 2.0
        low, high = (middle, high) if grows(middle) < value else (low, middle)
    return (low + high) / 2.0


SHAPES = ("sphere", "flat", "cone")
#: formula -> DOI.
FORMULAS = {
    "hertz": "10.1515/crll.1882.92.156",
    "sneddon": "10.1016/0020-7225(65)90019-4",
    "hayes": "10.1016/0021-9290(72)90010-3",
    "dimitriadis": "10.1016/S0006-3495(02)75620-8",
}
#: Hertz takes a sphere for a paraboloid: 1.7 % of force at a/R = 0.4, 10 % at 0.8 (against Sneddon).
MOST_A_OVER_R = 0.4
#: Half-space formulas: a bonded layer of nu = 0.5 is 13 % stiffer at a/h = 0.1.
MOST_A_OVER_H_DEEP = 0.1
#: Dimitriadis' truncated series is 3 % below the layer's exact equation at 0.3, 8 % at 0.5, 20 % at 1.
MOST_CHI = 0.3
#: Depth over thickness, and nominal contact strain, up to which small-strain theory is used.
MOST_DEPTH_OVER_H, MOST_STRAIN = 0.1, 0.1
#: Nominal strain under a sphere, 0.2 a/R (Tabor, The Hardness of Metals, 1951), and a cone, 0.2 cot(alpha).
TABOR = 0.2
#: Poroelastic diffusivities met in gels and soft tissue [mm^2/s], 1e-11 to 1e-8 m^2/s.
DIFFUSIVITY_MM2_S = (1e-5, 1e-2)


@dataclass(frozen=True, slots=True)
class Indenter:
    """The tip of the tool; ValueError where its shape is not offered, or its size missing or impossible."""

    shape: str  # ``sphere``, ``flat`` or ``cone``
    radius_mm: float | None = None  # of a sphere or a flat punch
    half_angle_deg: float | None = None  # of a cone, between its axis and its side

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise ValueError(f"tip shape {self.shape!r} is not offered, {', '.join(SHAPES)} are")
        if self.shape == "cone" and not (self.half_angle_deg and 0.0 < self.half_angle_deg < 90.0):
            raise ValueError(f"a cone needs a half angle between 0 and 90 degrees, got {self.half_angle_deg}")
        if self.shape != "cone" and not (self.radius_mm and 0.0 < self.radius_mm < math.inf):
            raise ValueError(f"a {self.shape} needs a radius above 0 mm, got {self.radius_mm}")


@dataclass(frozen=True, slots=True)
class Contact:
    """Contact of a tip with an elastic body at one depth."""

    formula: str  # key of :data:`FORMULAS`
    depth_mm: float
    contact_mm: float  # contact radius a
    factor_mm2: float  # G: F = E* G
    poisson: float
    outside: tuple[str, ...] = ()  # how the numbers leave the formula's range; empty within it

    def modulus_MPa(self, force_N: float) -> float:
        """Young's modulus E that gives this force [N/mm^2 = MPa]."""
        return (1.0 - self.poisson**2) * force_N / self.factor_mm2


def formulas_for(indenter: Indenter, thickness_mm: float | None) -> tuple[str, ...]:
    """Formulas for a tip, the one to be preferred first."""
    deep = ("hertz", "sneddon") if indenter.shape == "sphere" else ("sneddon",)
    if thickness_mm is None:
        return deep
    return ("hayes", "dimitriadis", *deep) if indenter.shape == "sphere" else ("hayes", *deep)


def contact_of(
    formula: str,
    indenter: Indenter,
    depth_mm: float,
    *,
    poisson: float = 0.5,
    thickness_mm: float | None = None,
    bonded: bool = True,
) -> Contact | None:
    """The contact a formula describes; ``None`` where it has no solution for these numbers."""
    if not 0.0 <= poisson <= 0.5:
        raise ValueError(f"Poisson's ratio must be 0 to 0.5, is {poisson}")
    if formula not in {"hayes", "dimitriadis"}:
        a, factor = _half_space(formula, indenter, depth_mm)
    elif thickness_mm is None or not thickness_mm > 0.0:
        raise ValueError(f"{formula} needs the thickness of the layer")
    elif formula == "dimitriadis":
        a, factor = _dimitriadis(indenter, depth_mm, thickness_mm, poisson, bonded=bonded)
    else:
        try:
            a, factor = layer_contact(indenter, depth_mm, thickness_mm, poisson, bonded=bonded)
        except ValueError:
            return None
    outside = _outside(formula, indenter, depth_mm, a, thickness_mm)
    return Contact(formula, depth_mm, a, factor, poisson, outside)


def _half_space(formula: str, tip: Indenter, depth: float) -> tuple[float, float]:
    """Contact radius and G on a half-space."""
    if tip.shape == "flat":
        assert tip.radius_mm is not None  # noqa: S101  (checked by Indenter)
        return tip.radius_mm, 2.0 * tip.radius_mm * depth
    if tip.shape == "cone":
        slope = math.tan(math.radians(tip.half_angle_deg or 0.0))
        return 2.0 / math.pi * depth * slope, 2.0 / math.pi * slope * depth**2
    radius = tip.radius_mm or 0.0
    if formula == "hertz":
        return math.sqrt(radius * depth), 4.0 / 3.0 * math.sqrt(radius) * depth**1.5
    return _sneddon_sphere(radius, depth)


def _sneddon_sphere(radius: float, depth: float) -> tuple[float, float]:
    """Sneddon's sphere: a/2 ln[(R+a)/(R-a)] = d, solved by bisection in a/R = tanh(z)."""
    high = 1.0 + depth / radius
    # in z = atanh(a/R) the depth is R z tanh z, which grows with z
    while high * math.tanh(high) * radius < depth:
        high *= 2.0
    z = _bisected(lambda z: z * math.tanh(z) * radius, depth, high, 80)
    a = radius * math.tanh(z)
    return a, (a * a + radius * radius) * z - a * radius


def layer_contact(
    tip: Indenter, depth: float, thickness: float, poisson: float, *, bonded: bool
) -> tuple[float, float]:
    """Contact radius [mm] and G [mm^2] of a flat punch, a sphere (a paraboloid) or a cone on a layer.

    Raises ValueError: the contact would be wider than :data:`MOST_A_OVER_H` times the thickness.
    """
    if tip.shape == "flat":
        a = tip.radius_mm or 0.0
        return a, 2.0 * a * depth * flat_factor(a / thickness, poisson, bonded=bonded)
    power = 2 if tip.shape == "sphere" else 1

    def profile(a: float) -> float:
        """Depth of the profile at the edge of contact, in the scale of the right side u^power."""
        if tip.shape == "sphere":
            return a * a / (tip.radius_mm or 0.0)
        return np.pi / 2.0 * a / float(np.tan(math.radians(tip.half_angle_deg or 0.0)))

    def depth_of(a: float) -> float:
        one, curved = _solve(a / thickness, poisson, bonded=bonded, power=power)
        return profile(a) * curved[1] / one[1]

    high = MOST_A_OVER_H * thickness
    if depth_of(high) < depth:
        _check(float("inf"))
    a = _bisected(depth_of, depth, high, BISECTIONS)
    one, curved = _solve(a / thickness, poisson, bonded=bonded, power=power)
    return a, 2.0 * a * (depth * one[0] - profile(a) * curved[0])


def _dimitriadis(
    tip: Indenter, depth: float, thickness: float, poisson: float, *, bonded: bool
) -> tuple[float, float]:
    """Contact radius (of Hertz) and G: the paper's general equation with its sets of coefficients.

    For nu = 0.5 its polynomial has the last term with the other sign: 2e-3 at the largest chi that is not
    flagged.
    """
    if tip.shape != "sphere" or tip.radius_mm is None:
        raise ValueError(f"dimitriadis describes a sphere, not a {tip.shape}")
    nu = poisson
    if bonded:
        alpha = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1.0 - nu)
        beta = (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1.0 - nu)
    else:
        alpha = -0.347 * (3.0 - 2.0 * nu) / (1.0 - nu)
        beta = 0.056 * (5.0 - 2.0 * nu) / (1.0 - nu)
    radius = tip.radius_mm
    chi = math.sqrt(radius * depth) / thickness
    pi = math.pi
    series = (
        1.0
        - 2.0 * alpha / pi * chi
        + 4.0 * alpha**2 / pi**2 * chi**2
        - 8.0 / pi**3 * (alpha**3 + 4.0 * pi**2 / 15.0 * beta) * chi**3
        + 16.0 * alpha / pi**4 * (alpha**3 + 3.0 * pi**2 / 5.0 * beta) * chi**4
    )
    return math.sqrt(radius * depth), 4.0 / 3.0 * math.sqrt(radius) * depth**1.5 * series


def _outside(formula: str, tip: Indenter, depth: float, a: float, thickness: float | None) -> tuple[str, ...]:
    """Limits that are passed, each with its number."""
    said = []

    def limit(name: str, value: float, most: float) -> None:
        if value > most:
            said.append(f"{name} = {value:.2g} (at most {most:g})")

    if tip.shape == "cone":
        limit("strain 0.2 cot(alpha)", TABOR / math.tan(math.radians(tip.half_angle_deg or 0.0)), MOST_STRAIN)
    elif tip.shape == "sphere" and tip.radius_mm is not None:
        if formula != "sneddon":
            limit("a/R", a / tip.radius_mm, MOST_A_OVER_R)
        limit("strain 0.2 a/R", TABOR * a / tip.radius_mm, MOST_STRAIN)
    elif tip.radius_mm is not None:
        limit("strain 0.2 d/a", TABOR * depth / tip.radius_mm, MOST_STRAIN)
    if thickness is None:
        return tuple(said)
    if formula in {"hertz", "sneddon"}:
        limit("a/h", a / thickness, MOST_A_OVER_H_DEEP)
    if formula == "dimitriadis":
        limit("sqrt(R d)/h", a / thickness, MOST_CHI)
    limit("d/h", depth / thickness, MOST_DEPTH_OVER_H)
    return tuple(said)


def poroelastic_band(contact_mm: float) -> tuple[float, float]:
    """Times in which fluid drains from under a contact: a^2 / D [s] (doi 10.1063/1.3370354)."""
    slow, fast = DIFFUSIVITY_MM2_S
    return contact_mm**2 / fast, contact_mm**2 / slow


def drained_share(time: FloatArray) -> FloatArray:
    """Share of the pressure left under a sphere, of time over a^2 / D (doi 10.1063/1.3370354)."""
    return np.asarray(0.491 * np.exp(-0.908 * np.sqrt(time)) + 0.509 * np.exp(-1.679 * time))
