"""Damping of a contact with a hard body, from its coefficient of restitution.

Pires et al., equation (1): ``F = k d^n (1 + chi d' / v0)``, ``chi = 8 (1 - e) / (5 e)`` (``flores``; Flores
et al. 2011, doi 10.1007/s11044-010-9237-4, equation (27)).  Multiplying the motion of a free mass by d' and
integrating over its contact gives, whatever k, n and the mass are, the e' that is reached (derived)::

    ln(1 - e' chi) + e' chi = ln(1 + chi) - chi                                     (``exact``: e' = e)
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from tissueid.arrays import FloatArray

Variant = Literal["flores", "exact"]

LEAST_RESTITUTION = 0.05
#: Restitution from which the exact factor is its tangent, and the largest share of 1/e that has a logarithm.
NEAR_1, SHORT_OF_1 = 0.9999, 1.0 - 1e-16
#: Halvings of a bracket: as many as a double has binary digits.
HALVINGS = 60


def damping_factor(restitution: float, law: Variant = "flores") -> float:
    """The damping factor chi for a coefficient of restitution; ValueError where that is out of range."""
    if not LEAST_RESTITUTION <= restitution <= 1.0:
        msg = f"a coefficient of restitution lies within {LEAST_RESTITUTION} and 1, got {restitution}"
        raise ValueError(msg)
    return float(damping_factors(restitution, law))


def damping_factors(restitution: Any, law: Variant) -> FloatArray:
    """:func:`damping_factor` at any number of restitutions, continued beyond 1, (...) -> (...)."""
    e = np.asarray(restitution, dtype=np.float64)
    if law == "flores":
        return np.asarray(8.0 * (1.0 - e) / (5.0 * e))
    low, high = np.zeros(e.shape), 1.0 / e
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        more = np.log1p(-np.minimum(e * middle, SHORT_OF_1)) + e * middle > np.log1p(middle) - middle
        low, high = np.where(more, middle, low), np.where(more, high, middle)
    # both sides vanish at e = 1, where chi begins as 1.5 (1 - e)
    return np.where(e > NEAR_1, 1.5 * (1.0 - e * e) / (1.0 + e**3), low)
