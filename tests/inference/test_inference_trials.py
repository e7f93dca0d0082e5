"""Residual summaries of a trial against what its samples say, and the curve that is kept of it."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import model_force
from scipy.signal import lfilter

from tissueid.inference import trials
from tissueid.inference.residual_blocks import residual_blocks
from tissueid.inference.summaries import BINS, residual_summary
from tissueid.inference.trials import Adjustment
from tissueid.inference.window import fitted_log
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.signal_noise import lag_one_correlation
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
        force[spike : spike + 2] += 40.0, 20.0  # no level: it is fitted
    trial = Trial("s", time, depth, force, source=Source(path="a.csv", sheet="Tab 1"))
    corner = int(np.argmax(depth >= 4.0))
    phases = (
        Phase("ramp", 0, corner + 1, 0.0, float(time[corner]), 2.0),
        Phase("hold", corner, n, float(time[corner]), float(time[-1]), 0.0),
    )
    segmentation = Segmentation(1, 1, Contact(0, 0.0, 0.001), phases, sigma)
    return trial, segmentation, fitted_log(trial, segmentation)


def summed(trial, segmentation, log, adjustment=NEITHER):
    fitted = model_force(MODEL, THETA, log, adjustment)
    return trials.summarise_trial(trial, segmentation, log, fitted=fitted, adjustment=adjustment)


def summary(trial, segmentation, log, adjustment=NEITHER):
    return summed(trial, segmentation, log, adjustment)[0]


def test_summary_of_a_good_fit():
    trial, segmentation, log = recorded(sigma=0.2)
    found, totals = summed(trial, segmentation, log)
    assert (found.path, found.sheet) == ("a.csv", "Tab 1")
    assert found.nrmsd.rmse_N == pytest.approx(0.2, rel=0.05)
    assert abs(found.residual_acf1) <= 0.05
    assert found.max_residual_fraction <= 0.02
    assert (found.gain, found.speed_mm_s) == (1.0, 2.0)
    assert found.depth_mm == pytest.approx(4.0)
    assert found.n_samples == totals.samples == 5000
    assert found.flags == ()
    assert np.sqrt(totals.squares / totals.samples) == pytest.approx(found.nrmsd.rmse_N)


def test_residuals_that_are_large_or_correlated_are_flagged():
    trial, segmentation, log = recorded(sigma=0.2, spike=2500)
    found = summary(trial, segmentation, log)
    flag = next(one for one in found.flags if one.code == "residual_large")
    assert flag.values["max_residual_fraction"] == found.max_residual_fraction
    assert found.max_residual_fraction == pytest.approx(40.0 / np.ptp(trial.force_N), rel=0.05)
    trial, segmentation, log = recorded(sigma=4.0)
    noisy = summary(trial, replace(segmentation, force_noise_N=4.0), log)
    # the largest of 5,000 samples of white noise
    assert noisy.max_residual_fraction > 0.1
    assert noisy.flags == ()
    wrong = summary(*recorded(sigma=0.2), Adjustment(gain=1.1))
    assert {"residual_correlated", "residual_large"} <= {one.code for one in wrong.flags}
    assert wrong.residual_acf1 > 0.9
    assert wrong.gain == 1.1


def test_a_short_curve_is_kept_whole_and_totals_are_of_all_samples():
    trial, segmentation, log = recorded(sigma=0.1, n=300)
    found, totals = summed(trial, segmentation, log)
    force, model = found.curve.force_N, found.curve.model_N
    np.testing.assert_array_equal(force, trial.force_N)
    assert totals.squares == pytest.approx(float(((force - model) ** 2).sum()))
    assert totals.force == pytest.approx(float(np.abs(force).sum()))
    assert (totals.low, totals.high, totals.samples) == (force.min(), force.max(), 300)


def test_decimation_keeps_ends_and_extremes():
    trial, segmentation, log = recorded(sigma=0.2, n=60_000, spike=31_234)
    curve = summary(trial, segmentation, log).curve
    assert curve.time_s.size <= trials.CURVE_POINTS + 2
    assert curve.time_s[0] == 0.0
    assert curve.time_s[-1] == pytest.approx(trial.time_s[-1])
    assert curve.force_N.max() == trial.force_N.max()
    assert curve.force_N.min() == trial.force_N.min()
    assert curve.depth_mm.max() == pytest.approx(4.0)
    assert (np.diff(curve.time_s) > 0.0).all()
    assert curve.model_N.shape == curve.fitted.shape == curve.force_N.shape


def test_excluded_samples_stay_in_the_curve_and_out_of_the_numbers():
    trial, segmentation, _ = recorded(sigma=0.2, n=400)
    force = trial.force_N.copy()
    force[:20] += 100.0
    spoiled = Trial("s", trial.time_s, trial.displacement_mm, force, source=trial.source)
    vague = Segmentation(1, 1, Contact(0, 0.0, 0.05), segmentation.phases, 0.2)
    guarded = fitted_log(spoiled, vague, guard=True)
    assert not guarded.data.include[:20].all()
    found = summary(spoiled, segmentation, guarded)
    assert found.n_samples == int(guarded.data.include.sum()) < 400
    assert found.nrmsd.rmse_N < 1.0
    assert not found.curve.fitted.all()


@pytest.mark.parametrize(
    ("force", "model", "by_range", "by_mean", "rmse"),
    [
        ([0.0, 4.0, 8.0, 12.0], [1.0, 3.0, 9.0, 11.0], 1.0 / 12.0, 1.0 / 6.0, 1.0),
        # the range is that of the measurement
        ([0.0, 10.0], [0.0, 30.0], np.sqrt(200.0) / 10.0, np.sqrt(200.0) / 5.0, np.sqrt(200.0)),
        # the mean is that of the size of the force
        ([-4.0, -8.0], [-5.0, -7.0], 1.0 / 4.0, 1.0 / 6.0, 1.0),
        ([-1.0, 1.0], [-1.0, 2.0], np.sqrt(0.5) / 2.0, np.sqrt(0.5), np.sqrt(0.5)),
        ([5.0] * 4, [5.0] * 4, 0.0, 0.0, 0.0),
        ([5.0] * 4, [6.0] * 4, np.inf, 0.2, 1.0),
    ],
)
def test_deviation_by_range_by_mean_and_in_newtons(force, model, by_range, by_mean, rmse):
    found = trials.nrmsd(np.array(force), np.array(model))
    assert (found.range, found.mean, found.rmse_N) == pytest.approx((by_range, by_mean, rmse))


def test_correlation_at_one_sample_is_that_of_the_residual():
    assert lag_one_correlation(np.resize([1.0, -1.0], 1000)) == pytest.approx(-0.999)
    assert lag_one_correlation(np.sin(np.linspace(0.0, 6.28, 1000))) > 0.99
    noise = np.random.default_rng(2).normal(size=200_000)
    # sd of the estimate is sqrt((1 - phi^2) / n) = 0.0016
    residual = 100.0 + lfilter([1.0], [1.0, -0.7], noise)
    assert lag_one_correlation(residual) == pytest.approx(0.7, abs=0.008)
    for few in ([1.0], [1.0, 2.0], [3.0, 3.0, 3.0]):
        assert lag_one_correlation(np.array(few)) == 0.0


def summary_of(sigma, scale):
    """A log, the residual of all its samples, and what is kept of it."""
    _, segmentation, log = recorded(sigma=sigma)
    fitted = model_force(MODEL, THETA, log, NEITHER)
    blocks = residual_blocks(segmentation, log, MODEL, THETA, NEITHER, fitted)
    return log, log.data.force_N - fitted, residual_summary(log, fitted, blocks, sigma_N=scale)


def test_the_histogram_counts_every_fitted_sample_and_those_beyond_it():
    log, residual, found = summary_of(0.2, 0.2)
    residual = residual[log.data.include]
    assert found.counts.sum() == residual.size == 5000
    np.testing.assert_array_equal(found.counts[1:-1], np.histogram(residual, found.edges_N)[0])
    assert found.edges_N.size == BINS + 1
    # in bins of a hundredth of that noise nearly everything lies beyond
    narrow = summary_of(0.2, 0.002)[2].counts
    assert (narrow[0], narrow[-1]) == ((residual < -0.01).sum(), (residual >= 0.01).sum())
    # a model that is exact leaves its rounding, which is counted in bins of its own size
    assert summary_of(0.0, 0.0)[2].counts.sum() == 5000


def test_the_autocorrelation_is_the_direct_one_and_means_of_the_hold_stand_since_its_corner():
    log, residual, found = summary_of(0.2, 0.2)
    centred = residual[log.data.include] - residual[log.data.include].mean()
    direct = [centred[k:] @ centred[:-k] / (centred @ centred) for k in found.lags.tolist()]
    np.testing.assert_allclose(found.correlation, direct, atol=1e-12)
    assert 1 == found.lags[0] < found.lags[-1] <= 1250
    # five standard errors of a white correlation
    assert np.abs(found.correlation).max() < 5 / np.sqrt(5000)
    since = log.data.time_s - 2.0
    held = zip(found.hold_since_s[3:], found.hold_mean_N[3:], found.hold_count[3:], strict=True)
    for place, mean, count in held:
        inside = (since >= place / 10**0.125 - 1e-9) & (since < place * 10**0.125 - 1e-9)
        assert count == inside.sum()
        assert mean == pytest.approx(residual[inside].mean(), abs=1e-12)
    assert (found.start_s, found.step_s) == pytest.approx((log.data.time_s[0], 0.002))


def test_the_kept_curve_follows_relaxation_behind_the_corner():
    curve = summary(*recorded(n=60_000)).curve
    assert curve.time_s.size <= trials.CURVE_POINTS + 2
    since = curve.time_s - 2.0
    # of 60,000 samples some 2,500 bins of 48 ms: the first of them alone would show nothing below
    early = since[(since > 0.0) & (since < 0.048)]
    assert early.size >= trials.CORNER_POINTS // 4
    assert early.min() == pytest.approx(0.002)
