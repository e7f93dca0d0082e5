"""Remarks beside the numbers of a population."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from tissueid.flags import Flag
from tissueid.population.design import Described
from tissueid.population.predictive import Predictive
from tissueid.population.rows import SpecimenRow
from tissueid.population.sampler import ESS_A_CHAIN, R_HAT, PopulationDraws

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
    specimens: Sequence[SpecimenRow],
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


def _of_outliers(specimens: Sequence[SpecimenRow]) -> list[Flag]:
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
