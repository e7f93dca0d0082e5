"""Predictive bands: closed forms of their width, and what they hold of recordings."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fit_factory import THETA, specimen_fit

from tissueid.inference.bands import BAND_DRAWS, BAND_POINTS, predictive_bands
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import KelvinVoigt

MODEL = KelvinVoigt(branches=1, stiffness_degree=0, depth_mm=6.0)
SIGMA = 0.3


def alone(samples: int = 300):
    """A fit of one log that differs in nothing from its tissue."""
    fit = specimen_fit(trials=1, samples=samples)
    (trial,) = fit.trials
    return replace(fit, trials=(replace(trial, gain=1.0, contact_offset_mm=0.0),))


def bands(theta: np.ndarray, fit=None):
    fit = fit or alone()
    tissue = SimpleNamespace(model=MODEL, theta=THETA)
    return fit.trials, predictive_bands(fit, tissue, theta, sigma_N=SIGMA)  # type: ignore[arg-type]


def two_values(theta: np.ndarray, share: float) -> np.ndarray:
    """Draws of two values of equal weight: their mean and their variance are known."""
    sign = np.where(np.arange(BAND_DRAWS) % 2, 1.0, -1.0)[:, None]
    return theta * (1.0 + share * sign * (np.arange(theta.size) == theta.size - 1))


def test_where_everything_is_known_the_noise_is_the_band() -> None:
    trials, found = bands(np.tile(THETA, (BAND_DRAWS, 1)))
    low, middle, high = found[trials[0].path, trials[0].sheet]
    assert np.array_equal(middle, trials[0].curve.model_N)
    assert high - low == pytest.approx(2 * 1.96 * SIGMA, rel=1e-4)


def test_draws_widen_the_band_by_their_spread() -> None:
    trials, found = bands(two_values(THETA, 0.1))
    curve = trials[0].curve
    path = ContactPath(curve.time_s, curve.depth_mm)
    low, _, high = found[trials[0].path, trials[0].sheet]
    longer, shorter = (MODEL.force(THETA * [1, 1, 1, 1, by], path) for by in (1.1, 0.9))
    expected = 1.96 * np.hypot(0.5 * (longer - shorter), SIGMA)
    # straight between some hundred samples of it
    assert (high - low) / 2 == pytest.approx(expected, rel=0.02)
    assert ((high - low) / 2).max() > 1.5 * 1.96 * SIGMA


def test_a_log_among_others_takes_up_by_its_gain_what_all_depths_share() -> None:
    fit = specimen_fit(trials=2, samples=300)
    sign = np.where(np.arange(BAND_DRAWS) % 2, 1.0, -1.0)[:, None]
    scaled = THETA * (1.0 + 0.1 * sign * np.array([1, 1, 1, 1, 0]))
    for trial, (low, _, high) in zip(fit.trials, bands(scaled, fit)[1].values(), strict=True):
        # all forces ten per cent up or down: a gain
        assert high - low == pytest.approx(2 * 1.96 * SIGMA, rel=1e-3), trial.path
    wide = bands(scaled)[1]
    ((low, _, high),) = wide.values()
    assert (high - low).max() > 2 * 2 * 1.96 * SIGMA


def test_a_long_curve_has_the_band_of_its_every_sample() -> None:
    """Draws are compared at some hundred samples of it, and the band is laid out between them."""
    trials, found = bands(two_values(THETA, 0.1), alone(12 * BAND_POINTS))
    curve = trials[0].curve
    path = ContactPath(curve.time_s, curve.depth_mm)
    low, middle, high = found[trials[0].path, trials[0].sheet]
    assert middle.size == curve.time_s.size
    longer, shorter = (MODEL.force(THETA * [1, 1, 1, 1, by], path) for by in (1.1, 0.9))
    assert (high - low) / 2 == pytest.approx(1.96 * np.hypot(0.5 * (longer - shorter), SIGMA), rel=0.02)


def test_the_band_of_a_known_tissue_holds_nineteen_samples_in_twenty() -> None:
    trials, found = bands(np.tile(THETA, (BAND_DRAWS, 1)), specimen_fit(trials=2, samples=300))
    inside = np.concatenate(
        [
            (trial.curve.force_N >= found[trial.path, trial.sheet][0])
            & (trial.curve.force_N <= found[trial.path, trial.sheet][2])
            for trial in trials
        ]
    )
    # 600 independent samples: three binomial standard deviations
    assert abs(inside.mean() - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / inside.size)
