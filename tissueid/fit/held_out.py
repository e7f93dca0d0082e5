"""Log predictive density of logs, or speeds, that took no part in a fit: each predicted from the others.

At the optimum the model is linearised in its coefficients, ln tau and the random effects; what a log adds to
the sums is then a small quadratic form, and leaving it out means subtracting it.  The random effects of the
held-out log are integrated.  One reduction of the sums serves every group.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Solution, SpecimenSums
from tissueid.likelihood import partial
from tissueid.likelihood.cone import support_directions
from tissueid.likelihood.objective import PartialObjective
from tissueid.likelihood.sums import N_STATIC, reduction

__all__ = ["held_out_scores"]

FloatArray = NDArray[np.float64]

#: Farthest that ln tau may follow the data that are left.
FARTHEST = 1.0
#: Curvature of a direction, relative to the strongest, that counts as none.
FLAT = 1e-13


class _Part(NamedTuple):
    """What one unit says of v = (theta, change of ln tau): its (penalised) squares are c - 2 b'v + v'hv."""

    h: FloatArray
    b: FloatArray
    c: float
    cost: float


def _columns(solution: Solution, scale: float) -> FloatArray:
    """Columns of a unit's reduced sums as weights of v, no random effects; shape (r - 1, p + branches)."""
    candidate, theta = solution.candidate, solution.evaluation.theta
    matrix, _ = partial.coefficients(0.0, 0.0, scale, candidate.degree, candidate.branches)
    m, p = matrix.shape
    weights = np.zeros((2 * m - N_STATIC, p + candidate.branches))
    weights[:m, :p] = matrix
    dynamic = (matrix @ theta)[N_STATIC:]
    size = candidate.degree + 1
    for j in range(candidate.branches):
        rows = slice(m + j * size, m + (j + 1) * size)
        weights[rows, p + j] = dynamic[j * size : (j + 1) * size]
    return weights


def _parts(sums: SpecimenSums, solution: Solution) -> list[_Part]:
    candidate, found, objective = solution.candidate, solution.evaluation, solution.objective
    reduce = reduction(sums.basis, found.log_tau, degree=candidate.degree, columns_degree=sums.columns_degree)
    columns = _columns(solution, sums.depth_mm)
    parts = []
    for k, unit in enumerate(sums.logs):
        q = np.ascontiguousarray(reduce.T @ (sums.gram[unit] @ reduce))
        if isinstance(objective, PartialObjective):
            gain, offset = objective.weight_gain, objective.weight_offset[k : k + 1]
            h, b, c, _, log_det = partial.assemble(
                q[None], found.theta, found.gamma[k : k + 1], found.delta[k : k + 1], gain, offset,
                objective.scale, candidate.degree, candidate.branches,
            )  # fmt: skip
            parts.append(_Part(h, b, float(c), float(log_det - np.log(gain) - np.log(offset[0]))))
        else:
            inner = q[:-1, :-1] @ columns
            parts.append(_Part(columns.T @ inner, columns.T @ q[:-1, -1], float(q[-1, -1]), 0.0))
    return parts


def _least(h: FloatArray, slope: FloatArray, frame: FloatArray) -> FloatArray:
    """The step within the frame that makes the slope zero."""
    inner = frame.T @ h @ frame
    unit = 1.0 / np.sqrt(np.maximum(np.diag(inner), 1e-300))
    scaled = inner * unit[:, None] * unit
    return np.asarray(
        frame @ (unit * (np.linalg.pinv(scaled, rcond=FLAT, hermitian=True) @ (unit * (frame.T @ slope))))
    )


def _without(h: FloatArray, b: FloatArray, start: FloatArray, frame: FloatArray, branches: int) -> FloatArray:
    """The optimum of the rest, in the directions that are free at that of all."""
    moved = start + _least(h, b - h @ start, frame)
    far = moved[-branches:] if branches else np.zeros(0)
    if (np.abs(far) <= FARTHEST).all():
        return moved
    held = start.copy()
    held[-branches:] = np.clip(far, -FARTHEST, FARTHEST)
    theta_only = frame[:, :-branches]
    return np.asarray(held + _least(h, b - h @ held, theta_only))


def held_out_scores(
    sums: SpecimenSums, solution: Solution, groups: Sequence[NDArray[np.int64]] | None = None
) -> FloatArray:
    """Log predictive density of every held-out group, predicted from the others.

    Parameters
    ----------
    sums : SpecimenSums
        As they are for white noise, whitened for correlated noise.
    solution : Solution
        Of all units; ``partial`` or ``shared``.
    groups : sequence of ndarray of int, optional
        Units that are held out together; by default the units in turn.

    Returns
    -------
    ndarray, shape (groups,)
        Up to a constant that all candidates share where the sums are whitened.
    """
    groups = sums.held_out_groups() if groups is None else groups
    parts = _parts(sums, solution)
    place = {int(unit): k for k, unit in enumerate(sums.logs)}
    found, sigma2 = solution.evaluation, solution.noise.sigma2
    directions, _ = support_directions(found.generators, found.weights, solution.objective.blocks)
    p, branches = found.theta.size, found.log_tau.size
    frame = np.zeros((p + branches, directions.shape[1] + branches))
    frame[:p, : directions.shape[1]] = directions
    frame[p:, directions.shape[1] :] = np.eye(branches)
    start = np.concatenate([found.theta, np.zeros(branches)])
    all_h = np.sum([one.h for one in parts], axis=0)
    all_b = np.sum([one.b for one in parts], axis=0)
    scores = np.empty(len(groups))
    for index, group in enumerate(groups):
        out = [parts[place[int(unit)]] for unit in group]
        h = np.sum([one.h for one in out], axis=0)
        b = np.sum([one.b for one in out], axis=0)
        v = _without(all_h - h, all_b - b, start, frame, branches)
        squares = sum(one.c for one in out) - 2.0 * b @ v + v @ h @ v
        cost = sum(one.cost for one in out)
        count = float(sums.count[group].sum())
        scores[index] = -0.5 * (count * np.log(2.0 * np.pi * sigma2) + squares / sigma2 + cost)
    return scores
