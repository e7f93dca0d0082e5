"""The figures of a law: what they are drawn from equals closed forms, and a browser shows just that."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fit_factory import STATIC, STIFFNESS, TAU_S, specimen_fit
from posterior_factory import sampled
from report_pages import document_of, drawn, open_all, page, render_report, specimen_of
from typed_call import typed_call

from tissueid.report.law_payload import _summary, binned_loading, curve_groups, law_payload, speed_groups
from tissueid.result import Curve, SpecimenFit
from tissueid.store.curves import curves_of_fits
from tissueid.store.posteriors import posteriors_of_fits

law_payload = typed_call(law_payload)
speed_groups = typed_call(speed_groups)

#: The page's numbers have five digits; a cubic of a rounded depth loses some of them.
DIGITS = 1e-4


def law_of(fit: SpecimenFit) -> dict[str, Any]:
    (law,) = law_payload(document_of(fit)["specimens"], curves_of_fits([fit]), posteriors_of_fits([fit]))
    return law


def with_profile(fit: SpecimenFit) -> SpecimenFit:
    """A quadratic profile about 1.5 s, with K tau = 9 along it."""
    tau = np.linspace(1.2, 1.8, 13)
    curve = {"tau_s": tau.tolist(), "rise": ((tau - 1.5) ** 2 / 0.01).tolist()}
    curve["stiffness_N_per_mm"] = (9.0 / tau).tolist()
    parameters = [
        replace(one, detail={**one.detail, "profile": curve}) if one.name == "relaxation_time_s" else one
        for one in fit.parameters
    ]
    return replace(fit, parameters=tuple(parameters))


def test_trials_of_one_speed_share_a_panel_and_many_speeds_are_merged():
    specimen = specimen_of(specimen_fit())
    trial = specimen["trials"][0]

    def groups(*speeds: float) -> list[tuple[str, tuple[int, ...]]]:
        found = speed_groups(specimen, [trial | {"speed_mm_s": speed} for speed in speeds])
        return [(one.label, one.members) for one in found]

    assert groups(4.0, 0.5, 4.1, 0.51) == [
        ("0.505 mm/s (30.3 mm/min)", (1, 3)),
        ("4.05 mm/s (243 mm/min)", (0, 2)),
    ]
    many = groups(*np.geomspace(0.01, 100.0, 40))
    assert len(many) == 12
    assert sorted(i for _, members in many for i in members) == list(range(40))


def test_parts_are_the_closed_forms_and_their_bands_hold_them():
    law = law_of(sampled(specimen_fit()))
    x = np.array(law["parts"]["x"])
    static = STATIC[0] * x + STATIC[1] * x**2 + STATIC[2] * x**3
    assert law["parts"]["static"]["value"] == pytest.approx(static, rel=DIGITS)
    assert law["parts"]["stiffness"]["value"] == pytest.approx(np.full(x.size, STIFFNESS), rel=DIGITS)
    for part, speed in zip(law["parts"]["dynamic"], (0.5, 2.0, 4.0), strict=True):
        length = speed * TAU_S
        assert part["value"] == pytest.approx(-STIFFNESS * length * np.expm1(-x / length), rel=DIGITS)
        inside = x > 0
        assert (np.array(part["low"])[inside] < np.array(part["value"])[inside]).all()
        assert (np.array(part["high"])[inside] > np.array(part["value"])[inside]).all()
    assert "low" not in law_of(specimen_fit())["parts"]["static"]


def test_peaks_are_the_largest_forces_with_mean_and_standard_deviation():
    fit = specimen_fit(trials=6, samples=300)
    (group,) = law_of(fit)["peaks"]
    largest = [float(trial.curve.force_N[trial.curve.fitted].max()) for trial in fit.trials]
    assert [one["force"] for one in group["points"]] == pytest.approx(largest)
    # trials 0 and 3 were loaded at 0.5 mm/s, 1 and 4 at 2, 2 and 5 at 4
    for mean, members in zip(group["means"], ((0, 3), (1, 4), (2, 5)), strict=True):
        own = [largest[i] for i in members]
        assert (mean["n"], mean["mean"]) == (2, pytest.approx(np.mean(own)))
        assert mean["sd"] == pytest.approx(np.std(own, ddof=1))
    assert [one["sd"] for one in law_of(specimen_fit(trials=3))["peaks"][0]["means"]] == [None] * 3
    length = 0.5 * TAU_S
    slow = sum(a * 6.0**k for k, a in enumerate(STATIC, 1)) - STIFFNESS * length * np.expm1(-6.0 / length)
    assert group["line"]["force"][0] == pytest.approx(slow, rel=DIGITS)


def test_a_window_is_told_in_the_time_of_its_curve_and_left_out_without_a_clock():
    fit = specimen_fit()
    (hold,) = law_of(fit)["holds"]
    # the factory's clock is at 2.5 s where its curves begin; the window is 12 to 24 s of that clock
    assert (hold["trial"], hold["start"], hold["end"]) == (0, 9.5, 21.5)
    document = document_of(fit)
    old = [type(one)(one.specimen, one.path, one.sheet, one.curve) for one in curves_of_fits([fit])]
    (law,) = law_payload(document["specimens"], old)
    assert law["holds"] == []
    assert law["residuals"] is None
    assert "fit again to see the holds drawn" in render_report(document, old)


def test_residuals_of_all_logs_are_summed_and_weighed_by_their_samples():
    fit = specimen_fit(trials=2)
    summaries = [trial.residual for trial in fit.trials]
    first, second = (one for one in summaries if one is not None)
    found = law_of(fit)["residuals"]
    assert found["counts"] == (first.counts + second.counts).tolist()
    assert sum(found["counts"]) == sum(int(trial.curve.fitted.sum()) for trial in fit.trials)
    count = first.hold_count + second.hold_count
    mean = (first.hold_count * first.hold_mean_N + second.hold_count * second.hold_mean_N) / count
    assert found["pooled"]["mean"] == pytest.approx(mean, rel=1e-4)
    assert found["pooled"]["error"] == pytest.approx(1.96 * fit.sigma_N / np.sqrt(count), rel=1e-4)
    sizes = [int(one.counts.sum()) for one in (first, second)]
    # the two logs were sampled at different steps: their lags are not the same times
    assert len(found["together"]["lag"]) == 6
    assert set(found["together"]["bound"]) == {float(f"{1.96 / size**0.5:.5g}") for size in sizes}
    same = law_of(specimen_fit(trials=4))["residuals"]["together"]
    (one, four) = [specimen_fit(trials=4).trials[i].residual for i in (0, 3)]
    # trials 0 and 3 are alike: their first lag weighs both
    weights = [one.counts.sum(), four.counts.sum()]
    expected = np.average([one.correlation[0], four.correlation[0]], weights=weights)
    assert same["value"][same["lag"].index(float(f"{one.step_s:.3g}"))] == pytest.approx(expected, rel=1e-4)


def read_back(tab: Any, kind: str) -> dict[str, Any]:
    """Traces and titles of axes as plotly holds them."""
    open_all(tab)
    traces = drawn(tab, kind)
    titles = tab.evaluate(
        """kind => { const { layout } = document.querySelector(`[data-figure=${kind}]`);
            return Object.fromEntries(Object.entries(layout).filter(([key]) => /^[xy]axis/.test(key))
                .map(([key, axis]) => [key, [axis.title.text, axis.type || "linear"]])); }""",
        kind,
    )
    return {"traces": traces, "titles": titles}


@pytest.mark.browser
def test_holds_are_drawn_in_linear_and_logarithmic_time_from_their_window(opened):
    fit = specimen_fit(samples=800)
    tab = opened(page(fit))
    found = read_back(tab, "holds")
    recorded, model, log_recorded, log_model = found["traces"]
    assert found["titles"]["xaxis"][1] == "linear"
    assert found["titles"]["xaxis2"] == ["Time from the stop [s], log", "log"]
    curve = fit.trials[0].curve
    begin = int(np.searchsorted(curve.time_s, 9.5 - 1e-6))
    inside = (curve.time_s > 9.5 + 0.3 * (curve.time_s[1] - curve.time_s[0])) & (curve.time_s <= 21.5)
    expected = curve.force_N[inside] / curve.model_N[begin]
    # 32-bit floats, and a time counted from the window
    kept = [y for x, y in zip(log_recorded["x"], log_recorded["y"], strict=True) if x <= 12.0]
    assert kept[-20:] == pytest.approx(expected[-20:], rel=1e-4)
    assert abs(len(kept) - expected.size) <= 1
    assert min(log_recorded["x"]) > 0.0
    assert min(recorded["x"]) < 0.0
    assert len(log_model["y"]) == len(log_recorded["y"])
    assert len(model["y"]) == len(recorded["y"])


@pytest.mark.browser
def test_residuals_profile_peaks_and_parts_show_their_numbers(opened):
    fit = with_profile(sampled(specimen_fit(samples=400)))
    law = law_of(fit)
    tab = opened(page(fit))
    residuals = read_back(tab, "residuals")
    by_name = {one["name"]: one for one in residuals["traces"]}
    assert by_name["residual"]["y"] == law["residuals"]["counts"][1:-1]
    assert by_name["all trials"]["y"] == law["residuals"]["together"]["value"]
    assert by_name["all holds"]["y"] == law["residuals"]["pooled"]["mean"]
    assert residuals["titles"]["xaxis2"] == ["Lag [s]", "log"]
    profile = {one["name"]: one for one in read_back(tab, "profile")["traces"]}
    assert profile["rise"]["y"] == pytest.approx((np.linspace(1.2, 1.8, 13) - 1.5) ** 2 / 0.01, abs=1e-6)
    assert np.array(profile["best K at each τ"]["y"]) * profile["rise"]["x"] == pytest.approx(9.0)
    assert len(profile["statistical"]["x"]) == 1_000
    peaks = [one for one in read_back(tab, "peaks")["traces"] if one["name"] == "6.00 mm"]
    assert peaks[0]["y"] == pytest.approx([one["mean"] for one in law["peaks"][0]["means"]])
    parts = {one["name"]: one for one in read_back(tab, "parts")["traces"]}
    assert parts["static force"]["y"] == law["parts"]["static"]["value"]


@pytest.mark.browser
def test_of_many_trials_the_picture_of_the_result_shows_one_a_speed(opened):
    fit = specimen_fit(trials=9, samples=60)
    html = page(fit)
    assert "the deepest of each speed" in html
    tab = opened(html)
    recorded = shown_by_depth(tab)
    # all nine are equally deep: the first of each speed
    expected = [trial.curve.force_N for trial in fit.trials[:3]]
    assert [one["y"] for one in recorded] == [pytest.approx(values, rel=1e-6) for values in expected]
    tab.select_option("select[data-choice]", "7")
    (chosen,) = shown_by_depth(tab)
    assert chosen["y"] == pytest.approx(fit.trials[7].curve.force_N, rel=1e-6)


def shown_by_depth(tab: Any) -> list[dict[str, Any]]:
    traces = read_back(tab, "main")["traces"]
    return [one for one in traces if one["name"] == "recorded" and one["axis"] == "x3"]


def test_means_of_bins_are_those_of_the_straight_lines_between_samples():
    """Few samples and uneven bins: the mean of a line over a bin is its value in the middle."""
    x = np.array([0.0, 0.3, 2.0, 4.0])
    curve = Curve(x, 3.0 * x, 2.0 + 5.0 * x, x, fitted=x >= 0)
    edges = np.array([0.0, 0.5, 0.7, 3.0, 9.0, 12.0, 15.0])
    found = binned_loading(curve, edges)
    middle = 0.5 * (edges[1:] + edges[:-1])
    # force against depth is 2 + 5/3 depth; the tool stops before the last bin
    assert found[:4] == pytest.approx(2.0 + 5.0 / 3.0 * middle[:4])
    assert np.isnan(found[5])


def test_mean_and_standard_deviation_of_a_programme_are_those_of_its_curves():
    made = specimen_fit(trials=6, samples=2_000)
    # without its noise a curve is its closed form, and logs of one speed are alike
    quiet = [replace(one, curve=replace(one.curve, force_N=one.curve.model_N)) for one in made.trials]
    groups = law_of(replace(made, trials=tuple(quiet)))["groups"]
    assert [one["members"] for one in groups] == [[[0, 0], [0, 3]], [[0, 1], [0, 4]], [[0, 2], [0, 5]]]
    assert groups[0]["label"] == "0.500 mm/s to 6.00 mm, n = 2"
    for group, speed in zip(groups, (0.5, 2.0, 4.0), strict=True):
        x, since = (np.array(group[part]["x"]) for part in ("loading", "hold"))
        length = speed * TAU_S
        loaded = sum(a * x**k for k, a in enumerate(STATIC, 1)) - STIFFNESS * length * np.expm1(-x / length)
        assert group["loading"]["mean"] == pytest.approx(loaded, rel=0.01, abs=0.05)
        rest = sum(a * 6.0**k for k, a in enumerate(STATIC, 1))
        branch = -STIFFNESS * length * np.expm1(-6.0 / length) * np.exp(-since / TAU_S)
        assert group["hold"]["mean"] == pytest.approx(rest + branch, rel=0.01)
        for part in ("loading", "hold"):
            assert set(group[part]["n"]) == {2}
            assert max(group[part]["sd"]) < 1e-9
    assert law_of(specimen_fit(trials=1))["groups"] == []


def test_a_spread_between_curves_is_their_standard_deviation():
    """Three curves of 1, 2 and 4 times one force: the standard deviation is 1.528 of it everywhere."""
    fit = specimen_fit(trials=1, samples=400)
    (one,) = fit.trials
    trials = tuple(
        replace(one, path=f"{factor}.csv", curve=replace(one.curve, force_N=factor * one.curve.model_N))
        for factor in (1.0, 2.0, 4.0)
    )
    (group,) = law_of(replace(fit, trials=trials))["groups"]
    for part in ("loading", "hold"):
        mean, sd = np.array(group[part]["mean"]), np.array(group[part]["sd"])
        assert sd / mean == pytest.approx(np.std([1, 2, 4], ddof=1) / np.mean([1, 2, 4]), rel=1e-4)


def test_a_mean_ends_where_the_first_of_its_curves_does():
    """Curves of one slope never fall, and so does their mean; one that is nowhere takes nothing from it."""
    rows = np.outer([1.0, 4.0, 2.0, np.nan], np.arange(6.0))
    rows[1, 3:] = np.nan
    found = _summary(np.arange(6.0), rows)
    assert (found["x"], found["n"]) == ([0.0, 1.0, 2.0], [3, 3, 3])
    assert found["mean"] == pytest.approx([0.0, 7 / 3, 14 / 3], rel=1e-4)
    assert _summary(np.arange(6.0), rows[1:2]) is None


@pytest.mark.browser
def test_all_curves_of_a_programme_share_a_figure_with_their_mean(opened):
    fit = specimen_fit(trials=6, samples=200)
    tab = opened(page(fit))
    found = read_back(tab, "group")
    names = [one["name"] for one in found["traces"]]
    assert names.count("recorded") == 12
    assert names.count("mean") == names.count("SD") == 6
    mean = next(one for one in found["traces"] if one["name"] == "mean")
    assert mean["y"] == law_of(fit)["groups"][0]["loading"]["mean"]
    assert found["titles"]["xaxis2"] == ["Time since the stop [s]", "linear"]
    # the parts of a curve meet at the stop, and no sample is lost
    loading, hold = (one for one in found["traces"][:2])
    assert len(loading["y"]) + len(hold["y"]) == 201


def test_curves_that_end_at_one_load_are_one_group_named_by_it():
    """Places of a piece that are pushed to one force stop at their own depths."""

    def held(depth_mm: float, ramp_s: float) -> tuple[Any, Any]:
        time_s = np.linspace(0.0, ramp_s + 5.0, 80)
        share = np.minimum(time_s / ramp_s, 1.0)
        force = 1.2 * share**2 * np.exp(-0.1 * np.maximum(time_s - ramp_s, 0.0))
        curve = Curve(time_s, depth_mm * share, force, force, np.ones(80, dtype=bool))
        trial = SimpleNamespace(speed_mm_s=depth_mm / ramp_s, depth_mm=depth_mm)
        return trial, SimpleNamespace(curve=curve)

    units = SimpleNamespace(length="mm", force="N")
    (one,) = curve_groups([[held(2.0, 2.0), held(3.0, 2.5), held(4.5, 3.0)]], units)
    assert one["label"] == "to 1.20 N in 2.6 s, n = 3"
    assert one["members"] == [[0, 0], [0, 1], [0, 2]]
    alike = curve_groups([[held(2.0, 2.0), held(2.1, 2.0)]], units)
    assert [group["label"] for group in alike] == ["1.02 mm/s to 2.05 mm, n = 2"]
