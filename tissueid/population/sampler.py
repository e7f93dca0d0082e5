"""The posterior of a population: pilots, fresh draws where they are needed, chains, and when to stop."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.extras import require
from tissueid.inference.diagnostics import Diagnostics, diagnose
from tissueid.population.chain import Record, sweeps
from tissueid.population.kernels import Cohort, Hyper, State
from tissueid.population.stage_one import (
    PILOT_NU,
    PILOT_WIDER,
    Design,
    Pilot,
    StageOne,
    first_pilot,
    packed,
    worths,
)
from tissueid.priors import PopulationPriors

#: Specimens are far beyond this quantile of a normal population's squared distances.
FAR_QUANTILE = 0.99
#: Rounds in which pilot and fresh draws follow each other, and sweeps of each.
PILOT_ROUNDS = 2
PILOT_SWEEPS = 400
#: Diagnostics that count as converged: Vehtari et al. 2021 ask for 1.01 and 100 effective draws a chain.
R_HAT = 1.01
ESS_A_CHAIN = 100.0
#: Draws kept of each specimen, of all chains together.
KEPT_PLACES = 400
#: Degrees of freedom that stand for a normal.
NORMAL_NU = 1e4


@dataclass(frozen=True, slots=True)
class SamplerOptions:
    """Options of a population's sampler."""

    tails: str = "t"  # ``t`` or ``normal``
    chains: int = 4
    #: Sweeps of each chain before the first that is kept, and kept in a block.
    settle: int = 500
    sweeps: int = 1500
    blocks: int = 6  # blocks at the most; sampling ends with the first after which all diagnostics are met
    seed: int = 0
    workers: int = 2  # threads; no number depends on it


@dataclass(frozen=True, slots=True, eq=False)
class PopulationDraws:
    """Draws of a population, chains first."""

    coefficient: FloatArray  # (chains, sweeps, q, p), mean (first row) and effects of covariates
    level_sd: FloatArray  # (chains, sweeps, L, p)
    sd: FloatArray  # (chains, sweeps, p), D: between specimens, in the core of the distribution
    correlation: FloatArray  # (chains, sweeps, p, p)
    nu: FloatArray  # (chains, sweeps), degrees of freedom; infinite where the population is normal
    specimens: FloatArray  # (kept, n, p), draws of each specimen's phi
    far: FloatArray  # (n,), probability that a specimen is beyond the :data:`FAR_QUANTILE` of a normal core
    weight: FloatArray  # (n,), posterior mean of its weight in the scale mixture; 1 is ordinary
    deviation: FloatArray  # (n, p), posterior mean of its deviation over D
    effect: FloatArray  # (G, p), posterior mean of the groups' effects
    worth: FloatArray  # (n,), effective stage-1 draws under the last pilot
    smoothed: NDArray[np.int64]  # specimens whose likelihood was smoothed
    moved: FloatArray  # (n,), moves a sweep
    diagnostics: dict[str, Diagnostics]  # name -> :class:`tissueid.inference.diagnostics.Diagnostics`
    converged: bool

    @property
    def mean(self) -> FloatArray:
        """Draws of the population's mean, shape (n, p), all chains in one."""
        return self.coefficient[:, :, 0].reshape(-1, self.sd.shape[-1])


def _hyper(priors: PopulationPriors, design: Design, size: int, tails: str) -> Hyper:
    from scipy.stats import chi2

    coefficient = np.full(design.columns.shape[1], priors.effect_sd)
    coefficient[0] = priors.mean_sd
    return Hyper(
        coefficient_sd=coefficient,
        scale=np.array([math.log(priors.between.median), priors.between.sd_ln, priors.correlation_shape]),
        level=np.array([math.log(priors.level.median), priors.level.sd_ln]),
        nu=np.array([priors.tail_shape, priors.tail_rate]),
        heavy=tails == "t",
        far=float(chi2.ppf(FAR_QUANTILE, size)),
    )


def _start(cohort: Cohort, pilot: Pilot, design: Design, hyper: Hyper, rng: np.random.Generator) -> State:
    """A state drawn around a pilot, wider than it."""
    n, q = cohort.design.shape
    p = cohort.phi.shape[1]
    first, end = cohort.start[:-1], cohort.start[1:]
    pick = np.array(
        [a + np.searchsorted(cohort.cumulative[a:b], rng.random()) for a, b in zip(first, end, strict=True)]
    )
    coefficient = np.zeros((q, p))
    # centred covariates: the mean of the specimens' centres is that of the population
    coefficient[0] = pilot.mean.mean(axis=0)
    sd = np.sqrt(pilot.covariance.diagonal() / PILOT_WIDER)
    coefficient[0] += sd * rng.standard_normal(p) / math.sqrt(n)
    levels, groups = len(design.levels), int(design.offsets[-1])
    pick = np.minimum(pick, end - 1).astype(np.int64)
    return State(
        phi=cohort.phi[pick].astype(np.float64),
        pick=pick,
        likelihood=np.zeros(n),
        coefficient=coefficient,
        effect=np.zeros((groups, p)),
        level_log_sd=hyper.level[0] + 0.3 * rng.standard_normal((levels, p)),
        log_sd=np.log(sd) + 0.3 * rng.standard_normal(p),
        partial=np.zeros((p, p)),
        nu=np.array([rng.uniform(3.0, 30.0) if hyper.heavy else NORMAL_NU]),
        weight=np.ones(n),
        step=np.log(np.stack([0.5 * sd, np.full(p, 0.3), np.ones(p)])),
        accepted=np.zeros(n, dtype=np.int64),
    )


def _room(cohort: Cohort, state: State, steps: int, kept: int) -> Record:
    n, p = cohort.design.shape[0], state.log_sd.size
    return Record(
        coefficient=np.empty((steps, *state.coefficient.shape)),
        level_log_sd=np.empty((steps, *state.level_log_sd.shape)),
        log_sd=np.empty((steps, p)),
        correlation=np.empty((steps, p, p)),
        nu=np.empty(steps),
        phi=np.zeros((min(kept, steps), n, p), dtype=np.float32),
        far=np.zeros(n),
        weight=np.zeros(n),
        deviation=np.zeros((n, p)),
        effect=np.zeros(state.effect.shape),
    )


def _next_pilot(
    stage: StageOne, design: Design, pilot: Pilot, hyper: Hyper, rng: np.random.Generator, seed: int
) -> Pilot:
    """A pilot from a short chain that was started at another."""
    cohort = packed(stage, design, pilot, seed)
    state = _start(cohort, pilot, design, hyper, rng)
    sweeps(rng, cohort, hyper, state, _room(cohort, state, 0, 0), PILOT_SWEEPS // 2, False)
    record = _room(cohort, state, PILOT_SWEEPS // 2, 0)
    sweeps(rng, cohort, hyper, state, record, PILOT_SWEEPS // 2, True)
    sd = np.exp(record.log_sd)
    covariance = (sd[:, :, None] * record.correlation * sd[:, None, :]).mean(axis=0)
    # what is not known of the centre widens where specimens may be
    covariance += np.cov(record.coefficient[:, 0], rowvar=False).reshape(covariance.shape)
    mean = cohort.design @ record.coefficient.mean(axis=0)
    effect = record.effect / record.nu.size
    for level in range(cohort.group.shape[0]):
        mean = mean + effect[cohort.group[level]]
    return Pilot(mean, PILOT_WIDER * covariance, PILOT_NU)


def _in_threads(work: Callable[[int], None], count: int, workers: int) -> None:
    with ThreadPoolExecutor(min(workers, os.cpu_count() or 1)) as pool:
        list(pool.map(work, range(count)))


def _stack(records: list[list[Record]], name: str) -> FloatArray:
    """One field of all records, chains first."""
    return np.stack([np.concatenate([getattr(one, name) for one in chain]) for chain in records])


def _diagnosed(records: list[list[Record]], hyper: Hyper) -> dict[str, Diagnostics]:
    draws: dict[str, FloatArray] = {}
    coefficient, log_sd = _stack(records, "coefficient"), _stack(records, "log_sd")
    p = log_sd.shape[2]
    for k in range(p):
        draws[f"ln_sd_{k}"] = log_sd[:, :, k]
        draws |= {f"coefficient_{a}_{k}": coefficient[:, :, a, k] for a in range(coefficient.shape[2])}
    level = _stack(records, "level_log_sd")
    draws |= {f"level_ln_sd_{a}_{k}": level[:, :, a, k] for a in range(level.shape[2]) for k in range(p)}
    correlation = _stack(records, "correlation")
    draws |= {f"correlation_{i}_{j}": correlation[:, :, i, j] for i in range(p) for j in range(i)}
    if hyper.heavy:
        draws["ln_nu"] = np.log(_stack(records, "nu"))
    return diagnose(draws)


def _met(found: dict[str, Diagnostics], chains: int) -> bool:
    return all(
        one.r_hat < R_HAT and min(one.ess_bulk, one.ess_tail) >= ESS_A_CHAIN * chains
        for one in found.values()
    )


def sample_population(
    stage: StageOne,
    design: Design,
    priors: PopulationPriors | None = None,
    options: SamplerOptions | None = None,
    tick: Callable[[str], None] | None = None,
) -> PopulationDraws:
    """Draw the population behind specimens."""
    require("numba")
    priors, options = priors or PopulationPriors(), options or SamplerOptions()
    tick = tick or (lambda _: None)
    hyper = _hyper(priors, design, stage.size, options.tails)
    rng = np.random.default_rng([options.seed, 0])
    pilot = first_pilot(stage, priors.between.median)
    for _ in range(PILOT_ROUNDS):
        tick("settling the population")
        pilot = _next_pilot(stage, design, pilot, hyper, rng, options.seed)
    cohort = packed(stage, design, pilot, options.seed)
    generators = [np.random.default_rng([options.seed, 1, k]) for k in range(options.chains)]
    states = [_start(cohort, pilot, design, hyper, one) for one in generators]
    records: list[list[Record]] = [[] for _ in generators]

    def settle(k: int) -> None:
        sweeps(generators[k], cohort, hyper, states[k], _room(cohort, states[k], 0, 0), options.settle, False)
        states[k].accepted[:] = 0

    def go_on(k: int) -> None:
        record = _room(cohort, states[k], options.sweeps, KEPT_PLACES // options.chains)
        sweeps(generators[k], cohort, hyper, states[k], record, options.sweeps, True)
        records[k].append(record)

    _in_threads(settle, options.chains, options.workers)
    found: dict[str, Diagnostics] = {}
    for block in range(options.blocks):
        tick(f"sampling the population, {options.sweeps * (block + 1):,} sweeps of {options.chains} chains")
        _in_threads(go_on, options.chains, options.workers)
        found = _diagnosed(records, hyper)
        if _met(found, options.chains):
            break
    judged = {"worth": worths(stage, pilot), "diagnostics": found, "converged": _met(found, options.chains)}
    return _gathered(cohort, records, states, hyper, **judged)


def _gathered(
    cohort: Cohort, records: list[list[Record]], states: list[State], hyper: Hyper, **judged: Any
) -> PopulationDraws:
    steps = sum(one.nu.size for chain in records for one in chain)
    nu = _stack(records, "nu")

    def mean(name: str) -> FloatArray:
        return np.asarray(sum(getattr(one, name) for chain in records for one in chain)) / steps

    return PopulationDraws(
        coefficient=_stack(records, "coefficient"),
        level_sd=np.exp(_stack(records, "level_log_sd")),
        sd=np.exp(_stack(records, "log_sd")),
        correlation=_stack(records, "correlation"),
        nu=nu if hyper.heavy else np.full_like(nu, np.inf),
        specimens=np.concatenate([chain[-1].phi for chain in records]).astype(np.float64),
        far=mean("far"),
        weight=mean("weight"),
        deviation=mean("deviation"),
        effect=mean("effect"),
        smoothed=np.flatnonzero(cohort.smooth >= 0),
        moved=np.asarray(sum(one.accepted for one in states)) / steps,
        **judged,
    )
