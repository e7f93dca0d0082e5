"""Draws by emcee's ensemble: independent proposals at the optimum, differential evolution, and stretches.

Weights are smoothed by their Pareto tail (Vehtari et al. 2024, JMLR 25: 72; Zhang & Stephens 2009, doi
10.1198/tech.2009.08017); a run that was killed goes on to the same draws.
"""

from __future__ import annotations

import contextlib
import io
import json
import sys
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import emcee
import numpy as np
from scipy.special import ndtri
from scipy.stats.qmc import Sobol

from tissueid.arrays import FloatArray
from tissueid.inference.diagnostics import diagnose
from tissueid.inference.proposal import cut_normal, learn_mixture, tempered
from tissueid.inference.target import Target
from tissueid.store.files import write_file

#: Seconds between two writes.
EVERY_S = 1.0


class Checkpoint:
    """Points and weights so far in one file, written apart and renamed; another ``key`` is not used."""

    def __init__(self, path: Path | None, key: str) -> None:
        self.path, self.key = path, key
        self._last = time.monotonic()

    def resume(self, rng: np.random.Generator, size: int) -> tuple[FloatArray, FloatArray]:
        """Points and their log weights so far; the generator stands where it stood."""
        nothing = np.empty((0, size)), np.empty(0)
        if self.path is None or not self.path.is_file():
            return nothing
        try:
            with np.load(io.BytesIO(self.path.read_bytes()), allow_pickle=False) as found:
                if str(found["key"]) != self.key or found["points"].shape[1] != size:
                    return nothing
                state = json.loads(str(found["generator"]))
                points, log_weight = found["points"], found["log_weight"]
        except (OSError, ValueError, KeyError, TypeError, IndexError, EOFError, zipfile.BadZipFile):
            return nothing
        rng.bit_generator.state = state
        return points, log_weight

    def write(self, rng: np.random.Generator, points: FloatArray, log_weight: FloatArray) -> None:
        """Keep what there is, once in a while; a disk that is full or read-only stops nothing."""
        if self.path is None or time.monotonic() - self._last < EVERY_S:
            return
        buffer = io.BytesIO()
        np.savez(
            buffer,
            key=np.array(self.key),
            generator=np.array(json.dumps(rng.bit_generator.state)),
            points=points,
            log_weight=log_weight,
        )
        # without the file a run that is killed begins anew
        with contextlib.suppress(OSError):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            write_file(self.path, buffer.getvalue())
        self._last = time.monotonic()


#: Points of positive weight that are too few to weigh, and to fit a tail to.
FEWEST, FEWEST_TAIL = 50, 8
#: Prior of the Pareto shape: a mean, worth so many points.
SHAPE_PRIOR, PRIOR_WORTH = 0.5, 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Weighed:
    """Smoothed importance weights, the independent draws they are worth, and the shape of their tail."""

    weights: FloatArray
    worth: float
    pareto: float

    @property
    def telling(self) -> bool:
        """True where the points are draws of the target but for their weights: more would tell no more."""
        return self.pareto <= GOOD_TAILS and self.worth >= HALF * self.weights.size


def _pareto(tail: FloatArray) -> tuple[float, float]:
    """Shape and scale of a generalised Pareto distribution of ascending exceedances."""
    n = tail.size
    grid = 30 + int(np.sqrt(n))
    quartile = max(float(tail[int(n / 4 + 0.5) - 1]), 1e-300)
    b = 1.0 - np.sqrt(grid / (np.arange(1.0, grid + 1) - 0.5))
    b = b / (3.0 * quartile) + 1.0 / tail[-1]
    k = np.log1p(-b[:, None] * tail).mean(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        profile = n * (np.log(-b / k) - k - 1.0)
    profile = np.where(np.isfinite(profile), profile, -np.inf)
    weight = np.exp(profile - profile.max())
    best = float((b * weight).sum() / weight.sum())
    shape = float(np.log1p(-best * tail).mean())
    scale = -shape / best
    shape = (n * shape + PRIOR_WORTH * SHAPE_PRIOR) / (n + PRIOR_WORTH)
    return shape, float(scale)


def smoothed(log_weight: FloatArray) -> Weighed:
    """Smooth the largest weights (n,), given by their logarithms, by the Pareto distribution they follow."""
    inside = np.flatnonzero(np.isfinite(log_weight))
    weights = np.zeros(log_weight.size)
    if inside.size < FEWEST:
        return Weighed(weights, 0.0, np.inf)
    part = np.exp(log_weight[inside] - log_weight[inside].max())
    size = int(min(0.2 * part.size, 3.0 * np.sqrt(part.size)))
    shape = -np.inf
    order = np.argsort(part)
    cut = part[order[-size - 1]]
    tail = part[order[-size:]] - cut
    if size >= FEWEST_TAIL and tail[-1] > 1e-12 and tail[0] >= 0.0 and np.ptp(tail) > 0.0:
        tail = np.maximum(tail, 1e-300)
        shape, scale = _pareto(tail)
        far = -np.log1p(-(np.arange(size) + 0.5) / size)
        quantiles = scale * (np.expm1(np.minimum(shape * far, 600.0)) / shape if abs(shape) > 1e-9 else far)
        part[order[-size:]] = np.minimum(cut + quantiles, part.max())
    weights[inside] = part / part.sum()
    return Weighed(weights, float(1.0 / (weights**2).sum()), float(shape))


#: Walkers, and steps of each from where importance sampling put it.
WALKERS, STEPS = 128, 30
#: Rounds at the most where importance weights are trusted, and where they are worth too few draws; else steps
#: of a round, rounds, and the effective draws of the walkers themselves that end them.
FEW_ROUNDS, MORE_ROUNDS, ROUND, ROUNDS, WALKED = 5, 25, 60, 20, 400.0
#: Points of importance sampling in one look, and looks at the most.
LOOK, MOST_LOOKS = 1_000, 12
#: Effective draws that intervals must be worth (ends are then good to a quarter of a standard deviation), and
#: the largest Pareto shape with which importance weights are trusted.
ENOUGH, TRUSTED = 100.0, 0.7
#: Share of draws of the normal within its walls that they are worth where the target is nearly that.
NEARLY = 0.8
#: Looks after which points that are worth less than this share of them are left to the walkers, and what they
#: are worth for each walker that starts from them, below which it walks alone.
FEW_LOOKS, POOR_LOOK, FEWEST_STARTS = 3, 0.1, 1.0 / 8.0
#: Share of the draws asked for that walkers still have to make where importance sampling is worth them.
HALF = 0.5
#: Shares of the moves: independent proposals, differential evolution, stretches; and those where the
#: Pareto shape says that proposals have the target's tails.
MOVES, MOVES_IN_TAILS, GOOD_TAILS = (0.6, 0.25, 0.15), (0.92, 0.05, 0.03), 0.5
#: Shares where proposals are worth next to nothing, worth of tempered weights to start from, and rounds.
MOVES_ALONE, START_WORTH, ROUNDS_ALONE = (0.05, 0.75, 0.2), 64.0, 30
#: Standard deviations at the optimum from which walkers alone have left along what no data hold.
FAR = 1e3
#: Shares of the moves where proposals are draws of the density itself, and the least of a uniform number.
MOVES_EXACT, SMALLEST = (1.0, 0.0, 0.0), 1e-12
#: R-hat of walkers that agree: that nothing but themselves has spread, and that weights have put in place.
ALIKE, ALIKE_WEIGHED = 1.1, 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Sampled:
    """A chain."""

    chain: FloatArray  # (walkers, steps, d), whitened coordinates of the target
    log_density: FloatArray  # (walkers, steps)
    converged: bool
    acceptance: float
    detail: dict[str, Any] = field(default_factory=dict)
    vectors: FloatArray | None = None  # (walkers, steps, size), of the chain, where the target tells them
    #: (n, d): the same draws with the machine at its mean, where they are known.
    at_mean_machine: FloatArray | None = None


class Proposal(Protocol):
    """A density to draw from."""

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws, shape (count, d)."""

    def log_density(self, z: FloatArray) -> FloatArray:
        """Up to a constant, (n, d) -> (n,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """A unit normal about a centre, drawn by a scrambled Sobol sequence, so that seeds agree on medians."""

    centre: FloatArray
    sequence: Sobol

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Next points of the sequence in random order, shape (count, d)."""
        # 0 itself would be infinite; in their own order each walker would have a stratum to itself
        inside = np.clip(self.sequence.random(count), SMALLEST, 1.0 - SMALLEST)
        return np.asarray(self.centre + rng.permutation(ndtri(inside)))

    def log_density(self, z: FloatArray) -> FloatArray:
        """Up to a constant, (n, d) -> (n,)."""
        return np.asarray(-0.5 * ((z - self.centre) ** 2).sum(axis=1))


def _proposal(target: Target, rng: np.random.Generator) -> Proposal:
    """The normal within its walls where the target is nearly that, else a mixture that learns it."""
    if target.is_normal:
        # from its second point on: the first one has the sequence expect a power of two
        return Normal(target.centre, Sobol(target.size, seed=rng).fast_forward(1))
    cut = cut_normal(target.centre, target.rows, target.walls, target.likely, rng)
    if cut.left:
        first = cut.draw(LOOK // 4, rng)
        worth = smoothed(target.densities(first) - cut.log_density(first)).worth
        if worth >= NEARLY * len(first):
            return cut
    return learn_mixture(target, cut, rng)[0]


def _independence(proposal: Proposal, rng: np.random.Generator) -> emcee.moves.MHMove:
    """Proposals whatever the walker's place."""

    def propose(coordinates: FloatArray, _: Any) -> tuple[FloatArray, FloatArray]:
        new = proposal.draw(len(coordinates), rng)
        return new, proposal.log_density(coordinates) - proposal.log_density(new)

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
    """Sample a specimen's posterior; ``draws``: effective ones that are asked for."""
    tell = progress or (lambda _count, _share: None)
    rng = np.random.default_rng([seed, 7])
    kept = Checkpoint(checkpoint, key)
    proposal = _proposal(target, rng)
    points, log_weight, weighed = _weighed(target, proposal, draws, rng, kept, tell)
    poor = weighed.worth < WALKERS * FEWEST_STARTS
    if poor and not np.isfinite(log_weight).any():
        raise ArithmeticError(f"none of {len(points)} proposals is passive and fits")
    weights = tempered(log_weight, START_WORTH) if poor else weighed.weights
    start = _started(target, points, weights, rng)
    shares = MOVES_IN_TAILS if weighed.pareto <= GOOD_TAILS else MOVES_ALONE if poor else MOVES
    kinds = (_independence(proposal, rng), emcee.moves.DEMove(), emcee.moves.StretchMove())
    moves = list(zip(kinds, MOVES_EXACT if target.is_normal else shares, strict=True))
    sampler = emcee.EnsembleSampler(WALKERS, target.size, target.walked, moves=moves, vectorize=True)
    state = emcee.State(start, random_state=np.random.RandomState(seed & 0xFFFFFFFF).get_state())

    def told(steps: int, share: float) -> None:
        tell(len(points) + WALKERS * steps, share)

    # walkers that no importance weights vouch for have to agree
    alike, few = (ALIKE if poor else ALIKE_WEIGHED), weighed.pareto <= TRUSTED
    worth_it = weighed.telling or weighed.worth >= HALF * draws
    rounds = ROUNDS_ALONE if poor else ROUNDS if not few else FEW_ROUNDS if worth_it else MORE_ROUNDS
    walked, apart = _walked(sampler, state, weighed, draws, told, rounds=rounds, alike=alike)
    told(int(sampler.iteration), 1.0)
    trusted = weighed.worth >= ENOUGH and few
    converged = bool(trusted or (walked >= ENOUGH and apart <= alike))
    most = max(weighed.worth, walked)
    detail: dict[str, Any] = {
        "steps": int(sampler.iteration),
        "walkers": WALKERS,
        "effective_draws": most,
        "pareto_k": weighed.pareto,
        "proposals": len(points),
    }
    if not converged:
        detail["reason"] = f"{most:.0f} of {draws} effective draws, Pareto k {weighed.pareto:.2f}"
        if np.isfinite(apart):
            detail["reason"] += f", walkers apart by R-hat {apart:.2f}"
    acceptance = float(np.mean(sampler.acceptance_fraction))
    first = sampler.iteration - _counted(sampler, trusted=few)
    kept_steps = np.linspace(first, sampler.iteration - 1, STEPS).astype(np.int64)
    chain = np.swapaxes(sampler.get_chain()[kept_steps], 0, 1)
    if poor and not np.abs(chain - target.centre).max() < FAR:
        msg = f"importance sampling is worth {weighed.worth:.0f} draws, and walkers left the data"
        raise ArithmeticError(msg)
    vectors = None if (told_of := sampler.get_blobs()) is None else np.swapaxes(told_of[kept_steps], 0, 1)
    return Sampled(chain, sampler.get_log_prob()[kept_steps].T, converged, acceptance, detail, vectors)


def _started(target: Target, points: FloatArray, weights: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Places of the walkers, by the weights of points; the heaviest instead of one that is not passive."""
    start = points[rng.choice(len(points), WALKERS, p=weights)]
    start = start + 1e-9 * rng.standard_normal(start.shape)
    outside = ~np.isfinite(target.densities(start))
    start[outside] = points[int(np.argmax(weights))]
    return start


def _counted(sampler: Any, *, trusted: bool) -> int:
    """Steps that count: walkers that were put in a thin tail have gone on by the second half."""
    return int(sampler.iteration if trusted else sampler.iteration - sampler.iteration // 2)


def _walked(
    sampler: Any,
    state: Any,
    weighed: Weighed,
    draws: int,
    progress: Callable[[int, float], None],
    *,
    rounds: int,
    alike: float,
) -> tuple[float, float]:
    """Walk, and tell the effective draws of the coordinate that has the fewest, and the largest R-hat."""
    trusted = weighed.pareto <= TRUSTED
    steps, wanted = (STEPS, float(draws)) if trusted else (ROUND, WALKED)
    found, apart = 0.0, np.inf
    for _ in range(rounds):
        # emcee prints what a density raises, and results may go to stdout
        with contextlib.redirect_stdout(sys.stderr):
            state = sampler.run_mcmc(state, steps, skip_initial_state_check=True)
        chain = np.swapaxes(sampler.get_chain()[-_counted(sampler, trusted=trusted) :], 0, 1)
        coordinates = diagnose({str(k): chain[:, :, k] for k in range(chain.shape[2])})
        found = min(one.ess_bulk for one in coordinates.values())
        apart = max(one.r_hat for one in coordinates.values())
        progress(int(sampler.iteration), min(found / wanted, 1.0))
        if (found >= wanted and (trusted or apart <= alike)) or (
            (weighed.telling or (trusted and weighed.worth >= draws)) and found >= HALF * draws
        ):
            break
    return found, apart


def _weighed(
    target: Target,
    proposal: Proposal,
    draws: int,
    rng: np.random.Generator,
    kept: Checkpoint,
    progress: Callable[[int, float], None],
) -> tuple[FloatArray, FloatArray, Weighed]:
    """Importance sampling until it is worth what was asked for, or tells that its proposals are as good."""
    points, log_weight = kept.resume(rng, target.size)
    found = Weighed(np.zeros(0), 0.0, np.inf)
    for _ in range(MOST_LOOKS):
        if len(points):
            found = smoothed(log_weight)
            progress(len(points), min(found.worth / draws, 1.0))
            dear = len(points) >= FEW_LOOKS * LOOK and found.worth < POOR_LOOK * len(points)
            if found.telling or found.worth >= draws or (dear and found.worth >= WALKERS * FEWEST_STARTS):
                break
        new = proposal.draw(LOOK, rng)
        points = np.vstack([points, new])
        log_weight = np.append(log_weight, target.densities(new) - proposal.log_density(new))
        kept.write(rng, points, log_weight)
    return points, log_weight, smoothed(log_weight)
