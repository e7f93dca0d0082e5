"""Noise that goes on from sample to sample: how much of it means keep, and the contact's sd under it."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tissueid.segment import segment
from tissueid.segment.memory import long_run_ratio, without_slow
from tissueid.signal_noise import white_noise_sd
from tissueid.trial import Trial


def noise_of(phi, size, seed):
    """AR(1) noise of sd 1 in its stationary state."""
    white = np.random.default_rng(seed).normal(size=size + 1000)
    return lfilter([np.sqrt(1.0 - phi * phi)], [1.0, -phi], white)[1000:]


def lasting_sd(values):
    time = np.arange(float(values.size))
    left = without_slow(time, values)
    return white_noise_sd(time, left) * long_run_ratio([left])


def test_white_noise_lasts_no_longer_than_its_differences_say():
    stretches = [without_slow(np.arange(700.0), noise_of(0.0, 700, seed)) for seed in range(100)]
    ratios = np.array([long_run_ratio([one]) for one in stretches])
    assert (ratios == 1.0).sum() >= 97


@pytest.mark.parametrize(("phi", "spread"), [(0.5, 0.15), (0.9, 0.25), (0.97, 0.35)])
def test_the_sd_of_means_is_that_of_the_noise(phi, spread):
    found = [lasting_sd(noise_of(phi, 2000, seed)) for seed in range(40)]
    truth = np.sqrt((1.0 + phi) / (1.0 - phi))
    assert np.median(found) == pytest.approx(truth, rel=0.1)
    assert np.std(found) / truth < spread


def test_a_hum_does_not_last_and_steps_of_a_coarse_reading_are_no_noise():
    time = np.arange(2000.0)
    hum = np.sin(2.0 * np.pi * time / 20.0) + 0.1 * noise_of(0.0, 2000, 1)
    # over means of a period and longer nothing of it is left
    assert lasting_sd(hum) < 1.0
    assert without_slow(time, np.round(np.sin(time / 300.0) * 3.0)) is None
    assert without_slow(time[:20], hum[:20]) is None


def push(phi, noise, seed, *, hold):
    """1 mm/s into tissue that relaxes within 2 s, contact at 0.3 or 2 mm; a hold of 20 s, or none."""
    contact, wait = (0.3, 0.5) if hold else (2.0, 0.0)
    time = np.arange(0.0, wait + contact + 5.0 + (20.0 if hold else 0.0), 0.01)
    x = np.clip(time - wait - contact, 0.0, 5.0)
    held = np.maximum(time - wait - contact - 5.0, 0.0)
    force = 2.0 * x + 0.3 * x**2 + 0.05 * x**3 + 3.0 * -np.expm1(-x / 2.0) * np.exp(-held / 2.0)
    force = force + noise * force.max() * noise_of(phi, time.size, seed)
    return segment(Trial("push", time, np.clip(time - wait, 0.0, contact + 5.0), force)).contact


def pushes(phi, noise, *, hold):
    return [push(phi, noise, seed, hold=hold) for seed in range(12)]


@pytest.mark.parametrize(("phi", "noise"), [(0.5, 0.01), (0.9, 0.002), (0.9, 0.01)])
def test_the_contact_under_correlated_noise_lies_in_its_interval(phi, noise):
    scores = np.array([(one.displacement_mm - 0.3) / one.sd_mm for one in pushes(phi, noise, hold=True)])
    # 12 intervals of 95 %: more than three miss with probability 0.002
    assert (np.abs(scores) > 1.96).sum() <= 3


def test_air_alone_shows_that_noise_lasts():
    sd_white, sd_lasting = (
        np.median([one.sd_mm for one in pushes(phi, 0.01, hold=False)]) for phi in (0.0, 0.5)
    )
    # noise^(2/3), a long-run sd of 1.73: 1.44; of differences alone it was 0.8
    assert sd_lasting > 1.2 * sd_white


def held(noise, *, step=0.0):
    """1 mm/s to 3 mm, contact at 0.5 mm, relaxing within 0.5 s, then 20 s of hold; 200 samples a second."""
    time = np.arange(0.0, 23.0, 0.005)
    x, since = np.clip(time - 0.5, 0.0, 2.5), np.maximum(time - 3.0, 0.0)
    force = x + np.exp(-since / 0.5) * -np.expm1(-x / 0.5) + noise(time)
    return segment(
        Trial("held", time, np.minimum(time, 3.0), np.round(force / step) * step if step else force)
    )


def test_a_hum_is_no_rupture_and_no_slip():
    white = np.random.default_rng(1).normal(size=4600)
    found = held(lambda time: 0.01 * white + 0.1 * np.sin(2.0 * np.pi * 20.0 * time))
    assert found.events == ()
    assert [one.kind for one in found.phases] == ["approach", "ramp", "hold"]


def test_a_hold_that_reads_one_level_shows_no_lasting_noise():
    found = held(lambda time: np.zeros(time.size), step=0.07)
    assert found.contact is not None
    assert found.contact.displacement_mm == pytest.approx(0.5, abs=0.1)


def test_a_jump_between_two_samples_is_a_move_with_the_contact_anywhere_on_its_way():
    time = np.arange(0.0, 30.0, 0.05)
    step = np.where(time < 1.0, 0.0, 2.0)
    noise = 0.05 * np.random.default_rng(2).normal(size=time.size)
    found = segment(Trial("step", time, step, 5.0 * step * np.exp(-np.maximum(time - 1.0, 0.0)) + noise))
    assert [one.stop - one.start for one in found.phases] == [20, 2, 580]
    assert found.contact.sd_mm > 1.0
    assert "contact_uncertain" in [flag.code for flag in found.flags]
