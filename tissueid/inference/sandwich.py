"""Covariance where a law misses more than the noise: the clustered sandwich.

Scores of clusters at the optimum say how much the misfit moves each direction (Mueller 2013, doi
10.3982/ECTA9097).  Clusters are logs where there are four or more, otherwise stretches of each log: fractions
of its travel in ramps, equal in ln time in holds.  Few clusters leave directions unseen: their scores are
drawn towards the mean over all directions, and Student's t stands for the normal.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.arrays import FloatArray
from tissueid.inference.optimum import covariance_of
from tissueid.inference.target import SpecimenTarget

#: Logs from which they are the clusters, and stretches of a log that are one cluster otherwise.
FEWEST_LOGS, TOGETHER = 4, 2
NORMAL_975 = 1.959963984540054


def _clusters(target: SpecimenTarget) -> NDArray[np.int64]:
    """Cluster of each observation."""
    system = target.system
    if len(system.logs) >= FEWEST_LOGS:
        return system.log
    return np.asarray(system.log * 1000 + system.fold // TOGETHER)


def sandwich_covariance(target: SpecimenTarget) -> tuple[FloatArray, float]:
    """Covariance of the free coordinates, and the samples that one independent sample stands for.

    Returns ``covariance`` (d, d); ``worth``: mean ratio of the variance to that of independent samples, at
    least 1.
    """
    normal, s = target.optimum.normal, target.n_shared
    columns = np.zeros((normal.residual.size, len(target.mode)))
    columns[:, :s] = normal.shared
    if "contact" in target.places:
        columns[:, target.places["contact"]] = normal.own[:, 0]
    elif normal.own.shape[1]:
        # what a log takes up by itself moves nothing that is shared
        follow = np.einsum("lqr,lrs->lqs", normal.own_inverse, normal.cross)
        columns[:, :s] -= np.einsum("kq,kqs->ks", normal.own, follow[target.system.log])
    columns = (columns @ target.slope)[:, target.free]
    covariance = covariance_of(target.precision)
    root = np.linalg.cholesky(covariance + 1e-14 * np.diag(np.diag(covariance)))
    whitened = columns @ root
    _, labels = np.unique(_clusters(target), return_inverse=True)
    count = int(labels.max()) + 1
    scores = np.zeros((count, whitened.shape[1]))
    np.add.at(scores, labels, whitened * normal.residual[:, None])
    scores -= scores.mean(axis=0)
    data = whitened.T @ whitened
    known = max(float(np.trace(data)), 1e-12)
    spread = scores.T @ scores * count / max(count - 1.0, 1.0)
    worth = max(float(np.trace(spread)) / known, 1.0)
    weight = count / (count + whitened.shape[1])
    middle = weight * spread + (1.0 - weight) * worth * data
    # prior directions keep their prior, none is known better than independent samples make it
    total = middle + np.eye(len(data)) - data
    values, vectors = np.linalg.eigh(0.5 * (total + total.T))
    tail = float(stats.t.ppf(0.975, count - 1) / NORMAL_975) ** 2 if count > 1 else 1.0
    values = np.maximum(values, 1.0)
    values = np.where(values > 1.0, 1.0 + (values - 1.0) * tail, 1.0)
    return root @ ((vectors * values) @ vectors.T) @ root.T, worth
