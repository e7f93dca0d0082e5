"""Means of a log's residual over blocks of its program, and the covariance that follows from their scores.

A hold is cut into blocks of equal ln(time since its corner), a ramp (or any other move) into fractions of its
own path, finer where it starts.  Blocks of one place in the program carry one key in every log, so that an
error of the model, which repeats, can be told from noise, which does not.  Beside every mean stands the mean
of the model's derivatives over the same samples: what the fit has taken out of the residual.

Covariance where a law misses more than the noise: the clustered sandwich.
Scores of clusters at the optimum say how much the misfit moves each direction (Mueller 2013, doi
10.3982/ECTA9097).  Clusters are logs where there are four or more, otherwise stretches of each log: fractions
of its travel in ramps, equal in ln time in holds.  Few clusters leave directions unseen: their scores are
drawn towards the mean over all directions, and Student's t stands for the normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.arrays import FloatArray
from tissueid.inference.optimum import covariance_of
from tissueid.inference.target import SpecimenTarget
from tissueid.inference.trials import Adjustment
from tissueid.inference.window import FittedLog
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.trial import Segmentation

#: Ends of the blocks of a move, as fractions of its path; the first hold what a late contact leaves behind.
MOVE_EDGES = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
#: Blocks of a hold, in each decade of the time since its corner.
HOLD_BLOCKS_PER_DECADE = 4
#: Step for the derivative of the static force by depth, relative to the fitted depth.
DEPTH_STEP = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class ResidualBlocks:
    """Block means of one log; ``k`` blocks in the order of time."""

    phase: NDArray[np.int64]  # (k,), which move or hold of the log, counted from 0 by its kind
    hold: NDArray[np.bool_]  # (k,)
    #: (k,): of a move: the index of its :data:`MOVE_EDGES`; of a hold: the whole part of
    #: ``HOLD_BLOCKS_PER_DECADE log10(time since the corner / s)``.
    place: NDArray[np.int64]
    count: NDArray[np.int64]  # (k,), samples that take part in the likelihood
    mean_N: FloatArray  # (k,), mean of measured less modelled force
    #: (k,): time of the first and of the last of these samples.
    start_s: FloatArray
    end_s: FloatArray  # (k,)
    shared: FloatArray  # (k, p), mean derivative of the model by its theta
    #: (k, q): mean derivative by what each log has for itself: ln gain, contact offset and shape; and by the
    #: branch states at its corners, which may lie between two samples.
    own: FloatArray
    #: Fastest loading and largest depth of the log.
    speed_mm_s: float
    depth_mm: float
    step_s: float  # median sampling interval


def _keys(segmentation: Segmentation, log: FittedLog) -> NDArray[np.int64]:
    """Phase by kind, kind, and place of every sample; shape (n, 3).  Phase -1: in none."""
    data = log.data
    offset = log.first - int(log.inserted)
    keys = np.zeros((data.time_s.size, 3), dtype=np.int64)
    keys[:, 0] = -1
    seen = {True: 0, False: 0}
    for phase in segmentation.phases:
        start, stop = max(phase.start - offset, 0), min(phase.stop - offset, data.time_s.size)
        if stop - start < 2:
            continue
        held = phase.kind == "hold"
        if held:
            since = np.maximum(data.time_s[start:stop] - phase.start_s, log.step_s / 2.0)
            place = np.floor(HOLD_BLOCKS_PER_DECADE * np.log10(since)).astype(np.int64)
        else:
            path = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(data.depth_mm[start:stop])))])
            place = np.searchsorted(MOVE_EDGES, path / max(path[-1], 1e-300), side="right")
        keys[start:stop] = np.column_stack(
            [np.full(stop - start, seen[held]), np.full(stop - start, held), place]
        )
        seen[held] += 1
    return keys


def _corner_columns(
    model: ChannelModel, theta: FloatArray, log: FittedLog, segmentation: Segmentation
) -> FloatArray:
    """Remainder of an error of the branch states at each corner, shape (n, holds * branches).

    A stop between two samples is not in the logged displacement: the states behind it are off by up to a
    fraction of v tau, and forget that with their relaxation times.
    """
    time = log.data.time_s
    columns = []
    tau = model.times(theta)
    for hold in segmentation.of_kind("hold"):
        since = time - hold.start_s
        inside = (since >= -0.5 * log.step_s) & (time <= hold.end_s + 0.5 * log.step_s)
        columns += [np.where(inside, np.exp(-np.maximum(since, 0.0) / float(one)), 0.0) for one in tau]
    return np.column_stack(columns) if columns else np.zeros((time.size, 0))


def _own_columns(model: ChannelModel, theta: FloatArray, log: FittedLog, fitted: FloatArray) -> FloatArray:
    """Derivatives of one log's force by its own parameters, shape (n, q)."""
    x = np.maximum(log.data.depth_mm, 0.0)
    step = DEPTH_STEP * model.depth_mm
    # the branch's share of a contact error is that of K's slope, which is small beside F_s'
    slope = (model.static_force(theta, x + step) - model.static_force(theta, x)) / step
    return np.column_stack([fitted, -slope])


def residual_blocks(
    segmentation: Segmentation,
    log: FittedLog,
    model: ChannelModel,
    theta: FloatArray,
    adjustment: Adjustment,
    fitted: FloatArray,
) -> ResidualBlocks:
    """Block means of one log under its specimen's model.

    ``model``, ``theta``: the specimen's tissue; ``adjustment``: the log's own gain, contact offset and shape;
    ``fitted`` (n,): force of all that along the log [N].
    """
    data = log.data
    path = ContactPath(data.time_s, data.depth_mm, data.speed_ratio)
    keys = _keys(segmentation, log)
    used = np.flatnonzero(data.include & (keys[:, 0] >= 0))
    keys = keys[used]
    first = np.flatnonzero(np.any(np.diff(keys, axis=0, prepend=-2) != 0, axis=1))
    last = np.append(first[1:], used.size) - 1
    count = np.diff(np.append(first, used.size))

    def means(columns: FloatArray) -> FloatArray:
        if first.size == 0:
            return np.zeros((0, *columns.shape[1:]))
        total = np.add.reduceat(columns[used], first, axis=0)
        return np.asarray(total / count.reshape(-1, *[1] * (columns.ndim - 1)))

    return ResidualBlocks(
        phase=keys[first, 0],
        hold=keys[first, 1] == 1,
        place=keys[first, 2],
        count=count,
        mean_N=means(data.force_N - fitted),
        start_s=data.time_s[used[first]],
        end_s=data.time_s[used[last]],
        shared=means(adjustment.gain * model.jacobian(theta, path)),
        own=means(
            np.concatenate(
                [
                    _own_columns(model, theta, log, fitted),
                    _corner_columns(model, theta, log, segmentation),
                ],
                axis=1,
            )
        ),
        speed_mm_s=max(log.speeds_mm_s),
        depth_mm=log.depth_mm,
        step_s=log.step_s,
    )


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
