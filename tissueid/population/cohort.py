"""A population from specimens, its rows, remarks and predictions: the one call that composes this package."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents import population as documents
from tissueid.flags import Flag
from tissueid.model.base import ContactPath
from tissueid.population.agreement import (
    Z95,
    agreement,
    confounding_flags,
    confounding_of,
    interval_95,
    order_effect,
    repeatability,
)
from tissueid.population.coordinates import Coordinates
from tissueid.population.members import (
    FEWEST_SPECIMENS,
    Member,
    TrialRow,
    design_of,
    fit_for_cohort,
    model_of,
    stage_one,
)
from tissueid.population.sampler import (
    ESS,
    R_HAT,
    PopulationDraws,
    SamplerOptions,
    sample_population,
    typical_without,
)
from tissueid.population.stage_one import Design, StageOne
from tissueid.priors import PopulationPriors

#: Share of the specimens that must have a total posterior.
FEWEST_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class SharedInstrument:
    """Instrument that is common to all specimens."""

    shift: FloatArray  # (p,), of ln quantities
    covariance: FloatArray  # (p, p)

    def added_to(self, mean: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draws of the mean with the machine's uncertainty, shape (n, p)."""
        values, vectors = np.linalg.eigh(self.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        return np.asarray(mean + self.shift + rng.standard_normal(mean.shape) @ root.T)


def shared_instrument(members: Sequence[Member], coordinates: Coordinates) -> SharedInstrument | None:
    """Medians, over specimens, of total less statistical posteriors; ``None`` with too few total ones."""
    shifts, more = [], []
    for one in members:
        if one.draws_total is None or len(one.draws_total) < 2:
            continue
        total, own = (coordinates.to_phi(x)[0] @ coordinates.logs.T for x in (one.draws_total, one.draws))
        shifts.append(np.median(total, axis=0) - np.median(own, axis=0))
        more.append(central_covariance(total) - central_covariance(own))
    if len(shifts) < max(FEWEST_SHARE * len(members), 1):
        return None
    covariance = np.median(more, axis=0)
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    positive = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return SharedInstrument(np.median(shifts, axis=0), np.asarray(positive))


def central_covariance(draws: FloatArray) -> FloatArray:
    """Covariance of draws pulled in to their central 99 %."""
    low, high = np.quantile(draws, [0.005, 0.995], axis=0)
    return np.asarray(np.cov(np.clip(draws, low, high), rowvar=False))


#: A specimen is named as an outlier where it is more likely than not beyond the 99 % of a normal core.
OUTLIER_PROBABILITY = 0.5
#: Groups of which every pair is compared; of more, each is compared with the largest.
MOST_PAIRED = 4


def of_quantities(draws: PopulationDraws, logs: FloatArray) -> PopulationDraws:
    """Draws of logarithms of the quantities; ``logs`` as in :attr:`Coordinates.logs`."""
    covariance = logs @ (draws.correlation * draws.sd[..., None] * draws.sd[..., None, :]) @ logs.T
    sd = np.sqrt(np.einsum("...kk->...k", covariance))
    widths = [np.median(one.reshape(-1, len(logs)), axis=0) for one in (draws.sd, sd)]
    return replace(
        draws,
        coefficient=draws.coefficient @ logs.T,
        level_sd=np.sqrt(draws.level_sd**2 @ logs.T**2),
        sd=sd,
        correlation=covariance / (sd[..., None] * sd[..., None, :]),
        specimens=draws.specimens @ logs.T,
        deviation=(draws.deviation * widths[0]) @ logs.T / widths[1],
    )


def quantity_rows(
    draws: PopulationDraws,
    coordinates: Coordinates,
    design: Design,
    instrument: SharedInstrument | None,
    rng: np.random.Generator,
) -> tuple[documents.Quantity, ...]:
    """Mean and spread of each quantity."""
    p = coordinates.size
    mean, sd = draws.mean, draws.sd.reshape(-1, p)
    total = None if instrument is None else np.exp(instrument.added_to(mean, rng))
    level_sd = draws.level_sd.reshape(len(mean), -1, p)
    rows = []
    for k, name in enumerate(coordinates.names):
        cv = np.sqrt(np.expm1(np.minimum(sd[:, k], 5.0) ** 2))
        rows.append(
            documents.Quantity(
                name=name,
                words=coordinates.words[k],
                unit=coordinates.units[k],
                median=float(np.exp(np.median(mean[:, k]))),
                ci95=interval_95(np.exp(mean[:, k])),
                ci95_total=None if total is None else interval_95(total[:, k]),
                sd_ln=float(np.median(sd[:, k])),
                sd_ln_ci95=interval_95(sd[:, k]),
                cv=float(np.median(cv)),
                cv_ci95=interval_95(cv),
                levels={
                    key: documents.Level(float(np.median(one)), interval_95(one))
                    for key, one in zip(design.levels, level_sd[:, :, k].T, strict=True)
                },
            )
        )
    return tuple(rows)


def specimen_rows(
    members: Sequence[Member], stage: StageOne, draws: PopulationDraws, coordinates: Coordinates
) -> tuple[documents.Specimen, ...]:
    """Every specimen, alone and pooled."""
    smoothed = set(draws.smoothed.tolist())
    rows = []
    for i, one in enumerate(members):
        own = stage.phi[i] @ coordinates.logs.T
        pooled = draws.specimens[:, i]
        farthest = int(np.abs(draws.deviation[i]).argmax())
        spread = np.maximum(own.var(axis=0), 1e-300)
        rows.append(
            documents.Specimen(
                specimen=one.specimen,
                separate=tuple(np.exp(np.median(own, axis=0)).tolist()),
                separate_ci95=tuple(map(interval_95, np.exp(own).T)),
                pooled=tuple(np.exp(np.median(pooled, axis=0)).tolist()),
                pooled_ci95=tuple(map(interval_95, np.exp(pooled).T)),
                shrinkage=tuple(np.clip(1.0 - pooled.var(axis=0) / spread, 0.0, 1.0).tolist()),
                far=float(draws.far[i]),
                outlier=coordinates.names[farthest] if draws.far[i] > OUTLIER_PROBABILITY else None,
                deviation=float(draws.deviation[i, farthest]),
                smoothed=i in smoothed,
                worth=float(draws.worth[i]),
            )
        )
    return tuple(rows)


def effect_rows(
    draws: PopulationDraws, coordinates: Coordinates, design: Design
) -> tuple[documents.Effect, ...]:
    """Ratios between groups, and for one standard deviation of each number."""
    coefficient = draws.coefficient.reshape(-1, *draws.coefficient.shape[2:])
    rows: list[documents.Effect] = []

    def add(
        values: FloatArray, covariate: str, of: str | None, against: str | None, per: float | None
    ) -> None:
        for k, name in enumerate(coordinates.names):
            ratio = np.exp(values[:, k])
            above = float((values[:, k] > 0.0).mean())
            rows.append(
                documents.Effect(
                    name, covariate, of, against, per, float(np.median(ratio)), interval_95(ratio), above
                )
            )

    titles = list(design.column_names)
    zero = np.zeros_like(coefficient[:, 0])
    grouped = {f"{design.group_by}: {group}" for group in design.compared[1:]}
    by_group = dict.fromkeys(design.compared[:1], zero) | {
        group: coefficient[:, titles.index(f"{design.group_by}: {group}")] for group in design.compared[1:]
    }
    pairs = list(combinations(design.compared, 2))
    if len(design.compared) > MOST_PAIRED:
        pairs = [pair for pair in pairs if pair[0] == design.compared[0]]
    for against, of in pairs:
        add(by_group[of] - by_group[against], str(design.group_by), of, against, None)
    for a, title in enumerate(titles[1:], start=1):
        if title in grouped:
            continue
        scale = design.scales.get(title)
        if scale is not None:
            add(coefficient[:, a], title, None, None, scale)
        else:
            key, group = title.split(": ", 1)
            add(coefficient[:, a], key, group, "the largest group", None)
    return tuple(rows)


#: Leave-one-out up to so many specimens, so many parts beyond.
MOST_SINGLE = 20
PARTS = 10
#: NRMSD of the population model in paper A [%]; its normaliser is not stated.
PAPER_A_PERCENT = (4.23, 10.95)
FEWEST_SAMPLES = 5


def prediction_error(
    coordinates: Coordinates, theta: FloatArray, trial: TrialRow
) -> tuple[float, float] | None:
    """NRMSD by range and by mean, fractions, of a tissue on the part of a log within the common depth."""
    curve = trial.curve
    if curve is None:
        return None
    use = curve.fitted & (curve.depth_mm <= coordinates.depth_mm * (1.0 + 1e-9)) & (curve.depth_mm >= 0.0)
    if use.sum() < FEWEST_SAMPLES:
        return None
    model = coordinates.model.force(theta, ContactPath(curve.time_s, np.maximum(curve.depth_mm, 0.0)))
    force = curve.force_N[use]
    rmsd = float(np.sqrt(np.mean((model[use] - force) ** 2)))
    span, mean = float(np.ptp(force)), float(force.mean())
    if not (span > 0.0 and mean > 0.0):
        return None
    return rmsd / span, rmsd / mean


def held_out(
    members: Sequence[Member],
    draws: PopulationDraws,
    design: Design,
    coordinates: Coordinates,
    rng: np.random.Generator,
) -> documents.HeldOut | None:
    """Predict every specimen from the others; ``None`` without a curve, or with too few specimens."""
    if len(members) < 4 or not any(trial.curve is not None for one in members for trial in one.trials):
        return None
    folds = [np.array([i]) for i in range(len(members))]
    if len(members) > MOST_SINGLE:
        folds = [np.sort(part) for part in np.array_split(rng.permutation(len(members)), PARTS)]
    rows = []
    for fold, coefficient in zip(folds, typical_without(draws.chains, folds, rng), strict=True):
        for i in fold:
            theta = coordinates.to_theta(design.columns[i] @ coefficient)[0]
            for trial in members[i].trials:
                error = prediction_error(coordinates, theta, trial)
                if error is not None:
                    rows.append(documents.Trial(members[i].specimen, trial.path, trial.sheet, *error))
    if not rows:
        return None
    by_range, by_mean = (
        _spread([getattr(row, key) for row in rows]) for key in ("nrmsd_range", "nrmsd_mean")
    )
    return documents.HeldOut(len(folds), PAPER_A_PERCENT, by_range, by_mean, tuple(rows))


def _spread(values: Sequence[float]) -> documents.Spread:
    low, middle, high = np.quantile(values, [0.16, 0.5, 0.84])
    return documents.Spread(float(middle), float(low), float(high))


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
    draws: PopulationDraws, coordinates: Coordinates, rng: np.random.Generator
) -> Predictive:
    """Specimens of the population, and its typical one."""
    kept: list[FloatArray] = []
    found = refused = tried = 0
    while found < SPECIMENS and tried < MOST_TRIES:
        # a specimen that overflows is as little passive as one with a negative force
        with np.errstate(over="ignore", invalid="ignore"):
            theta = coordinates.to_theta(_drawn(draws, BATCH, rng))
            finite = np.asarray(np.isfinite(theta).all(axis=1))
            theta = np.where(finite[:, None], theta, 0.0)
            good = np.asarray(coordinates.passive(theta) & finite)
        tried += len(theta)
        rows = np.flatnonzero(good)[: SPECIMENS - found]
        used = int(rows[-1]) + 1 if good.sum() > rows.size else len(good)
        kept.append(theta[rows])
        found += rows.size
        refused += used - rows.size
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


def population_flags(
    draws: PopulationDraws,
    predictive: Predictive,
    specimens: Sequence[documents.Specimen],
    design: Design,
    floored: Mapping[str, int],
) -> Iterator[Flag]:
    """Flags of a population; ``floored``: specimen -> draws of which a number was zero."""
    if not draws.converged:
        yield _of_chains(draws)
    outliers = [row for row in specimens if row.outlier is not None]
    if outliers:
        yield _of_outliers(outliers, len(specimens))
    smoothed = [row.specimen for row in specimens if row.smoothed]
    if smoothed:
        message = (
            f"the population lies among few draws of {len(smoothed)} of {len(specimens)} specimens "
            f"(first {smoothed[0]})"
        )
        yield Flag("likelihood_smoothed", message, {"specimens": smoothed})
    if floored:
        message = (
            f"{len(floored)} specimens (first {next(iter(floored))}) have no force or stiffness in "
            f"{sum(floored.values())} draws"
        )
        values = {"specimens": list(floored), "draws": list(floored.values())}
        yield Flag("draws_floored", message, values)
    share = predictive.refused / max(predictive.refused + len(predictive.theta), 1)
    if share > MANY_REFUSED or predictive.typical_is_drawn:
        message = f"{100 * share:.0f} % of drawn specimens were not passive and were drawn again"
        message += ", the typical one too" if predictive.typical_is_drawn else ""
        refused = {"refused": predictive.refused, "kept": len(predictive.theta)}
        yield Flag("population_not_passive", message, refused)
    for key, who in design.missing.items():
        message = f"{key} is not stated of {len(who)} specimens (first {who[0]}): the mean was taken"
        yield Flag("covariate_missing", message, {"covariate": key, "specimens": list(who)})


def _of_chains(draws: PopulationDraws) -> Flag:
    worst = max(draws.diagnostics.values(), key=lambda one: one.r_hat)
    least = min(min(one.ess_bulk, one.ess_tail) for one in draws.diagnostics.values())
    message = (
        f"chains over the population: R-hat {worst.r_hat:.3f} (wanted {R_HAT}), {least:.0f} effective draws "
        f"(wanted {ESS:.0f})"
    )
    return Flag("population_not_converged", message, {"r_hat": worst.r_hat, "ess": least})


def _of_outliers(outliers: Sequence[documents.Specimen], count: int) -> Flag:
    said = "; ".join(
        f"{row.specimen} (probability {row.far:.2f}, {row.outlier} {row.deviation:+.1f} sd)"
        for row in sorted(outliers, key=lambda row: -row.far)[:LONGEST_LIST]
    )
    more = f"; and {len(outliers) - LONGEST_LIST} more" if len(outliers) > LONGEST_LIST else ""
    message = f"far from the others: {said}{more}; of a normal population {0.01 * count:.2g} would be"
    return Flag("specimen_outlier", message, {"specimens": [row.specimen for row in outliers]})


#: Wanted half widths, relative.
PRECISIONS = (0.02, 0.05, 0.10)


def specimens_for_mean(between_sd: float, own_sd: float, precision: float) -> int:
    """Specimens for a relative half width of the 95 % interval of the mean; at least 3."""
    half = math.log1p(precision)
    return max(math.ceil(Z95**2 * (between_sd**2 + own_sd**2) / half**2), 3)


def specimens_for_sd(between_sd: float, own_sd: float, precision: float) -> int:
    """Specimens for a relative half width of the 95 % interval of the standard deviation; at least 3."""
    inflated = (between_sd**2 + own_sd**2) / between_sd**2
    return max(math.ceil(1.0 + 0.5 * (Z95 * inflated / precision) ** 2), 3)


def size_rows(names: tuple[str, ...], sd: FloatArray, own_sd: FloatArray) -> tuple[documents.CohortSize, ...]:
    """A row a quantity and precision; ``sd`` (n, p)."""
    spread = np.quantile(sd, [0.025, 0.5, 0.975], axis=0)
    rows = []
    for k, name in enumerate(names):
        for precision in PRECISIONS:
            means, sds = (
                [specimens_for(float(d[k]), float(own_sd[k]), precision) for d in spread]
                for specimens_for in (specimens_for_mean, specimens_for_sd)
            )
            rows.append(
                documents.CohortSize(
                    name, precision, means[1], (min(means), max(means)), sds[1], (min(sds), max(sds))
                )
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
    draws: PopulationDraws
    predictive: Predictive
    told: documents.Populations  # everything that is said of it


@dataclass(frozen=True, slots=True, eq=False)
class CohortFit:
    """Everything that is said of a cohort."""

    members: tuple[Member, ...]  # specimens that took part
    left_out: tuple[documents.LeftOut, ...]
    population: Population | None
    reason: str | None  # why there is no population
    agreement: documents.Agreement | None
    order: documents.Order | None
    confounding: documents.Confounding | None
    flags: tuple[Flag, ...]


def cohort(
    members: Sequence[Member], options: CohortOptions, tick: Callable[[str], None] = lambda _: None
) -> CohortFit:
    """The population behind specimens.

    ``members``: those that can't stand in one population are named in ``left_out``; ``tick``: told what is
    being done.  Raises UsageError: a covariate that no specimen states, or that is the same for all.
    """
    kept, left = fit_for_cohort(members)
    confounding = confounding_of([[trial.speed_mm_s for trial in one.trials] for one in members])
    order = order_effect(members)
    flags = confounding_flags(confounding)
    if len(kept) < FEWEST_SPECIMENS:
        reason = (
            f"{len(kept)} specimen{'s' * (len(kept) != 1)} with a posterior of one model: a population takes "
            f"{FEWEST_SPECIMENS} at least"
        )
        return CohortFit(kept, left, None, reason, None, order, confounding, tuple(flags))
    coordinates = Coordinates(model_of(kept))
    design = design_of(kept, options.group_by, options.covariates)
    stage, floored = stage_one(kept, coordinates)
    population = _population(kept, stage, coordinates, design, options, tick)
    specimens = population.told.specimens
    force = {row.specimen: row.pooled[coordinates.static_at_depth] for row in specimens}
    flags += population_flags(population.draws, population.predictive, specimens, design, floored)
    return CohortFit(kept, left, population, None, agreement(kept, force), order, confounding, tuple(flags))


def _population(
    members: Sequence[Member],
    stage: StageOne,
    coordinates: Coordinates,
    design: Design,
    options: CohortOptions,
    tick: Callable[[str], None],
) -> Population:
    draws = sample_population(stage, design, options.priors, options.sampler, tick)
    rng = np.random.default_rng([options.sampler.seed, 4])
    tick("drawing specimens from the population")
    predictive = predictive_specimens(draws, coordinates, rng)
    instrument = shared_instrument(members, coordinates)
    shown = of_quantities(draws, coordinates.logs)
    sd = shown.sd.reshape(-1, coordinates.size)
    own_sd = np.median([(one @ coordinates.logs.T).std(axis=0) for one in stage.phi], axis=0)
    predicted = None
    if options.hold_out:
        tick("predicting held-out specimens")
        fresh = np.random.default_rng([options.sampler.seed, 3])
        predicted = held_out(members, draws, design, coordinates, fresh)
    law, correlation = coordinates.model, shown.correlation.reshape(-1, coordinates.size, coordinates.size)
    heavy = None
    if np.isfinite(draws.nu).all():
        heavy = documents.DegreesOfFreedom(float(np.median(draws.nu)), interval_95(draws.nu))
    told = documents.Populations(
        model=documents.Model(law.branches, law.stiffness_degree, law.name),
        depth_mm=coordinates.depth_mm,
        quantities=quantity_rows(shown, coordinates, design, instrument, rng),
        correlation=np.clip(np.median(correlation, axis=0), -1.0, 1.0).tolist(),
        degrees_of_freedom=heavy,
        groups=design.compared,
        effects=effect_rows(shown, coordinates, design),
        specimens=specimen_rows(members, stage, shown, coordinates),
        repeatability=repeatability(members, sd[:, coordinates.static_at_depth], rng),
        held_out=predicted,
        cohort_size=size_rows(coordinates.names, sd, own_sd),
        predictive=documents.Predictive(
            len(predictive.theta), predictive.refused, predictive.typical_is_drawn
        ),
        sampler=_sampler(draws),
    )
    return Population(coordinates, draws, predictive, told)


def _sampler(draws: PopulationDraws) -> documents.Sampler:
    chains, sweeps = draws.nu.shape
    found = draws.diagnostics.values()
    return documents.Sampler(
        converged=draws.converged,
        chains=chains,
        sweeps=sweeps,
        r_hat=max(one.r_hat for one in found),
        r_hat_wanted=R_HAT,
        ess=min(min(one.ess_bulk, one.ess_tail) for one in found),
        ess_wanted=ESS,
    )
