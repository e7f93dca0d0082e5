"""Specimens of a simulator that shares nothing with the package: what is printed of them holds the truth."""

from dataclasses import replace

import numpy as np
import pytest
from closed_forms import branch_state

import tissueid as ti
from tissueid.inference.verdict import reaching
from tissueid.uncertainty import ParameterUncertainty


def recorded(force_of, *, seed, noise=0.002, rate_Hz=50.0, speed=2.0, depth=5.0, hold_s=20.0):
    """A ramp through a millimetre of air and a hold; noise is a share of the peak."""
    time = np.arange(0.0, 1.0 + (1.0 + depth) / speed + hold_s, 1.0 / rate_Hz)
    travel = np.clip(speed * (time - 1.0), 0.0, 1.0 + depth)
    force = force_of(time, np.maximum(travel - 1.0, 0.0))
    force += noise * force.max() * np.random.default_rng(seed).standard_normal(time.size)
    return ti.Trial(time_s=time, displacement_mm=travel, force_N=force)


def elastic(x):
    return 0.3 * x + 0.05 * x**2 + 0.05 * x**3


def quasi_linear(time, x):
    """Four tenths of the elastic force relax within 1.5 s, inside the convolution."""
    return elastic(x) + 0.4 * branch_state(time, elastic(x), 1.5)


def rows(fit):
    """Printed rows of a fit's parameters, by name."""
    return {one["name"]: one for one in fit.result.as_json()["parameters"]}


def relaxed(fit, name):
    """Values, errors and times of a number after an ideal step."""
    rows = [one for one in fit.result.quoted.model if one.name == name and one.at.path == "step"]
    return [(one.value, one.stderr, one.at.time_s) for one in rows if one.value is not None]


@pytest.mark.parametrize("seed", [0, 1])
def test_a_law_that_predicts_a_little_better_widens_what_relaxes_after_a_step(seed):
    fit = ti.fit([recorded(quasi_linear, seed=seed)])
    share, ((over, error, _),) = 0.4 / 1.4, relaxed(fit, "peak_to_plateau")
    for value, stderr, time in relaxed(fit, "fraction_relaxed"):
        assert abs(value - share * (1.0 - np.exp(-time / 1.5))) < 3.0 * stderr
    assert abs(over - 1.4) < 3.0 * error


def kelvin_voigt(time, x):
    return 0.3 * x + 0.05 * x**2 + 0.02 * x**3 + 0.5 * branch_state(time, x, 3.0)


def test_two_logs_leave_what_they_have_in_common_open_evenly():
    logs = [
        recorded(lambda time, x, gain=gain: gain * kelvin_voigt(time, x), seed=seed)
        for seed, gain in enumerate((1.03, 0.97))
    ]
    # stated to be constant, or K may vary as well
    found = rows(ti.fit(logs, "polynomial * constant * prony:1", specimen="two sites").sample())
    for name, truth in (("static_1_N_per_mm", 0.3), ("stiffness_0_N_per_mm", 0.5)):
        low, high = found[name]["ci95_total"]
        up, down = np.log(high / found[name]["value"]), np.log(found[name]["value"] / low)
        assert low < truth < high
        # flat priors of coefficients had them four times as far up as down
        assert 0.5 < up / down < 2.0


def sites(*ratios):
    """Recordings of one tissue at sites whose relaxation times are these times its own."""

    def site(ratio):
        return lambda t, x: 2.0 * x + 0.3 * x**2 + 0.05 * x**3 + 3.0 * branch_state(t, x, 0.5 * ratio)

    return [
        recorded(site(ratio), seed=seed, noise=0.0005, rate_Hz=200.0, depth=4.0, hold_s=8.0)
        for seed, ratio in enumerate(ratios)
    ]


def test_sites_that_relax_at_different_rates_are_not_explained_by_a_soft_machine():
    fit = ti.fit(sites(0.95, 1.0, 1.05), specimen="three sites").sample()
    found = rows(fit)
    truths = {"static_1_N_per_mm": 2.0, "stiffness_0_N_per_mm": 3.0, "relaxation_time_s": 0.5}
    for name, truth in (truths | {"viscosity_N_s_per_mm": 1.5}).items():
        low, high = found[name]["ci95_total"]
        assert low < truth < high
        assert high - low < 0.5 * truth
    assert [one.time_ratio for one in fit.result.trials] == pytest.approx([0.95, 1.0, 1.05], abs=0.01)
    assert not {"discrepancy", "machine_implausible"} & {flag.code for flag in fit.result.flags}


@pytest.mark.system
def test_the_band_of_another_site_knows_that_sites_relax_at_different_rates():
    fast, one, slow = sites(0.8, 1.0, 1.25)
    low, high = ti.fit([fast, one, slow], "polynomial * prony:1").sample(draws=400).band(one)
    stop = int(np.argmax(one.displacement_mm > 4.999))
    apart = float((slow.force_N - fast.force_N)[stop - 20 : stop].mean())
    # Student's t of two degrees of freedom times the scatter of three
    assert 0.5 * (high - low)[stop] > 4.30 * 0.5 * apart


def test_what_is_stated_of_a_coefficient_is_not_drawn_down_by_the_common_size():
    logs = [recorded(lambda t, x, g=g: g * kelvin_voigt(t, x), seed=k) for k, g in enumerate((1.2, 0.8))]
    means = {"static_1_N_per_mm": 0.3, "static_2_N_per_mm2": 0.05, "static_3_N_per_mm3": 0.02}
    means |= {"stiffness_0_N_per_mm": 0.5}
    stated = {name: (value, 0.1 * value) for name, value in means.items()}
    options = ti.FitOptions(branches=1, stiffness_degree=0)
    fit = ti.fit(logs, specimen="two sites", priors=ti.Priors(linear=stated), options=options).sample()
    for name, (mean, sd) in stated.items():
        assert abs(rows(fit)[name]["value"] - mean) < 0.25 * sd


def test_forces_at_the_limit_of_a_cell_are_not_fitted(tmp_path):
    whole = recorded(kelvin_voigt, seed=3, depth=5.7, hold_s=60.0)
    force = np.minimum(whole.force_N, 0.9 * whole.force_N.max())
    table = np.column_stack([whole.time_s, whole.displacement_mm, force])
    path = tmp_path / "overload.csv"
    np.savetxt(path, table, "%.5f", ",", header="Time (s),Displacement (mm),Force (N)", comments="")
    (trial,) = ti.read_trials(path)
    assert "clipped_force" in {flag.code for flag in trial.flags}
    fit = ti.fit(trial)
    truth = {"static_1_N_per_mm": 0.3, "stiffness_0_N_per_mm": 0.5, "relaxation_time_s": 3.0}
    found = {one.name: one for one in fit.result.parameters if one.name in truth}
    for name, value in truth.items():
        assert abs(found[name].value - value) < 3.0 * found[name].stderr < 0.2 * value
    assert fit.result.trials[0].n_samples < trial.time_s.size - np.count_nonzero(force == force.max())


@pytest.mark.parametrize(
    ("value", "total", "alone", "reaches"),
    [
        # six places whose times differ by 20 %: each alone has the truth, 0.3, where the pooled F_s bends
        (0.165, (0.082, 0.250), (0.189, 0.382), 0.3),
        # identical logs: what is not known of the machine moves the pooled value, within its interval
        (0.3789, (0.367, 0.392), (0.3720, 0.3786), None),
        (0.3, (0.25, 0.35), (0.2, 0.4), None),
        (0.3, (0.25, 0.35), None, None),
    ],
)
def test_the_interval_of_a_value_that_no_log_alone_has_holds_theirs(value, total, alone, reaches):
    own = ParameterUncertainty(value, 0.01, total, total, 400.0, 400.0, 1.0, alone)
    found, flags = reaching({"a1": ("a1", value)}, {"a1": own}, 6)
    assert [flag.code for flag in flags] == ([] if reaches is None else ["logs_apart"])
    low, high = found["a1"].ci95_total
    assert (low, high) == total if reaches is None else low == total[0] < reaches < high < alone[1]


def test_the_intervals_behind_a_machine_of_which_nothing_is_known_hold_a_rigid_one():
    trial = recorded(lambda t, x: 2.0 * x + 3.0 * branch_state(t, x, 0.5), seed=0, rate_Hz=100.0)
    found = rows(ti.fit([trial]).sample())
    for name, truth in (("relaxation_time_s", 0.5), ("viscosity_N_s_per_mm", 1.5)):
        low, high = found[name]["ci95_total"]
        assert low < truth < high < 1.1 * truth


def test_a_relaxation_that_is_slower_than_its_search_leaves_what_it_exchanges_unknown():
    trial = recorded(lambda t, x: kelvin_voigt(t, x) + 2.0 * branch_state(t, x, 500.0), seed=1)
    found = {one.name: one for one in ti.fit([trial]).result.parameters}
    unknown = {name for name, one in found.items() if not one.identified}
    slow = ("stiffness_0_N_per_mm_b2", "relaxation_time_s_b2", "viscosity_N_s_per_mm_b2")
    assert unknown == {"static_1_N_per_mm", *slow}
    assert all(found[name].value is None for name in unknown)
    assert abs(found["relaxation_time_s"].value - 3.0) < 0.2


def test_travel_that_is_read_with_noise_bends_no_law():
    trial = recorded(lambda t, x: kelvin_voigt(t, x), seed=5, rate_Hz=100.0)
    noise = 0.03 * np.random.default_rng(7).standard_normal(trial.time_s.size)
    read = replace(trial, displacement_mm=trial.displacement_mm + noise)
    found = rows(ti.fit([read]).sample())
    # K was 0 at half the depth, and a1 twice what it is
    truths = {"static_1_N_per_mm": 0.3, "stiffness_0_N_per_mm": 0.5, "relaxation_time_s": 3.0}
    for name, truth in truths.items():
        low, high = found[name]["ci95_total"]
        assert low - 0.1 * truth < truth < high + 0.1 * truth
