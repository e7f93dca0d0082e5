"""Contents of a bundle: one identified tissue, as frozen data, and its document."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import BundleError
from tissueid.notebook import Shown
from tissueid.result import Estimate, ModelChoice
from tissueid.rupture_law import RuptureLaw
from tissueid.trial import Axes, TipShape

if TYPE_CHECKING:
    from tissueid.model.channels import ChannelModel

BUNDLE_FORMAT = "tissueid/bundle"
BUNDLE_SCHEMA_VERSION = 1
OPTIONAL = ("draws", "population_mean", "population_sd")
ARRAYS = ("theta", "covariance", *OPTIONAL)
UNITS = Axes().as_json()


@dataclass(frozen=True, slots=True, eq=False)
class Bundle(Shown):
    """One identified tissue.

    Attributes
    ----------
    specimen : str
    model : ModelChoice
        Key and options of the contact model.
    theta_names : tuple of str
    theta : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
    parameters : tuple of Estimate
        What was reported, in the words of identification.json.
    depth_mm : float
        The model is claimed on [0, depth_mm].
    speeds_mm_s : tuple of float
        Slowest and fastest loading speed it was fitted to [mm/s].
    tip_radius_mm : float or None
    tip : TipShape or None
        Shape of the tip, where it was stated.
    sigma_N : float
        Residual standard deviation [N].
    flags : tuple of mapping
    provenance : mapping
        Input hashes, versions, options, seed.
    draws : ndarray, shape (n, p), or None
        Posterior draws of theta; of a population, specimens drawn from it.
    population_mean, population_sd : ndarray, shape (m, p), or None
        In the coordinates of :mod:`tissueid.population.coordinates`.
    rupture : RuptureLaw or None
        When it breaks, as `tissueid rupture` found; ``None`` where nothing is claimed.
    units : mapping
    schema_version : int
    """

    specimen: str
    model: ModelChoice
    theta_names: tuple[str, ...]
    theta: FloatArray
    covariance: FloatArray
    parameters: tuple[Estimate, ...]
    depth_mm: float
    speeds_mm_s: tuple[float, float]
    tip_radius_mm: float | None
    sigma_N: float
    flags: tuple[Mapping[str, Any], ...]
    provenance: Mapping[str, Any]
    tip: TipShape | None = None
    draws: FloatArray | None = None
    population_mean: FloatArray | None = None
    population_sd: FloatArray | None = None
    rupture: RuptureLaw | None = None
    units: Mapping[str, str] = field(default_factory=lambda: dict(UNITS))
    schema_version: int = BUNDLE_SCHEMA_VERSION

    def __post_init__(self) -> None:
        for name in ARRAYS:
            values = getattr(self, name)
            if values is not None:
                array = np.array(values, dtype=np.float64, copy=True)
                array.flags.writeable = False
                object.__setattr__(self, name, array)

    @property
    def is_population(self) -> bool:
        """True where its draws are specimens of a population, and not what is known of one."""
        return self.population_mean is not None

    def contact_model(self) -> ChannelModel:
        """Build the contact model these parameters belong to, as it was fitted."""
        from tissueid.model.grammar import rebuilt

        return rebuilt(self.model, self.depth_mm)

    def require_renderable(self) -> None:
        """Check that a device could render this tissue.

        Raises
        ------
        BundleError
            The recording was normalised: a device moves millimetres and pushes newtons.
        """
        if dict(self.units) != UNITS:
            units = ", ".join(f"{key} in {unit}" for key, unit in self.units.items())
            msg = (
                f"{self.specimen}: the recordings were normalised ({units}), and a device renders mm and N; "
                "fit recordings of displacement and force to feel this tissue"
            )
            raise BundleError(msg)

    def parameter(self, name: str) -> Estimate:
        """Return the reported parameter of that name (``KeyError`` where there is none)."""
        for estimate in self.parameters:
            if estimate.name == name:
                return estimate
        raise KeyError(name)

    def as_json(self) -> dict[str, Any]:
        """Return the document of ``schemas/bundle.schema.json``."""
        return {
            "schema": f"{BUNDLE_FORMAT}/{self.schema_version}",
            "specimen": self.specimen,
            "model": self.model.as_json(),
            "theta_names": list(self.theta_names),
            "parameters": [estimate.as_json() for estimate in self.parameters],
            "validity": {
                "depth_mm": self.depth_mm,
                "speeds_mm_s": list(self.speeds_mm_s),
                "tip_radius_mm": self.tip_radius_mm,
                **({} if self.tip is None else {"tip": self.tip.as_json()}),
            },
            "sigma_N": self.sigma_N,
            "units": dict(self.units),
            "flags": [dict(flag) for flag in self.flags],
            "provenance": dict(self.provenance),
            "rupture": None if self.rupture is None else self.rupture.as_json(),
        }
