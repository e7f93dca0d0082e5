"""Global search over relaxation times, no starting values needed.

The objective is smooth in ln tau on the scale of one (a property of exponentials, whatever the data),
so a scan at the basis nodes cannot step over a minimum.  The best minima of the scan are polished by
Gauss-Newton steps (a handful of evaluations), and by L-BFGS with the exact gradient where these do not
descend, as at a bound.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from tissueid.likelihood.cone import support_directions
from tissueid.likelihood.objective import Evaluation, Objective

__all__ = ["global_minimum", "polish", "step_in_log_tau", "unbounded_covariance"]

FloatArray = NDArray[np.float64]

#: Spacing of the scan in ln tau, for one branch and for pairs and triples.
SCAN_SINGLE = 0.25
SCAN_SEVERAL = 0.6
#: Minima of a scan that are polished.
POLISHED = 3
#: Two branches of one specimen closer than this in ln tau describe one relaxation.
MIN_SEPARATION = 0.3
#: Gauss-Newton steps before and after L-BFGS, the longest of them in ln tau, and its halvings.
FIRST_STEPS = 12
LONGEST_STEP = 0.7
HALVINGS = 3
FINISHING_STEPS = 8
FINISHED = 1e-11
#: Relative rounding error of an objective from Gram matrices.
VALUE_ROUNDING = 1e-10


def _grid(bounds: tuple[float, float], spacing: float) -> FloatArray:
    n = max(int(np.ceil((bounds[1] - bounds[0]) / spacing)), 4)
    return np.linspace(bounds[0], bounds[1], n + 1)


def _local_minima(values: FloatArray, count: int) -> list[int]:
    padded = np.concatenate([[np.inf], values, [np.inf]])
    minima = np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]))
    return [int(i) for i in minima[np.argsort(values[minima], kind="stable")][:count]]


def _scan_single(objective: Objective, bounds: tuple[float, float]) -> list[FloatArray]:
    grid = _grid(bounds, SCAN_SINGLE)
    values = objective.values([grid[i : i + 1] for i in range(grid.size)])
    return [grid[i : i + 1] for i in _local_minima(values, POLISHED)]


def _scan_several(
    objective: Objective, bounds: tuple[float, float], seeds: list[FloatArray]
) -> list[FloatArray]:
    grid = _grid(bounds, SCAN_SEVERAL)
    if objective.branches == 2:
        points = [np.array(pair) for pair in combinations(grid, 2)]
    else:
        points = [
            np.sort(np.append(seed, extra))
            for seed in seeds
            for extra in grid
            if np.abs(seed - extra).min() > MIN_SEPARATION
        ]
    if not points:
        # a range too narrow for two nodes: one start, spread over it
        return [np.linspace(*bounds, objective.branches)]
    values = objective.values(points)
    chosen: list[FloatArray] = []
    for i in np.argsort(values, kind="stable"):
        if all(np.abs(points[i] - other).max() > 2 * SCAN_SEVERAL for other in chosen):
            chosen.append(points[i])
        if len(chosen) == POLISHED:
            break
    return chosen


def unbounded_covariance(evaluation: Evaluation, blocks: NDArray[np.int64]) -> tuple[FloatArray, bool]:
    """Inverse Gauss-Newton curvature of (theta, ln tau) within the passive set.

    Returns
    -------
    inverse : ndarray, shape (p + branches, p + branches)
        Multiply by the noise variance for a covariance; zero across an active bound.
    bounded : bool
        True where a passivity bound is active.
    """
    directions, bounded = support_directions(evaluation.generators, evaluation.weights, blocks)
    p = evaluation.theta.size
    branches = evaluation.log_tau.size
    frame = np.zeros((p + branches, directions.shape[1] + branches))
    frame[:p, : directions.shape[1]] = directions
    frame[p:, directions.shape[1] :] = np.eye(branches)
    inner = frame.T @ evaluation.curvature @ frame
    if not np.isfinite(inner).all():
        msg = "the curvature of the objective is not finite: the samples span too many decades"
        raise FloatingPointError(msg)
    diagonal = np.diag(inner)
    used = diagonal > 0.0
    unit = np.where(used, 1.0 / np.sqrt(np.where(used, diagonal, 1.0)), 0.0)
    scaled = inner * unit[:, None] * unit
    inverse = np.linalg.pinv(scaled, rcond=1e-13, hermitian=True) * unit[:, None] * unit
    inverse[~used, ~used] = np.inf
    keep = np.where(np.isfinite(inverse), inverse, 0.0)
    result = frame @ keep @ frame.T
    for i in np.flatnonzero(~used[directions.shape[1] :]):
        result[p + i, p + i] = np.inf
    return result, bounded


def step_in_log_tau(evaluation: Evaluation, blocks: NDArray[np.int64]) -> FloatArray:
    """Gauss-Newton step in ln tau, theta and random effects following; shape (branches,)."""
    inverse, _ = unbounded_covariance(evaluation, blocks)
    p = evaluation.theta.size
    block = inverse[p:, p:]
    if not np.isfinite(block).all():
        return np.zeros(evaluation.log_tau.size)
    return np.asarray(-0.5 * block @ evaluation.gradient)


def _descend(objective: Objective, best: Evaluation, bounds: tuple[float, float]) -> tuple[Evaluation, bool]:
    """Gauss-Newton steps with halving; True where all that is left to gain is the value's rounding."""
    for _ in range(FIRST_STEPS):
        step = np.clip(step_in_log_tau(best, objective.blocks), -LONGEST_STEP, LONGEST_STEP)
        inside = (best.log_tau > bounds[0]) & (best.log_tau < bounds[1])
        if inside.all() and 0.0 < -0.5 * float(best.gradient @ step) <= VALUE_ROUNDING * abs(best.value):
            return best, True
        for _halving in range(HALVINGS + 1):
            trial = objective.evaluate(np.clip(best.log_tau + step, *bounds), best)
            if trial.value < best.value:
                break
            step = 0.5 * step
        else:
            return best, False
        best = trial
    return best, False


def _quasi_newton(objective: Objective, best: Evaluation, bounds: tuple[float, float]) -> Evaluation:
    """L-BFGS with the exact gradient of ln(sum of squares)."""
    unit = max(best.value, 1e-300)
    state = {"last": best}

    def value_and_slope(log_tau: FloatArray) -> tuple[float, FloatArray]:
        evaluation = objective.evaluate(log_tau, state["last"])
        state["last"] = evaluation
        return np.log(max(evaluation.value, 1e-300) / unit), evaluation.gradient / max(
            evaluation.value, 1e-300
        )

    found = minimize(
        value_and_slope,
        best.log_tau,
        jac=True,
        method="L-BFGS-B",
        bounds=[bounds] * best.log_tau.size,
        options={"ftol": 1e-13, "gtol": 1e-10, "maxiter": 60},
    )
    last = objective.evaluate(np.clip(found.x, *bounds), state["last"])
    return last if last.value <= best.value else best


def polish(
    objective: Objective, start: FloatArray, bounds: tuple[float, float], *, warm: Evaluation | None = None
) -> Evaluation:
    """The local minimum that a start leads to.

    Parameters
    ----------
    objective : Objective
    start : ndarray, shape (branches,)
        ln tau.
    bounds : tuple of float
        Range of ln tau.
    """
    if start.size == 0:
        return objective.evaluate(start, warm)
    best, arrived = _descend(objective, objective.evaluate(start, warm), bounds)
    if not arrived:
        best = _quasi_newton(objective, best, bounds)
    # the value's own rounding hides the last digits of ln tau; the gradient does not
    for _ in range(FINISHING_STEPS):
        step = np.clip(step_in_log_tau(best, objective.blocks), -0.5, 0.5)
        if np.abs(step).max(initial=0.0) < FINISHED:
            break
        trial = objective.evaluate(np.clip(best.log_tau + step, *bounds), best)
        flatter = np.abs(trial.gradient).max() < np.abs(best.gradient).max()
        if trial.value > best.value * (1.0 + VALUE_ROUNDING) or not flatter:
            break
        best = trial
    return best


def global_minimum(
    objective: Objective,
    bounds: tuple[float, float],
    *,
    scan: Objective | None = None,
    seeds: list[FloatArray] | None = None,
) -> Evaluation:
    """The best passive fit over all relaxation times in the bounds.

    Parameters
    ----------
    objective : Objective
        What is minimised.
    bounds : tuple of float
        Range of ln tau.
    scan : Objective, optional
        A cheaper objective to scan with where there are two or three branches.
    seeds : list of ndarray, optional
        For three branches: good pairs. For any: further starts of the right length.

    Returns
    -------
    Evaluation
    """
    seeds = seeds or []
    if objective.branches == 0:
        return objective.evaluate(np.zeros(0))
    if objective.branches == 1:
        starts = _scan_single(objective, bounds)
    else:
        pairs = [seed for seed in seeds if seed.size == objective.branches - 1]
        starts = _scan_several(scan or objective, bounds, pairs)
    starts += [seed for seed in seeds if seed.size == objective.branches]
    results = [polish(objective, start, bounds) for start in starts]
    best = min(results, key=lambda one: one.value)
    order = np.argsort(best.log_tau, kind="stable")
    if (order == np.arange(order.size)).all():
        return best
    return objective.evaluate(best.log_tau[order])
