"""Tip and tissue, as far as a modulus needs them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tissueid.model.moduli import Contact, Indenter, contact_of
from tissueid.trial import Trial

#: Soft wet tissue hardly changes its volume in seconds.
DEFAULT_POISSON = 0.5


@dataclass(frozen=True, slots=True)
class Geometry:
    """Geometry that a modulus needs beside a force."""

    indenter: Indenter
    thickness_mm: float | None = None  # ``None`` where the tissue is taken as deep
    poisson: float = DEFAULT_POISSON
    bonded: bool = True  # whether a layer sticks to its base

    def __post_init__(self) -> None:
        if not 0.0 <= self.poisson <= 0.5:
            msg = f"Poisson's ratio must be 0 to 0.5, is {self.poisson}"
            raise ValueError(msg)
        if self.thickness_mm is not None and not self.thickness_mm > 0.0:
            msg = f"a thickness must be positive, is {self.thickness_mm} mm"
            raise ValueError(msg)

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

    def as_json(self) -> dict[str, float | str | None]:
        """Assumptions of the moduli."""
        return {
            "shape": self.indenter.shape,
            "radius_mm": self.indenter.radius_mm,
            "half_angle_deg": self.indenter.half_angle_deg,
            "thickness_mm": self.thickness_mm,
            "poisson": self.poisson,
            "support": "half-space"
            if self.thickness_mm is None
            else ("bonded layer" if self.bonded else "slipping layer"),
        }


def stated_geometry(tip: Mapping[str, Any], thickness_mm: float | None, poisson: float) -> Geometry | None:
    """Tip and thickness as a study states them; ``None`` where they do not make a known shape.

    ``tip``: ``[tip]`` of study.toml: shape, radius_mm, half_angle_deg; ``thickness_mm``: of the specimen.
    """
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


#: Neither stated nor looked for in headers.
NO_TIP = TipOf(header=False)
