"""Uncertainty budget of a reported parameter by source, read off the draws.

Parameters depend on the machine's coordinates, on the gains of its channels and on a single log's contact
almost linearly over the posterior: each source's share is its variance in that linear dependence, and noise
(with the scatter between logs) is what remains.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.target import SpecimenTarget
from tissueid.uncertainty import BudgetRow

TOTAL = "total"
#: Names of the machine's coordinates as sources.
SOURCES = {
    "frame_compliance_mm_per_N": "frame",
    "skew_s": "time skew",
    "force_filter_s": "force filter",
    "contact": "contact points",
}


def uncertainty_budget(
    target: SpecimenTarget, vectors: FloatArray, gains: FloatArray, draws: Mapping[str, FloatArray]
) -> tuple[BudgetRow, ...]:
    """Standard deviation by source of every reported parameter.

    ``vectors`` (n, size); ``gains`` (n, 2); ``draws``: reported parameter -> draws with the machine open.
    """
    columns, names = [gains[:, 0], gains[:, 1]], ["force gain", "displacement gain"]
    for k, name in enumerate(target.names):
        if name in SOURCES and target.free[k]:
            columns.append(vectors[:, k])
            names.append(SOURCES[name])
    matrix = np.column_stack(columns)
    matrix = matrix - matrix.mean(axis=0)
    spread = np.maximum(matrix.std(axis=0), 1e-300)
    rows = []
    for parameter, values in draws.items():
        centred = values - values.mean()
        variance = float(np.mean(centred**2))
        slope, *_ = np.linalg.lstsq(matrix / spread, centred, rcond=1e-8)
        parts = np.minimum(slope**2, variance)
        left = max(variance - float(parts.sum()), 0.0)
        shares = [(name, float(part)) for name, part in zip(names, parts, strict=True)]
        shares = [("noise", left), *shares]
        whole = sum(part for _, part in shares) or 1.0
        rows += [BudgetRow(parameter, name, float(np.sqrt(part)), part / whole) for name, part in shares]
        rows.append(BudgetRow(parameter, TOTAL, float(np.sqrt(variance)), None))
    return tuple(rows)
