"""The page of recomputed papers: kinds told apart, figures that are what the document says."""

from __future__ import annotations

from functools import partial
from typing import Any

import pytest
from report_pages import drawn, self_contained, wait_for_figures
from typed_call import typed_call

from tissueid.documents import plain
from tissueid.report.reproduction_page import KINDS, render_reproduction
from tissueid.reproduce.controller import table_3
from tissueid.reproduce.document import PAPER_WORDS, PLACES
from tissueid.reproduce.hip import guidance_forces, restitutions
from tissueid.reproduce.published import PIRES, SADEGHNEJAD, Ledger, Readings, rounded
from tissueid.reproduce.speeds import force_displacement, peak_against_speed
from tissueid.store.files import plain_json
from tissueid.store.schema import check

render_reproduction = typed_call(render_reproduction)


@pytest.fixture(scope="module")
def document():
    readings = Readings()
    ledger = Ledger(SADEGHNEJAD)
    items, figures = [ledger.item("table-2/tau", 0.0234, judge=rounded(3))], []
    for rows, figure in (
        force_displacement(readings),
        peak_against_speed(readings),
        guidance_forces(readings),
    ):
        items += rows
        figures.append(figure)
    items += [*restitutions(), *table_3(readings)]
    found: dict[str, Any] = plain_json(
        {
            "schema": "tissueid/reproduction/1",
            "tissueid": "0",
            "papers": [
                {"name": name, "words": PAPER_WORDS[name], "places": list(PLACES[name])}
                for name in (SADEGHNEJAD, PIRES)
            ],
            "seed": 1,
            "seconds": 1.0,
            "readings": readings.as_json(),
            "items": plain(items),
            "figures": plain(figures),
            "lost": ["everything"],
        }
    )
    check(found, "reproduction", where="reproduction.json")
    return found


def test_every_row_says_its_kind_in_words_and_asks_the_network_for_nothing(document):
    page = self_contained(partial(render_reproduction, document))
    for item in document["items"]:
        row = page.partition(f'data-item="{item["item"]}"')[2].partition("</tr>")[0]
        assert f"{KINDS[item['kind']][1]}</i>{item['kind']}</span>" in row
        assert ("not printed" in row) is (item["published"] is None)


def test_a_number_that_differs_comes_first(document):
    page = render_reproduction(document)
    assert "Not everything agrees" in page
    assert "Differing: Relaxation time." in page
    right = {**document, "items": document["items"][1:]}
    assert "Not everything agrees" not in render_reproduction(right)


@pytest.mark.browser
def test_figures_are_drawn_from_the_document(opened, document):
    page = opened(render_reproduction(document), width=1200, height=6000)
    wait_for_figures(page, 3)
    traces = {figure["key"]: drawn(page, figure["key"]) for figure in document["figures"]}
    titles = page.evaluate("[...document.querySelectorAll('.xtitle')].map(one => one.textContent)")
    overflow = {}
    for width in (1400, 800, 400):
        page.set_viewport_size({"width": width, "height": 900})
        # figures follow a moment later
        page.wait_for_function("document.documentElement.scrollWidth <= innerWidth", timeout=30_000)
        overflow[width] = page.evaluate("document.documentElement.scrollWidth - innerWidth")
    for figure in document["figures"]:
        wanted = [{key: trace[key] for key in ("name", "x", "y")} for trace in figure["traces"]]
        assert [{key: one[key] for key in ("name", "x", "y")} for one in traces[figure["key"]]] == wanted
    assert titles == [figure["x_title"] for figure in document["figures"]]
    assert overflow == dict.fromkeys((1400, 800, 400), 0)
