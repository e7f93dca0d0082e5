"""The regularised spectrum of a hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tissueid.inference.holds import hold_numbers, relaxation_spectrum
from tissueid.trial import Contact, Phase, Segmentation, Source, Trial

RATE = 100.0
PLATEAU, FAST, SLOW = 5.0, (4.0, 0.2), (3.0, 5.0)


def relaxing(time):
    return PLATEAU + FAST[0] * np.exp(-time / FAST[1]) + SLOW[0] * np.exp(-time / SLOW[1])


def held_trial(hold_s=30.0, *, noise=0.0, seed=0):
    """A linear ramp of one second to 12 N, then the relaxation above."""
    time = np.arange(int((1.0 + hold_s) * RATE) + 1) / RATE
    corner = int(RATE)
    depth = np.minimum(time, 1.0) * 3.0
    force = np.where(time < 1.0, 12.0 * time, relaxing(np.maximum(time - 1.0, 0.0)))
    force = force + noise * np.random.default_rng(seed).standard_normal(time.size)
    phases = (
        Phase("ramp", 0, corner + 1, 0.0, 1.0, 3.0),
        Phase("hold", corner, time.size, 1.0, float(time[-1]), 0.0),
    )
    contact = Contact(index=0, displacement_mm=0.0, sd_mm=1e-3)
    trial = Trial("knee", time, depth, force, source=Source(path="hold.csv"))
    return trial, Segmentation(1, 1, contact, phases, noise)


def test_the_longest_hold_tells_how_it_was_reached():
    found = hold_numbers(*held_trial())
    assert (found.longest_s, found.speed_mm_s, found.depth_mm) == pytest.approx((30.0, 3.0, 3.0))


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


def test_standing_in_air_is_no_hold_and_without_contact_there_is_nothing():
    trial, segmentation = held_trial(noise=0.01)
    quiet = replace(trial, force_N=np.zeros(trial.time_s.size) + 0.01)
    assert hold_numbers(quiet, segmentation).longest_s == 0.0
    assert hold_numbers(trial, replace(segmentation, contact=None)).spectra == ()
