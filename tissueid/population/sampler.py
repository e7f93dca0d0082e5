"""The posterior of a population: pilots, fresh draws where they are needed, chains, and when to stop."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.inference.diagnostics import Diagnostics, diagnose
from tissueid.population.chains import Chains, Hyper, Scales, State, squares, transposed
from tissueid.population.stage_one import (
    PILOT_WIDER,
    Cohort,
    Design,
    Mixture,
    Pilot,
    StageOne,
    first_pilot,
    packed,
    worths,
)
from tissueid.priors import PopulationPriors

#: Specimens are far beyond this quantile of a normal population's squared distances.
FAR_QUANTILE = 0.99
#: Rounds in which pilot and chains follow each other, and sweeps of each.
PILOT_ROUNDS = 2
PILOT_SWEEPS = 40
#: Diagnostics that count as converged: Vehtari et al. 2021 ask for 1.01 and 400 effective draws.  With many
#: short chains R-hat is nested (Margossian et al. 2024, arXiv:2110.13017): chains of one start against
#: those of others.
R_HAT = 1.01
ESS = 400.0
STARTS = 4
#: Chains times specimens at the most: where a sweep costs more, fewer chains settle.
MOST_PLACES = 25_600
#: A typical tissue is needed without some specimens, not its uncertainty: short chains do.
SHORT_CHAINS, SHORT_SETTLE, SHORT_SWEEPS = 8, 40, 80
#: Draws kept of each specimen, of all chains together.
KEPT_PLACES = 400


@dataclass(frozen=True, slots=True)
class SamplerOptions:
    """Options of a population's sampler."""

    tails: str = "t"  # ``t`` or ``normal``
    chains: int = 64  # at the most
    settle: int = 60  # sweeps of each chain before the first that is kept
    draws: int = 6400  # kept in a block, of all chains
    blocks: int = 6  # blocks at the most; sampling ends with the first after which all diagnostics are met
    seed: int = 0


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
    deviation: FloatArray  # (n, p), posterior mean of its deviation over D
    worth: FloatArray  # (n,), effective stage-1 draws under the last pilot
    smoothed: NDArray[np.int64]  # specimens whose likelihood was smoothed
    diagnostics: dict[str, Diagnostics]  # name -> :class:`tissueid.inference.diagnostics.Diagnostics`
    converged: bool
    chains: Chains  # as they ended

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


def _start(cohort: Cohort, pilot: Pilot, hyper: Hyper, chains: int, rng: np.random.Generator) -> State:
    """States around a pilot, wider than it: :data:`STARTS` of them, each of as many chains."""
    n, q = cohort.design.shape
    p, groups, levels = cohort.phi.shape[1], cohort.level_of.size, len(cohort.group)
    pick = np.searchsorted(cohort.cumulative, np.arange(n) + rng.random((STARTS, n)))
    pick = np.clip(pick, cohort.start[:-1], cohort.start[1:] - 1)
    sd = np.sqrt(pilot.covariance.diagonal() / PILOT_WIDER)
    # centred covariates: the mean of the specimens' centres is that of the population
    coefficient = np.zeros((STARTS, q, p))
    coefficient[:, 0] = pilot.mean.mean(axis=0) + sd * rng.standard_normal((STARTS, p)) / math.sqrt(n)
    log_sd = np.log(sd) + 0.3 * rng.standard_normal((STARTS, p))
    level = hyper.level[0] + 0.3 * rng.standard_normal((STARTS, levels, p))
    log_nu = np.log(rng.uniform(3.0, 30.0, STARTS))

    def each(values: Any) -> Any:
        return np.repeat(values, chains // STARTS, axis=0)

    return State(
        phi=each(cohort.phi[pick].astype(np.float64)),
        pick=each(pick),
        coefficient=each(coefficient),
        effect=np.zeros((chains, groups, p)),
        level_log_sd=each(level),
        scales=Scales(each(log_sd), np.zeros((chains, p, p))),
        log_nu=each(log_nu),
        weight=np.ones((chains, n)),
    )


class Record:
    """Draws of the population from the sweeps of all chains, and running sums over its specimens."""

    def __init__(self) -> None:
        self.draws: dict[str, list[FloatArray]] = {}
        self.phi: list[NDArray[np.float32]] = []
        self.sums: dict[str, FloatArray] = {}
        self.sweeps = 0

    def take(self, chains: Chains) -> None:
        """Keep a state of the chains."""
        state, scales, centre = chains.state, chains.state.scales, chains.centre
        low = scales.low
        draws = {
            "coefficient": state.coefficient,
            "level_log_sd": state.level_log_sd,
            "log_sd": scales.log_sd,
            "correlation": low @ transposed(low),
            "log_nu": state.log_nu,
            "scales": scales.vector,
        }
        far = squares(state.phi - centre, scales.unit) > chains.hyper.far
        sums: dict[str, FloatArray] = {
            "far": far.astype(np.float64),
            "deviation": (state.phi - centre) * np.exp(-scales.log_sd)[:, None],
            "effect": state.effect,
        }
        for name, values in draws.items():
            self.draws.setdefault(name, []).append(values.copy())
        for name, values in sums.items():
            self.sums[name] = self.sums.get(name, np.zeros(values.shape[1:])) + values.mean(axis=0)
        self.sweeps += 1

    def of(self, name: str) -> FloatArray:
        """Draws of one kind, chains first, then sweeps."""
        return np.stack(self.draws[name], axis=1)

    def mean(self, name: str) -> FloatArray:
        """Mean of what is summed."""
        return np.asarray(self.sums[name] / self.sweeps)


def _run(chains: Chains, settle: int, sweeps: int, record: Record, places: int = 0) -> None:
    """Let chains settle, then keep their sweeps; of the last block ``places`` draws of each specimen."""
    for _ in range(settle):
        chains.sweep(adapt=True)
    thin = max(sweeps * len(chains.state.phi) // max(places, 1), 1)
    record.phi = []
    for sweep in range(sweeps):
        chains.sweep(adapt=False)
        record.take(chains)
        if places and sweep % thin == 0:
            record.phi.append(chains.state.phi.astype(np.float32))


def _next_pilot(chains: Chains) -> Pilot:
    """A pilot from a short run of the chains, whose steps learn from it."""
    record, cohort = Record(), chains.cohort
    _run(chains, PILOT_SWEEPS // 2, PILOT_SWEEPS // 2, record)
    sd, scales = np.exp(record.of("log_sd")), record.of("scales")
    chains.moves.learn(scales.reshape(-1, scales.shape[2]))
    covariance = (sd[..., :, None] * record.of("correlation") * sd[..., None, :]).mean(axis=(0, 1))
    # what is not known of the centre widens where specimens may be
    coefficient = record.of("coefficient")
    spread = np.cov(coefficient[:, :, 0].reshape(-1, sd.shape[2]), rowvar=False)
    mean = cohort.design @ coefficient.mean(axis=(0, 1))
    for group in cohort.group:
        mean = mean + record.mean("effect")[group]
    return Pilot(mean, PILOT_WIDER * (covariance + spread.reshape(covariance.shape)))


def _diagnosed(record: Record, hyper: Hyper) -> dict[str, Diagnostics]:
    """Effective draws of the chains, and R-hat of those of one start against those of others."""
    draws: dict[str, FloatArray] = {}
    coefficient, log_sd = record.of("coefficient"), record.of("log_sd")
    p = log_sd.shape[2]
    for k in range(p):
        draws[f"ln_sd_{k}"] = log_sd[:, :, k]
        draws |= {f"coefficient_{a}_{k}": coefficient[:, :, a, k] for a in range(coefficient.shape[2])}
    level = record.of("level_log_sd")
    draws |= {f"level_ln_sd_{a}_{k}": level[:, :, a, k] for a in range(level.shape[2]) for k in range(p)}
    correlation = record.of("correlation")
    draws |= {f"correlation_{i}_{j}": correlation[:, :, i, j] for i in range(p) for j in range(i)}
    if hyper.heavy:
        draws["ln_nu"] = record.of("log_nu")
    nested = {k: one.reshape(STARTS, -1, record.sweeps).swapaxes(1, 2) for k, one in draws.items()}
    r_hat = diagnose({k: one.reshape(STARTS, -1) for k, one in nested.items()})
    return {k: replace(one, r_hat=r_hat[k].r_hat) for k, one in diagnose(draws).items()}


def _met(found: dict[str, Diagnostics]) -> bool:
    return all(one.r_hat < R_HAT and min(one.ess_bulk, one.ess_tail) >= ESS for one in found.values())


def sample_population(
    stage: StageOne,
    design: Design,
    priors: PopulationPriors | None,
    options: SamplerOptions,
    tick: Callable[[str], None] = lambda _: None,
) -> PopulationDraws:
    """Draw the population behind specimens."""
    priors = priors or PopulationPriors()
    hyper = _hyper(priors, design, stage.size, options.tails)
    known: dict[int, Mixture] = {}
    rng = np.random.default_rng([options.seed, 0])
    count = STARTS * max(min(options.chains, MOST_PLACES // len(stage.phi)) // STARTS, 2)
    pilot = first_pilot(stage, priors.between.median)
    cohort = packed(stage, design, pilot, known)
    chains = Chains(cohort, hyper, _start(cohort, pilot, hyper, count, rng), rng)
    for _ in range(PILOT_ROUNDS):
        tick("settling the population")
        pilot = _next_pilot(chains)
        chains.cohort = packed(stage, design, pilot, known)
        chains.aim()
    record, sweeps = Record(), math.ceil(options.draws / count)
    found: dict[str, Diagnostics] = {}
    for block in range(options.blocks):
        tick(f"sampling the population, {sweeps * (block + 1):,} sweeps of {count} chains")
        _run(chains, 0 if block else options.settle, sweeps, record, KEPT_PLACES)
        found = _diagnosed(record, hyper)
        if _met(found):
            break
    nu = np.exp(record.of("log_nu"))
    return PopulationDraws(
        coefficient=record.of("coefficient"),
        level_sd=np.exp(record.of("level_log_sd")),
        sd=np.exp(record.of("log_sd")),
        correlation=record.of("correlation"),
        nu=nu if hyper.heavy else np.full_like(nu, np.inf),
        specimens=np.concatenate(record.phi).astype(np.float64),
        far=record.mean("far"),
        deviation=record.mean("deviation"),
        worth=worths(stage, pilot),
        smoothed=chains.cohort.smooth,
        diagnostics=found,
        converged=_met(found),
        chains=chains,
    )


def typical_without(
    chains: Chains, folds: Sequence[NDArray[np.int64]], rng: np.random.Generator
) -> FloatArray:
    """Mean and effects, (folds, q, p), medians of the population without the specimens of each fold.

    All folds are chains at once, which begin where those of all specimens ended.
    """
    count = max(min(SHORT_CHAINS, MOST_PLACES // (len(chains.cohort.design) * len(folds))), 1)
    begin = rng.integers(len(chains.used), size=count * len(folds))
    used = np.ones((len(begin), len(chains.cohort.design)), dtype=bool)
    for k, fold in enumerate(folds):
        used[k * count : (k + 1) * count, fold] = False
    record = Record()
    _run(chains.branched(begin, used, rng), SHORT_SETTLE, SHORT_SWEEPS, record)
    coefficient = record.of("coefficient")
    return np.median(coefficient.reshape(len(folds), -1, *coefficient.shape[2:]), axis=1)
