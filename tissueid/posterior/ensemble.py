"""The default sampler of ``fit``: emcee's ensemble of walkers, run until its draws are enough.

A short warm-up, started from the mode and its Laplace covariance, learns mean and covariance of the
posterior.  They are then frozen in an independence proposal that makes most of the moves; differential
evolution and the snooker update make the others, and mix what a bell shape does not cover.  The chain stops
by the rule of :mod:`tissueid.posterior.stopping`.

All random numbers come from one ``RandomState``, batches of points are split in one way whatever the number
of workers, and a look at a chain depends on the chain alone: the same seed gives the same draws, bit for bit,
from one run, from a killed and resumed one, and with any number of workers.

emcee imports slowly; it is imported where it is needed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.posterior.checkpoint import Checkpoint, SavedWalk
from tissueid.posterior.diagnostics import Diagnostics, diagnose
from tissueid.posterior.stopping import Memory, memory_of, next_look, shortfalls
from tissueid.posterior.target import Target
from tissueid.posterior.warm_up import BatchDensity, sampler_of, stream, warm_up
from tissueid.uncertainty import SamplerReport

__all__ = ["EnsembleChain", "sample_ensemble"]

FloatArray = NDArray[np.float64]

#: Walkers: eight a coordinate, so that pairs of them span all directions, and no fewer than 32.
_LEAST_WALKERS = 32
_WALKERS_PER_COORDINATE = 8

#: Of the random numbers and the moves: a checkpoint of another scheme is of no use.
_SCHEME = 2

#: A chain has at least so many steps, whatever the limit.
_LEAST_STEPS = 64

#: Longest autocorrelation time [steps] that the default limit has room for, and the least limit.
_LONGEST_TAU = 20
_LEAST_LIMIT = 1_500

#: A walk that would need longer autocorrelation times than this ends with fewer effective draws: the end of a
#: 95 % interval is then known to 0.12 standard deviations instead of 0.05.
_PATIENT_TAU = 10
_ENOUGH = 400


@dataclass(frozen=True, slots=True, eq=False)
class EnsembleChain:
    """What the sampler leaves.

    Attributes
    ----------
    names : tuple of str
        Sampled coordinates.
    points : ndarray, shape (walkers, draws, d)
        After burn-in, thinned.
    log_density : ndarray, shape (walkers, draws)
    converged : bool
    reason : str
        What is lacking, where it has not converged.
    diagnostics : mapping
        Coordinate -> :class:`~tissueid.posterior.diagnostics.Diagnostics` of ``points``.
    tau : ndarray, shape (d,)
        Integrated autocorrelation time [steps].
    steps, burn_in, thin : int
        Steps made after the warm-up, dropped, and between two kept draws.
    acceptance : float
        Share of the proposals after the burn-in that were accepted.
    seed : int
    remarks : tuple of str
        On the checkpoint.
    """

    names: tuple[str, ...]
    points: FloatArray
    log_density: FloatArray
    converged: bool
    reason: str
    diagnostics: Mapping[str, Diagnostics]
    tau: FloatArray
    steps: int
    burn_in: int
    thin: int
    acceptance: float
    seed: int = 0
    remarks: tuple[str, ...] = ()

    def report(self) -> SamplerReport:
        """The words of identification.json."""
        detail: dict[str, Any] = {
            "walkers": self.points.shape[0],
            "steps": self.steps,
            "burn_in": self.burn_in,
            "thin": self.thin,
            "autocorrelation_steps": dict(zip(self.names, self.tau.tolist(), strict=True)),
            "ess": min(min(one.ess_bulk, one.ess_tail) for one in self.diagnostics.values()),
            "r_hat": max(one.r_hat for one in self.diagnostics.values()),
            "seed": self.seed,
        }
        if self.reason:
            detail["reason"] = self.reason
        return SamplerReport(
            name="emcee",
            converged=self.converged,
            draws=self.points.shape[0] * self.points.shape[1],
            acceptance=self.acceptance,
            detail=detail,
        )


def sample_ensemble(
    target: Target,
    *,
    draws: int = 10_000,
    seed: int,
    workers: int = 1,
    checkpoint: Path | None = None,
    key: str = "",
    max_steps: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> EnsembleChain:
    """Sample a posterior until its draws are enough.

    Parameters
    ----------
    target : Target
        Its density is asked for at up to 16 points at a time, from ``workers`` threads at once.
    draws : int
        Effective draws of each coordinate, in bulk and tails.  A walk of an autocorrelation time beyond 10
        steps ends once it is as long as 10 of them would have been, and has 400.
    seed : int
        At least 0.
    workers : int
        Threads; changes nothing but the time.
    checkpoint : Path, optional
        File that keeps the chain; a chain of the same key, seed and optimum goes on from it.
        :func:`tissueid.posterior.checkpoint.discard` removes it.
    key : str
        Stands for all that the target depends on: hashes of data, options, version of the code.
    max_steps : int, optional
        After the warm-up.  By default enough for an autocorrelation time of 20 steps.
    progress : callable, optional
        Told at each look how many effective draws there are, and of how many.

    Returns
    -------
    EnsembleChain
        Also where it has not converged within ``max_steps``: ``converged`` and ``reason`` say so.

    Raises
    ------
    ValueError
        The target has no finite density near its mode.
    """
    walkers = max(_LEAST_WALKERS, _WALKERS_PER_COORDINATE * len(target.names))
    limit = max_steps
    if limit is None:
        limit = max(math.ceil(_LONGEST_TAU * draws / walkers), _LEAST_LIMIT)
    saved = Checkpoint(checkpoint, _identity(target, key=key, seed=seed, walkers=walkers))
    with ThreadPoolExecutor(workers) if workers > 1 else nullcontext() as pool:
        density = BatchDensity(target, pool)
        walk = _Walk(density, saved.load() or warm_up(density, target, walkers, seed), saved)
        found = _walk_until_enough(walk, target.names, draws, max(limit, _LEAST_STEPS), progress)
        walk.finish()
    return replace(found, seed=seed, remarks=() if saved.remark is None else (saved.remark,))


def _walk_until_enough(
    walk: _Walk,
    names: tuple[str, ...],
    draws: int,
    limit: int,
    progress: Callable[[int, int], None] | None,
) -> EnsembleChain:
    steps = 0
    patience = _PATIENT_TAU * draws / walk.walkers
    while True:
        steps = next_look(steps, math.ceil(draws / walk.walkers), limit)
        if steps > patience:
            draws = min(draws, _ENOUGH)
        points, log_density = walk.until(steps)
        memory = memory_of(points)
        kept = steps - memory.burn_in
        if progress is not None:
            progress(min(draws, int(kept * walk.walkers / memory.tau.max())), draws)
        if steps < limit and shortfalls(memory, kept, walk.walkers, draws, None, names):
            continue
        chain = _kept(points, memory)
        diagnostics = diagnose(dict(zip(names, chain.transpose(2, 0, 1), strict=True)))
        lacking = shortfalls(memory, kept, walk.walkers, draws, diagnostics, names)
        if not lacking or steps >= limit:
            break
    moved = np.any(np.diff(points[memory.burn_in :], axis=0) != 0.0, axis=2)
    return EnsembleChain(
        names=names,
        points=chain,
        log_density=_kept(log_density, memory),
        converged=not lacking,
        reason=f"after {steps} steps of {walk.walkers} walkers: {'; '.join(lacking)}" if lacking else "",
        diagnostics=diagnostics,
        tau=memory.tau,
        steps=steps,
        burn_in=memory.burn_in,
        thin=memory.thin,
        acceptance=float(moved.mean()),
    )


def _kept(path: FloatArray, memory: Memory) -> FloatArray:
    """What is kept of an array of shape (steps, walkers, ...): shape (walkers, draws, ...)."""
    return np.ascontiguousarray(np.swapaxes(path[memory.burn_in :: memory.thin], 0, 1))


def _identity(target: Target, *, key: str, seed: int, walkers: int) -> str:
    """What makes a walk this one; a target that differs in the last bit of its optimum is another."""
    import emcee

    mode, covariance = (np.asarray(of, dtype=np.float64) for of in (target.mode, target.covariance))
    optimum = (mode.tobytes() + covariance.tobytes() + target.log_density(mode[None]).tobytes()).hex()
    versions = f"emcee {emcee.__version__}, numpy {np.__version__}, scheme {_SCHEME}"
    return f"{key}|{seed}|{walkers}|{','.join(target.names)}|{optimum}|{versions}"


class _Walk:
    """The walkers on their way, and the file that keeps it."""

    def __init__(self, density: BatchDensity, begun: SavedWalk, checkpoint: Checkpoint) -> None:
        self._points, self._log_density = begun.points, begun.log_density
        self._centre, self._root = begun.centre, begun.root
        self._steps = len(begun.points)
        self._sampler = sampler_of(density, begun)
        self._sampler.random_state = begun.random_state
        self._checkpoint = checkpoint

    @property
    def walkers(self) -> int:
        """How many there are."""
        return int(self._points.shape[1])

    def until(self, steps: int) -> tuple[FloatArray, FloatArray]:
        """Walk to a number of steps, unless there already.

        Returns
        -------
        ndarray, shape (steps, walkers, d)
        ndarray, shape (steps, walkers)
            Log densities.
        """
        if steps > self._steps:
            self._points, self._log_density = _grown(self._points, steps), _grown(self._log_density, steps)
            last = self._steps - 1
            for state in stream(self._sampler, self._points[last], self._log_density[last], steps - 1 - last):
                self._points[self._steps] = state.coords
                self._log_density[self._steps] = state.log_prob
                self._steps += 1
                if self._checkpoint.due:
                    self._checkpoint.save(self._walked())
        return self._points[:steps], self._log_density[:steps]

    def finish(self) -> None:
        """Write the end of a walk that was long enough to be written before."""
        if self._checkpoint.written:
            self._checkpoint.save(self._walked())

    def _walked(self) -> SavedWalk:
        points, log_density = self._points[: self._steps], self._log_density[: self._steps]
        return SavedWalk(points, log_density, self._centre, self._root, self._sampler.random_numbers())


def _grown(array: FloatArray, length: int) -> FloatArray:
    longer = np.empty((length, *array.shape[1:]))
    longer[: len(array)] = array
    return longer
