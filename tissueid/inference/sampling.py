"""Draws by emcee's ensemble: independent proposals at the optimum, differential evolution, and stretches.

Walkers move in coordinates whitened at the optimum.  A chain is written beside the result while it grows, and
a run that was killed goes on from there to the same draws.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import emcee
import numpy as np
from numpy.typing import NDArray

from tissueid.inference.checkpoint import Checkpoint
from tissueid.inference.proposal import CutNormal, cut_normal
from tissueid.inference.target import Target

__all__ = ["Sampled", "sample"]

FloatArray = NDArray[np.float64]

#: Walkers over coordinates, and the fewest.
WALKERS_EACH, FEWEST_WALKERS = 2, 32
#: Steps between looks, and the most.
LOOK, MOST_STEPS = 25, 4_000
#: Autocorrelation times that a chain must be long, and that are thrown away at its start.
LONG_ENOUGH, BURN_IN = 20.0, 4.0
#: Shares of the moves.
MOVES = (0.7, 0.18, 0.12)
#: Seconds between checkpoints.
EVERY_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """A chain.

    Attributes
    ----------
    chain : ndarray, shape (walkers, steps, d)
        Whitened coordinates of the target.
    log_density : ndarray, shape (walkers, steps)
    converged : bool
    acceptance : float
    detail : dict
    """

    chain: FloatArray
    log_density: FloatArray
    converged: bool
    acceptance: float
    detail: dict[str, Any] = field(default_factory=dict)


def _independence(cut: CutNormal, rng: np.random.Generator) -> emcee.moves.MHMove:
    """Proposals from the pool, whatever the walker's place."""

    def propose(coordinates: FloatArray, _: Any) -> tuple[FloatArray, FloatArray]:
        new = cut.pool[rng.integers(len(cut.pool), size=len(coordinates))]
        return new, cut.log_density(coordinates) - cut.log_density(new)

    return emcee.moves.MHMove(propose)


def sample(
    target: Target,
    *,
    draws: int,
    seed: int,
    checkpoint: Path | None = None,
    key: str = "",
    progress: Callable[[int, float], None] | None = None,
) -> Sampled:
    """Sample a specimen's posterior.

    Parameters
    ----------
    target : Target
    draws : int
        Effective draws that are asked for.
    seed : int
    checkpoint : Path, optional
        File that a killed run goes on from.
    key : str
        Of everything the chain depends on.
    progress : callable, optional
        Told steps so far and the share of what was asked.
    """
    began = time.perf_counter()
    d = target.size
    rng = np.random.default_rng([seed, 7])
    cut = cut_normal(target.centre, target.rows, target.walls, target.likely, rng)
    walkers = max(FEWEST_WALKERS, 2 * ((WALKERS_EACH * d + 2) // 2))
    moves = [
        (_independence(cut, rng), MOVES[0]),
        (emcee.moves.DEMove(), MOVES[1]),
        (emcee.moves.StretchMove(), MOVES[2]),
    ]

    sampler = emcee.EnsembleSampler(walkers, d, target.densities, moves=moves, vectorize=True)
    first = cut.pool[: 4 * walkers]
    inside = np.isfinite(target.densities(first))
    if inside.sum() < walkers // 2:
        msg = "too few points near the optimum are passive tissue"
        raise ArithmeticError(msg)
    start = first[rng.choice(np.flatnonzero(inside), walkers, replace=inside.sum() < walkers)]
    start = start + 1e-9 * rng.standard_normal(start.shape)
    start[~np.isfinite(target.densities(start))] = first[np.flatnonzero(inside)[0]]
    kept = Checkpoint(checkpoint, key)
    state, chain, levels = kept.resume(sampler, start, rng, seed)
    return _walk(sampler, state, chain, levels, draws, kept, rng, progress, began)


def _walk(
    sampler: Any,
    state: Any,
    chain: list[FloatArray],
    levels: list[FloatArray],
    draws: int,
    kept: Checkpoint,
    rng: np.random.Generator,
    progress: Callable[[int, float], None] | None,
    began: float,
) -> Sampled:
    """Steps until enough effective draws are there."""
    last = time.perf_counter()
    walkers = sampler.nwalkers
    time_int, effective, accepted = np.inf, 0.0, []
    while True:
        steps = sum(len(one) for one in chain)
        if steps:
            whole = np.concatenate(chain)
            time_int = autocorrelation_time(whole)
            burn = int(min(BURN_IN * time_int + 5, steps // 3))
            effective = (steps - burn) * walkers / time_int
            if progress is not None:
                progress(steps, min(effective / draws, 1.0))
            if (effective >= draws and steps - burn >= LONG_ENOUGH * time_int) or steps >= MOST_STEPS:
                break
        sampler.reset()
        state = sampler.run_mcmc(state, LOOK, store=True, skip_initial_state_check=True)
        chain.append(sampler.get_chain().copy())
        levels.append(sampler.get_log_prob().copy())
        accepted.append(float(np.mean(sampler.acceptance_fraction)))
        if time.perf_counter() - last > EVERY_S:
            kept.write(state, chain, levels, rng)
            last = time.perf_counter()
    whole, level = np.concatenate(chain), np.concatenate(levels)
    burn = int(min(BURN_IN * time_int + 5, len(whole) // 3))
    converged = bool(effective >= draws)
    detail: dict[str, Any] = {
        "steps": len(whole),
        "burn_in": burn,
        "walkers": walkers,
        "autocorrelation_time": float(time_int),
        "effective_draws": float(effective),
        "wall_s": time.perf_counter() - began,
    }
    if not converged:
        detail["reason"] = f"{effective:.0f} of {draws} effective draws after {len(whole)} steps"
    acceptance = float(np.mean(accepted)) if accepted else 0.0
    return Sampled(np.swapaxes(whole[burn:], 0, 1), level[burn:].T, converged, acceptance, detail)


def autocorrelation_time(chain: FloatArray) -> float:
    """Longest integrated autocorrelation time of the coordinates of walkers, shape (steps, walkers, d)."""
    steps = chain.shape[0]
    centred = chain - chain.mean(axis=(0, 1))
    size = 2 * int(2 ** np.ceil(np.log2(max(steps, 2))))
    spectrum = np.fft.rfft(centred, n=size, axis=0)
    cov = np.fft.irfft(np.abs(spectrum) ** 2, n=size, axis=0)[:steps].mean(axis=1)
    rho = cov / np.maximum(cov[0], 1e-300)
    times = 2.0 * np.cumsum(rho, axis=0) - 1.0
    window = np.arange(steps)[:, None] >= 5.0 * times
    at = np.where(window.any(axis=0), window.argmax(axis=0), steps - 1)
    return float(np.maximum(times[at, np.arange(times.shape[1])], 1.0).max())
