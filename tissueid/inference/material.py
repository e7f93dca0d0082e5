"""E_0 and E_inf of a fitted tissue under a known tip, and whether its relaxation may be fluid flow.

Without a tip the stiffness of a fit is structural: of this tip on this support.  With its shape, and the
thickness where the tissue is a layer, the static force gives the equilibrium modulus and the force of an
ideal step the instantaneous one, by every formula that fits the tip.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.inference.estimates import MAX_WIDTH, TissueEstimate, width_of
from tissueid.inference.quoted import unknown_parameters
from tissueid.measured.geometry import Geometry
from tissueid.model import functionals
from tissueid.model.channels import TissueModel
from tissueid.model.moduli import FORMULAS, Contact, formulas_for, poroelastic_band
from tissueid.quantities import Quantity, QuotedNumbers

#: Depths at which a modulus is given, as shares of the fitted depth.
SHARES = (0.5, 1.0)
KPA_PER_MPA = 1000.0


def _static(model: TissueModel, theta: FloatArray, depth: float) -> float:
    return float(model.static_force(theta, np.array([depth]))[0])


def _sudden(model: TissueModel, theta: FloatArray, depth: float) -> float:
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
