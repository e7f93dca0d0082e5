"""Simulated recordings against closed forms and the synthetic oracle, which shares no code with them."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.selfcheck.protocol import Centre, Protocol
from tissueid.selfcheck.tissue import tissue_check
from tissueid.selfcheck.truth import ProtocolLog, Truth, noise, recorded_force
from tissueid.synth.recipe import Branch
from tissueid.synth.response import Path as SynthPath
from tissueid.synth.response import tissue_force

MODEL = kelvin_voigt(branches=1, stiffness_degree=1, depth_mm=8.0)
THETA = np.array([20.0, -1.2, 0.35, 63.62, 10.0, 0.2])
#: 10 N/mm, and nothing that relaxes.
ELASTIC = (kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=8.0), np.array([10.0, 0.0, 0.0, 0.0, 1.0]))
SPEED, CORNER = 4.0, 1.5
TIME = np.arange(0.0, 4.0, 0.01)
DEPTH = np.minimum(SPEED * TIME, SPEED * CORNER)


def log(time: np.ndarray = TIME, depth: np.ndarray = DEPTH) -> ProtocolLog:
    return ProtocolLog("hold", time, depth, 0.01)


def force(*, gain: float = 1.0, offset_mm: float = 0.0, one: ProtocolLog | None = None, **defects: float):
    return recorded_force(MODEL, THETA, one or log(), gain=gain, offset_mm=offset_mm, calibration=defects)


def oracle(path: SynthPath, *, offset_mm: float) -> np.ndarray:
    """The closed form, which shares no code with the contact model."""
    return tissue_force(
        path, TIME, offset_mm=offset_mm, static=(20.0, -1.2, 0.35), branches=(Branch((63.62, 10.0), 0.2),)
    )


@pytest.mark.parametrize("offset_mm", [0.0, 0.053, -0.02])
def test_a_perfect_chain_records_what_the_oracle_computes(offset_mm):
    path = SynthPath(np.array([0.0, CORNER, 4.0]), np.array([0.0, 6.0, 6.0]))
    # closed form against recursion; the tissue is met between two samples, or is indented and relaxed
    np.testing.assert_allclose(force(offset_mm=offset_mm), oracle(path, offset_mm=offset_mm), atol=1e-9)


def test_there_is_no_force_in_air_and_none_of_an_approach():
    # 1 mm in air first: contact at 0.25 s, between two samples where it is offset
    path = SynthPath(np.array([0.0, CORNER + 0.25, 4.0]), np.array([-1.0, 6.0, 6.0]))
    one = log(depth=path.at(TIME))
    for offset in (0.0, 0.033):
        found = force(one=one, offset_mm=offset)
        np.testing.assert_allclose(found, oracle(path, offset_mm=offset), atol=1e-9)
        assert (found[one.depth_mm < offset] == 0.0).all()
    # a filter and a late force begin with the contact, not with the record
    assert (force(one=one, force_filter_s=0.01, skew_s=0.002)[:24] == 0.0).all()


def test_trials_are_what_a_machine_exports():
    truth = Truth(THETA, np.array([1.0, 1.1]), np.array([0.0, 0.02]), 0.3, 0.0, 0.05)
    logs = (log(), ProtocolLog("later", TIME - 1.0, DEPTH - 4.0, 0.01))
    centre = Centre(MODEL, THETA, sigma_N=0.3, phi=0.0, white_share=0.0, pooling="partial")
    check = tissue_check(Protocol("two logs", logs, (SPEED, SPEED)), centre)
    trials = check.trials(truth, np.random.default_rng(6))
    assert [trial.name for trial in trials] == ["hold", "later"]
    np.testing.assert_allclose(trials[1].time_s, TIME, atol=1e-12)
    np.testing.assert_array_equal(trials[1].displacement_mm, logs[1].depth_mm)
    for trial, one, gain, offset in zip(trials, logs, truth.gain, truth.offset_mm, strict=True):
        left = trial.force_N - force(one=one, gain=gain, offset_mm=offset)
        # standard error of an sd of 400 samples is 0.01
        assert left.std() == pytest.approx(0.3, abs=0.04)
    # and in air, of 100 samples
    assert trials[1].force_N[logs[1].depth_mm < 0.0].std() == pytest.approx(0.3, abs=0.08)


def test_gains_of_logs_and_channels_and_a_delay_act_on_the_force():
    np.testing.assert_allclose(force(gain=1.1), 1.1 * force(), rtol=1e-12)
    np.testing.assert_allclose(force(force_gain=1.02), 1.02 * force(), rtol=1e-12)
    # 8 mm recorded by a channel that reads 2 % too much are 8 / 1.02 mm
    smaller = log(depth=DEPTH / 1.02)
    np.testing.assert_allclose(force(displacement_gain=1.02), force(one=smaller), rtol=1e-12)
    # two samples late, between corners; sub-steps are joined by lines
    np.testing.assert_allclose(force(skew_s=0.02)[10:140], force()[8:138], atol=2e-3)


def test_a_filtered_ramp_lags_by_its_time_constant_on_any_clock():
    uneven = np.sort(np.concatenate([[0.0], np.random.default_rng(4).uniform(0.0, 1.4, 300)]))
    for time in (TIME[TIME < CORNER], uneven):
        one = log(time, SPEED * time)
        found = recorded_force(*ELASTIC, one, gain=1.0, offset_mm=0.0, calibration={"force_filter_s": 0.03})
        # low-pass of a ramp from rest: rate (t - tau (1 - exp(-t / tau)))
        expected = 10.0 * SPEED * (time + 0.03 * np.expm1(-time / 0.03))
        np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("give", [0.0005, 0.004, 0.02])
def test_the_tip_is_where_the_frame_leaves_it(give):
    found = force(frame_compliance_mm_per_N=give)
    # where the tip is followed between samples it is where every one of ten times as many leaves it
    fine = np.arange(0.0, 3.9901, 0.001)
    one = log(fine, np.interp(fine, TIME, DEPTH))
    finer = force(one=one, frame_compliance_mm_per_N=give)
    expected = MODEL.force(THETA, ContactPath(fine, one.depth_mm - give * finer))
    np.testing.assert_allclose(finer, expected, atol=2e-4)
    # tips on lines over an eighth of a sample, squared
    np.testing.assert_allclose(found, finer[::10], atol=2e-4)
    assert found.max() < force().max()


def test_noise_is_stationary_with_the_stated_correlation():
    rng = np.random.default_rng(8)
    time = np.arange(40_000) * 0.01
    found = noise(time, sigma_N=2.0, phi=0.9, reference_step_s=0.01, white_share=0.0, rng=rng)
    # standard error of the sd of an AR(1): sd sqrt((1 + phi^2) / (1 - phi^2) / 2 n)
    assert found.std() == pytest.approx(2.0, abs=4 * 2.0 * np.sqrt(9.5 / 80_000))
    assert np.corrcoef(found[1:], found[:-1])[0, 1] == pytest.approx(0.9, abs=4 * np.sqrt(0.19 / 40_000))
    mixed = noise(time, sigma_N=2.0, phi=0.9, reference_step_s=0.01, white_share=0.5, rng=rng)
    assert np.corrcoef(mixed[1:], mixed[:-1])[0, 1] == pytest.approx(0.45, abs=0.03)
    white = noise(time, sigma_N=2.0, phi=0.0, reference_step_s=0.01, white_share=0.0, rng=rng)
    assert np.corrcoef(white[1:], white[:-1])[0, 1] == pytest.approx(0.0, abs=4 / 200)


def test_noise_on_unequal_steps_loses_correlation_with_time():
    rng = np.random.default_rng(9)
    time = np.concatenate([[0.0, 0.01], 0.03 + np.arange(8) * 0.01])
    many = np.array(
        [
            noise(time, sigma_N=1.0, phi=0.8, reference_step_s=0.01, white_share=0.0, rng=rng)
            for _ in range(20_000)
        ]
    )
    correlation = np.corrcoef(many.T)
    # 0.8 over 10 ms, 0.8^2 over 20 ms; standard error of a correlation
    assert correlation[0, 1] == pytest.approx(0.8, abs=4 * 0.36 / np.sqrt(20_000))
    assert correlation[1, 2] == pytest.approx(0.64, abs=4 * 0.59 / np.sqrt(20_000))
    np.testing.assert_allclose(many.std(axis=0), 1.0, atol=4 / np.sqrt(40_000))
