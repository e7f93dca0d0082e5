"""The table of trials sorts and filters; what is copied and told is there without a pointer."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from fit_factory import specimen_fit
from msgspec import structs
from posterior_factory import sampled
from report_pages import document_of, page
from typed_call import typed_call

from tissueid.documents import typed
from tissueid.documents.session import Scale
from tissueid.documents.study import StudyCheck
from tissueid.report.methods_words import AUTHORS, TITLE, citation, methods_view, subscripted
from tissueid.report.page import Beside
from tissueid.report.rendering_words import RefusedDevice, RenderedDevice, Rendering

methods_view = typed_call(methods_view)

TABLE = "#specimen-1-trial-table"


def names(tab: Any) -> list[str]:
    """Trials that are shown, from top to bottom."""
    found: list[str] = tab.evaluate(
        """table => [...document.querySelectorAll(`${table} tbody tr`)].filter(row => !row.hidden)
            .map(row => row.cells[0].textContent.trim())""",
        TABLE,
    )
    return found


@pytest.fixture
def tab(opened):
    found = opened(page(specimen_fit(trials=12, samples=60)), width=1200)
    # what is folded is opened as a reader would
    for part in ("specimen-1-trials", "cite"):
        found.click(f"#{part} > summary")
    return found


@pytest.mark.browser
def test_a_heading_sorts_up_and_down_by_number_and_by_name(tab):
    unsorted = [f"run_{i}.csv" for i in range(1, 13)]
    assert names(tab) == unsorted
    speeds = f"{TABLE} thead th:nth-child(2) button"
    heading = tab.locator(f"{TABLE} thead th:nth-child(2)")
    # figures are drawn as they come into sight: what is clicked shall stand still
    heading.scroll_into_view_if_needed()
    tab.wait_for_function("new Promise(done => requestIdleCallback(() => done(true)))")
    tab.click(speeds)
    tab.wait_for_selector(f"{TABLE} thead th:nth-child(2)[aria-sort=ascending]")
    # speeds are 0.5, 2 and 4 mm/s in turn; equal ones keep their order
    slow = [f"run_{i}.csv" for i in (1, 4, 7, 10)]
    assert names(tab)[:4] == slow
    assert heading.get_attribute("aria-sort") == "ascending"
    assert tab.text_content(f"{TABLE}-shown") == "12 of 12 rows, sorted by Speed [mm/s], ascending"
    tab.click(speeds)
    assert names(tab)[-4:] == slow
    assert heading.get_attribute("aria-sort") == "descending"
    # by the keyboard, and 10 after 9
    tab.focus(f"{TABLE} thead th:nth-child(1) button")
    tab.keyboard.press("Enter")
    assert names(tab) == unsorted
    assert heading.get_attribute("aria-sort") is None


@pytest.mark.browser
def test_a_filter_leaves_the_rows_that_carry_its_words(tab):
    tab.get_by_label("Filter by name or remark").fill("RUN_1")
    assert names(tab) == ["run_1.csv", "run_10.csv", "run_11.csv", "run_12.csv"]
    assert tab.text_content(f"{TABLE}-shown") == "4 of 12 rows"
    tab.get_by_label("Filter by name or remark").fill("run_1 zero_dt 4.00")
    assert names(tab) == ["run_12.csv"]
    tab.get_by_label("Filter by name or remark").fill("")
    assert len(names(tab)) == 12


def test_methods_say_what_this_run_did_with_equations():
    fit = specimen_fit()
    document = document_of(fit)
    told = methods_view(document["specimens"][0], document)
    for said in (
        "3 indentation trials of specimen kidney 3, 1 of them with a hold,",
        "0.500 to 4.00 mm/s to 6.00 mm (2,400 samples)",
        "one relaxing branch whose stiffness is constant",
    ):
        assert said in told["before"]
    assert "chosen by predicting data that were held out" in told["after"][0]
    assert "no posterior was sampled" in told["after"][1]
    assert "9.00 ± 0.11 N·s/mm" in told["after"][2]
    assert "K_j(x) = b_j0\n" in told["plain"]
    html = page(fit)
    block = html.split('id="specimen-1-methods-text">')[1].split("</details>")[0]
    assert block.count("<math") == 2
    assert "<mfrac>" in block
    assert "F<sub>s</sub>" in block


def read_back(text: str) -> dict[str, Any]:
    """What a run did, read from its methods paragraph alone, as whoever repeats the run would."""

    def one(pattern: str) -> str | None:
        found = re.search(pattern, text)
        return None if found is None else found[1]

    words = {"no": 0, "one": 1, "two": 2, "three": 3}
    noises = {
        "white noise": "white",
        "first-order autoregressive noise": "ar1",
        "white and first-order autoregressive noise together": "white+ar1",
    }
    versions = dict(re.findall(r"(tissueid|emcee|lmfit|numba|numpy|scipy) (\d[\w.]*\w)", text))
    chosen = one(r"([^.]*) chosen by predicting data that were held out") or ""
    drawn = re.search(r"sampled by (\w+) \(([\d,]+) draws, for ([\d,]+) effective ones; seed (\d+)", text)
    contact = one(r"Contact was set at (\S+) mm")
    return {
        "noise": noises[one(r"under ([a-z -]+?) of the force") or ""],
        "noise_found": "of the force (found from the residuals)" in text,
        "sampler": None if drawn is None else drawn[1],
        "draws": None if drawn is None else int(drawn[2].replace(",", "")),
        "wanted": None if drawn is None else int(drawn[3].replace(",", "")),
        "seed": None if drawn is None else int(drawn[4]),
        "branches": words[one(r"(\w+) relaxing branch") or ""],
        "static_degree": int(one(r"static force of degree (\d)") or -1),
        "stiffness_degree": int(one(r"in depth \(degree (\d)\)|constant \(degree 0\)") or 0),
        "chosen": ("number of branches" in chosen, "degree of K" in chosen),
        "unloading": "Retracts and cycles were fitted as well" in text,
        "contact_mm": None if contact is None else float(contact),
        "versions": versions,
    }


VERSIONS = {"emcee": "3.1.6", "lmfit": "1.3.4", "numba": "0.68.1", "numpy": "2.4.6", "scipy": "1.17.1"}


@pytest.mark.parametrize(
    ("noise", "sampler", "wanted", "seed", "branches", "degree", "given"),
    [
        ("white", "emcee", 2_000, 0, 1, 0, ("auto", "auto")),
        ("ar1", "emcee", 150, 7, 2, 1, (2, "auto")),
        ("white+ar1", "emcee", 2_000, 0, 3, 2, ("auto", 2)),
        ("white+ar1", "emcee", 150, 7, 2, 2, (2, 2)),
        ("white", "none", 0, 3, 1, 0, ("auto", "auto")),
        ("ar1", "none", 0, 3, 2, 1, (2, "auto")),
    ],
)
def test_methods_are_read_back_as_the_options_of_the_run(
    noise, sampler, wanted, seed, branches, degree, given
):
    fit = specimen_fit()
    made = fit if sampler == "none" else sampled(fit, seed=seed)
    made = replace(made, model=replace(made.model, branches=branches, stiffness_degree=degree))
    if made.posterior is not None:
        report = structs.replace(made.posterior.sampler, name=sampler)
        found = structs.replace(made.posterior.noise, model=noise)
        made = replace(made, posterior=replace(made.posterior, sampler=report, noise=found))
    if given == (2, 2):
        made = replace(made, selection=())
    document = document_of(made)
    set_by_hand = seed == 7
    document["provenance"] |= {"versions": VERSIONS}
    document["provenance"]["options"] |= {
        "branches": given[0], "stiffness_degree": given[1], "noise": "auto" if seed == 0 else noise,
        "sampler": sampler, "draws": wanted, "seed": seed, "unloading": set_by_hand,
        "contact_displacement_mm": -1.25 if set_by_hand else None,
    }  # fmt: skip
    text = methods_view(document["specimens"][0], document)["plain"]
    known = sampler != "none"
    assert read_back(text) == {
        # without a posterior the noise is the one of the fit itself
        "noise": noise if known else "white",
        "noise_found": seed == 0,
        "sampler": sampler if known else None,
        "draws": 4_000 if known else None,
        "wanted": wanted if known else None,
        "seed": seed if known else None,
        "branches": branches,
        "static_degree": 3,
        "stiffness_degree": degree,
        "chosen": (given[0] == "auto", given[1] == "auto"),
        "unloading": set_by_hand,
        "contact_mm": -1.25 if set_by_hand else None,
        "versions": {"tissueid": "0.1.0", **VERSIONS},
    }
    if not known:
        assert "no posterior was sampled" in text


def test_an_index_is_set_below_and_a_name_is_left_alone():
    assert str(subscripted("F_s and η_j of kidney_3 & s_j")) == (
        "F<sub>s</sub> and η<sub>j</sub> of kidney_3 &amp; s<sub>j</sub>"
    )


def test_the_citation_is_that_of_the_citation_file():
    text = (Path(__file__).parents[2] / "CITATION.cff").read_text(encoding="utf-8")
    assert re.search(r'^title: "(.*)"', text, re.MULTILINE)[1] == TITLE  # type: ignore[index]
    assert re.search(r"name: (.*)", text)[1] == AUTHORS  # type: ignore[index]
    assert citation("0.1.0")["text"] == f"{AUTHORS}. {TITLE}. Version 0.1.0."
    assert "{{The tissueid developers}}" in citation("0.1.0")["bibtex"]


def test_what_a_renderer_does_and_what_is_missing_stand_on_the_page():
    scale = Scale(
        force_scale=0.0066, motion_scale=5.0, felt_force_is_measured_over=152.0,
        felt_stiffness_is_measured_over=760.0, peak_force_N=1.8, clamp_N=2.0, required_damping_N_s_per_m=0.3,
        device_damping_N_s_per_m=0.5, clipped_share_expected=0.0, lowered_from_force_scale=0.01,
        known="assumed",
    )  # fmt: skip
    device = RenderedDevice("a device", scale, 40.32, 64.0, 20.0, faster_than_identified=True)
    refused = RefusedDevice("another", "needs <more> damping")
    rendering = Rendering(passive=True, draws=500, draws_passive=499, unique=True, devices=(device, refused))
    missing = {"table": "tip", "keys": ["radius_mm", "half_angle_deg"], "weight": 3, "why": "w", "where": []}
    metadata = {
        "schema": "tissueid/study-check/1", "path": "study.toml", "unmatched": [], "grade": "D",
        "share": 0.42, "missing": [missing],
    }  # fmt: skip
    html = page(specimen_fit(), renderings=[rendering], beside=Beside(typed(metadata, StudyCheck)))
    for said in (
        "499 of 500 posterior draws", "measured / 152", "37 %", "lowered from measured / 100",
        "refused: needs &lt;more&gt; damping", "Grade <strong>D</strong>: 42 %", "radius or half angle",
    ):  # fmt: skip
        assert said in html
    assert "What a renderer will do" not in page(specimen_fit())


@pytest.mark.browser
def test_a_text_is_copied_or_where_that_is_forbidden_selected(tab):
    button = tab.locator("button[data-copies=cite-text]")
    button.click()
    tab.wait_for_function(
        "() => document.querySelector('button[data-copies=cite-text]').textContent !== 'Copy the reference'"
    )
    said = button.text_content()
    assert said in {"copied", "selected: press Ctrl-C"}
    if said != "copied":
        assert TITLE in tab.evaluate("getSelection().toString()")
    # a browser that forbids it
    tab.evaluate(
        "() => { if (navigator.clipboard) navigator.clipboard.write = () => Promise.reject(new Error()); }"
    )
    tab.click("button[data-copies=cite-bibtex]")
    tab.wait_for_function("() => getSelection().toString().includes('@software{tissueid')")
