"""What samples are worth where a model misses more than the noise: independent ones among all.

A generalised posterior (Bissiri, Holmes & Walker 2016, doi 10.1111/rssb.12158) divides the log likelihood by
the number c of samples that one independent sample stands for.  It is the mean, over the parameters, of the
sandwich variance over the naive one (the magnitude adjustment of Pauli, Racugno & Ventura 2011, Statistica
Sinica 21: 149): tr(H^-1 J) / p, with H the sum of squares of the derivatives and J that of the scores of
clusters.  Clusters are logs where there are four or more, otherwise stretches of each log, of equal numbers
of residual blocks: these are fractions of the path in ramps and equal in ln time in holds.  Few clusters make
c uncertain, which Student's t over the normal carries.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.fit.residual_blocks import ResidualBlocks

__all__ = ["samples_per_independent"]

FloatArray = NDArray[np.float64]

#: Logs from which they are the clusters, and clusters of a log where there are fewer.
FEWEST_LOGS, STRETCHES = 4, 8
#: Directions of the parameters that are known worse than this, relative to the best, tell nothing.
KNOWN = 1e-10
NORMAL_975 = 1.959963984540054


def _without_own(one: ResidualBlocks, own: int) -> tuple[FloatArray, FloatArray]:
    """Derivatives and residual of each block, weighted by its samples, free of the log's own effects."""
    root = np.sqrt(one.count.astype(np.float64))[:, None]
    both = root * np.column_stack([one.shared, one.mean_N])
    if own:
        basis, _ = np.linalg.qr(root * one.own[:, :own])
        both = both - basis @ (basis.T @ both)
    return both[:, :-1], both[:, -1]


def samples_per_independent(blocks: Sequence[ResidualBlocks], sigma_N: float, *, own: int) -> float:
    """Samples that one independent sample stands for, at least 1.

    Parameters
    ----------
    blocks : sequence of ResidualBlocks
        Of all logs, at the optimum.
    sigma_N : float
        Standard deviation of the residuals [N].
    own : int
        Columns of ``own`` that every log was fitted with for itself.
    """
    logs = [_without_own(one, own) for one in blocks if one.count.size]
    if not logs or not sigma_N > 0.0:
        return 1.0
    columns = np.concatenate([one[0] for one in logs])
    unit = np.sqrt((columns**2).sum(axis=0))
    unit[unit == 0.0] = 1.0
    values, vectors = np.linalg.eigh(columns.T @ columns / unit / unit[:, None])
    known = values > KNOWN * values[-1]
    whiten = vectors[:, known] / np.sqrt(values[known]) / unit[:, None]
    scores = []
    for derivative, residual in logs:
        rows = [np.arange(residual.size)]
        if len(logs) < FEWEST_LOGS:
            rows = [part for part in np.array_split(rows[0], STRETCHES) if part.size]
        scores += [whiten.T @ (derivative[part].T @ residual[part]) for part in rows]
    count = len(scores)
    if count < 2:
        return 1.0
    spread = np.array(scores) / sigma_N
    spread -= spread.mean(axis=0)
    ratio = float((spread**2).sum()) / int(known.sum()) * count / (count - 1.0)
    return max(ratio * float(stats.t.ppf(0.975, count - 1) / NORMAL_975) ** 2, 1.0)
