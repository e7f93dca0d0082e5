"""Spectra of holds and the time in which fluid drains, against sums and closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from tissueid.measured.spectrum import drainage_time, hold_numbers, relaxation_spectrum
from tissueid.model.moduli import drained_share
from tissueid.trial import Contact, Phase, Segmentation, Source, Trial


@pytest.mark.parametrize("ramp_s", [0.0, 0.5])
@pytest.mark.parametrize("truth", [0.3, 3.0])
def test_the_time_of_drainage_is_found_behind_its_ramp(truth: float, ramp_s: float) -> None:
    """Parts of a ramp under a sphere, drained each from its own moment, by a fine sum."""
    time = np.arange(0.0, 10.0, 0.01)
    part = (np.arange(4000) + 0.5) / 4000
    weight = np.diff(np.append(0.0, ((np.arange(4000) + 1.0) / 4000) ** 1.5))
    since = time[:, None] + ramp_s * (1.0 - part)
    force = 5.0 + 20.0 * drained_share(since / truth) @ weight
    force += 0.01 * np.random.default_rng(1).standard_normal(time.size)
    assert drainage_time(time, force, ramp_s) == pytest.approx(truth, rel=0.01)


def test_the_function_of_drainage_begins_at_one_and_ends_at_none() -> None:
    """Hu et al. 2010, the printed coefficients."""
    np.testing.assert_allclose(drained_share(np.array([0.0, 1.0, 1e4])), [1.0, 0.2930, 0.0], atol=2e-4)
    assert drainage_time(np.arange(5.0), np.ones(5), 0.0) == 0.0


RATE = 100.0
PLATEAU, FAST, SLOW = 5.0, (4.0, 0.2), (3.0, 5.0)


def relaxing(time):
    return PLATEAU + FAST[0] * np.exp(-time / FAST[1]) + SLOW[0] * np.exp(-time / SLOW[1])


def test_the_longest_hold_tells_how_it_was_reached_and_standing_in_air_is_none():
    """A linear ramp of one second to 12 N, then the relaxation above."""
    time = np.arange(int(31.0 * RATE) + 1) / RATE
    corner, force = int(RATE), np.where(time < 1.0, 12.0 * time, relaxing(np.maximum(time - 1.0, 0.0)))
    ramp = Phase("ramp", 0, corner + 1, 0.0, 1.0, 3.0)
    hold = Phase("hold", corner, time.size, 1.0, float(time[-1]), 0.0)
    trial = Trial("knee", time, np.minimum(time, 1.0) * 3.0, force, source=Source(path="hold.csv"))
    segmentation = Segmentation(1, 1, Contact(0, 0.0, 1e-3), (ramp, hold), 0.01)
    found = hold_numbers(trial, segmentation)
    assert (found.longest_s, found.speed_mm_s, found.depth_mm) == pytest.approx((30.0, 3.0, 3.0))
    quiet = replace(trial, force_N=np.full(time.size, 0.01))
    assert hold_numbers(quiet, segmentation).longest_s == 0.0
    assert hold_numbers(trial, replace(segmentation, contact=None)).spectra == ()


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.2])
def test_spectrum_has_its_two_peaks_and_fits_to_the_noise(noise):
    time = np.arange(0.0, 30.0, 0.01)
    force = relaxing(time) + noise * np.random.default_rng(3).standard_normal(time.size)
    tau, amplitude, plateau, _, rmse = relaxation_spectrum(time, force)
    assert (amplitude >= 0.0).all()
    fast, slow = tau < 1.0, tau >= 1.0
    # smoothing and noise spread a line over its neighbours, its sum and its centre stay
    assert amplitude[fast].sum() == pytest.approx(FAST[0], rel=0.05)
    assert amplitude[slow].sum() == pytest.approx(SLOW[0], rel=0.05)
    for part, (_, centre) in ((fast, FAST), (slow, SLOW)):
        mean = np.exp(np.average(np.log(tau[part]), weights=amplitude[part]))
        assert mean == pytest.approx(centre, rel=0.15)
    assert plateau == pytest.approx(PLATEAU, rel=0.02)
    assert rmse <= max(1.05 * noise, 0.005)


def test_smoothing_grows_with_the_noise():
    time = np.arange(0.0, 30.0, 0.01)
    draws = np.random.default_rng(4).standard_normal(time.size)
    weights = [relaxation_spectrum(time, relaxing(time) + sd * draws)[3] for sd in (0.002, 0.02, 0.2)]
    assert weights == sorted(weights)
    assert weights[-1] > weights[0]
