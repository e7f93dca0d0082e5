"""Hertz's law with the damping of Flores from recordings: recovery, intervals, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tissueid.inference.contact_law import fit_contact_law
from tissueid.inference.contact_path import contact_log
from tissueid.model.impact import HertzImpact, reached_restitution
from tissueid.segment import segment
from tissueid.synth.contact_law import simulate_contact_law
from tissueid.synth.recipe import Hold, Log, Move, Recipe
from tissueid.synth.simulate import as_trials

TRUTH = {"stiffness_N_per_mm_n": 4.0, "exponent": 1.5, "restitution": 0.7}
RAMP = (Move(5.0, 100.0),)
HELD = (*RAMP, Hold(3.0))
RETURNED = (*HELD, Move(0.0, 100.0))


def recorded(moves, *, seed=1, speeds=(1.0,), **recipe):
    """Trials of a program at multiples of its speed."""
    logs = tuple(
        Log(
            f"at{number}",
            tuple(Move(m.to_mm, m.speed_mm_min * factor) if isinstance(m, Move) else m for m in moves),
        )
        for number, factor in enumerate(speeds)
    )
    plan = Recipe("law", logs, **{"rate_Hz": 100.0, "sigma_N": 0.2, "contact_offset_mm": 1.0, **recipe})
    rng = np.random.default_rng(seed)
    law = {"stiffness": 4.0, "exponent": 1.5, "restitution": 0.7}
    return as_trials(simulate_contact_law(plan, **law, rng=rng))


def fitted(moves, **given):
    """The law behind such trials, contact and phases found as in any fit."""
    logs = [contact_log(trial, segment(trial)) for trial in recorded(moves, **given)]
    return fit_contact_law([log for log in logs if log is not None])


def test_the_law_is_recovered_within_its_intervals_and_they_are_narrow():
    found = fitted(RETURNED, speeds=(1.0, 3.0))
    assert found.converged
    for one in found.parameters:
        low, high = one.interval
        # a right 95 % interval of this seed holds the truth; four standard errors leave nothing to luck
        assert abs(one.value - TRUTH[one.name]) <= 4.0 * one.stderr
        assert low < one.value < high
        assert one.stderr < 0.05 * TRUTH[one.name]
    assert found.nrmsd < 0.01
    assert found.returned == pytest.approx(0.683, abs=0.02)


def test_noise_free_recordings_give_the_truth():
    found = fitted(RETURNED, speeds=(1.0, 2.0), sigma_N=0.0)
    # the segmenter places the contact within a sample; offsets are fitted
    for one in found.parameters:
        assert one.value == pytest.approx(TRUTH[one.name], rel=2e-3)


def test_rounding_of_the_records_begins_no_second_contact_in_a_hold():
    rng = np.random.default_rng(3)
    for trial in recorded(RETURNED, sigma_N=0.0):
        found = segment(trial)
        exact = contact_log(trial, found)
        for _ in range(10):
            rounded = trial.displacement_mm * (1.0 + 1e-14 * rng.standard_normal(trial.time_s.size))
            log = contact_log(replace(trial, displacement_mm=rounded), found)
            # a hold has no speed, whatever the sign of its rounding
            np.testing.assert_allclose(log.ratio, exact.ratio, atol=1e-9)


def test_the_fitted_law_is_the_contact_model_that_is_felt():
    trial = recorded(RETURNED, sigma_N=0.0)[0]
    log = contact_log(trial, segment(trial))
    found = fit_contact_law([log])
    k, n, e = (one.value for one in found.parameters)
    stepper = HertzImpact(10.0, slowest_mm_s=1e-6).stepper(np.array([k, n, e]))
    depth = trial.displacement_mm - 1.0
    steps = np.diff(trial.time_s, prepend=trial.time_s[0] - 0.01)
    felt = np.array([stepper.step(x, dt) for x, dt in zip(depth, steps, strict=True)])
    # a stepper sees the speed of a corner one sample late: a few samples of thousands
    assert np.quantile(np.abs(felt - trial.force_N), 0.99) < 2e-3 * trial.force_N.max()


def test_a_ramp_alone_leaves_stiffness_and_restitution_null():
    found = fitted(RAMP, speeds=(1.0, 5.0))
    stiffness, exponent, restitution = found.parameters
    assert (stiffness.value, restitution.value, found.returned) == (None, None, None)
    assert "only k (1 + chi) is determined" in restitution.reason
    assert exponent.value == pytest.approx(1.5, abs=4.0 * exponent.stderr)
    # 1 + chi = 1 + 8 * 0.3 / 3.5
    assert found.loading == pytest.approx(4.0 * (1.0 + 2.4 / 3.5), rel=0.05)
    assert not found.identified


@pytest.mark.parametrize("seed", range(2, 6))
def test_a_contact_that_the_record_does_not_show_does_not_lead_the_search_astray(seed):
    # five times as fast, all of the record is one ramp: its contact is known to a millimetre only
    found = fitted(RAMP, speeds=(1.0, 5.0), seed=seed)
    assert found.nrmsd < 0.01
    assert found.parameters[1].value == pytest.approx(1.5, abs=0.02)


def test_noise_as_large_as_the_signal_leaves_the_exponent_null():
    found = fitted((Move(1.6, 20.0), Hold(1.0)), sigma_N=0.8, contact_offset_mm=1.0)
    assert found.parameters[1].value is None
    assert "wide" in found.parameters[1].reason or "end of its range" in found.parameters[1].reason


def test_correlated_noise_widens_the_interval():
    white = fitted(RETURNED, seed=5, sigma_N=0.5)
    correlated = fitted(RETURNED, seed=5, sigma_N=0.0, ar1_sigma_N=0.5, ar1_phi=0.9)
    # one sample in (1 + 0.9) / (1 - 0.9) = 19 counts: the error is 4.4 times as large for a smooth column
    ratio = correlated.parameters[2].stderr / white.parameters[2].stderr
    assert 2.5 < ratio < 7.0
    assert abs(correlated.left_correlation) < 0.1 < 0.8 < correlated.correlation


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    hit, known = np.zeros(3), np.zeros(3)
    for seed in range(100):
        found = fitted(RETURNED, seed=100 + seed, rate_Hz=200.0, sigma_N=0.2, ar1_sigma_N=0.3, ar1_phi=0.8)
        for at, one in enumerate(found.parameters):
            if one.interval is not None:
                known[at] += 1
                hit[at] += one.interval[0] <= TRUTH[one.name] <= one.interval[1]
    # binomial: three standard deviations of 95 % in 100 are 6.5 %
    assert (known >= 95).all()
    assert (hit / known >= 0.95 - 0.065).all()


def test_returned_speed_is_that_of_the_fitted_damping():
    found = fitted(RETURNED)
    assert found.returned == pytest.approx(reached_restitution(found.theta[2]), rel=1e-9)
