"""The page of a population: its numbers, bands and figures."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
from cohort_outputs import cohort_fits, study_of
from fit_factory import identification
from report_pages import self_contained, wait_for_figures
from typed_call import typed_call

from tissueid.documents import plain, typed
from tissueid.documents.identification import Identification
from tissueid.population.cohort import CohortOptions, cohort
from tissueid.population.document import as_document, members_of, population_bundle
from tissueid.population.sampler import SamplerOptions
from tissueid.report.population_page import (
    MOST_DRAWN,
    held_out_sentence,
    population_payload,
    render_population,
)
from tissueid.store.curves import curves_of_fits
from tissueid.store.posteriors import posteriors_of_fits

members_of = typed_call(members_of)
held_out_sentence = typed_call(held_out_sentence)
render_population = typed_call(render_population)
population_payload = typed_call(population_payload)


@pytest.fixture(scope="module")
def found():
    fits = cohort_fits(6)
    document = plain(identification(fits).as_json()) | {"study": study_of(fits)}
    options = CohortOptions(group_by="sex", sampler=SamplerOptions(draws=1000, blocks=1))
    results = [
        (entry, curves_of_fits([one]), posteriors_of_fits([one])[0])
        for entry, one in zip(typed(document, Identification).specimens, fits, strict=True)
    ]
    fit = cohort(members_of(document, results), options)
    document = as_document(fit, options, source="0" * 64)
    bundle = population_bundle(fit, document.provenance)
    assert bundle is not None
    return plain(document), bundle


def test_the_page_asks_the_network_for_nothing_and_says_its_numbers(found):
    document, bundle = found
    page = self_contained(partial(render_population, document, bundle))
    said = ("Population of 6 specimens", "Intraclass correlation", "sex: m against f", "4.23 to 10.95 %")
    for words in (*said, document["population"]["quantities"][2]["words"]):
        assert words in page


def test_paper_a_is_compared_with_and_not_claimed():
    spread = {"median": 0.05, "low68": 0.02, "high68": 0.13}
    wide = {"median": 0.4, "low68": 0.2, "high68": 0.5}
    held: dict[str, Any] = {
        "folds": 3, "paper_a_percent": [4.23, 10.95], "nrmsd_range": spread, "nrmsd_mean": wide, "trials": [],
    }  # fmt: skip

    assert "is consistent with that, which proves nothing" in held_out_sentence(held)
    assert "lies outside that" in held_out_sentence(held | {"nrmsd_range": wide})


def test_bands_of_force_hold_the_typical_tissue(found):
    bands = population_payload(*found)["bands"]
    low, high = bands["quantiles"][0], bands["quantiles"][4]
    assert all(a <= b <= c for a, b, c in zip(low[1:], bands["typical"][1:], high[1:], strict=True))


def test_a_large_cohort_draws_its_outliers_and_an_even_choice(found):
    document, _ = found
    row = document["population"]["specimens"][0]
    many = [
        row | {"specimen": f"s{k}", "outlier": "relaxation_time_s" if k == 777 else None} for k in range(900)
    ]
    large = document | {"population": document["population"] | {"specimens": many}}

    shown = population_payload(large, None)["specimens"]

    assert len(shown) == MOST_DRAWN
    assert [one["name"] for one in shown if one["outlier"]] == ["s777"]


@pytest.mark.browser
def test_figures_draw_themselves_without_an_error(opened, found):
    page = opened(render_population(*found), width=1200, height=6000)
    wait_for_figures(page, 5)
    page.select_option("#quantity", "4")
    page.wait_for_timeout(300)
    axis = page.evaluate("document.querySelector('[data-figure=shrinkage]').layout.yaxis.title.text")
    points = page.evaluate(
        "document.querySelector('[data-figure=shrinkage]').querySelectorAll('.scatterlayer .point').length"
    )
    assert axis == "relaxation time [s]"
    # six specimens, alone and with the population
    assert points == 12
