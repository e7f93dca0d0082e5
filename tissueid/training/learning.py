"""Practice of one person: a power law over attempts.

``y = a n^b`` over the number n of the attempt, fitted to ln y by least squares (Newell & Rosenbloom 1981,
Mechanisms of skill acquisition and the law of practice).  A few attempts do not tell a power from an
exponential; b with its interval is a description.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

#: Attempts from which a slope has a standard error worth a word.
FEWEST = 4


@dataclass(frozen=True, slots=True)
class Learning:
    """A fitted curve."""

    first: float  # a: the fitted value at the first attempt
    #: b; negative where the measure falls.
    exponent: float
    exponent_se: float
    attempts: int


def learning_curve(values: Sequence[float]) -> Learning | None:
    """The curve through a measure of attempts in their order; None for fewer than four positive ones.

    ``values``: NaN where an attempt has none.
    """
    y = np.asarray(values, dtype=np.float64)
    number = np.arange(1, y.size + 1)
    known = np.isfinite(y) & (y > 0.0)
    if int(known.sum()) < FEWEST:
        return None
    design = np.column_stack([np.ones(int(known.sum())), np.log(number[known])])
    (intercept, slope), *_ = np.linalg.lstsq(design, np.log(y[known]), rcond=None)
    left = np.log(y[known]) - design @ np.array([intercept, slope])
    variance = float(left @ left) / (left.size - 2) * np.linalg.inv(design.T @ design)
    return Learning(math.exp(intercept), float(slope), math.sqrt(float(variance[1, 1])), int(left.size))
