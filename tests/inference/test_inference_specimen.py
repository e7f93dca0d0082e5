"""One specimen from its logs to its result: pooling, units, standard errors, profiles."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import by_name, draw, handle_for, handles_of, identified, small_recipe, state_of

from tissueid.inference.estimates import LEVEL_95, MAX_WIDTH, estimate_tissue, profile, theta_covariance
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.synth import Branch, Hold, Log, Move

TRUE = Branch((30.0,), 0.2)
POOLINGS = ("partial", "shared", "scaled")


def fit(recipe, seed=0, *, static="partial", tick=None):
    return state_of(handles_of(recipe, seed), machine=True, static=static, tick=tick).fit


@pytest.mark.parametrize("static", POOLINGS)
def test_tissue_is_identified_and_says_how(static):
    found = fit(small_recipe(branches=(TRUE,)), static=static)
    assert found.specimen == "knee"
    assert found.model.as_json() == {
        "key": "kelvin-voigt", "name": "kelvin-voigt", "range_s": None, "branches": 1,
        "static_degree": 3, "stiffness_degree": 0, "static_pooling": static,
    }  # fmt: skip
    truth = {"relaxation_time_s": 0.2, "viscosity_N_s_per_mm": 6.0, "static_1_N_per_mm": 20.0}
    for name, value in truth.items():
        one = found.parameter(name)
        assert one.identified, name
        assert abs(one.value - value) <= 4.0 * one.stderr, name
    assert (found.sigma_N, found.nrmsd.rmse_N) == pytest.approx((0.2, 0.2), rel=0.15)
    assert found.optimisers["agree"]
    assert found.optimisers["lm_converged"]
    assert found.depth_mm == pytest.approx(4.0, abs=1e-3)  # contact points are refined
    assert found.speeds_mm_s == pytest.approx((1.0, 10.0))
    assert found.n_samples == sum(trial.n_samples for trial in found.trials)
    assert (len(found.trials), len(found.relaxation), found.selection) == (5, 2, ())
    assert found.theta_names == kelvin_voigt(1, 0, 4.0).parameter_names


def test_residuals_are_those_of_the_reported_tissue():
    handles = handles_of(small_recipe(branches=(TRUE,)), 1)
    found = state_of(handles, static="shared").fit
    model = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=found.depth_mm)
    squares = 0.0
    for log, trial in zip((one.load() for one in handles), found.trials, strict=True):
        depth = np.maximum(log.displacement_mm - trial.contact_offset_mm, 0.0)
        residual = log.force_N - model.force(found.theta, ContactPath(log.time_s, depth))
        # the path between a contact and the sample behind it is a line here and there
        assert trial.nrmsd.rmse_N == pytest.approx(float(np.sqrt(np.mean(residual**2))), rel=1e-4)
        squares += float(residual @ residual)
    assert found.nrmsd.rmse_N == pytest.approx(float(np.sqrt(squares / found.n_samples)), rel=1e-4)
    # with the priors in it: weak ones, and those of the contacts
    assert found.optimisers["vp_sum_of_squares_N2"] == pytest.approx(squares, rel=0.02)


def test_shared_logs_keep_a_contact_each():
    handles = handles_of(small_recipe(branches=(TRUE,), sigma_N=0.05), 5, sd_mm=0.03)
    contact = handles[0].segmentation.contact
    late = replace(contact, displacement_mm=contact.displacement_mm + 0.03)
    moved = handle_for(handles[0].load(), replace(handles[0].segmentation, contact=late))
    found = state_of([moved, *handles[1:]], machine=True, static="shared").fit
    assert found.trials[0].contact_offset_mm == pytest.approx(-0.03, abs=0.004)
    assert max(abs(one.contact_offset_mm) for one in found.trials[1:]) <= 0.004
    tau = by_name(found)["relaxation_time_s"]
    assert abs(tau.value - 0.2) <= 4.0 * tau.stderr


@pytest.mark.parametrize("static", ["partial", "scaled"])
def test_scatter_between_logs_is_taken_up_by_each_log(static):
    small = small_recipe(branches=(TRUE,), cv_both=0.1)
    found = fit(small, 2, static=static)
    assert max(trial.nrmsd.rmse_N for trial in found.trials) <= 0.25
    if static == "partial":
        truth = np.array([log.truth["gain"] for log in draw(small, 2)])
        ours = np.array([trial.gain for trial in found.trials])
        np.testing.assert_allclose(ours / ours.mean(), truth / truth.mean(), rtol=0.03)


@pytest.mark.parametrize(("logs", "pooling"), [(3, "partial"), (5, "scaled")])
def test_curves_and_times_of_a_log_are_its_own_where_a_speed_is_repeated(logs, pooling):
    """Three ramps have a speed each; the holds behind them begin at one of these."""
    small = small_recipe(branches=(TRUE,))
    assert fit(replace(small, logs=small.logs[:logs]), static="auto").model.static_pooling == pooling


def test_one_log_has_nothing_to_pool():
    found = fit(small_recipe(branches=(TRUE,), logs=small_recipe().logs[-1:]))
    assert found.model.static_pooling == "shared"
    assert len(found.trials) == 1
    assert found.trials[0].gain == 1.0
    assert abs(by_name(found)["relaxation_time_s"].detail["estimate"] - 0.2) <= 0.05


def test_the_same_logs_give_the_same_bytes_and_progress_names_what_is_done():
    said = []
    first, second = (fit(small_recipe(branches=(TRUE,)), 4, tick=said.append) for _ in range(2))
    np.testing.assert_array_equal(first.theta, second.theta)
    np.testing.assert_array_equal(first.covariance, second.covariance)
    assert [one.as_json() for one in first.parameters] == [one.as_json() for one in second.parameters]
    assert [sum(word in one for one in said) for word in ("reading", "residuals")] == [10, 10]


GROWING = Branch((30.0, 6.0), 0.2)
SEEDS = 25


def estimate(recipe, seed, pooling, *, branches=1, degree=0):
    asked = {"branches": (branches,), "degrees": (degree,), "pooling": pooling, "noise": "white"}
    return estimate_tissue(identified(handles_of(recipe, seed), **asked))


@pytest.mark.parametrize("pooling", POOLINGS)
def test_values_come_in_natural_units(pooling):
    found = by_name(estimate(small_recipe(branches=(GROWING,), sigma_N=0.01), 0, pooling, degree=1))
    expected = {
        "static_1_N_per_mm": (20.0, "N/mm"),
        "static_2_N_per_mm2": (-1.2, "N/mm^2"),
        "static_3_N_per_mm3": (0.35, "N/mm^3"),
        "stiffness_0_N_per_mm": (30.0, "N/mm"),
        "stiffness_1_N_per_mm2": (6.0, "N/mm^2"),
        "relaxation_time_s": (0.2, "s"),
        # K at half of 4 mm is 42 N/mm
        "viscosity_N_s_per_mm": (42.0 * 0.2, "N s/mm"),
    }
    assert set(found) == set(expected)
    for name, (value, unit) in expected.items():
        assert found[name].unit == unit
        assert found[name].identified
        assert found[name].value == pytest.approx(value, rel=0.05)
        assert abs(found[name].value - value) <= 6.0 * found[name].stderr


def test_a_bound_that_data_do_not_press_against_narrows_no_standard_error():
    ours = identified(handles_of(small_recipe(branches=(GROWING,)), 0), branches=(1,), degrees=(1,))
    touched = replace(ours.optimum, active=np.ones_like(ours.optimum.active))
    covariance = theta_covariance(replace(ours, optimum=touched))
    np.testing.assert_allclose(covariance, theta_covariance(ours), rtol=1e-9)
    # and one that holds leaves no room across it
    pressed = replace(touched, normal=replace(touched.normal, gradient=-1e6 * touched.prior.cone.sum(axis=0)))
    assert np.linalg.matrix_rank(theta_covariance(replace(ours, optimum=pressed))) < len(covariance)


@pytest.mark.system
@pytest.mark.parametrize("pooling", ["shared", "scaled", pytest.param("partial", marks=pytest.mark.slow)])
def test_standard_errors_are_the_spread_over_repeated_recordings(pooling):
    """25 seeds: an estimated sd scatters by 14 %, so that 0.65 to 1.45 fails an error of half or double.

    Logs that may differ do: of logs without scatter five can't say that there is none.  Their static shapes
    and times are alike here all the same, which leaves too wide an error of these: one speed each, 4 % of a
    time that is known to 0.4 %.
    """
    recipe = small_recipe(branches=(GROWING,), cv_both=0.0 if pooling == "shared" else 0.05)
    truth = {"relaxation_time_s": 0.2, "viscosity_N_s_per_mm": 8.4, "stiffness_0_N_per_mm": 30.0}
    truth |= {"static_1_N_per_mm": 20.0, "static_2_N_per_mm2": -1.2, "static_3_N_per_mm3": 0.35}
    found = [by_name(estimate(recipe, seed, pooling, degree=1)) for seed in range(SEEDS)]
    for name, number in truth.items():
        values, claims = ([one[name].detail[key] for one in found] for key in ("estimate", "estimate_stderr"))
        spread, claim = np.std(values, ddof=1), np.mean(claims)
        alike = {"static": 0.4, "relaxation": 0.15} if pooling == "scaled" else {}
        least = alike.get(name.partition("_")[0], 0.65)
        assert least <= spread / claim <= 1.45, (name, spread, claim)
        assert abs(np.mean(values) - number) <= 4.0 * claim / np.sqrt(SEEDS), name


def test_viscosity_is_known_far_better_than_stiffness_and_time():
    found = by_name(estimate(small_recipe(branches=(Branch((63.62,), 0.021),)), 0, "shared"))
    relative = {name: one.stderr / one.value for name, one in found.items() if one.value}
    assert relative["viscosity_N_s_per_mm"] < 0.3 * relative["relaxation_time_s"]
    assert relative["stiffness_0_N_per_mm"] == pytest.approx(relative["relaxation_time_s"], rel=0.3)


def test_further_branches_are_numbered_by_ascending_time():
    branches = (Branch((10.0,), 1.5), Branch((40.0,), 0.1))
    found = by_name(estimate(small_recipe(branches=branches, sigma_N=0.02), 0, "shared", branches=2))
    assert found["relaxation_time_s"].value == pytest.approx(0.1, rel=0.1)
    assert found["relaxation_time_s_b2"].value == pytest.approx(1.5, rel=0.1)
    assert found["viscosity_N_s_per_mm_b2"].value == pytest.approx(15.0, rel=0.1)
    assert found["stiffness_0_N_per_mm_b2"].symbol == "b0,2"


def test_what_is_not_identified_has_no_value_and_keeps_its_estimate():
    # sampled at 10 Hz, a relaxation of 21 ms is not seen; the viscosity is
    logs = tuple(log for log in small_recipe().logs if log.name != "ramp-600")
    found = by_name(estimate(small_recipe(rate_Hz=10.0, logs=logs), 1, "shared"))
    tau = found["relaxation_time_s"]
    assert (tau.identified, tau.value, tau.stderr) == (False, None, None)
    low, high = tau.detail["profile_ci95"]
    assert 0.0 < low <= tau.detail["estimate"] <= high
    assert tau.detail["open_low"] or np.log(high / low) > MAX_WIDTH
    assert found["viscosity_N_s_per_mm"].identified
    # an elastic tissue has a static curve alone
    tissue = estimate(small_recipe(branches=(Branch((1e-9,), 0.1),)), 0, "shared")
    known = {name for name, one in by_name(tissue).items() if one.identified}
    assert "static_1_N_per_mm" in known
    assert not known & {"relaxation_time_s", "viscosity_N_s_per_mm"}
    assert np.isfinite(tissue.covariance).all()


def test_an_active_bound_is_said_and_leaves_a_passive_tissue():
    recipe = small_recipe(branches=(Branch((60.0, -15.0), 0.2),), sigma_N=2.0)  # K is zero at 4 mm
    tissues = [estimate(recipe, seed, "shared", degree=2) for seed in range(8)]
    assert all(one.model.is_passive(one.theta) for one in tissues)
    assert all((np.diag(one.covariance) >= 0.0).all() for one in tissues)
    assert any(one.bounded for one in tissues)


@pytest.mark.parametrize("pooling", ["shared", "partial", "scaled"])
def test_theta_is_in_the_order_of_the_model_and_passive(pooling):
    tissue = estimate(small_recipe(branches=(GROWING,)), 0, pooling, degree=1)
    found = [by_name(tissue)[name] for name in tissue.model.parameter_names]
    stderr = np.sqrt(np.diag(tissue.covariance))
    np.testing.assert_allclose([one.detail["estimate"] for one in found], tissue.theta, rtol=1e-12)
    np.testing.assert_allclose([one.stderr for one in found], stderr, rtol=1e-9)
    assert tissue.model.is_passive(tissue.theta)
    assert np.linalg.eigvalsh(tissue.covariance / stderr / stderr[:, None]).min() >= -1e-9


def test_a_covariance_is_symmetric_where_directions_are_nearly_flat():
    one = Log("one", (Move(4.0, 240.0), Hold(1.0)))
    recipe = replace(small_recipe(branches=(GROWING,), sigma_N=1e-9), logs=(one,))
    tissue = estimate(recipe, 0, "shared", branches=3, degree=2)
    assert (tissue.covariance == tissue.covariance.T).all()


def profiled(recipe, seed=1, branch=0, **asked):
    ours = identified(handles_of(recipe, seed), noise="white", **asked)
    return ours, *profile(ours, branch)


def test_a_well_determined_time_is_closed_and_about_its_standard_errors():
    ours, interval, curve = profiled(small_recipe(branches=(Branch((30.0,), 0.2),)))
    assert interval.closed
    assert interval.low < np.log(0.2) < interval.high
    half = np.sqrt(LEVEL_95 * ours.optimum.covariance[0, 0])
    centre = ours.optimum.point.log_times[0]
    assert interval.low == pytest.approx(centre - half, abs=0.05 * half)
    assert interval.high == pytest.approx(centre + half, abs=0.05 * half)
    assert interval.width == pytest.approx(2.0 * half, rel=0.05)
    # the rise of a parabola in standard errors
    rise = ((np.log(curve["tau_s"]) - centre) / np.sqrt(ours.optimum.covariance[0, 0])) ** 2
    np.testing.assert_allclose(curve["rise"], rise, rtol=0.15, atol=0.05)
    # K tau is what the ramps know
    product = np.array(curve["tau_s"]) * curve["stiffness_N_per_mm"]
    assert np.ptp(product) < 0.6 * np.ptp(curve["tau_s"]) / 0.2 * product.mean()


RAMPS = tuple(Log(f"ramp-{v:.0f}", (Move(4.0, v),)) for v in (60.0, 120.0))
SHORT_HOLD = (Log("hold", (Move(4.0, 240.0), Hold(2.0))),)


@pytest.mark.parametrize(
    ("branch", "given", "open_low"),
    [
        (Branch((60.0,), 0.005), {"logs": RAMPS, "rate_Hz": 20.0}, True),
        (Branch((30.0,), 200.0), {"logs": SHORT_HOLD, "sigma_N": 0.5}, False),
    ],
)
def test_a_time_far_below_the_sampling_or_beyond_the_record_is_open_there(branch, given, open_low):
    _, interval, _ = profiled(small_recipe(branches=(branch,), **given))
    assert interval.open_low or not open_low
    assert interval.open_high or open_low
    assert not interval.closed
    if open_low:
        assert interval.low == pytest.approx(np.log(0.2 / 20.0), abs=1e-6)


def test_each_branch_has_its_own():
    two = (Branch((30.0,), 0.05), Branch((25.0,), 1.5))
    recipe = small_recipe(branches=two, sigma_N=0.05)
    for branch, tau in enumerate((0.05, 1.5)):
        ours, interval, curve = profiled(recipe, branches=(2,), branch=branch)
        assert interval.closed
        assert interval.low < np.log(tau) < interval.high
        assert min(curve["tau_s"]) < np.exp(ours.optimum.point.log_times[branch]) < max(curve["tau_s"])
