"""What is kept of a residual equals what its samples say; the profile crosses its interval."""

from __future__ import annotations

import numpy as np
import pytest
from inference_cases import model_force, small_recipe
from test_inference_estimates import estimate, named
from test_inference_trials import MODEL, NEITHER, THETA, recorded

from tissueid.inference.estimates import LEVEL_95
from tissueid.inference.residual_blocks import residual_blocks
from tissueid.inference.summaries import BINS, residual_summary
from tissueid.inference.trials import CORNER_POINTS, CURVE_POINTS, ResidualTotals, summarise_trial


def summary_of(sigma, n=5000, scale=None):
    _, segmentation, log = recorded(sigma=sigma, n=n)
    fitted = model_force(MODEL, THETA, log, NEITHER)
    blocks = residual_blocks(segmentation, log, MODEL, THETA, NEITHER, fitted)
    return log, fitted, residual_summary(log, fitted, blocks, sigma_N=sigma if scale is None else scale)


def test_the_histogram_counts_every_fitted_sample_and_those_beyond_it():
    log, fitted, found = summary_of(0.2)
    residual = (log.data.force_N - fitted)[log.data.include]
    assert found.counts.sum() == residual.size == 5000
    inside, _ = np.histogram(residual, found.edges_N)
    np.testing.assert_array_equal(found.counts[1:-1], inside)
    assert found.edges_N.size == BINS + 1
    # in bins of a hundredth of that noise nearly everything lies beyond
    _, _, narrow = summary_of(0.2, scale=0.002)
    assert narrow.counts[0] == (residual < -0.01).sum()
    assert narrow.counts[-1] == (residual >= 0.01).sum()


def test_the_autocorrelation_is_the_direct_one_and_white_noise_has_none():
    log, fitted, found = summary_of(0.2)
    residual = (log.data.force_N - fitted)[log.data.include]
    centred = residual - residual.mean()
    direct = [centred[k:] @ centred[:-k] / (centred @ centred) for k in found.lags.tolist()]
    np.testing.assert_allclose(found.correlation, direct, atol=1e-12)
    assert found.lags[0] == 1
    assert found.lags[-1] <= 1250
    # five standard errors of a white correlation
    assert np.abs(found.correlation).max() < 5 / np.sqrt(5000)
    # a model that is exact leaves its rounding, which is counted in bins of its own size
    assert summary_of(0.0)[2].counts.sum() == 5000


def test_means_of_the_hold_stand_at_the_time_since_its_corner():
    log, fitted, found = summary_of(0.2)
    residual = log.data.force_N - fitted
    since = log.data.time_s - 2.0
    for place, mean, count in zip(
        found.hold_since_s[3:], found.hold_mean_N[3:], found.hold_count[3:], strict=True
    ):
        inside = (since >= place / 10**0.125 - 1e-9) & (since < place * 10**0.125 - 1e-9)
        assert count == inside.sum()
        assert mean == pytest.approx(residual[inside].mean(), abs=1e-12)
    assert found.start_s == log.data.time_s[0]
    assert found.step_s == pytest.approx(0.002)


def test_the_kept_curve_follows_relaxation_behind_the_corner():
    trial, segmentation, log = recorded(n=60_000)
    fitted = model_force(MODEL, THETA, log, NEITHER)
    curve = summarise_trial(
        trial, segmentation, log, fitted=fitted, adjustment=NEITHER, totals=ResidualTotals()
    ).curve
    assert curve.time_s.size <= CURVE_POINTS + 2
    since = curve.time_s - 2.0
    # of 60,000 samples some 2,500 bins of 48 ms: the first of them alone would show nothing below
    early = since[(since > 0.0) & (since < 0.048)]
    assert early.size >= CORNER_POINTS // 4
    assert early.min() == pytest.approx(0.002)


def test_the_profile_rises_to_its_level_at_the_ends_of_its_interval():
    for seed in (2, 3):
        tau = named(estimate(small_recipe(), seed, "shared"))["relaxation_time_s"]
        curve = tau.detail["profile"]
        low, high = tau.detail["profile_ci95"]
        at = np.interp(np.log([low, high]), np.log(curve["tau_s"]), curve["rise"])
        # a curve of 31 points, straight between them
        np.testing.assert_allclose(at, LEVEL_95, rtol=0.05)
        assert min(curve["rise"]) == 0.0
        assert curve["tau_s"] == sorted(curve["tau_s"])
        best = curve["tau_s"][curve["rise"].index(0.0)]
        assert best == pytest.approx(tau.detail["estimate"], rel=1e-5)
        # K tau is known far better than either: along the profile it stays
        product = np.array(curve["stiffness_N_per_mm"]) * curve["tau_s"]
        assert np.ptp(product) < 0.5 * np.ptp(curve["tau_s"]) / best * product.mean()
