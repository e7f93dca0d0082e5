"""The page of ``design``: verdict, table and limits in words, points of the figures read back."""

from __future__ import annotations

from copy import deepcopy
from functools import cache, partial
from typing import Any

import pytest
from report_pages import drawn, self_contained, wait_for_figures, wide
from typed_call import typed_call

from tissueid.design.document import design_document
from tissueid.design.machine import PRESETS
from tissueid.design.plan import against, planned
from tissueid.design.precision import Asked, given_protocol
from tissueid.design.tissues import given_recipe, of_recipe_tissue, parsed_want
from tissueid.report.design_page import render_design
from tissueid.store.files import plain_json
from tissueid.store.schema import first_problem

render_design = typed_call(render_design)

pytestmark = pytest.mark.needs_jit


@cache
def made(machine_name: str) -> dict[str, Any]:
    machine, recipe = PRESETS[machine_name], given_recipe("paper-a-30")
    tissues = of_recipe_tissue(recipe)
    wants = tuple(parsed_want(text, tissues.model) for text in ("tau=2%", "eta=1%"))
    asked = Asked(wants=wants, max_depth_mm=8.0, max_force_N=machine.max_force_N)
    given = against(recipe.name, given_protocol(recipe), machine, tissues, asked)
    plan = planned(machine, tissues, asked, lambda _message, _done, _total: None)
    document: dict[str, Any] = plain_json(
        design_document(plan, machine, tissues, asked, given=given, specimens=17)
    )
    assert first_problem(document, "design") is None
    return document


def test_page_recommends_and_says_what_the_given_protocol_takes():
    document = made("paper-a")
    page = self_contained(partial(render_design, document))
    best, other = document["protocols"][0], document["against"]["protocol"]
    assert "<strong>Within reach.</strong>" in page
    assert f"{best['logs']} logs in {best['seconds'] / 60:.1f} min of machine time" in page
    assert f"paper-a-30 takes {other['seconds'] / 60:.1f} min" in page
    for one in document["protocols"]:
        for row in one["indentations"]:
            assert f"{row['repeats']} × {row['words']}" in page
    assert "17 specimens" in page
    assert "What limits it" not in page
    assert "The frame is taken as rigid" in page


def test_page_says_that_none_can_how_near_it_comes_and_what_limits_it():
    document = made("slow-logger")
    page = render_design(document)
    assert "<strong>None on this machine.</strong>" in page
    tau = document["protocols"][0]["precision"][0]["assured"]
    assert f"relaxation time to {100 * tau:.1f} %" in page
    assert "What limits it" in page
    for one in document["verdict"]["limits"]:
        assert one["words"] in page
    assert "paper-a-30 can&rsquo;t be run on this machine: it moves at 70 mm/min" in page
    assert "fit will flag it" in page


def figures_of(opened: Any, html: str, *, width: int = 1200) -> list[dict[str, Any]]:
    """Traces of every figure as plotly holds them, types of its axes, and marks that are drawn."""
    tab = opened(html, width=width, height=4000)
    wait_for_figures(tab, 2)
    figures = [
        {"traces": drawn(tab, "precision", want=want)}
        | tab.evaluate(
            "want => { const box = document.querySelectorAll('[data-figure]')[want]; return {"
            " x: box.layout.xaxis.type, y: box.layout.yaxis.type,"
            " marks: box.querySelectorAll('.scatterlayer .point').length }; }",
            want,
        )
        for want in (0, 1)
    ]
    assert wide(tab) <= width
    return figures


def expected(document: dict[str, Any], want: int) -> dict[str, list[list[float]]]:
    def points(rows: list[dict[str, Any]]) -> list[list[float]]:
        return [
            [one["seconds"] / 60.0 for one in rows],
            [100.0 * one["precision"][want]["assured"] for one in rows],
        ]

    front = sorted(document["front"], key=lambda one: one["seconds"])
    return {
        "least time": points(front),
        "protocols": points(document["protocols"]),
        "paper-a-30": points([document["against"]["protocol"]]),
    }


@pytest.mark.browser
def test_figures_hold_the_points_of_the_tables(opened):
    document = made("paper-a")
    for want, figure in enumerate(figures_of(opened, render_design(document))):
        assert (figure["x"], figure["y"]) == ("log", "log")
        found = {one["name"]: [one["x"], one["y"]] for one in figure["traces"]}
        for name, points in expected(document, want).items():
            # the page carries the numbers whole
            assert found[name] == [pytest.approx(axis, rel=1e-12) for axis in points], name
        wanted = 100.0 * document["asked"]["wants"][want]["share"]
        assert found["wanted"][1] == pytest.approx([wanted, wanted])
        points_drawn = sum(len(points[0]) for points in expected(document, want).values())
        assert figure["marks"] == points_drawn


@pytest.mark.browser
def test_a_wrong_point_would_be_seen_and_a_small_screen_holds_the_page(opened):
    document = made("paper-a")
    wrong = deepcopy(document)
    wrong["protocols"][0]["precision"][0]["assured"] *= 1.5
    figure, _ = figures_of(opened, render_design(wrong), width=400)
    found = {one["name"]: one["y"] for one in figure["traces"]}
    assert found["protocols"] != pytest.approx(expected(document, 0)["protocols"][1], rel=1e-12)
