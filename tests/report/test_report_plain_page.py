"""A page of sections: its numbers stand in it, and a browser draws its figures without a word."""

from __future__ import annotations

import pytest
from report_pages import payload_of

from tissueid.report.page import render_plain
from tissueid.report.parts import Figure, Section, Table

LINE = {"x": [0, 1], "y": [1, 2], "mode": "lines", "line": {"ink": "data", "width": 3}}
DOTS = {"x": [0, 1], "y": [2, 1], "mode": "markers", "marker": {"ink": "model"}}
PLAIN = {"x": [0, 1], "y": [3, 3]}


def page() -> str:
    figure = Figure("Two <lines>", "x [mm]", "y [N]", [LINE, DOTS, PLAIN], {"yaxis": {"rangemode": "tozero"}})
    return render_plain(
        "A <title>", [Section("One", "Words.", [Table(("a", "b"), [("1", "<2>")])], [figure])]
    )


def test_words_are_escaped_and_numbers_stand_in_the_page():
    text = page()
    assert "A &lt;title&gt;" in text
    assert "<td>&lt;2&gt;</td>" in text
    (figure,) = payload_of(text, "figures")
    assert (figure["x"], figure["traces"]) == ("x [mm]", [LINE, DOTS, PLAIN])


def test_a_page_without_figures_carries_no_script():
    assert "<script" not in render_plain("Empty", [Section("One", "Words.")])


@pytest.mark.browser
@pytest.mark.slow
def test_a_browser_draws_every_trace_in_the_pages_colours(opened):
    tab = opened(page())
    tab.locator("[data-drawn=yes] .scatterlayer .trace").nth(2).wait_for(state="attached")
    colours = tab.evaluate("document.querySelector('[data-figure]').data.map((one) => one.line?.color)")
    ink = tab.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--data').trim()")
    assert colours[0] == ink
