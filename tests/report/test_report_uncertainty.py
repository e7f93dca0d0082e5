"""How sure a result is, on the page: intervals, alarms, sources, and figures that equal the draws."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from fit_factory import specimen_fit
from msgspec import structs
from posterior_factory import SHARES, SOURCES, posterior, sampled
from report_pages import drawn, open_all, page, payload_of, specimen_of
from typed_call import typed_call

from tissueid.digits import together
from tissueid.flags import Flag
from tissueid.report.figures import MOST_NUMBERS, posterior_payload
from tissueid.report.uncertainty_words import paper_view, reported_order, uncertainty_view
from tissueid.store.posteriors import posteriors_of_fits

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
            entry |= {"identified": False, "value": None, "ci95": None, "ci95_total": None}
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
