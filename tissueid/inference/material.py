"""Elastic moduli of a fitted tissue under a known tip, and whether its relaxation may be fluid flow.

Without a tip the stiffness of a fit is structural: of this tip on this support.  With its shape, and the
thickness where the tissue is a layer, the static force gives the equilibrium modulus and the force of an
ideal step the instantaneous one, by every formula that fits the tip.

Drainage or viscosity, by holds at several depths.
Fluid drains from under a contact of radius a in a time that grows as a^2; a viscous tissue does not know the
contact (Hu, Zhao, Vlassak & Suo 2010, doi 10.1063/1.3370354).  The slope of ln tau on ln a tells them apart,
where a tip is known, is not buried, and holds of one length stand at two depths or more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import t

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.inference.estimates import MAX_WIDTH, TissueEstimate, width_of
from tissueid.inference.quoted import unknown_parameters
from tissueid.measured.geometry import Geometry
from tissueid.model import functionals
from tissueid.model.channels import ChannelModel
from tissueid.model.moduli import FORMULAS, Contact, formulas_for, poroelastic_band
from tissueid.quantities import DEPTH_TEST, Quantity, QuotedNumbers

#: Depths at which a modulus is given, as shares of the fitted depth.
SHARES = (0.5, 1.0)
KPA_PER_MPA = 1000.0


def _static(model: ChannelModel, theta: FloatArray, depth: float) -> float:
    return float(model.static_force(theta, np.array([depth]))[0])


def _sudden(model: ChannelModel, theta: FloatArray, depth: float) -> float:
    return functionals.force_after_step(model, theta, depth, 0.0)


def _moduli(tissue: TissueEstimate, formula: str, depth: float, contact: Contact | None) -> list[Quantity]:
    rows = []
    at: dict[str, float | str] = {"formula": formula, "doi": FORMULAS[formula], "depth_mm": depth}
    for name, force in (("modulus_equilibrium", _static), ("modulus_instantaneous", _sudden)):
        if contact is None:
            reason = f"{formula} has no solution here: the contact is too wide for the layer"
            rows.append(Quantity(name, "kPa", at, None, None, reason))
            continue
        value, stderr = functionals.delta_method(
            lambda theta, f=force, c=contact: KPA_PER_MPA * c.modulus_MPa(f(tissue.model, theta, depth)),  # type: ignore[misc]
            tissue.theta,
            tissue.covariance,
            unknown_parameters(tissue),
        )
        if width_of(value, stderr) > MAX_WIDTH:
            rows.append(Quantity(name, "kPa", at, None, None, "the data do not determine it"))
        else:
            rows.append(Quantity(name, "kPa", at, value, stderr))
    return rows


def _poroelastic(tissue: TissueEstimate, contact: Contact) -> list[Flag]:
    """Relaxation times that fluid flow under this contact could have as well."""
    tau = tissue.model.times(tissue.theta)
    low, high = poroelastic_band(contact.contact_mm)
    suspect = [float(value) for value in tau if low <= value <= high]
    if not suspect:
        return []
    times = ", ".join(f"{value:.3g}" for value in suspect)
    message = f"relaxation in {times} s lies where fluid drains from this contact, {low:.3g} to {high:.3g} s"
    values = {"tau_s": suspect, "contact_mm": contact.contact_mm, "from_s": low, "to_s": high}
    return [Flag("poroelastic", message, values)]


def with_moduli(
    quoted: QuotedNumbers, tissue: TissueEstimate, geometry: Geometry | None
) -> tuple[QuotedNumbers, list[Flag]]:
    """The same numbers with the moduli for a tip, and what is to be said of them.

    ``geometry``: without one nothing changes.
    """
    if geometry is None:
        return quoted, []
    rows: list[Quantity] = []
    outside: dict[str, tuple[str, ...]] = {}
    full = tissue.model.depth_mm
    deepest: Contact | None = None
    for formula in formulas_for(geometry.indenter, geometry.thickness_mm):
        for share in SHARES:
            contact = geometry.contact(formula, share * full)
            rows += _moduli(tissue, formula, share * full, contact)
        if contact is not None:
            deepest = deepest or contact
            if contact.outside:
                outside[formula] = contact.outside
    flags = [] if deepest is None else _poroelastic(tissue, deepest)
    if outside:
        formula, limits = next(iter(outside.items()))
        more = f"; {len(outside)} formulas in all" if len(outside) > 1 else ""
        values = {"formulas": list(outside), "depth_mm": full}
        flags.append(
            Flag(
                "modulus_out_of_range",
                f"at {full:.3g} mm {formula} is outside its range: {limits[0]}{more}",
                values,
            )
        )
    return replace(quoted, moduli=tuple(rows), assumptions=geometry.as_json()), flags


UNIT = "1"
#: Slopes of ln tau on ln contact radius of a viscous tissue and of one that drains.
VISCOUS, DRAINAGE = 0.0, 2.0
#: Ratio of the largest to the smallest contact radius, depth over tip radius, and holds, that can decide.
FEWEST_RATIO, BURIED, FEWEST_HOLDS = 1.1, 0.5, 3
#: Least standard deviation of ln tau: two holds at one site agree no better.
LEAST_SD = 0.02


def depth_test(
    geometry: Geometry | None, depths_mm: Sequence[float], tau_s: Sequence[float]
) -> tuple[Quantity | None, tuple[Flag, ...]]:
    """Slope of ln tau on ln contact radius, and its flag.

    ``geometry``: tip; without one, or with a flat punch, nothing is tested; ``depths_mm``, ``tau_s``: depth
    and relaxation time of a hold each, of one length.  Returns value and standard error of the slope, with
    ``verdict`` and 95 % interval among its conditions; ``poroelastic`` where the slope is that of drainage.
    """
    if geometry is None or geometry.indenter.shape == "flat" or len(depths_mm) < FEWEST_HOLDS:
        return None, ()
    formula = formulas_for(geometry.indenter, geometry.thickness_mm)[0]
    contacts = [geometry.contact(formula, depth) for depth in depths_mm]
    radius = np.array([np.nan if one is None else one.contact_mm for one in contacts])
    if not np.isfinite(radius).all() or radius.max() < FEWEST_RATIO * radius.min():
        return None, ()
    deepest = float(max(depths_mm))
    at: dict[str, float | str] = {"depth_mm": deepest, "holds": float(len(depths_mm))}
    tip = geometry.indenter.radius_mm
    if geometry.indenter.shape == "sphere" and tip is not None and deepest > BURIED * tip:
        reason = f"the tip is buried: {deepest:.3g} mm of depth, {tip:.3g} mm of radius"
        return Quantity(DEPTH_TEST, UNIT, at, None, None, reason), ()
    slope, error, half = _slope(np.log(radius), np.log(tau_s))
    verdict = _verdict(slope - half, slope + half)
    at |= {"low": slope - half, "high": slope + half, "verdict": verdict}
    flags: tuple[Flag, ...] = ()
    if verdict == "drainage":
        words = (
            f"relaxation times grow as the contact radius to the power {slope:.2f} [{slope - half:.2f}, "
            f"{slope + half:.2f}] to {deepest:.3g} mm: fluid drains"
        )
        flags = (Flag("poroelastic", words, {"slope": slope, "stderr": error}),)
    return Quantity(DEPTH_TEST, UNIT, at, slope, error), flags


def _slope(x: FloatArray, y: FloatArray) -> tuple[float, float, float]:
    """Slope of a line, its standard error, and half its 95 % interval."""
    off, freedom = x - x.mean(), x.size - 2
    slope = float(off @ y / (off @ off))
    rest = y - y.mean() - slope * off
    sd = max(float(np.sqrt(rest @ rest / freedom)), LEAST_SD)
    error = sd / float(np.sqrt(off @ off))
    return slope, error, float(t.ppf(0.975, freedom)) * error


def _verdict(low: float, high: float) -> str:
    """One of drainage, viscous, neither, can't decide."""
    viscous, drains = low <= VISCOUS <= high, low <= DRAINAGE <= high
    if viscous == drains:
        return "can't decide" if viscous else "neither"
    return "viscous" if viscous else "drainage"
