"""Tip and tissue, and Young's modulus of one push where both are known and the strain is small.

Beyond a/R of 0.4, a depth of the radius, and the limits of the formula and of the layer
(:mod:`tissueid.model.moduli`) the modulus is refused with the number.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.measured import MeasuredModulus
from tissueid.documents.quantities import Assumptions
from tissueid.model.moduli import FORMULAS, MOST_A_OVER_R, Contact, Indenter, contact_of, formulas_for
from tissueid.trial import Segmentation, Trial, contact_frame

#: Soft wet tissue hardly changes its volume in seconds.
DEFAULT_POISSON = 0.5


class StatedAssumptions(Assumptions, frozen=True, omit_defaults=False):
    """Assumptions under a known tip: what it does not have is null in the file."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """Geometry that a modulus needs beside a force."""

    indenter: Indenter
    thickness_mm: float | None = None  # ``None`` where the tissue is taken as deep
    poisson: float = DEFAULT_POISSON
    bonded: bool = True  # whether a layer sticks to its base

    def __post_init__(self) -> None:
        if not 0.0 <= self.poisson <= 0.5:
            raise ValueError(f"Poisson's ratio must be 0 to 0.5, is {self.poisson}")
        if self.thickness_mm is not None and not self.thickness_mm > 0.0:
            raise ValueError(f"a thickness must be positive, is {self.thickness_mm} mm")

    def contact(self, formula: str, depth_mm: float) -> Contact | None:
        """The contact at a depth by one formula."""
        return contact_of(
            formula,
            self.indenter,
            depth_mm,
            poisson=self.poisson,
            thickness_mm=self.thickness_mm,
            bonded=self.bonded,
        )

    def __str__(self) -> str:
        tip = self.indenter
        size = f"{tip.half_angle_deg:g} degrees" if tip.shape == "cone" else f"{tip.radius_mm:g} mm"
        body = "deep" if self.thickness_mm is None else f"{self.thickness_mm:g} mm thick"
        return f"{tip.shape} of {size}, tissue {body}, Poisson's ratio {self.poisson:g}"

    def stated(self) -> StatedAssumptions:
        """Assumptions of the moduli."""
        tip, layer = self.indenter, "bonded layer" if self.bonded else "slipping layer"
        support = "half-space" if self.thickness_mm is None else layer
        size = (tip.radius_mm, tip.half_angle_deg, self.thickness_mm)
        return StatedAssumptions(tip.shape, *size, self.poisson, support)


def stated_geometry(tip: Mapping[str, Any], thickness_mm: float | None, poisson: float) -> Geometry | None:
    """Tip and thickness as a study states them; ``None`` where they do not make a known shape."""
    try:
        indenter = Indenter(str(tip.get("shape")), tip.get("radius_mm"), tip.get("half_angle_deg"))
    except ValueError:
        return None
    return Geometry(indenter, thickness_mm, poisson)


@dataclass(frozen=True, slots=True)
class TipOf:
    """The tip of a recording: as stated, or that of its header."""

    stated: Geometry | None = None  # by flags or a study
    header: bool = True  # take a sphere of the radius in the header where nothing is stated

    def of(self, trial: Trial) -> Geometry | None:
        """Tip and tissue of a trial; ``None`` where they are not known."""
        radius = trial.protocol.tip_radius_mm
        if self.stated is not None or not self.header or radius is None or not radius > 0.0:
            return self.stated
        return Geometry(Indenter("sphere", radius))


KPA_PER_MPA = 1000.0
#: Depths at which the loading is compared with the formula.
DEPTHS = 40


def modulus_of(
    trial: Trial, segmentation: Segmentation, loading: slice, last: int | None, geometry: Geometry | None
) -> MeasuredModulus | None:
    """The modulus of one push; ``None`` where the tip or the contact is not known."""
    if geometry is None or segmentation.contact is None or trial.axes.normalised:
        return None
    depth, force = contact_frame(trial, segmentation)
    deepest = float(depth[loading.stop - 1])
    if not deepest > 0.0:
        return None
    formula = formulas_for(geometry.indenter, geometry.thickness_mm)[0]
    contact = geometry.contact(formula, deepest)
    refused = ["the contact is too wide for the layer"] if contact is None else _limits(contact, geometry)
    held = None
    if contact is not None and not refused and last is not None:
        held = KPA_PER_MPA * contact.modulus_MPa(float(force[last]))
    return MeasuredModulus(
        formula=formula,
        doi=FORMULAS[formula],
        tip=str(geometry),
        depth_mm=deepest,
        contact_mm=None if contact is None else contact.contact_mm,
        loading_kPa=None if refused else _loading(depth[loading], force[loading], formula, geometry),
        held_kPa=held,
        refused=", ".join(refused) or None,
    )


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
