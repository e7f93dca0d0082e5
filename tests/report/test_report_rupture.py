"""The page of ``tissueid rupture``."""

from __future__ import annotations

import html
from functools import partial
from typing import Any

import pytest
from fit_factory import identification
from report_pages import self_contained, wait_for_figures, wide
from rupture_cohorts import known_cohort, typical_threshold
from typed_call import typed_call

from tissueid.report.rupture_page import render_rupture
from tissueid.rupture.document import as_document
from tissueid.rupture.failures import Failure
from tissueid.rupture.run import RuptureRun
from tissueid.rupture.study import rupture_study
from tissueid.store.files import plain_json
from tissueid.store.schema import first_problem

render_rupture = typed_call(render_rupture)

pytestmark = pytest.mark.needs_jit


@pytest.fixture(scope="module")
def failures():
    return known_cohort("work", 0.05, [12], threshold=typical_threshold("work"), stop_mm=6.0)


def document_of(failures: list[Failure], asked: str = "auto") -> dict[str, Any]:
    run = RuptureRun(rupture_study(failures, weight=1.5, asked=asked), identification([]), ())
    bundles = {one.specimen: f"bundle-{one.specimen}.h5" for one in failures}
    return plain_json(as_document(run, bundles))


@pytest.fixture(scope="module")
def document(failures):
    return document_of(failures)


def test_the_page_asks_the_network_for_nothing_and_says_its_numbers(document):
    page = self_contained(partial(render_rupture, document))
    work = document["criteria"][0]

    assert first_problem(document, "rupture") is None
    assert "Criterion: work." in page
    assert f"{work['median']:.1f} N mm" in page
    said = html.unescape(page)
    for sentence in document["sentences"]:
        assert sentence in said


def test_tests_that_did_not_rupture_are_counted_and_explained(failures, document):
    censored = sum(not one.ruptured for one in failures)

    assert censored > 0
    assert sum(row["censored"] for row in document["speeds"]) == censored
    assert f"{censored} of 18 tests ended without a rupture" in " ".join(document["sentences"])


def test_the_page_says_what_the_bundles_do(document):
    laws = render_rupture(document)
    without = render_rupture(document | {"laws": [], "taken": "none", "asked": "none"})

    assert "The bundles rupture by total work." in laws
    assert "No rupture is written into the bundles." in without
    assert ("In the bundles" in laws, "In the bundles" in without) == (True, False)


def test_a_cohort_that_can_not_tell_says_so():
    failures = known_cohort("work", 0.05, [13], threshold=typical_threshold("work"), speeds=(600.0,))
    document = document_of(failures)

    assert "one speed" in document["decision"]["reason"]
    assert "Undecided." in render_rupture(document)


@pytest.mark.slow
@pytest.mark.browser
def test_figures_draw_themselves_without_an_error(opened, failures, document):
    tab = opened(render_rupture(document), width=1200, height=5000)
    wait_for_figures(tab, 3)
    traces = tab.evaluate("document.querySelectorAll('.scatterlayer .trace').length")
    # specimens that ruptured and the mean, twice; work and depth of the four criteria
    specimens = len({one.specimen for one in failures if one.ruptured})
    assert traces == 2 * (specimens + 1) + 2
    assert wide(tab) <= 1200
