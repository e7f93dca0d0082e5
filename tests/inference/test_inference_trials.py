"""Residual summaries of a trial and the curve that is kept of it."""

from __future__ import annotations

import numpy as np
import pytest
from inference_cases import model_force

from tissueid.inference.trials import CURVE_POINTS, Adjustment, ResidualTotals, summarise_trial
from tissueid.inference.window import fitted_log
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.trial import Contact, Phase, Segmentation, Source, Trial

MODEL = kelvin_voigt(branches=1, stiffness_degree=1, depth_mm=4.0)
THETA = np.array([20.0, -1.0, 0.3, 25.0, 2.0, 0.5])
NEITHER = Adjustment()


def recorded(sigma=0.0, n=5000, spike=None, seed=0):
    time = np.arange(n) * 0.002
    depth = np.minimum(2.0 * time, 4.0)
    force = MODEL.force(THETA, ContactPath(time, depth))
    force = force + sigma * np.random.default_rng(seed).normal(size=n)
    if spike is not None:
        force[spike] += 40.0
    trial = Trial("s", time, depth, force, source=Source(path="a.csv", sheet="Tab 1"))
    corner = int(np.argmax(depth >= 4.0))
    phases = (
        Phase("ramp", 0, corner + 1, 0.0, float(time[corner]), 2.0),
        Phase("hold", corner, n, float(time[corner]), float(time[-1]), 0.0),
    )
    segmentation = Segmentation(1, 1, Contact(0, 0.0, 0.001), phases, sigma)
    return trial, segmentation, fitted_log(trial, segmentation)


def summary(trial, segmentation, log, adjustment=NEITHER, totals=None):
    return summarise_trial(
        trial, segmentation, log, fitted=model_force(MODEL, THETA, log, adjustment), adjustment=adjustment,
        totals=ResidualTotals() if totals is None else totals,
    )  # fmt: skip


def test_summary_of_a_good_fit():
    trial, segmentation, log = recorded(sigma=0.2)
    totals = ResidualTotals()
    found = summary(trial, segmentation, log, totals=totals)
    assert (found.path, found.sheet) == ("a.csv", "Tab 1")
    assert found.nrmsd.rmse_N == pytest.approx(0.2, rel=0.05)
    assert abs(found.residual_acf1) <= 0.05
    assert found.max_residual_fraction <= 0.02
    assert found.gain == 1.0
    assert found.speed_mm_s == 2.0
    assert found.depth_mm == pytest.approx(4.0)
    assert found.n_samples == totals.count == 5000
    assert found.flags == ()
    assert np.sqrt(totals.squares / totals.count) == pytest.approx(found.nrmsd.rmse_N)


def test_a_large_residual_is_flagged_with_its_share():
    trial, segmentation, log = recorded(sigma=0.2, spike=2500)
    found = summary(trial, segmentation, log)
    flag = next(one for one in found.flags if one.code == "residual_large")
    assert flag.values["max_residual_fraction"] == pytest.approx(found.max_residual_fraction)
    assert found.max_residual_fraction == pytest.approx(40.0 / np.ptp(trial.force_N), rel=0.05)


def test_a_wrong_model_leaves_correlated_residuals():
    trial, segmentation, log = recorded(sigma=0.2)
    found = summary(trial, segmentation, log, Adjustment(gain=1.1))
    assert {"residual_correlated", "residual_large"} <= {one.code for one in found.flags}
    assert found.residual_acf1 > 0.9
    assert found.gain == 1.1


def test_decimation_keeps_ends_and_extremes():
    trial, segmentation, log = recorded(sigma=0.2, n=60_000, spike=31_234)
    curve = summary(trial, segmentation, log).curve
    assert curve.time_s.size <= CURVE_POINTS + 2
    assert curve.time_s[0] == 0.0
    assert curve.time_s[-1] == pytest.approx(trial.time_s[-1])
    assert curve.force_N.max() == trial.force_N.max()
    assert curve.force_N.min() == trial.force_N.min()
    assert curve.depth_mm.max() == pytest.approx(4.0)
    assert (np.diff(curve.time_s) > 0.0).all()
    assert curve.model_N.shape == curve.fitted.shape == curve.force_N.shape


def test_a_short_curve_is_kept_whole():
    trial, segmentation, log = recorded(n=200)
    np.testing.assert_array_equal(summary(trial, segmentation, log).curve.force_N, trial.force_N)


def test_excluded_samples_stay_in_the_curve_and_out_of_the_numbers():
    trial, segmentation, _ = recorded(sigma=0.2, n=400)
    force = trial.force_N.copy()
    force[:20] += 100.0
    spoiled = Trial("s", trial.time_s, trial.displacement_mm, force, source=trial.source)
    guarded = fitted_log(
        spoiled, Segmentation(1, 1, Contact(0, 0.0, 0.05), segmentation.phases, 0.2), guard=True
    )
    assert not guarded.data.include[:20].all()
    found = summary(spoiled, segmentation, guarded)
    assert found.n_samples == int(guarded.data.include.sum()) < 400
    assert found.nrmsd.rmse_N < 1.0
    assert not found.curve.fitted.all()


def test_totals_over_trials_are_those_of_all_samples():
    rng = np.random.default_rng(0)
    totals = ResidualTotals()
    forces, models = [], []
    for n in (30, 50):
        force, model = rng.normal(size=n), rng.normal(size=n)
        totals.add(force, model)
        forces.append(force)
        models.append(model)
    force, model = np.concatenate(forces), np.concatenate(models)
    assert totals.squares == pytest.approx(float(((force - model) ** 2).sum()))
    assert totals.force == pytest.approx(float(np.abs(force).sum()))
    assert (totals.low, totals.high, totals.count) == (force.min(), force.max(), 80)
