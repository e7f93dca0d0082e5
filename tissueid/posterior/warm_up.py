"""How an ensemble begins: starts, a warm-up that learns the independence proposal, and the weights of moves.

A walk is a pure function of what the warm-up leaves (:class:`tissueid.posterior.checkpoint.SavedWalk`), so
that one that was interrupted goes on as if it had not been.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.posterior.checkpoint import SavedWalk
from tissueid.posterior.target import Target

__all__ = ["BatchDensity", "sampler_of", "stream", "warm_up"]

FloatArray = NDArray[np.float64]

#: Points that are evaluated together; fixed, because sums may depend on how a batch is split.
_CHUNK = 16

#: Degrees of freedom of the independence proposal: heavier tails than a posterior of many data has.
_DOF = 4.0

#: Weights of differential evolution, snooker and independence: while the proposal is learnt, and after.
#: Autocorrelation time [steps] without the independence move, with half of it and with 0.9: normals of one to
#: six coordinates (correlation 0.95) 4 to 28, 2.1 to 4.9, 1.3 to 2.4; of four coordinates: cut at a bound 25,
#: 6.5, 3.9; with the ln of a half-normal 25, 5.9, 3.5; a banana 22, 7.5, 4.7.
_WARM_UP_WEIGHTS = (0.3, 0.2, 0.5)
_WEIGHTS = (0.05, 0.05, 0.9)

#: Weights where the learnt proposal is a poor stand-in for the posterior (two branches that can't be told
#: apart, a relaxation time known on one side only): walkers stay where it is too thin, and must be moved on
#: by the others.  Poor is a standard deviation of ln (posterior / proposal) over the walkers above 1; it is
#: at most 0.5 for normals of one to six coordinates.
_WEIGHTS_OF_POOR = (0.5, 0.2, 0.3)
_POOR = 1.0

#: Steps of each warm-up round; each learns from the last two thirds of its own.
_WARM_UP_ROUNDS = (40, 80)

#: Starts are so much wider than the Laplace approximation, as R-hat wants them.
_OVER_DISPERSION = 1.5

#: A start without density is drawn again, each time closer to the mode.
_CLOSER = 0.9
_MOST_REDRAWS = 200

#: Least eigenvalue of a correlation matrix that is sampled from: rounding, or a direction without scatter.
_LEAST_EIGENVALUE = 1e-10


class BatchDensity:
    """The density of many points, a chunk at a time, in threads where there are some."""

    def __init__(self, target: Target, pool: ThreadPoolExecutor | None) -> None:
        self._one = target.log_density
        self._map = map if pool is None else pool.map

    def __call__(self, points: FloatArray) -> FloatArray:
        """Log densities of points of shape (n, d)."""
        chunks = [points[start : start + _CHUNK] for start in range(0, len(points), _CHUNK)]
        values = np.concatenate(list(self._map(self._one, chunks)))
        # a point whose density can't be worked out (overflow, no Cholesky factor) has none
        values[~np.isfinite(values)] = -np.inf
        return values


def sampler_of(density: BatchDensity, begun: SavedWalk) -> Any:
    """The sampler of a walk; its moves are weighted by how well the learnt proposal covers the walkers."""
    return _sampler(density, begun.points.shape[1], begun.centre, begun.root, _weights(begun))


def _weights(begun: SavedWalk) -> tuple[float, ...]:
    """Weights of the moves, by how well the proposal covers the walkers after the warm-up."""
    from tissueid.posterior.moves import StudentProposal

    proposal = StudentProposal(begun.centre, begun.root, _DOF)
    ratio = begun.log_density[0] - proposal.log_density(begun.points[0])
    return _WEIGHTS_OF_POOR if float(ratio.std()) > _POOR else _WEIGHTS


def _sampler(
    density: BatchDensity, walkers: int, centre: FloatArray, root: FloatArray, weights: tuple[float, ...]
) -> Any:
    from tissueid.posterior.moves import (
        DifferentialEvolution,
        Independence,
        Sampler,
        Snooker,
        StudentProposal,
    )

    moves = (DifferentialEvolution(), Snooker(), Independence(StudentProposal(centre, root, _DOF)))
    weighted = list(zip(moves, weights, strict=True))
    return Sampler(walkers, len(centre), density, vectorize=True, moves=weighted)


def stream(sampler: Any, points: FloatArray, log_density: FloatArray, steps: int) -> Any:
    """States of the walkers, one a step."""
    import emcee

    state = emcee.State(points, log_prob=log_density, copy=True)
    return sampler.sample(state, iterations=steps, store=False, skip_initial_state_check=True)


def warm_up(density: BatchDensity, target: Target, walkers: int, seed: int) -> SavedWalk:
    """Walk from the starts towards the posterior and learn the proposal; its last step is the first one."""
    random = np.random.RandomState(seed)
    centre, root = np.asarray(target.mode, dtype=np.float64), _root_of(target.covariance)
    points, log_density = _starts(density, centre, root, walkers, random)
    random_state: Any = random.get_state()
    for steps in _WARM_UP_ROUNDS:
        sampler = _sampler(density, walkers, centre, root, _WARM_UP_WEIGHTS)
        sampler.random_state = random_state
        path = np.empty((steps, *points.shape))
        for step, state in enumerate(stream(sampler, points, log_density, steps)):
            path[step] = state.coords
        points, log_density, random_state = state.coords, state.log_prob, sampler.random_numbers()
        learnt = path[steps // 3 :].reshape(-1, path.shape[2])
        centre, root = learnt.mean(axis=0), _root_of(np.atleast_2d(np.cov(learnt.T)))
    return SavedWalk(points[None], log_density[None], centre, root, random_state)


def _starts(
    density: BatchDensity,
    mode: FloatArray,
    root: FloatArray,
    walkers: int,
    random: np.random.RandomState,
) -> tuple[FloatArray, FloatArray]:
    points = np.empty((walkers, len(mode)))
    log_density = np.full(walkers, -np.inf)
    reach = _OVER_DISPERSION
    for _ in range(_MOST_REDRAWS):
        left = np.flatnonzero(np.isneginf(log_density))
        if not left.size:
            return points, log_density
        points[left] = mode + reach * random.standard_normal((left.size, len(mode))) @ root.T
        log_density[left] = density(points[left])
        reach *= _CLOSER
    msg = f"no finite density near the mode {mode.tolist()}: {left.size} of {walkers} walkers have no start"
    raise ValueError(msg)


def _root_of(covariance: FloatArray) -> FloatArray:
    """Triangular root of a covariance, made definite where rounding left it without one."""
    covariance = np.asarray(covariance, dtype=np.float64)
    if not np.isfinite(covariance).all():
        # no curvature could be worked out at the mode; the warm-up learns it from any start
        covariance = np.eye(len(covariance))
    scale = np.sqrt(np.abs(np.diag(covariance)))
    scale[~(scale > 0.0)] = 1.0
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    correlation = (vectors * np.maximum(values, _LEAST_EIGENVALUE)) @ vectors.T
    return np.asarray(scale[:, None] * np.linalg.cholesky(correlation))
