"""Number of specimens that a wanted precision takes.

Half the width of a 95 % interval of a mean of n specimens is 1.96 sqrt((D^2 + m^2) / n) in ln units, with D
the spread between specimens and m that of one specimen's own posterior; of a standard deviation, relative to
itself, 1.96 (D^2 + m^2) / D^2 / sqrt(2 (n - 1)).  Both are large-sample formulas of a normal population
(derived); the answer is given for the median of D and for both ends of its interval.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray

#: Wanted half widths, relative.
PRECISIONS = (0.02, 0.05, 0.10)
Z95 = 1.959963984540054


@dataclass(frozen=True, slots=True)
class SizeRow:
    """Specimens for one quantity and one precision: median, and at the ends of the interval of D."""

    name: str
    precision: float
    mean: int
    mean_range: tuple[int, int]
    sd: int
    sd_range: tuple[int, int]

    def as_json(self) -> dict[str, Any]:
        """A row of ``cohort_size``."""
        return {
            "name": self.name,
            "precision": self.precision,
            "mean": self.mean,
            "mean_range": list(self.mean_range),
            "sd": self.sd,
            "sd_range": list(self.sd_range),
        }


def specimens_for_mean(between_sd: float, own_sd: float, precision: float) -> int:
    """Specimens for a relative half width of the 95 % interval of the mean; at least 3."""
    half = math.log1p(precision)
    return max(math.ceil(Z95**2 * (between_sd**2 + own_sd**2) / half**2), 3)


def specimens_for_sd(between_sd: float, own_sd: float, precision: float) -> int:
    """Specimens for a relative half width of the 95 % interval of the standard deviation; at least 3."""
    inflated = (between_sd**2 + own_sd**2) / between_sd**2
    return max(math.ceil(1.0 + 0.5 * (Z95 * inflated / precision) ** 2), 3)


def size_rows(names: tuple[str, ...], sd: FloatArray, own_sd: FloatArray) -> tuple[SizeRow, ...]:
    """A row a quantity and precision.

    ``sd`` (n, p): draws of D; ``own_sd`` (p,): typical standard deviation of one specimen's ln quantity.
    """
    low, middle, high = np.quantile(sd, [0.025, 0.5, 0.975], axis=0)
    rows = []
    for k, name in enumerate(names):
        for precision in PRECISIONS:
            means = [
                specimens_for_mean(float(d[k]), float(own_sd[k]), precision) for d in (low, middle, high)
            ]
            sds = [specimens_for_sd(float(d[k]), float(own_sd[k]), precision) for d in (low, middle, high)]
            rows.append(
                SizeRow(name, precision, means[1], (min(means), max(means)), sds[1], (min(sds), max(sds)))
            )
    return tuple(rows)
