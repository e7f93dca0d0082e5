"""A cohort as ``population.json`` and ``population.h5``, and the specimens of a finished fit as a cohort."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from msgspec import structs

from tissueid import __version__
from tissueid.arrays import evenly
from tissueid.documents import typed
from tissueid.documents.identification import Identification, Specimen
from tissueid.documents.population import Population, Provenance
from tissueid.model.grammar import KELVIN_VOIGT
from tissueid.population.cohort import CohortFit, CohortOptions, central_covariance, of_quantities
from tissueid.population.members import FEWEST_DRAWS, MOST_DRAWS_IN_ALL, Member, TrialRow
from tissueid.priors import PopulationPriors, SpreadPrior
from tissueid.result import Estimate, ModelChoice
from tissueid.store.bundle import Bundle
from tissueid.store.curves import TrialCurve
from tissueid.store.posteriors import StoredPosterior

#: Draws of mean and spread that a bundle keeps.
KEPT_DRAWS = 4000
PROVENANCE = ("group_by", "covariates", "tails", "seed", "priors", "identification_sha256")
AS_THEY_ARE = ("left_out", "reason", "agreement", "order", "confounding", "flags")
#: Specimens whose curves are kept, to be predicted from the others; of more an even choice.
MOST_WITH_CURVES = 200
_NO_UNITS: Mapping[str, str] = {"length": "mm", "force": "N", "time": "s"}


def members_of(
    document: Identification, results: Iterable[tuple[Specimen, Sequence[TrialCurve], StoredPosterior | None]]
) -> tuple[Member, ...]:
    """The specimens of a finished fit, with as many draws as a cohort of that size can use."""
    study = document.study
    covariates = {row.specimen: structs.asdict(row) for row in study.specimens} if study else {}
    order = {(row.path, row.sheet): (row.run, row.site) for row in study.trials} if study else {}
    count = len(document.specimens)
    most = max(MOST_DRAWS_IN_ALL // max(count, 1), FEWEST_DRAWS)
    with_curves = set(evenly(count, MOST_WITH_CURVES).tolist())
    members = []
    for place, (entry, curves, posterior) in enumerate(results):
        known = {"operator": study and study.study.operator} | covariates.get(entry.specimen, {})
        known.pop("specimen", None)
        drawn = {(one.path, one.sheet): one.curve for one in curves if place in with_curves}
        validity = entry.validity
        rows = []
        for one in entry.trials:
            where = one.path, one.sheet
            run, site = order.get(where, (None, None))
            rows.append(TrialRow(*where, one.gain, one.speed_mm_s, one.depth_mm, run, site, drawn.get(where)))
        members.append(
            Member(
                specimen=entry.specimen,
                model=ModelChoice.of(entry.model),
                depth_mm=validity.depth_mm,
                **_draws(posterior, most, key=entry.model.key),
                covariates=known,
                trials=tuple(rows),
                speeds_mm_s=validity.speeds_mm_s,
                tip_radius_mm=validity.tip_radius_mm,
                sigma_N=entry.sigma_N,
                units=structs.asdict(entry.units),
            )
        )
    return tuple(members)


def _draws(posterior: StoredPosterior | None, most: int, *, key: str) -> dict[str, Any]:
    """Draws of a member, evenly thinned."""
    if posterior is None:
        return {"draws": np.empty((0, 0)), "log_prior": None, "draws_total": None}

    def thin(values: Any) -> Any:
        return None if values is None else values[evenly(len(values), most)].copy()

    prior = posterior.log_prior
    if key != KELVIN_VOIGT and prior is not None and not prior.any():
        # outputs of older versions had no prior density of other laws
        prior = None
    return {
        "draws": thin(posterior.draws),
        "log_prior": thin(prior),
        "draws_total": thin(posterior.draws_total),
    }


def population_priors(document: Identification) -> PopulationPriors:
    """Priors of the population as the study stated them, defaults where it is silent."""
    stated = document.study.population if document.study else None
    if stated is None:
        return PopulationPriors()
    plain_numbers = ("mean_sd", "effect_sd", "correlation_shape")
    told: dict[str, Any] = {name: value for name in plain_numbers if (value := getattr(stated, name))}
    for name in ("between", "level"):
        if (spread := getattr(stated, name)) is not None:
            told[name] = SpreadPrior(spread.median, spread.sd_ln)
    if stated.tails is not None:
        told |= {"tail_shape": stated.tails.shape, "tail_rate": stated.tails.rate}
    return PopulationPriors(**told)


def as_document(fit: CohortFit, options: CohortOptions, *, source: str) -> Population:
    """The document of a cohort."""
    return Population(
        schema="tissueid/population/1",
        specimens_used=tuple(one.specimen for one in fit.members),
        population=None if fit.population is None else fit.population.told,
        **{key: getattr(fit, key) for key in AS_THEY_ARE},
        provenance=typed(
            {
                "tissueid": __version__,
                "identification_sha256": source,
                "group_by": options.group_by,
                "covariates": options.covariates,
                "tails": options.sampler.tails,
                "seed": options.sampler.seed,
                "priors": options.priors.as_json(),
            },
            Provenance,
        ),
    )


def population_bundle(fit: CohortFit, said: Provenance) -> Bundle | None:
    """The population as a bundle: typical tissue, covariance between specimens, specimens drawn from it."""
    found = fit.population
    if found is None or len(found.predictive.theta) < 2:
        return None
    coordinates, theta = found.coordinates, found.predictive.theta
    rows = evenly(len(found.draws.mean), KEPT_DRAWS)
    mean, shown = found.draws.mean[rows], of_quantities(found.draws, coordinates.logs)
    # t tails of few degrees of freedom have no variance: the covariance is that of the central 99 %
    with np.errstate(over="ignore", invalid="ignore"):
        covariance = central_covariance(theta)
    if not np.isfinite(covariance).all():
        return None
    spread = coordinates.to_theta(mean).std(axis=0)
    tips = {one.tip_radius_mm for one in fit.members}
    law = coordinates.model
    options = {key: getattr(said, key) for key in PROVENANCE}
    # exponentials are themselves at all times, other relaxations are looked at on a range
    looked_at = (law.resolution_s, law.window_s) if np.isfinite(law.window_s) else None
    return Bundle(
        specimen=f"population of {len(fit.members)} specimens",
        model=replace(fit.members[0].model, static_pooling="shared", range_s=looked_at),
        theta_names=coordinates.model.parameter_names,
        theta=found.predictive.typical,
        covariance=covariance,
        parameters=tuple(
            Estimate(spec.name, spec.symbol, spec.unit, float(value), float(error), identified=True)
            for spec, value, error in zip(
                coordinates.model.parameters, found.predictive.typical, spread, strict=True
            )
        ),
        depth_mm=coordinates.depth_mm,
        speeds_mm_s=(
            min(one.speeds_mm_s[0] for one in fit.members),
            max(one.speeds_mm_s[1] for one in fit.members),
        ),
        tip_radius_mm=tips.pop() if len(tips) == 1 else None,
        sigma_N=float(np.median([one.sigma_N for one in fit.members])),
        flags=fit.flags,
        provenance={"tissueid": said.tissueid, "versions": {}, "options": options, "inputs": []},
        draws=theta,
        population_mean=shown.mean[rows],
        population_sd=shown.sd.reshape(-1, coordinates.size)[rows],
        units=dict(fit.members[0].units) or dict(_NO_UNITS),
    )
