"""The page of a fit in a browser: figures and links, silent, on every screen and without a pointer."""

import base64
import io
import re
from functools import partial
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
from fit_factory import specimen_fit
from posterior_factory import sampled
from report_pages import (
    document_of,
    drawn,
    grave,
    open_all,
    page,
    payload_of,
    render_report,
    self_contained,
    wide,
)
from typed_call import typed_call

from tissueid.arrays import kept_samples
from tissueid.documents import typed
from tissueid.documents.twin import Twin
from tissueid.report import page as report_page
from tissueid.report.figures import curve_bytes, thinned
from tissueid.report.page import plotly_script
from tissueid.report.twin_page import twin_sections
from tissueid.store.curves import curves_of_fits
from tissueid.store.posteriors import posteriors_of_fits
from tissueid.study.completeness import completeness_of_result
from tissueid.study.pages import rendering_of

LARGEST_PAGE_BYTES = 7_000_000


class Outline(HTMLParser):
    """Collects headings, ids, outside references and unlabelled parts."""

    def __init__(self) -> None:
        super().__init__()
        self.levels: list[int] = []
        self.ids: list[str] = []
        self.outside: list[str] = []
        self.bare_headers = 0
        self.unlabelled = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if re.fullmatch(r"h[1-6]", tag):
            self.levels.append(int(tag[1]))
        if given.get("id"):
            self.ids.append(str(given["id"]))
        for name in ("src", "href"):
            value = given.get(name) or ""
            if value and not value.startswith(("#", "data:")):
                self.outside.append(value)
        self.bare_headers += tag == "th" and "scope" not in given
        self.unlabelled += given.get("role") in {"img", "region", "group"} and not given.get("aria-label")


def outline(html: str) -> Outline:
    parsed = Outline()
    parsed.feed(html)
    return parsed


CASES = {
    "one": lambda: page(specimen_fit(samples=60)),
    "refused": lambda: page(specimen_fit(samples=60, identified=False), refused=True),
    "several": lambda: page(*(specimen_fit(name, trials=1, samples=60) for name in "abc"), refused=True),
    "none": lambda: page(refused=True),
}


@pytest.mark.parametrize("case", CASES)
def test_structure_is_sound(case):
    parsed = outline(CASES[case]())
    assert parsed.outside == []
    assert parsed.bare_headers == 0
    assert parsed.unlabelled == 0
    assert len(parsed.ids) == len(set(parsed.ids))
    assert parsed.levels[0] == 1
    assert parsed.levels.count(1) == 1
    assert max(np.diff(parsed.levels), default=0) <= 1


def test_names_from_files_are_escaped_and_equal_input_gives_an_equal_page():
    fit = specimen_fit("<script>alert(1)</script>", trials=1, samples=60)
    html = self_contained(partial(page, fit, refused=True))
    assert "<script>alert(1)" not in html
    assert "&lt;script&gt;alert(1)" in html
    assert "<b>notes</b>" not in html


LARGE = [(1, 30, 20_000, False), (29, 1, 20_000, False)]
LARGE_SAMPLED = [(1, 30, 700, True), (30, 10, 700, True), (60, 2, 700, True)]


@pytest.mark.parametrize(
    ("specimens", "trials", "samples", "drawn_from"),
    [*LARGE, *(pytest.param(*one, marks=pytest.mark.system) for one in LARGE_SAMPLED)],
)
def test_a_page_stays_below_seven_megabytes(specimens, trials, samples, drawn_from):
    fits = [specimen_fit(f"s{i}", trials=trials, samples=samples, seed=i) for i in range(specimens)]
    fits = [sampled(fit, seed=i) for i, fit in enumerate(fits)] if drawn_from else fits
    assert len(page(*fits).encode()) <= LARGEST_PAGE_BYTES


def test_thinning_keeps_ends_peak_and_largest_residual():
    curve = specimen_fit(samples=20_000, trials=1).trials[0].curve
    index = thinned(curve, 500)
    residual = np.abs(curve.force_N - curve.model_N)
    assert index.size <= 500
    assert {0, 19_999, int(curve.force_N.argmax()), int(residual.argmax())} <= set(index.tolist())
    assert (np.diff(index) > 0).all()
    assert kept_samples((curve.force_N, curve.depth_mm), 400, 400, [4321]).tolist().count(4321) == 1
    assert thinned(curve, 20_000).size == 20_000


def test_every_sample_of_an_ordinary_recording_reaches_the_page():
    # 100 s at 100 Hz of one specimen; of thirty recordings still 4 samples a pixel of a wide screen
    fit = specimen_fit(trials=1, samples=10_000)
    ((trial,),) = payload_of(page(fit), "curves")["specimens"]
    assert len(base64.b64decode(trial["f"])) == 4 * 10_000
    assert curve_bytes(1) // 30 > 4 * 1_000 * 23
    assert curve_bytes(200) < curve_bytes(1) // 3


@pytest.mark.browser
def test_figures_show_the_curves_and_the_page_is_silent(opened):
    fit = specimen_fit(trials=3, samples=400)
    tab = opened(page(fit))
    traces = drawn(tab, "main")
    title = tab.evaluate("document.querySelector('[data-figure=main]').layout.xaxis3.title.text")
    assert title == "Depth [mm]"
    for name, values in (("recorded", "force_N"), ("model", "model_N")):
        # three trials against time, then three against depth
        own = [trace for trace in traces if trace["name"] == name]
        assert len(own) == 6
        for trace, (abscissa, trial) in zip(
            own, [(x, trial) for x in ("time_s", "depth_mm") for trial in fit.trials], strict=True
        ):
            # the page carries 32-bit floats: 24 bits of mantissa
            assert trace["x"] == pytest.approx(getattr(trial.curve, abscissa), rel=1e-7, abs=1e-9)
            assert trace["y"] == pytest.approx(getattr(trial.curve, values), rel=1e-7, abs=1e-9)
    residual = next(trace["y"] for trace in traces if trace["name"] == "fitted")
    curve = fit.trials[0].curve
    expected = curve.force_N - curve.model_N
    assert [value is not None for value in residual] == curve.fitted.tolist()
    # a difference of two numbers near 100 N, each with 24 bits: 1e-5 N
    assert [v for v in residual if v is not None] == pytest.approx(expected[curve.fitted], abs=2e-5)
    tab.select_option("select[data-choice]", "1")
    data = next(trace for trace in drawn(tab, "main") if trace["name"] == "recorded")
    assert data["y"] == pytest.approx(fit.trials[1].curve.force_N, rel=1e-7, abs=1e-9)


@pytest.mark.browser
@pytest.mark.parametrize(("width", "scheme"), [(1400, "light"), (400, "light"), (800, "dark"), (400, "dark")])
def test_page_fits_the_screen_in_both_colour_schemes(opened, width, scheme):
    # on a light screen sampled, and the residuals contradict the model
    fit = specimen_fit("x" * 60, samples=100, identified=False)
    html = page(sampled(fit, misfit=True) if scheme == "light" else fit, refused=True)
    tab = opened(html, width=width, color_scheme=scheme)
    drawn(tab, "main")
    assert wide(tab) == width
    paper = tab.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (paper == "rgb(255, 255, 255)") is (scheme == "light")
    # the picture of the result begins on the first screen of a desk
    if width == 1400:
        assert tab.locator('[data-figure="main"]').bounding_box()["y"] < 300


@pytest.mark.browser
def test_a_link_of_the_overview_opens_its_specimen(opened):
    fits = [specimen_fit(f"s {i}", trials=1, samples=100, seed=i) for i in range(4)]
    tab = opened(page(*fits))
    assert len(drawn(tab, "overview")[0]["y"]) == 4
    tab.click("a[href='#specimen-3']")
    assert drawn(tab, "main", specimen=2)[0]["y"] == pytest.approx(
        fits[2].trials[0].curve.force_N, rel=1e-7, abs=1e-9
    )


@pytest.mark.browser
def test_the_library_is_inflated_whole(opened):
    tab = opened(page(specimen_fit(samples=60)))
    # what stands in the page is the library that is installed, to its last character
    whole = str(plotly_script())
    assert tab.evaluate("[...document.head.querySelectorAll('script')].map((s) => s.textContent)") == [whole]
    assert tab.evaluate("document.querySelectorAll('iframe, #library').length") == 0


#: Characters that a reader of one specimen sees before anything is opened.
MOST_UNFOLDED = 8_000


@pytest.mark.browser
def test_a_page_of_one_specimen_shows_its_numbers_before_anything_is_opened(opened):
    fit = sampled(specimen_fit(trials=30, samples=60, identified=False), misfit=True, converged=False)
    html = render_report(document_of(fit, refused=True), curves_of_fits([fit]))
    tab = opened(html)
    text = tab.evaluate("document.body.innerText")
    assert len(text) <= MOST_UNFOLDED
    assert tab.evaluate("[...document.querySelectorAll('details')].every((one) => !one.open)")
    for words in ("Contact model", "Static a1", "Viscosity", "NRMSD 0.", "Reasons", "Not to be relied on"):
        assert words in text, words
    for folded in ("shrinkage", "R-hat", "renderer", "SHA-256"):
        assert folded not in text, folded
    assert tab.locator(".first .remarks > li, .first .alarm").count() <= 5 + len(fit.flags)


@pytest.mark.browser
def test_a_figure_is_saved_as_svg_on_white_and_the_tables_as_a_workbook(opened):
    tab = opened(page(specimen_fit(trials=2, samples=80)), color_scheme="dark")
    drawn(tab, "main")
    with tab.expect_download() as saved:
        tab.locator('[data-figure="main"] + button.save').click()
    assert saved.value.suggested_filename.endswith("-main.svg")
    picture = Path(saved.value.path()).read_text(encoding="utf-8")
    assert picture.startswith("<svg")
    assert "rgb(255, 255, 255)" in picture
    assert "Force [N]" in picture
    # the screen stays dark
    assert tab.evaluate("document.documentElement.className") == ""
    assert tab.evaluate("document.querySelector('[data-figure=main]').layout.paper_bgcolor") == "#15181c"
    with tab.expect_download() as saved:
        tab.click("a.tables")
    book = openpyxl.load_workbook(io.BytesIO(Path(saved.value.path()).read_bytes()))
    assert book.sheetnames[0] == "Parameters"
    rows = list(book["Parameters"].values)
    assert rows[1][:7] == (*("kidney 3", "Relaxation time", "relaxation_time_s", "tau", "s", True), 1.5)


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
    shown = [rendering_of(specimen, posteriors_of_fits([fit])[0])]
    twin = twin_sections(typed(TWIN, Twin))
    return page(fit, refused=True, renderings=shown, metadata=described, twin=twin)


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
