"""Young's modulus from a force at a depth under a tip of known shape, with the range of each formula.

F = E* G with E* = E / (1 - nu^2) and G [mm^2] of the tip alone, in frictionless contact:

=============  ==========================================================  ================================
hertz          sphere: 4/3 sqrt(R) d^1.5                                   doi 10.1515/crll.1882.92.156
sneddon        flat: 2 a d; cone: 2/pi tan(alpha) d^2; sphere, exact in    doi 10.1016/0020-7225(65)90019-4
               a/R: (a^2+R^2)/2 L - a R, d = a/2 L, L = ln[(R+a)/(R-a)]
hayes          layer on a rigid base, any of the three (:mod:`.layer`)      doi 10.1016/0021-9290(72)90010-3
dimitriadis    sphere on a thin layer: a series in sqrt(R d)/h              doi 10.1016/S0006-3495(02)75620-8
=============  ==========================================================  ================================

A structural stiffness becomes a modulus only by these assumptions: homogeneous, linear, isotropic, small
strain.  Where the numbers leave the range in which a formula holds, :func:`Contact.outside` says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from tissueid.model.layer import MOST_A_OVER_H, flat_factor, layer_contact

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
MOST_DEPTH_OVER_H = 0.1
MOST_STRAIN = 0.1
#: Nominal strain under a sphere, 0.2 a/R (Tabor, The Hardness of Metals, 1951), and a cone, 0.2 cot(alpha).
TABOR = 0.2
#: Poroelastic diffusivities met in gels and soft tissue [mm^2/s], 1e-11 to 1e-8 m^2/s.
DIFFUSIVITY_MM2_S = (1e-5, 1e-2)


@dataclass(frozen=True, slots=True)
class Indenter:
    """The tip of the tool.

    Raises ValueError: the shape is not offered, or its size is missing or impossible.
    """

    shape: str  # ``sphere``, ``flat`` or ``cone``
    radius_mm: float | None = None  # of a sphere or a flat punch
    half_angle_deg: float | None = None  # of a cone, between its axis and its side

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            msg = f"tip shape {self.shape!r} is not offered, {', '.join(SHAPES)} are"
            raise ValueError(msg)
        if self.shape == "cone" and not (self.half_angle_deg and 0.0 < self.half_angle_deg < 90.0):
            msg = f"a cone needs a half angle between 0 and 90 degrees, got {self.half_angle_deg}"
            raise ValueError(msg)
        if self.shape != "cone" and not (self.radius_mm and 0.0 < self.radius_mm < math.inf):
            msg = f"a {self.shape} needs a radius above 0 mm, got {self.radius_mm}"
            raise ValueError(msg)


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
    """The contact a formula describes; ``None`` where it has no solution for these numbers.

    ``formula``: one of :func:`formulas_for`; ``depth_mm``: positive; ``poisson``: 0 to 0.5; ``thickness_mm``:
    of the layer; needed by ``hayes`` and ``dimitriadis``; ``bonded``: the layer sticks to its rigid base
    (else it slips).
    """
    if not 0.0 <= poisson <= 0.5:
        msg = f"Poisson's ratio must be 0 to 0.5, is {poisson}"
        raise ValueError(msg)
    if formula in {"hayes", "dimitriadis"}:
        if thickness_mm is None or not thickness_mm > 0.0:
            msg = f"{formula} needs the thickness of the layer"
            raise ValueError(msg)
        found = (_hayes if formula == "hayes" else _dimitriadis)(
            indenter, depth_mm, thickness_mm, poisson, bonded=bonded
        )
    else:
        found = _half_space(formula, indenter, depth_mm)
    if found is None:
        return None
    a, factor = found
    outside = _outside(formula, indenter, depth_mm, a, thickness_mm)
    return Contact(formula, depth_mm, a, factor, poisson, outside)


def _half_space(formula: str, tip: Indenter, depth: float) -> tuple[float, float] | None:
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
    low, high = 0.0, 1.0 + depth / radius
    # in z = atanh(a/R) the depth is R z tanh z, which grows with z
    while high * math.tanh(high) * radius < depth:
        high *= 2.0
    for _ in range(80):
        middle = (low + high) / 2.0
        low, high = (middle, high) if middle * math.tanh(middle) * radius < depth else (low, middle)
    z = (low + high) / 2.0
    a = radius * math.tanh(z)
    return a, (a * a + radius * radius) * z - a * radius


def _hayes(
    tip: Indenter, depth: float, thickness: float, poisson: float, *, bonded: bool
) -> tuple[float, float] | None:
    """Contact radius and G on a layer."""
    if tip.shape == "flat":
        a = tip.radius_mm or 0.0
        if a > MOST_A_OVER_H * thickness:
            return None
        return a, 2.0 * a * depth * flat_factor(a / thickness, poisson, bonded=bonded)
    angle = None if tip.half_angle_deg is None else math.radians(tip.half_angle_deg)
    radius = tip.radius_mm if tip.shape == "sphere" else None
    try:
        return layer_contact(depth, thickness, poisson, radius_mm=radius, half_angle_rad=angle, bonded=bonded)
    except ValueError:
        return None


def _dimitriadis(
    tip: Indenter, depth: float, thickness: float, poisson: float, *, bonded: bool
) -> tuple[float, float]:
    """Contact radius (of Hertz) and G: the general equation of the paper, with its two sets of coefficients.

    For nu = 0.5 the paper also prints the polynomial, its last term (0.0975 chi^4) with the other sign: 2e-3
    of the force at the largest chi that is not flagged.
    """
    if tip.shape != "sphere" or tip.radius_mm is None:
        msg = f"dimitriadis describes a sphere, not a {tip.shape}"
        raise ValueError(msg)
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
    """Times in which fluid drains from under a contact of radius a: a^2 / D over the usual D [s].

    Hu, Zhao, Vlassak & Suo, doi 10.1063/1.3370354: poroelastic relaxation under an indenter takes a^2 / D,
    so that it grows with the square of the tip, while viscosity does not know the tip's size.
    """
    slow, fast = DIFFUSIVITY_MM2_S
    return contact_mm**2 / fast, contact_mm**2 / slow
