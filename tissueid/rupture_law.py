"""When a tissue ruptures, as frozen data: criterion, threshold, how it scatters, what resists afterwards.

Criteria are readings: none of them is stated by Sadeghnejad et al., whose force law alone
makes the force at any depth grow with speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tissueid.documents import plain

#: Unit of a threshold, by criterion.
THRESHOLD_UNITS: Mapping[str, str] = {
    "work": "N mm",
    "weighted-force": "N",
    "stored-energy": "N mm",
    "depth": "mm",
}
#: Work done on the tissue; F_s + w F_d; energy stored in springs; depth.
CRITERIA = tuple(THRESHOLD_UNITS)
#: w of the weighted force: the dynamic force counts half as much again (a reading).
DEFAULT_WEIGHT = 1.5


@dataclass(frozen=True, slots=True)
class RuptureLaw:
    """A tissue breaks when a measure of its loading first reaches a threshold."""

    criterion: str  # one of :data:`CRITERIA`
    threshold: float  # median over tests of this specimen [:data:`THRESHOLD_UNITS`]
    weight: float  # w of the weighted force; of no effect elsewhere
    sd_ln: float  # standard deviation of ln threshold from test to test
    specimen_sd_ln: float  # the same between specimens
    population: float  # median over specimens
    population_ci95: tuple[float, float]  # its 95 % interval
    residual: float  # share of the force that is left after the rupture, 0 to 1

    def __post_init__(self) -> None:
        if self.criterion not in CRITERIA:
            raise ValueError(f"no criterion of rupture {self.criterion!r}; there are {', '.join(CRITERIA)}")
        if not (self.threshold > 0.0 and self.weight >= 0.0 and 0.0 <= self.residual <= 1.0):
            raise ValueError(
                "a threshold must be above 0, a weight not below 0 and a residual share within 0 to 1, got "
                f"{self.threshold}, {self.weight} and {self.residual}"
            )

    @property
    def unit(self) -> str:
        """Unit of the threshold."""
        return THRESHOLD_UNITS[self.criterion]

    def as_json(self) -> dict[str, Any]:
        """The ``rupture`` object of ``schemas/bundle.schema.json``."""
        return plain(self) | {"unit": self.unit}  # type: ignore[no-any-return]
