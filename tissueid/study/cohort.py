"""From the specimens of a finished fit to their population, written into the same output folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from tissueid.documents import plain
from tissueid.documents.population import Population
from tissueid.errors import NotIdentifiedError, printable
from tissueid.population.cohort import CohortFit, CohortOptions, cohort
from tissueid.population.document import as_document, members_of, population_bundle, population_priors
from tissueid.population.members import thawed_among_fresh
from tissueid.report.population_page import render_population
from tissueid.store.bundle import write_bundle
from tissueid.store.files import IDENTIFICATION, json_bytes, sha256_of, time_now
from tissueid.store.outputs import OutputSet
from tissueid.store.results import each_result, read_identification
from tissueid.store.schema import check

_DOCUMENT, _BUNDLE, _PAGE = "population.json", "population.h5", "cohort.html"
#: Covariates that tell thawed tissue from fresh, and specimens that a refusal names.
STATES, MOST_NAMED = {"storage", "freeze_thaw_cycles"}, 5
#: What is written into the output folder.
POPULATION_FILES = (_DOCUMENT, _BUNDLE, _PAGE)


@dataclass(frozen=True, slots=True, eq=False)
class WrittenPopulation:
    """population.json as it was written, and the cohort behind it."""

    document: Population
    fit: CohortFit
    felt: bool = True  # specimens drawn from it are in population.h5

    @property
    def converged(self) -> bool:
        """True where the chains met their rule."""
        found = self.document.population
        return found is not None and found.sampler.converged


def write_population(
    out: Path, options: CohortOptions, progress: Callable[[str, int, int], None], *, mix_states: bool = False
) -> WrittenPopulation:
    """Draw the population of the specimens in an output folder and write it beside them.

    ``options``: the study's priors take the place of theirs; ``mix_states``: pool thawed specimens with fresh
    ones.  Raises NotIdentifiedError: there are too few specimens with a posterior; each that takes no part is
    named; BundleError: the folder is not whole, or another process writes into it.
    """
    with OutputSet(out) as run:
        identification = read_identification(out)
        options = replace(options, priors=population_priors(identification))
        members = members_of(identification, each_result(out))
        if not mix_states and not STATES & {options.group_by, *options.covariates}:
            _refuse_mixed(*thawed_among_fresh(members))
        fit = cohort(members, options, lambda text: progress(text, 0, 0))
        document = as_document(fit, options, source=sha256_of(out / IDENTIFICATION))
        written = plain(document)
        if fit.population is None:
            left = "".join(f"; {printable(row.specimen)}: {row.reason}" for row in document.left_out)
            raise NotIdentifiedError(f"no population: {document.reason}{left}")
        check(written, Population, where=_DOCUMENT)
        progress("writing the report", 0, 0)
        run.carry_over(but=POPULATION_FILES)
        run.write(_DOCUMENT, json_bytes(written))
        bundle = population_bundle(fit, document.provenance)
        if bundle is not None:
            write_bundle(bundle, run.path(_BUNDLE))
        run.write(_PAGE, render_population(document, bundle, created=time_now()).encode("utf-8"))
        run.commit()
    return WrittenPopulation(document=document, fit=fit, felt=bundle is not None)


def _refuse_mixed(thawed: list[str], fresh: list[str]) -> None:
    """Freezing damages cells and matrix: thawed and fresh tissue are no one population."""
    if thawed and fresh:
        names = ", ".join(printable(one) for one in thawed[:MOST_NAMED])
        more = f" and {len(thawed) - MOST_NAMED} more" if len(thawed) > MOST_NAMED else ""
        raise NotIdentifiedError(
            f"no population: {names}{more} thawed among {len(fresh)} fresh; --mix-states pools them, "
            "tissueid cohort --group-by storage compares them"
        )
