"""Predictive bands: closed forms of their width, and what they hold of recordings."""

from __future__ import annotations

import numpy as np
import pytest
from fit_factory import THETA, specimen_fit

from tissueid.inference.trials import Adjustment
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.inference.bands import BAND_DRAWS, BAND_POINTS, predictive_bands
from tissueid.inference.target import Redrawn

MODEL = KelvinVoigt(branches=1, stiffness_degree=0, depth_mm=6.0)
SIGMA = 0.3


def redrawn(theta: np.ndarray, *, gain: np.ndarray, offset_mm: np.ndarray) -> Redrawn:
    count = len(theta)
    return Redrawn(theta, gain, offset_mm, np.full(count, SIGMA), np.zeros(count), theta, 1.0)


def bands(
    theta: np.ndarray,
    *,
    gain: np.ndarray | None = None,
    offset_mm: np.ndarray | None = None,
    samples: int = 300,
):
    trials = specimen_fit(trials=2, samples=samples).trials
    flat = np.ones((len(theta), 2))
    drawn = redrawn(
        theta,
        gain=flat if gain is None else gain,
        offset_mm=0.0 * flat if offset_mm is None else offset_mm,
    )
    own = [Adjustment(), Adjustment()]
    return trials, predictive_bands(MODEL, THETA, trials, own, drawn, sigma_N=SIGMA)


def test_where_everything_is_known_the_noise_is_the_band() -> None:
    trials, found = bands(np.tile(THETA, (BAND_DRAWS, 1)))
    for trial in trials:
        low, middle, high = found[trial.path, trial.sheet]
        # the same numbers added and taken off again: rounding of forces near 100 N
        assert middle == pytest.approx(trial.curve.model_N, abs=1e-11)
        assert high - low == pytest.approx(2 * 1.96 * SIGMA, rel=1e-9)


def test_a_gain_that_scatters_widens_the_band_by_its_share_of_the_force() -> None:
    # two values of equal weight: their mean is one, their variance known
    spread = 0.02
    gain = 1.0 + spread * np.where(np.arange(BAND_DRAWS) % 2, 1.0, -1.0)[:, None] * np.ones((1, 2))
    trials, found = bands(np.tile(THETA, (BAND_DRAWS, 1)), gain=gain)
    for trial in trials:
        low, _, high = found[trial.path, trial.sheet]
        path = ContactPath(trial.curve.time_s, trial.curve.depth_mm)
        expected = 1.96 * np.hypot(spread * MODEL.force(THETA, path), SIGMA)
        assert (high - low) / 2 == pytest.approx(expected, rel=1e-9)


def test_an_offset_moves_the_band_along_the_slope_of_the_curve() -> None:
    offset = np.full((BAND_DRAWS, 2), 1e-4)
    trials, found = bands(np.tile(THETA, (BAND_DRAWS, 1)), offset_mm=offset)
    for trial in trials:
        _, middle, _ = found[trial.path, trial.sheet]
        x = trial.curve.depth_mm
        slope = THETA[0] + 2 * THETA[1] * x + 3 * THETA[2] * x**2
        # second order of an offset of 1e-4 mm: half the curvature (1.7 N/mm^2) times 1e-8 mm^2
        assert middle - trial.curve.model_N == pytest.approx(-1e-4 * slope, abs=2e-8)


def test_a_longer_relaxation_time_moves_the_middle_as_the_model_says() -> None:
    theta = THETA.copy()
    theta[-1] *= 1.1
    trials, found = bands(np.tile(theta, (BAND_DRAWS, 1)))
    for trial in trials:
        path = ContactPath(trial.curve.time_s, trial.curve.depth_mm)
        expected = trial.curve.model_N + MODEL.force(theta, path) - MODEL.force(THETA, path)
        assert found[trial.path, trial.sheet][1] == pytest.approx(expected, abs=1e-9)


def test_a_long_curve_has_the_band_of_its_every_sample() -> None:
    """Draws are compared at some hundred samples of it, and the band is laid out between them."""
    theta = THETA.copy()
    theta[-1] *= 1.1
    trials, found = bands(np.tile(theta, (BAND_DRAWS, 1)), samples=12 * BAND_POINTS)
    for trial in trials:
        path = ContactPath(trial.curve.time_s, trial.curve.depth_mm)
        shift = MODEL.force(theta, path) - MODEL.force(THETA, path)
        low, middle, high = found[trial.path, trial.sheet]
        assert middle.size == trial.curve.time_s.size
        assert high - low == pytest.approx(2 * 1.96 * SIGMA, rel=1e-6)
        # straight between samples 12 apart: far below the noise of 0.3 N
        assert middle - trial.curve.model_N == pytest.approx(shift, abs=0.002)


def test_the_band_of_a_known_tissue_holds_nineteen_samples_in_twenty() -> None:
    trials, found = bands(np.tile(THETA, (BAND_DRAWS, 1)))
    inside = np.concatenate(
        [
            (trial.curve.force_N >= found[trial.path, trial.sheet][0])
            & (trial.curve.force_N <= found[trial.path, trial.sheet][2])
            for trial in trials
        ]
    )
    # 600 independent samples: three binomial standard deviations
    assert abs(inside.mean() - 0.95) <= 3 * np.sqrt(0.95 * 0.05 / inside.size)


def test_logs_with_curves_of_their_own_have_the_band_of_the_noise() -> None:
    trials = specimen_fit(trials=1, samples=100).trials
    theta = np.tile(THETA * 1.2, (BAND_DRAWS, 1))
    ones = np.ones((BAND_DRAWS, 1))
    drawn = redrawn(theta, gain=ones, offset_mm=0.0 * ones)
    own = [Adjustment(static=np.zeros(4))]
    ((low, middle, high),) = predictive_bands(MODEL, THETA, trials, own, drawn, sigma_N=SIGMA).values()
    assert np.array_equal(middle, trials[0].curve.model_N)
    assert high - low == pytest.approx(2 * 1.96 * SIGMA, rel=1e-9)
