"""The table of trials sorts and filters; how sure a result is, in words, figures and bands."""

import base64
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fit_factory import specimen_fit
from msgspec import structs
from posterior_factory import SHARES, SOURCES, posterior, sampled
from report_pages import document_of, drawn, open_all, page, payload_of, specimen_of
from typed_call import typed_call

from tissueid.digits import together
from tissueid.documents import typed
from tissueid.documents.session import Scale
from tissueid.documents.study import StudyCheck
from tissueid.flags import Flag
from tissueid.report.figures import MOST_NUMBERS, posterior_payload
from tissueid.report.methods_words import AUTHORS, TITLE, citation, methods_view, subscripted
from tissueid.report.rendering_words import RefusedDevice, RenderedDevice, Rendering
from tissueid.report.uncertainty_words import paper_view, reported_order, uncertainty_view
from tissueid.store.posteriors import posteriors_of_fits

methods_view = typed_call(methods_view)

TABLE = "#specimen-1-trial-table"


def names(tab: Any) -> list[str]:
    """Trials that are shown, from top to bottom."""
    return tab.evaluate(
        """table => [...document.querySelectorAll(`${table} tbody tr`)].filter(row => !row.hidden)
            .map(row => row.cells[0].textContent.trim())""",
        TABLE,
    )


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
    """The settings of a run, read from its methods paragraph alone, as whoever repeats the run would."""

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
        ("white", "emcee", 2_000, 0, 1, 0, ("auto", "auto")), ("ar1", "emcee", 150, 7, 2, 1, (2, "auto")),
        ("white+ar1", "emcee", 2_000, 0, 3, 2, ("auto", 2)), ("white+ar1", "emcee", 150, 7, 2, 2, (2, 2)),
        ("white", "none", 0, 3, 1, 0, ("auto", "auto")), ("ar1", "none", 0, 3, 2, 1, (2, "auto")),
    ],
)  # fmt: skip
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
    html = page(specimen_fit(), renderings=[rendering], metadata=typed(metadata, StudyCheck))
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


posterior_payload = typed_call(posterior_payload)
paper_view = typed_call(paper_view)
reported_order = typed_call(reported_order)
uncertainty_view = typed_call(uncertainty_view)


def words_of(html: str, start: str, end: str) -> str:
    section = html.split(start)[1].split(end)[0]
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", section))


first_screen = partial(words_of, start='<section class="first"', end="</section>")
sure_section = partial(words_of, start='-sure">', end='<details class="part"')
residual_section = partial(words_of, start='-residuals">', end='<details class="part"')


def test_parameters_come_in_the_order_of_the_publication():
    names = [one.name for one in reported_order(specimen_of(specimen_fit())["parameters"])]
    assert [name.split("_")[0] for name in names] == [
        "relaxation", "static", "static", "static", "stiffness", "viscosity",
    ]  # fmt: skip


FIT = sampled(specimen_fit(samples=60))


@pytest.fixture(scope="module")
def sure():
    """The page of a fit whose posterior was sampled."""
    return page(FIT)


def test_every_interval_on_the_first_screen_is_that_of_the_result(sure):
    text = first_screen(sure)
    for one in FIT.parameters:
        known = one.uncertainty
        low, high, wide_low, wide_high = together([one.value, *known.ci95, *known.ci95_total], known.sd)[1:]
        assert f"{low} to {high} {wide_low} to {wide_high}" in text
    assert "95 % statistical" in text
    assert "95 % total" in text
    assert " true " not in text


def test_alarms_take_every_interval_off_the_first_screen_and_are_said_once(sure):
    fit = sampled(specimen_fit(samples=60), misfit=True, converged=False)
    flags = (
        Flag("misfit", "no interval can be believed"),
        Flag("sampler_not_converged", "intervals are rough"),
    )
    html = page(replace(fit, flags=(*fit.flags, *flags)))
    text, below = first_screen(html), sure_section(html)
    for said in (
        "the force just after the peak lies 2.1 N above the model", "Not to be relied on",
        "The recordings contradict this model or its noise", "frame compliance is taken as none",
    ):  # fmt: skip
        assert text.count(said) == 1, said
    assert not re.search("95 %|±|no interval can be believed|intervals are rough", text)
    # below, the intervals stand with the warning, and the sampler with its reason
    assert "do not quote them" in below
    assert "95 % statistical" in below
    assert "not converged: R-hat of ln_tau_1 is 1.08 after 20,000 steps" in below
    assert "The sampler did not converge" in text
    assert "The sampler did not converge" not in first_screen(sure)


def test_what_is_not_identified_has_no_number_and_shares_a_row_by_kind():
    fit = sampled(specimen_fit(samples=60, identified=False))
    view = uncertainty_view(specimen_of(fit))
    (tau,) = [row for row in view["rows"] if "tau" in row.symbols]
    assert (tau.value, tau.intervals) == ("not identified", ())
    assert "Relaxation time τ not identified" in first_screen(page(fit))
    document = specimen_of(fit)
    for entry in document["parameters"]:
        if entry["name"].startswith("static"):
            of_draws = ("mean", "sd", "ci95", "ci95_total", "ess_bulk", "ess_tail", "r_hat")
            entry |= {"identified": False, **dict.fromkeys(("value", *of_draws))}
    (static,) = [row for row in paper_view(document)["rows"] if row.words == "Static"]
    assert (static.symbols, static.value) == (("a1", "a2", "a3"), "not identified")


def test_sampler_noise_priors_models_and_checks_are_told(sure):
    text, checked = sure_section(sure), residual_section(sure)
    for said in (
        "Sampled by emcee: 32 walkers, 2,000 steps, 4,000 draws kept",
        "at least 8,700 effective draws",
        "34 % of the proposals accepted; converged",
        "Static force, linear term normal, mean 5, sd 2 by the study 4.000 ± 0.050",
        "calibrated for the stated model and noise",
        "where the model itself is wrong they say nothing",
    ):
        assert said in text
    # and in the methods paragraph, as it is shown and as it is copied
    assert sure.count("at least 8,700 effective draws") == 3
    assert re.search(r"Gain of the force normal, mean 1, sd 0.01 default .* 2 % the data said little", text)
    told = "correlated (AR(1)), 0.300 N in all; the correlated part keeps 0.6 of itself over 0.0100 s"
    assert told in checked
    assert "Early hold: no more than the noise makes (p = 0.60)." in checked


def test_shares_of_the_sources_are_stacked_in_order_and_their_sd_tabulated(sure):
    stack = sure.split('class="stack"')[1].split("</span>")[0]
    widths = [float(width) for width in re.findall(r"width:([\d.]+)%", stack)]
    assert widths == [100 * share for share in SHARES]
    view = uncertainty_view(specimen_of(FIT))
    assert [source for source, _ in view["budget"]["sources"]] == list(SOURCES)
    assert view["budget"]["beside"] == ["total", "cluster bootstrap"]
    (eta,) = [row for row in view["budget"]["rows"] if row["of"].symbol == "eta"]
    assert eta["largest"]["source"] in {"force gain", "frame"}
    assert len(eta["sd"]) == len(SOURCES) + 2


def test_without_a_total_interval_nothing_speaks_of_one_but_the_reason():
    fit = sampled(specimen_fit(samples=60), total=False)
    html = page(fit)
    assert "95 % total" not in html
    assert "No total interval was worked out" in html
    sampler = fit.posterior.sampler
    total = {"converged": False, "worth": 2.2, "tail_shape": 15.9}
    told = structs.replace(sampler, detail={**sampler.detail, "total": total})
    text = sure_section(page(replace(fit, posterior=replace(fit.posterior, sampler=told))))
    assert "No total interval is given" in text
    assert "the draws are worth 2.2 independent ones" in text


def test_a_page_without_a_posterior_has_standard_errors():
    html = page(specimen_fit(samples=60))
    assert "95 %" not in first_screen(html)
    assert "No posterior was sampled" in sure_section(html)
    assert "4.000 ± 0.050" in first_screen(html)


def test_white_noise_and_a_sampler_of_earlier_versions_have_their_own_sentences():
    unknown = {"shrinkage": float("nan"), "posterior_sd": float("nan")}
    own = replace(
        FIT.posterior,
        sampler=structs.replace(FIT.posterior.sampler, name="exact", acceptance=0.97),
        noise=structs.replace(FIT.posterior.noise, model="white", phi=0.0),
        priors=tuple(structs.replace(row, **unknown) for row in FIT.posterior.priors),
    )
    html = page(replace(FIT, posterior=own))
    text = sure_section(html)
    assert "Noise of the force: white, 0.300 N" in residual_section(html)
    assert "Sampled by exact: 4,000 draws kept" in text
    assert "97 % of the proposals accepted" in text
    assert "walkers" not in text
    # what is null is a dash
    assert "by the study – ± – –" in text


def test_a_page_carries_a_bounded_number_of_draws():
    def payload(count: int) -> list[dict[str, Any] | None]:
        fits = [sampled(specimen_fit(f"s{i}", trials=1, samples=40), seed=i) for i in range(count)]
        return posterior_payload([specimen_of(fit) for fit in fits], posteriors_of_fits(fits))

    (one,) = payload(1)
    assert one["draws"]["count"] == one["total"]["count"] == 1_000
    many = payload(40)
    assert all(part is not None for part in many)
    numbers = [part["draws"]["count"] * 2 * len(part["names"]) for part in many if part is not None]
    assert sum(numbers) <= MOST_NUMBERS
    assert one["chain"]["shape"] == [4, 250, 3]
    # 16-bit steps between the least and the largest draw of each column
    steps = np.frombuffer(base64.b64decode(one["draws"]["steps"]), "<u2").reshape(len(one["names"]), -1)
    assert steps.min(axis=1).tolist() == [0] * len(steps)
    assert steps.max(axis=1).tolist() == [65_535] * len(steps)


def test_the_overview_has_the_interval_of_each_specimen_and_none_under_a_misfit():
    plain, odd, bare = (specimen_fit(name, trials=1, samples=40) for name in "abc")
    html = page(sampled(plain), sampled(odd, misfit=True), bare)
    points = payload_of(html, "curves")["overview"]
    known = sampled(plain).parameter("viscosity_N_s_per_mm").uncertainty
    assert points[0]["up"] == pytest.approx(known.ci95[1] - 9.0, rel=1e-12)
    assert points[0]["down"] == pytest.approx(9.0 - known.ci95[0], rel=1e-12)
    assert (points[1]["up"], points[1]["down"]) == (0.0, 0.0)
    assert (points[2]["up"], points[2]["down"]) == (0.11, 0.11)
    rows = html.split('<table class="overview">')[1].split("</table>")[0].split("<tr>")
    assert "±" not in rows[3]
    assert "9.00 ± 0.11" in rows[2]


@pytest.mark.browser
def test_figures_show_bands_densities_and_draws(opened):
    fit = sampled(specimen_fit(trials=2, samples=200))
    tab = opened(page(fit))
    # a band about each of two logs would hide the other
    assert not [trace for trace in drawn(tab, "main") if trace["name"] == "predicted"]
    tab.select_option("select[data-choice]", "1")
    (band,) = [trace for trace in drawn(tab, "main") if trace["name"] == "predicted"]
    x = fit.trials[1].curve.time_s
    # the page carries 32-bit floats of numbers near 100: 24 bits of mantissa, and a difference of two
    assert band["x"] == pytest.approx([*x, *x[::-1]], rel=1e-7, abs=1e-5)
    assert band["y"] == pytest.approx([0.6] * x.size + [-0.6] * x.size, abs=3e-5)
    assert band["fill"] == "toself"
    open_all(tab)
    corner = drawn(tab, "corner")
    # two densities or two clouds a cell of the lower triangle, diagonal included
    assert len(corner) == 2 * (len(fit.parameters) * (len(fit.parameters) + 1) // 2)
    # row 1, column 0: a1 over the relaxation time, total draws below
    total, statistical = corner[2:4]
    assert (total["name"], statistical["name"]) == ("total", "statistical")
    kept = fit.posterior.draws[np.linspace(0, len(fit.posterior.draws) - 1, 1_000).astype(int)][::4]
    # 16-bit steps of some 10 sd's range
    assert statistical["x"] == pytest.approx(kept[:, 4], abs=10 * kept[:, 4].std() / 65_535)
    assert statistical["y"] == pytest.approx(kept[:, 0], abs=10 * kept[:, 0].std() / 65_535)
    # last row: viscosity, which is no draw but a product of two
    eta = kept[:, 3] * kept[:, 4]
    assert corner[-2 * len(fit.parameters) + 1]["y"] == pytest.approx(eta, abs=10 * eta.std() / 65_535)
    for density in (corner[0], corner[1]):
        width = density["x"][1] - density["x"][0]
        # a density: its sum times the width of a bin is one
        assert sum(density["y"]) * width == pytest.approx(1.0, rel=1e-3)
    assert len(drawn(tab, "trace")) == 4 * len(posterior().chain_names)
