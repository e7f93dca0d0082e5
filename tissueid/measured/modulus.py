"""Young's modulus of one push, where the tip is known and the depth within what its formula allows.

Small strain is asked of every law: a/R at most 0.4, depth at most the radius, and the limits of the formula
and of the layer (:mod:`tissueid.model.moduli`).  Beyond them the modulus is refused with the number.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.measured.geometry import Geometry
from tissueid.measures import MeasuredModulus
from tissueid.model.moduli import FORMULAS, Contact, formulas_for
from tissueid.trial import Segmentation, Trial, contact_frame

KPA_PER_MPA = 1000.0
#: Contact radius over that of a sphere, in every law.
MOST_A_OVER_R = 0.4
#: Depths at which the loading is compared with the formula.
DEPTHS = 40


def modulus_of(
    trial: Trial, segmentation: Segmentation, loading: slice, last: int | None, geometry: Geometry | None
) -> MeasuredModulus | None:
    """The modulus of one push; ``None`` where the tip or the contact is not known.

    ``loading``: samples from contact to the stop; ``last``: last sample of the hold after it.
    """
    if geometry is None or segmentation.contact is None or trial.axes.normalised:
        return None
    depth, force = contact_frame(trial, segmentation)
    deepest = float(depth[loading.stop - 1])
    if not deepest > 0.0:
        return None
    formula = formulas_for(geometry.indenter, geometry.thickness_mm)[0]
    contact = geometry.contact(formula, deepest)
    said = MeasuredModulus(formula, FORMULAS[formula], str(geometry), deepest)
    if contact is None:
        return MeasuredModulus(*_head(said), refused="the contact is too wide for the layer")
    limits = _limits(contact, geometry)
    if limits:
        return MeasuredModulus(*_head(said), contact_mm=contact.contact_mm, refused=", ".join(limits))
    return MeasuredModulus(
        *_head(said),
        contact_mm=contact.contact_mm,
        loading_kPa=_loading(depth[loading], force[loading], formula, geometry),
        held_kPa=None if last is None else KPA_PER_MPA * contact.modulus_MPa(float(force[last])),
    )


def _head(said: MeasuredModulus) -> tuple[str, str, str, float]:
    return said.formula, said.doi, said.tip, said.depth_mm


def _limits(contact: Contact, geometry: Geometry) -> list[str]:
    """Limits that are passed, each with its number."""
    tip = geometry.indenter
    limits = list(contact.outside)
    if tip.radius_mm is not None:
        a_over_r = contact.contact_mm / tip.radius_mm
        if tip.shape == "sphere" and a_over_r > MOST_A_OVER_R and not any(one[:3] == "a/R" for one in limits):
            limits.insert(0, f"a/R = {a_over_r:.2g} (at most {MOST_A_OVER_R:g})")
        if contact.depth_mm > tip.radius_mm:
            limits.append(f"depth {contact.depth_mm:.3g} mm beyond the radius of {tip.radius_mm:.3g} mm")
    return limits


def _loading(depth: FloatArray, force: FloatArray, formula: str, geometry: Geometry) -> float | None:
    """Least squares of the formula over the loading [kPa]."""
    edges = np.linspace(0.0, float(depth[-1]), DEPTHS + 1)
    index = np.digitize(depth, edges[:-1]) - 1
    inside = (index >= 0) & (depth > 0.0)
    count = np.bincount(index[inside], minlength=DEPTHS)
    used = count > 0
    if int(used.sum()) < 2:
        return None
    mean_depth = np.bincount(index[inside], depth[inside], DEPTHS)[used] / count[used]
    mean_force = np.bincount(index[inside], force[inside], DEPTHS)[used] / count[used]
    contacts = [geometry.contact(formula, float(d)) for d in mean_depth]
    factor = np.array([0.0 if one is None else one.factor_mm2 for one in contacts])
    if not float(factor @ factor) > 0.0:
        return None
    return KPA_PER_MPA * (1.0 - geometry.poisson**2) * float(factor @ mean_force) / float(factor @ factor)
