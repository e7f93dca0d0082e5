"""The page for everybody: axe-core, keyboard, colours, widths and paper."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from fit_factory import specimen_fit
from posterior_factory import sampled
from report_pages import document_of, grave, open_all, page, wide
from typed_call import typed_call

from tissueid.documents import typed
from tissueid.documents.twin import Twin
from tissueid.report import page as report_page
from tissueid.report.page import Beside
from tissueid.report.twin_page import twin_sections
from tissueid.store.posteriors import posteriors_of_fits
from tissueid.study.completeness import completeness_of_result
from tissueid.study.pages import rendering_of

completeness_of_result = typed_call(completeness_of_result)
rendering_of = typed_call(rendering_of)

pytestmark = pytest.mark.browser

LIMIT = {"of": "force", "share": 0.07, "source": "Jones 1989", "doi": "10.1068/p180681", "conditions": "-"}
ROWS = [
    {"name": "tau", "symbol": "tau1", "unit": "s", "went_in": 1.0, "went_in_ci95": [0.9, 1.1],
     "came_out": out, "came_out_ci95": span, "verdict": verdict}
    for out, span, verdict in ((1.0, [0.8, 1.2], "inside"), (None, None, "destroyed"))
]  # fmt: skip
TWIN = {
    "schema": "tissueid/twin/1", "specimen": "liver-1", "model": "kelvin-voigt", "program": "indent 4 mm",
    "force_scale": 0.01, "motion_scale": 5.0, "limit": LIMIT,
    "unseen": {"speed_mm_s": 2.0, "nrmsd_model": 0.002},
    "devices": [{"device": "emulated Falcon", "nrmsd_model": 0.001, "nrmsd_recording": 0.002,
                 "fit_nrmsd": 0.001, "noticeable": 0.1, "rows": ROWS}],
}  # fmt: skip
TEMPLATE = Path(report_page.__file__).with_name("templates") / "specimen.html.j2"
#: Figures of a specimen; a relaxation time that is not identified has no profile.
FIGURES = set(re.findall(r'part\.figure\("(\w+)"', TEMPLATE.read_text("utf-8"))) - {"profile"}
DEVICE = {"sensible": (1400, 900), "tablet": (800, 1000), "telephone": (400, 800)}


@pytest.fixture(scope="module")
def whole():
    """A page with every part that a report can have."""
    fit = sampled(specimen_fit(trials=3, samples=120, identified=False))
    specimen = document_of(fit)["specimens"][0]
    described = completeness_of_result(None)
    return page(
        fit,
        refused=True,
        renderings=[rendering_of(specimen, posteriors_of_fits([fit])[0])],
        beside=Beside(described, twin_sections(typed(TWIN, Twin))),
    )


def draw_all(tab: Any) -> set[str]:
    """Open everything and wait until every figure is drawn; their kinds."""
    open_all(tab)
    boxes = tab.locator("[data-figure]")
    for place in range(boxes.count()):
        # what is above may grow as it is drawn and push this one out of sight again
        tab.wait_for_function(
            """(place) => {
                const box = document.querySelectorAll("[data-figure]")[place];
                if (!box.data) box.scrollIntoView();
                return Boolean(box.data);
            }""",
            arg=place,
            polling=100,
        )
    return set(tab.evaluate("[...document.querySelectorAll('[data-figure]')].map((b) => b.dataset.figure)"))


#: Looked at whenever the tests run; the others with the slow tests.
BY_DEFAULT = {("telephone", "dark")}


@pytest.mark.parametrize(
    ("size", "scheme"),
    [
        pytest.param(size, scheme, marks=[pytest.mark.slow] * ((size, scheme) not in BY_DEFAULT))
        for size in DEVICE
        for scheme in ("light", "dark")
    ],
)
def test_axe_finds_no_serious_issue(opened, whole, scheme, size):
    width, height = DEVICE[size]
    tab = opened(whole, width=width, height=height, color_scheme=scheme)
    assert draw_all(tab) == FIGURES
    assert grave(tab) == []
    assert wide(tab) == width


def test_every_control_is_reached_and_seen_by_the_keyboard(opened, whole):
    tab = opened(whole)
    open_all(tab)
    tab.keyboard.press("Tab")
    assert tab.evaluate("document.activeElement.className") == "skip"
    reached = set()
    for _ in range(120):
        tab.keyboard.press("Tab")
        kind, outline = tab.evaluate(
            "[document.activeElement.tagName, getComputedStyle(document.activeElement).outlineStyle]"
        )
        if kind == "BODY":
            break
        # what has the focus shows it
        assert outline != "none", kind
        reached.add(kind)
    assert {"SELECT", "SUMMARY", "INPUT", "BUTTON", "DIV", "A"} <= reached


def test_paper_is_white_and_whole_even_from_a_dark_screen(opened, whole):
    tab = opened(whole, color_scheme="dark")
    pages = tab.pdf(format="A4")
    assert pages.startswith(b"%PDF")
    # a picture a figure: an empty page would be a few kB
    assert len(pages) > 100_000
    assert tab.evaluate("[...document.querySelectorAll('details')].every((one) => one.open)")
    assert tab.evaluate("[...document.querySelectorAll('[data-figure]')].every((box) => box.data)")
    tab.emulate_media(media="print")
    assert tab.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    tab.wait_for_function(
        "[...document.querySelectorAll('[data-figure]')].every((box) => box.layout.paper_bgcolor === '#fff')"
    )
    # nothing stands beyond the edge of a sheet of A4 with its margins
    tab.set_viewport_size({"width": 718, "height": 1000})
    tab.wait_for_function("document.documentElement.scrollWidth <= 718")
    assert tab.evaluate("getComputedStyle(document.querySelector('.choose')).display") == "none"


def test_series_are_told_apart_without_colour(opened, whole):
    tab = opened(whole)
    draw_all(tab)
    dashes = tab.evaluate(
        """document.querySelector('[data-figure=parts]').data
            .filter((t) => t.xaxis === 'x2' && t.mode === 'lines' && !t.fill).map((t) => t.line.dash)"""
    )
    assert len(set(dashes)) == len(dashes) == 3


@pytest.mark.slow
@pytest.mark.browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_gallery_can_be_read_by_everybody(browser, scheme):
    path = Path(__file__).resolve().parents[2] / "reports" / "gallery" / "index.html"
    page = browser.new_page(viewport={"width": 400, "height": 800}, color_scheme=scheme)
    page.goto(path.as_uri())
    assert grave(page) == []
    assert wide(page) <= 400
    page.close()
