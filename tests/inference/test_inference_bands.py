"""Predictive bands: closed forms of their width."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from fit_factory import specimen_fit

from tissueid.inference.reported import BAND_DRAWS, predictive_bands
from tissueid.result import SpecimenFit

SIGMA = 0.3


def bands_of(
    fit: SpecimenFit, force_of: Callable[[np.ndarray], np.ndarray], vectors: np.ndarray
) -> list[np.ndarray]:
    """Bands of logs whose observations are the samples of their curves."""
    times = [trial.curve.time_s for trial in fit.trials]
    system = SimpleNamespace(
        log=np.repeat(np.arange(len(times)), [one.size for one in times]),
        mid=np.concatenate(times),
        logs=[SimpleNamespace(time_s=one) for one in times],
    )
    target = SimpleNamespace(system=system, forces=lambda x: np.stack([force_of(one) for one in x]))
    return list(predictive_bands(fit, target, vectors, sigma_N=SIGMA).values())  # type: ignore[arg-type]


def one_log() -> SpecimenFit:
    fit = specimen_fit(trials=1, samples=300)
    return replace(fit, trials=fit.trials[:1])


def spread(size: int = BAND_DRAWS) -> np.ndarray:
    """Normal draws of one coordinate."""
    return np.random.default_rng(0).standard_normal((size, 1))


def test_where_everything_is_known_the_noise_is_the_band() -> None:
    fit = one_log()
    force = fit.trials[0].curve.model_N
    ((low, middle, high),) = bands_of(fit, lambda _: force, spread())
    assert np.array_equal(middle, force)
    assert high - low == pytest.approx(2 * 1.96 * SIGMA, rel=1e-4)


def test_draws_widen_the_band_by_their_spread() -> None:
    fit = one_log()
    force = fit.trials[0].curve.model_N
    slope = np.linspace(0.0, 2.0, force.size)
    ((low, _, high),) = bands_of(fit, lambda x: force + slope * x[0], spread())
    # a hundred draws know their spread to some ten per cent
    assert (high - low) / 2 == pytest.approx(1.96 * np.hypot(slope, SIGMA), rel=0.2)
    assert (high - low)[-1] > 4.0 * (high - low)[0]


def test_one_draw_far_out_does_not_make_the_band() -> None:
    fit = one_log()
    force = fit.trials[0].curve.model_N
    vectors = np.zeros((BAND_DRAWS, 1))
    vectors[3] = 1e4
    ((low, _, high),) = bands_of(fit, lambda x: force + x[0], vectors)
    assert high - low == pytest.approx(2 * 1.96 * SIGMA, rel=1e-3)


def test_a_log_among_others_takes_up_by_its_gain_what_all_depths_share() -> None:
    fit = specimen_fit(trials=2, samples=300)
    force = np.concatenate([trial.curve.model_N for trial in fit.trials])
    for low, _, high in bands_of(fit, lambda x: force * (1.0 + 0.1 * x[0]), spread()):
        assert high - low == pytest.approx(2 * 1.96 * SIGMA, rel=1e-3)
    alone = one_log()
    own = alone.trials[0].curve.model_N
    ((low, _, high),) = bands_of(alone, lambda x: own * (1.0 + 0.1 * x[0]), spread())
    assert (high - low).max() > 2 * 2 * 1.96 * SIGMA
