"""Quantities as they are printed: symbol, unit, what each depends on, and how its interval is read.

The model is F = F_s(x) + sum over branches of K(x) acting on a Maxwell branch of relaxation time tau, with
F_s(x) = a1 x + a2 x^2 + a3 x^3, K(x) = b0 + b1 x + b2 x^2 and x the depth below contact.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class QuantityWords:
    """One printed quantity."""

    #: As printed; the unit of normalised recordings is that of strain and stress.
    symbol: str
    unit: str
    #: Its name in words, and what it is of the model.
    title: str
    meaning: str
    depends: str  # what moves it besides the tissue
    interval: str  # what its interval knows and does not


_BOTH = (
    "With 95 % the value lies in it, if model and noise hold: the statistical one knows noise, contact and "
    "the scatter between logs, the total one frame, filter, skew and gains as well."
)
_POLYNOMIAL = (
    "Its terms are strongly correlated: one alone may be wide, or of odd sign, while the force they make "
    "together is well known."
)
_DEEP = "on the depth that was reached, and on the contact point: a shift of contact moves all terms together"
_SHARED = (
    "on tau (b0 tau is better known than b0), on the speed of the ramp, and on the contact point; at one "
    "speed and one depth only the form of the polynomials parts it from a1"
)

# fmt: off
#: Name in identification.json, or symbol where it has none -> words.
QUANTITIES: Mapping[str, QuantityWords] = {
    "relaxation_time_s": QuantityWords("tau", "s", "Relaxation time",
        "the time after which a held force of this branch has fallen to 37 % of its start",
        "on the number of branches, on the window of the hold (no more than a third of it is sure) and on "
        "the sampling (two intervals at least); a soft frame, a force filter or a skew makes short ones "
        "longer",
        f"{_BOTH} It is lopsided: the long end goes far where the hold is short. `interval_open` says where "
        "it has no end."),
    "viscosity_N_s_per_mm": QuantityWords("eta", "N s/mm", "Viscosity (stiffness times relaxation time)",
        "eta = K tau (at half the depth where K varies): force per speed in long ramps",
        "on little: a ramp shows the product K tau even where K and tau can't be told apart; on the "
        "branches, which share the sum of all viscosities between them",
        f"{_BOTH} Where the total one is much wider, the machine decides: state it in [calibration]."),
    "static_1_N_per_mm": QuantityWords("a1", "N/mm", "Static force, linear term",
        "a1 of F_s(x) = a1 x + a2 x^2 + a3 x^3: force that stays, per depth, at contact",
        f"{_DEEP}; on the hold: what relaxes later than it ends counts as static",
        f"{_BOTH} {_POLYNOMIAL}"),
    "static_2_N_per_mm2": QuantityWords("a2", "N/mm^2", "Static force, square term",
        "a2 of F_s(x): how the static force bends upwards with depth",
        _DEEP,
        f"{_BOTH} {_POLYNOMIAL}"),
    "static_3_N_per_mm3": QuantityWords("a3", "N/mm^3", "Static force, cubic term",
        "a3 of F_s(x): the same, further in",
        _DEEP,
        f"{_BOTH} {_POLYNOMIAL}"),
    "stiffness_0_N_per_mm": QuantityWords("b0", "N/mm", "Dynamic stiffness at contact",
        "b0 of K(x) = b0 + b1 x + b2 x^2: stiffness that relaxes, at contact",
        _SHARED,
        f"{_BOTH} At the passivity bound its end is the bound itself."),
    "stiffness_1_N_per_mm2": QuantityWords("b1", "N/mm^2", "Dynamic stiffness, growth with depth",
        "b1 of K(x): growth of the relaxing stiffness with depth",
        "on holds at several depths, or several speeds: without them the polynomial decides",
        f"{_BOTH} {_POLYNOMIAL}"),
    "stiffness_2_N_per_mm3": QuantityWords("b2", "N/mm^3", "Dynamic stiffness, curvature with depth",
        "b2 of K(x): its curvature",
        "on holds at several depths, or several speeds: without them the polynomial decides",
        f"{_BOTH} {_POLYNOMIAL}"),
    "nrmsd": QuantityWords("NRMSD", "% of range", "Normalised root-mean-square deviation",
        "root mean square of force minus model over all fitted samples, as a share of the force's range",
        "on the noise and on what the model lacks; by the mean force it is about twice as large on a ramp",
        "It has none: it is a sum over the samples that were fitted. Beside the noise of the recordings it "
        "says how much the model misses."),
    "modulus_equilibrium": QuantityWords("E_inf", "kPa", "Modulus after relaxation",
        "Young's modulus that gives the static force at the stated depth, by the formula of the tip",
        "on tip, depth, thickness and Poisson's ratio as they were stated; the formula holds for shallow "
        "contact",
        "± is one standard error of the force alone: neither tip nor formula is in it."),
    "modulus_instantaneous": QuantityWords("E_0", "kPa", "Modulus before relaxation",
        "the same of the force that a sudden push to that depth would meet",
        "on what E_inf depends on, and on the branches: nothing faster than the sampling is in it",
        "± is one standard error of the force alone: neither tip nor formula is in it."),
    "r_hat": QuantityWords("R-hat", "1", "Agreement of the chains",
        "spread of all draws over the spread within chains, rank-normalised (doi 10.1214/20-BA1221)",
        "on the number of draws: it falls to 1 as chains forget where they began",
        "It has none: above 1.01 intervals are rough; ask for more --draws."),
    "damping_restitution": QuantityWords("e", "1", "Coefficient of restitution",
        "e of a law * impact: speed after a bounce over the speed before it",
        "on holds or unloading: in a ramp alone only k (1 + chi) is determined",
        _BOTH),
    "contact": QuantityWords("contact", "mm", "Contact point",
        "displacement, as recorded, at which the tool meets the tissue: depth counts from it",
        "on samples in air before it, on their noise, and on the slope that follows",
        "± is its standard deviation; all intervals of the fit know of it."),
}
# fmt: on
_BY_SYMBOL = {words.symbol.casefold(): name for name, words in QUANTITIES.items()}
_BRANCH = re.compile(r"^(tau|eta)_?b?[123]$|^(b[012]),?_?b?[123]$")


def quantity_name(typed: str) -> str | None:
    """Name of a quantity that was typed by its symbol, with or without its branch; ``None`` if it is none.

    >>> quantity_name("tau2"), quantity_name("b0,3"), quantity_name("NRMSD")
    ('relaxation_time_s', 'stiffness_0_N_per_mm', 'nrmsd')
    """
    plain = typed.strip().casefold()
    found = _BRANCH.match(plain)
    if found is not None:
        plain = found[1] or found[2]
    name = _BY_SYMBOL.get(plain)
    return name or next((one for one in QUANTITIES if one.casefold() == plain), None)
