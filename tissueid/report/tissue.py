"""The identified tissue of a specimen as a law to be evaluated, with the draws that say how sure it is.

Everything comes from the output folder: theta from identification.json, draws from ``posteriors.h5``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.identification import Specimen
from tissueid.documents.inspect import Units
from tissueid.model.channels import ChannelModel
from tissueid.model.grammar import rebuilt
from tissueid.result import ModelChoice
from tissueid.store.posteriors import StoredPosterior

#: Draws that a band is taken over: its ends are then good to a tenth of the posterior's sd.
BAND_DRAWS = 500
#: Ends of a 95 % band.
ENDS = (0.025, 0.975)
#: Digits of a number in a figure: a pixel needs four.
DIGITS = 5


def brief(values: Iterable[float]) -> list[float]:
    """Numbers in the digits that a figure can show."""
    return [float(f"{value:.{DIGITS}g}") for value in values]


def speed_unit(units: Units) -> str:
    """``mm/s``, or ``1/s`` where depth is a strain."""
    return f"{units.length}/s"


@dataclass(frozen=True, slots=True, eq=False)
class Tissue:
    """One identified contact model."""

    model: ChannelModel
    theta: FloatArray  # (p,)
    #: (n, p): of the total posterior where there is one, else of the statistical one; ``None``: nothing was
    #: sampled.
    draws: FloatArray | None

    def static(self, thetas: FloatArray, depth_mm: FloatArray) -> FloatArray:
        """F_s [N] of several thetas, shape (n, depths)."""
        return np.stack([self.model.static_force(theta, depth_mm) for theta in thetas])

    def stiffness(self, thetas: FloatArray, depth_mm: FloatArray) -> FloatArray:
        """Stiffness that relaxes [N/mm] of several thetas, shape (n, depths)."""
        return np.stack([self.model.stiffness(theta, depth_mm).sum(axis=0) for theta in thetas])

    def dynamic(self, thetas: FloatArray, depth_mm: FloatArray, speed_mm_s: float) -> FloatArray:
        """Relaxing force in loading at constant speed from rest [N], shape (n, depths)."""
        return np.stack([self.model.loading(theta, depth_mm, speed_mm_s) for theta in thetas])

    def force(self, thetas: FloatArray, depth_mm: FloatArray, speed_mm_s: float) -> FloatArray:
        """Force in loading at constant speed from rest [N], shape (n, depths)."""
        return self.static(thetas, depth_mm) + self.dynamic(thetas, depth_mm, speed_mm_s)


def tissue_of(specimen: Specimen, stored: StoredPosterior | None) -> Tissue | None:
    """The tissue of one of ``specimens`` of identification.json; ``None`` where a number is missing."""
    choice = specimen.model
    model = rebuilt(ModelChoice.of(choice), specimen.validity.depth_mm)
    known = {entry.name: entry for entry in specimen.parameters}
    values = [
        known[name].detail.get("estimate", known[name].value) if name in known else None
        for name in model.parameter_names
    ]
    if any(value is None for value in values):
        return None
    draws = None
    if stored is not None and set(model.parameter_names) <= set(stored.theta_names):
        table = stored.draws if stored.draws_total is None else stored.draws_total
        kept = np.linspace(0, len(table) - 1, min(len(table), BAND_DRAWS)).astype(int)
        order = [stored.theta_names.index(name) for name in model.parameter_names]
        draws = table[kept][:, order]
    return Tissue(model, np.array(values, dtype=np.float64), draws)
