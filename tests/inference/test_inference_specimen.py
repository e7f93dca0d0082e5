"""One specimen from its logs to its result, for the three ways to pool them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import by_name, draw, handle_for, handles_for, small_recipe

from tissueid.inference.specimen import FitOptions, fit_with_state
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.synth import Branch, recipe

TRUE = Branch((30.0,), 0.2)
POOLINGS = ("partial", "shared", "scaled")


def fit(recipe_, seed=0, *, branches=1, degree=0, static="partial", sd_mm=1e-4, tick=None):
    handles = handles_for(draw(recipe_, seed), sd_mm=sd_mm)
    options = FitOptions(branches=branches, stiffness_degree=degree, static=static)
    return fit_with_state("knee", handles, options=options, tick=tick).fit


def codes(fitted):
    return {flag.code for flag in fitted.flags}


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
    logs = draw(small_recipe(branches=(TRUE,)), 1)
    options = FitOptions(branches=1, stiffness_degree=0, static="shared")
    found = fit_with_state("knee", handles_for(logs), options=options, machine=False).fit
    model = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=found.depth_mm)
    squares = 0.0
    for log, trial in zip(logs, found.trials, strict=True):
        depth = np.maximum(log.displacement_mm - trial.contact_offset_mm, 0.0)
        residual = log.force_N - model.force(found.theta, ContactPath(log.time_s, depth))
        # the path between a contact and the sample behind it is a line here and there
        assert trial.nrmsd.rmse_N == pytest.approx(float(np.sqrt(np.mean(residual**2))), rel=1e-4)
        squares += float(residual @ residual)
    assert found.nrmsd.rmse_N == pytest.approx(float(np.sqrt(squares / found.n_samples)), rel=1e-4)
    # with the priors in it: weak ones, and those of the contacts
    assert found.optimisers["vp_sum_of_squares_N2"] == pytest.approx(squares, rel=0.02)


def test_shared_logs_keep_a_contact_each():
    handles = handles_for(draw(small_recipe(branches=(TRUE,), sigma_N=0.05), 5), sd_mm=0.03)
    contact = handles[0].segmentation.contact
    late = replace(contact, displacement_mm=contact.displacement_mm + 0.03)
    trial = handles[0].load()
    moved = handle_for(trial, replace(handles[0].segmentation, contact=late))
    options = FitOptions(branches=1, stiffness_degree=0, static="shared")
    found = fit_with_state("knee", [moved, *handles[1:]], options=options).fit
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


def test_one_log_has_nothing_to_pool():
    small = small_recipe(branches=(TRUE,), logs=small_recipe().logs[-1:])
    found = fit(small)
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


def test_chosen_model_comes_with_its_table():
    found = fit(small_recipe(branches=(TRUE,)), 3, branches=None, degree=None, static="shared")
    (row,) = [row for row in found.selection if row["chosen"]]
    assert (row["branches"], row["stiffness_degree"]) == (found.model.branches, found.model.stiffness_degree)


def test_at_10_hz_viscosity_is_known_and_the_relaxation_time_is_not():
    found = fit(recipe("paper-a-30-10Hz"))
    tau, eta = (by_name(found)[name] for name in ("relaxation_time_s", "viscosity_N_s_per_mm"))
    assert (tau.identified, tau.value, eta.identified) == (False, None, True)
    assert abs(eta.value - 63.62 * 0.021) <= 4.0 * eta.stderr
    assert {"not_identified", "compliance_unknown"} <= codes(found)
