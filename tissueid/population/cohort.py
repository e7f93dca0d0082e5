"""A population from specimens, its remarks and predictions: the one call that composes this package.

Number of specimens that a wanted precision takes.
Half the width of a 95 % interval of a mean of n specimens is 1.96 sqrt((D^2 + m^2) / n) in ln units, with D
the spread between specimens and m that of one specimen's own posterior; of a standard deviation, relative to
itself, 1.96 (D^2 + m^2) / D^2 / sqrt(2 (n - 1)).  Both are large-sample formulas of a normal population
(derived); the answer is given for the median of D and for both ends of its interval.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.population import CohortSize, Effect, Order, Quantity, Repeatability, Specimen
from tissueid.flags import Flag
from tissueid.population.agreement import Agreement, agreement, order_effect, repeatability
from tissueid.population.confounding import Confounding, speed_confounding
from tissueid.population.coordinates import Coordinates
from tissueid.population.design import Described, design_of
from tissueid.population.held_out import HeldOut, held_out
from tissueid.population.members import FEWEST_SPECIMENS, LeftOut, Member, fit_for_cohort, model_of, stage_one
from tissueid.population.rows import effect_rows, quantity_rows, shared_instrument, specimen_rows
from tissueid.population.sampler import ESS_A_CHAIN, R_HAT, PopulationDraws, SamplerOptions, sample_population
from tissueid.population.stage_one import StageOne
from tissueid.priors import PopulationPriors

#: Specimens that a bundle keeps, proposals tried for them at the most, and tried at a time.
SPECIMENS = 2000
MOST_TRIES = 40_000
BATCH = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Predictive:
    """Prediction of a specimen that was not measured."""

    typical: FloatArray  # (p,), theta of the median tissue
    #: The median of every quantity is no passive tissue: the nearest drawn specimen stands for it.
    typical_is_drawn: bool
    theta: FloatArray  # (n, p), drawn specimens, all passive
    refused: int  # draws that were not passive, and were drawn again

    @property
    def refused_share(self) -> float:
        """Of all draws."""
        return self.refused / max(self.refused + len(self.theta), 1)


def _drawn(draws: PopulationDraws, count: int, rng: np.random.Generator) -> FloatArray:
    """Phi of specimens of new donors, sites and operators at the cohort's mean covariates."""
    p = draws.sd.shape[-1]
    mean, sd = draws.mean, draws.sd.reshape(-1, p)
    correlation, nu = draws.correlation.reshape(-1, p, p), draws.nu.ravel()
    level = draws.level_sd.reshape(len(mean), -1, p)
    row = rng.integers(len(mean), size=count)
    factor = np.linalg.cholesky(correlation[row] + 1e-12 * np.eye(p))
    z = np.einsum("nij,nj->ni", factor, rng.standard_normal((count, p)))
    heavy = np.isfinite(nu[row])
    half = 0.5 * np.where(heavy, nu[row], 1.0)
    weight = np.where(heavy, rng.standard_gamma(half) / half, 1.0)
    phi = mean[row] + sd[row] * z / np.sqrt(weight)[:, None]
    return np.asarray(phi + (level[row] * rng.standard_normal((count, level.shape[1], p))).sum(axis=1))


def predictive_specimens(
    draws: PopulationDraws, coordinates: Coordinates, rng: np.random.Generator, count: int = SPECIMENS
) -> Predictive:
    """Specimens of the population, and its typical one.

    ``count``: fewer are given where most draws are not passive.
    """
    kept: list[FloatArray] = []
    found = refused = tried = 0
    while found < count and tried < MOST_TRIES:
        # a specimen that overflows is as little passive as one with a negative force
        with np.errstate(over="ignore", invalid="ignore"):
            theta = coordinates.to_theta(_drawn(draws, min(BATCH, 2 * count), rng))
            finite = np.asarray(np.isfinite(theta).all(axis=1))
            theta = np.where(finite[:, None], theta, 0.0)
            good = np.asarray(coordinates.passive(theta) & finite)
        tried += len(theta)
        used = (
            int(np.searchsorted(np.cumsum(good), count - found)) + 1
            if good.sum() > count - found
            else len(good)
        )
        kept.append(theta[:used][good[:used]])
        found += len(kept[-1])
        refused += int((~good[:used]).sum())
    theta = np.concatenate(kept) if kept else np.empty((0, coordinates.size))
    middle = np.median(draws.mean, axis=0)
    typical = coordinates.to_theta(middle)
    if bool(coordinates.passive(typical)[0]) or not len(theta):
        return Predictive(typical[0], False, theta, refused)
    phi, _ = coordinates.to_phi(theta)
    sd = np.median(draws.sd.reshape(-1, middle.size), axis=0)
    nearest = int((((phi - middle) / sd) ** 2).sum(axis=1).argmin())
    return Predictive(theta[nearest], True, theta, refused)


#: Names in one sentence.
LONGEST_LIST = 8
#: Refused predictive draws that are worth a word.
MANY_REFUSED = 0.05


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - LONGEST_LIST} more" if len(names) > LONGEST_LIST else ""
    return ", ".join(names[:LONGEST_LIST]) + more


def population_flags(
    draws: PopulationDraws,
    predictive: Predictive,
    specimens: Sequence[Specimen],
    described: Described,
    floored: Mapping[str, int],
) -> list[Flag]:
    """Flags of a population.

    ``floored``: specimen -> draws of which a number was zero.
    """
    flags = [*_of_chains(draws), *_of_outliers(specimens)]
    smoothed = [row.specimen for row in specimens if row.smoothed]
    if smoothed:
        message = (
            f"the population lies among few draws of {len(smoothed)} of {len(specimens)} specimens "
            f"(first {smoothed[0]})"
        )
        flags.append(Flag("likelihood_smoothed", message, {"specimens": smoothed}))
    if floored:
        message = (
            f"{len(floored)} specimens (first {next(iter(floored))}) have no force or stiffness in "
            f"{sum(floored.values())} draws"
        )
        flags.append(
            Flag("draws_floored", message, {"specimens": list(floored), "draws": list(floored.values())})
        )
    if predictive.refused_share > MANY_REFUSED or predictive.typical_is_drawn:
        share = 100 * predictive.refused_share
        message = f"{share:.0f} % of drawn specimens were not passive and were drawn again"
        if predictive.typical_is_drawn:
            message += ", the typical one too"
        flags.append(
            Flag(
                "population_not_passive",
                message,
                {"refused": predictive.refused, "kept": len(predictive.theta)},
            )
        )
    for key, who in described.missing.items():
        message = f"{key} is not stated of {len(who)} specimens (first {who[0]}): the mean was taken"
        flags.append(Flag("covariate_missing", message, {"covariate": key, "specimens": list(who)}))
    return flags


def _of_chains(draws: PopulationDraws) -> list[Flag]:
    if draws.converged:
        return []
    worst = max(draws.diagnostics.values(), key=lambda one: one.r_hat)
    least = min(min(one.ess_bulk, one.ess_tail) for one in draws.diagnostics.values())
    wanted = ESS_A_CHAIN * draws.nu.shape[0]
    message = (
        f"chains over the population: R-hat {worst.r_hat:.3f} (wanted {R_HAT}), {least:.0f} effective draws "
        f"(wanted {wanted:.0f})"
    )
    return [Flag("population_not_converged", message, {"r_hat": worst.r_hat, "ess": least})]


def _of_outliers(specimens: Sequence[Specimen]) -> list[Flag]:
    outliers = [row for row in specimens if row.outlier is not None]
    if not outliers:
        return []
    said = "; ".join(
        f"{row.specimen} (probability {row.far:.2f}, {row.outlier} {row.deviation:+.1f} sd)"
        for row in sorted(outliers, key=lambda row: -row.far)[:LONGEST_LIST]
    )
    more = f"; and {len(outliers) - LONGEST_LIST} more" if len(outliers) > LONGEST_LIST else ""
    message = (
        f"far from the others: {said}{more}; of a normal population {0.01 * len(specimens):.2g} would be"
    )
    return [Flag("specimen_outlier", message, {"specimens": [row.specimen for row in outliers]})]


#: Wanted half widths, relative.
PRECISIONS = (0.02, 0.05, 0.10)
Z95 = 1.959963984540054


def specimens_for_mean(between_sd: float, own_sd: float, precision: float) -> int:
    """Specimens for a relative half width of the 95 % interval of the mean; at least 3."""
    half = math.log1p(precision)
    return max(math.ceil(Z95**2 * (between_sd**2 + own_sd**2) / half**2), 3)


def specimens_for_sd(between_sd: float, own_sd: float, precision: float) -> int:
    """Specimens for a relative half width of the 95 % interval of the standard deviation; at least 3."""
    inflated = (between_sd**2 + own_sd**2) / between_sd**2
    return max(math.ceil(1.0 + 0.5 * (Z95 * inflated / precision) ** 2), 3)


def size_rows(names: tuple[str, ...], sd: FloatArray, own_sd: FloatArray) -> tuple[CohortSize, ...]:
    """A row a quantity and precision.

    ``sd`` (n, p): draws of D; ``own_sd`` (p,): typical standard deviation of one specimen's ln quantity.
    """
    low, middle, high = np.quantile(sd, [0.025, 0.5, 0.975], axis=0)
    rows = []
    for k, name in enumerate(names):
        for precision in PRECISIONS:
            means = [
                specimens_for_mean(float(d[k]), float(own_sd[k]), precision) for d in (low, middle, high)
            ]
            sds = [specimens_for_sd(float(d[k]), float(own_sd[k]), precision) for d in (low, middle, high)]
            rows.append(
                CohortSize(name, precision, means[1], (min(means), max(means)), sds[1], (min(sds), max(sds)))
            )
    return tuple(rows)


@dataclass(frozen=True, slots=True)
class CohortOptions:
    """Options of a population's sampling."""

    group_by: str | None = None  # covariate whose groups are compared
    covariates: tuple[str, ...] = ()
    priors: PopulationPriors = field(default_factory=PopulationPriors)
    sampler: SamplerOptions = field(default_factory=SamplerOptions)
    hold_out: bool = True  # predict every specimen from the others


@dataclass(frozen=True, slots=True, eq=False)
class Population:
    """Population of specimens, where there are enough."""

    coordinates: Coordinates
    described: Described
    draws: PopulationDraws
    predictive: Predictive
    quantities: tuple[Quantity, ...]
    specimens: tuple[Specimen, ...]
    effects: tuple[Effect, ...]
    held_out: HeldOut | None
    repeatability: Repeatability | None
    sizes: tuple[CohortSize, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CohortFit:
    """Everything that is said of a cohort."""

    members: tuple[Member, ...]  # specimens that took part
    left_out: tuple[LeftOut, ...]
    population: Population | None
    reason: str | None  # why there is no population
    agreement: Agreement | None
    order: Order | None
    confounding: Confounding | None
    flags: tuple[Flag, ...]


def cohort(
    members: Sequence[Member],
    options: CohortOptions | None = None,
    tick: Callable[[str], None] | None = None,
) -> CohortFit:
    """The population behind specimens.

    ``members``: those that can't stand in one population are named in ``left_out``; ``tick``: told what is
    being done.  Raises UsageError: a covariate that no specimen states, or that is the same for all.
    """
    options, tick = options or CohortOptions(), tick or (lambda _: None)
    kept, left = fit_for_cohort(members)
    confounding = speed_confounding(members)
    order = order_effect(members)
    flags = [] if confounding is None else confounding.flags()
    if len(kept) < FEWEST_SPECIMENS:
        reason = (
            f"{len(kept)} specimen{'s' * (len(kept) != 1)} with a posterior of one model: a population takes "
            f"{FEWEST_SPECIMENS} at least"
        )
        return CohortFit(kept, left, None, reason, None, order, confounding, tuple(flags))
    coordinates = Coordinates(model_of(kept))
    described = design_of(kept, options.group_by, options.covariates)
    stage, floored = stage_one(kept, coordinates)
    population = _population(kept, stage, coordinates, described, options, tick)
    force = {row.specimen: row.pooled[coordinates.static_at_depth] for row in population.specimens}
    flags += population_flags(
        population.draws, population.predictive, population.specimens, described, floored
    )
    return CohortFit(kept, left, population, None, agreement(kept, force), order, confounding, tuple(flags))


def _population(
    members: Sequence[Member],
    stage: StageOne,
    coordinates: Coordinates,
    described: Described,
    options: CohortOptions,
    tick: Callable[[str], None],
) -> Population:
    draws = sample_population(stage, described.design, options.priors, options.sampler, tick)
    rng = np.random.default_rng([options.sampler.seed, 4])
    tick("drawing specimens from the population")
    predictive = predictive_specimens(draws, coordinates, rng)
    instrument = shared_instrument(members, coordinates)
    sd = draws.sd.reshape(-1, coordinates.size)
    own_sd = np.median([one.std(axis=0) for one in stage.phi], axis=0)
    predicted = None
    if options.hold_out:
        predicted = held_out(members, stage, described, coordinates, options.priors, options.sampler, tick)
    return Population(
        coordinates=coordinates,
        described=described,
        draws=draws,
        predictive=predictive,
        quantities=quantity_rows(draws, coordinates, described, instrument, rng),
        specimens=specimen_rows(members, stage, draws, coordinates),
        effects=effect_rows(draws, coordinates, described),
        held_out=predicted,
        repeatability=repeatability(members, sd[:, coordinates.static_at_depth], rng),
        sizes=size_rows(coordinates.names, sd, np.asarray(own_sd, dtype=np.float64)),
    )
