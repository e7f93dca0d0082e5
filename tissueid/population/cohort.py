"""A population from specimens: the one call that composes the parts of this package."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tissueid.flags import Flag
from tissueid.population.agreement import (
    Agreement,
    OrderEffect,
    Repeatability,
    agreement,
    order_effect,
    repeatability,
)
from tissueid.population.cohort_size import SizeRow, size_rows
from tissueid.population.confounding import Confounding, speed_confounding
from tissueid.population.coordinates import Coordinates
from tissueid.population.design import Described, design_of
from tissueid.population.held_out import HeldOut, held_out
from tissueid.population.members import FEWEST_SPECIMENS, LeftOut, Member, fit_for_cohort, stage_one
from tissueid.population.predictive import Predictive, predictive_specimens
from tissueid.population.remarks import population_flags
from tissueid.population.rows import (
    EffectRow,
    QuantityRow,
    SpecimenRow,
    effect_rows,
    quantity_rows,
    specimen_rows,
)
from tissueid.population.sampler import PopulationDraws, SamplerOptions, sample_population
from tissueid.population.shared_instrument import shared_instrument
from tissueid.population.stage_one import StageOne
from tissueid.priors import PopulationPriors

#: Coordinate of the static force at the common depth.
STATIC_AT_DEPTH = 2


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
    quantities: tuple[QuantityRow, ...]
    specimens: tuple[SpecimenRow, ...]
    effects: tuple[EffectRow, ...]
    held_out: HeldOut | None
    repeatability: Repeatability | None
    sizes: tuple[SizeRow, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CohortFit:
    """Everything that is said of a cohort."""

    members: tuple[Member, ...]  # specimens that took part
    left_out: tuple[LeftOut, ...]
    population: Population | None
    reason: str | None  # why there is no population
    agreement: Agreement | None
    order: OrderEffect | None
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
    branches, degree = kept[0].order
    coordinates = Coordinates(branches, degree, min(one.depth_mm for one in kept))
    described = design_of(kept, options.group_by, options.covariates)
    stage, floored = stage_one(kept, coordinates)
    population = _population(kept, stage, coordinates, described, options, tick)
    force = {row.specimen: row.pooled[STATIC_AT_DEPTH] for row in population.specimens}
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
        repeatability=repeatability(members, sd[:, STATIC_AT_DEPTH], rng),
        sizes=size_rows(coordinates.names, sd, np.asarray(own_sd, dtype=np.float64)),
    )
