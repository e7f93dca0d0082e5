"""Ruptures with their numbers, and what is none: spikes, relaxation, softening, unloading."""

from __future__ import annotations

import numpy as np
import pytest
from told import codes, events, flag_of, kinds

from tissueid.segment import SegmentOptions, segment, segmentation
from tissueid.trial import Event, Segmentation, Trial

RATE_HZ = 100.0


def ruptures(found: Segmentation) -> list[Event]:
    return events(found, "rupture")


def ramp(force_of_depth, *, hold_s: float = 0.0, sigma_N: float = 0.05, seed: int = 2) -> Trial:
    """1 mm in air, then into the tissue at 1 mm/s to 6 mm."""
    time = np.arange(0.0, 7.0 + hold_s, 1.0 / RATE_HZ)
    depth = np.minimum(time, 7.0) - 1.0
    noise = sigma_N * np.random.default_rng(seed).standard_normal(time.size)
    return Trial("ramp", time, depth, force_of_depth(np.maximum(depth, 0.0)) + noise)


def relaxing(time: np.ndarray, depth: np.ndarray, tau_s: float, gain: float) -> Trial:
    """A spring of 2 N/mm beside a branch that relaxes."""
    decay, state, branch = np.exp(-(time[1] - time[0]) / tau_s), 0.0, []
    for v in np.gradient(depth, time).tolist():
        state = decay * state + (1.0 - decay) * v
        branch.append(state)
    return Trial("relaxing", time, depth, 2.0 * depth + gain * np.array(branch))


def test_a_rupture_has_its_force_drop_depth_and_work() -> None:
    found = segment(ramp(lambda x: np.where(x <= 4.0, 10.0 * x, 4.0 * x)))
    (event,) = ruptures(found)
    assert event.time_s == pytest.approx(5.0, abs=1.0 / RATE_HZ)
    values = event.values
    # noise 0.05 N, and the running median looks two samples of 0.1 N back
    assert values["force_before_N"] == pytest.approx(40.0, abs=0.3)
    assert values["drop_N"] == pytest.approx(24.0, abs=0.5)
    assert values["drop_fraction"] == pytest.approx(0.6, abs=0.01)
    assert values["depth_mm"] == pytest.approx(4.0, abs=0.03)
    # half of 4 mm times 40 N
    assert values["work_N_mm"] == pytest.approx(80.0, rel=0.01)
    said = flag_of(found, "rupture")
    assert said.values["time_s"] == event.time_s
    assert said.values["count"] == 1


def test_every_layer_that_breaks_is_found() -> None:
    trial = ramp(lambda x: 15.0 * x * np.where(x > 2.0, 0.5, 1.0) * np.where(x > 4.0, 0.4, 1.0))
    broke = ruptures(segment(trial))
    assert [event.values["depth_mm"] for event in broke] == pytest.approx([2.0, 4.0], abs=0.03)
    assert [event.values["drop_fraction"] for event in broke] == pytest.approx([0.5, 0.6], abs=0.03)


@pytest.mark.parametrize("samples", [1, 3, 10])
def test_a_fall_that_takes_a_few_samples_is_dated_at_its_onset(samples: int) -> None:
    def force(x: np.ndarray) -> np.ndarray:
        fallen = np.clip((x - 3.0) * RATE_HZ / samples, 0.0, 1.0)
        return 10.0 * x * (1.0 - 0.7 * fallen)

    (event,) = ruptures(segment(ramp(force)))
    assert event.time_s == pytest.approx(4.0, abs=3.0 / RATE_HZ)


def test_a_curve_pulled_to_failure_ruptures_at_its_peak() -> None:
    # force sinks to nothing over a millimetre, as in necking
    trial = ramp(lambda x: np.where(x < 4.5, 20.0 * x, np.maximum(90.0 - 85.0 * (x - 4.5), 3.0)))
    (event,) = ruptures(segment(trial))
    assert event.values["depth_mm"] == pytest.approx(4.5, abs=0.1)
    assert event.values["drop_fraction"] > 0.9


def test_single_outliers_are_no_rupture() -> None:
    trial = ramp(lambda x: 10.0 * x)
    force = np.array(trial.force_N)
    force[[300, 450, 451]] -= 25.0
    force[620] = 0.0
    assert ruptures(segment(Trial("spikes", trial.time_s, trial.displacement_mm, force))) == []


@pytest.mark.parametrize("rounding_s", [0.0, 0.2])
def test_relaxation_at_a_stop_is_no_rupture(rounding_s: float) -> None:
    time = np.arange(0.0, 12.0, 0.002)
    width = max(rounding_s, 1e-9)
    u = np.clip((time - 4.0) / width + 0.5, 0.0, 1.0)
    smooth = width * (0.5 * u - np.sin(np.pi * u) / (2.0 * np.pi)) + np.maximum(time - 4.0 - 0.5 * width, 0.0)
    depth = time - smooth
    # a branch of 30 ms that carries 80 % of the force while the tool moves
    assert ruptures(segment(relaxing(time, depth, 0.03, 40.0))) == []


def test_a_slower_second_ramp_is_no_rupture() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    found = segment(relaxing(time, np.interp(time, [0, 2, 20], [0, 4, 6]), 0.2, 20.0))
    assert kinds(found) == ["ramp", "ramp"]
    assert ruptures(found) == []


def test_a_soft_middle_is_no_rupture() -> None:
    # a layered tissue: force sinks by a quarter over a third of the depth
    trial = ramp(lambda x: 30.0 * np.sin(np.minimum(x, 4.0) * np.pi / 5.0) + 20.0 * np.maximum(x - 4.0, 0.0))
    assert ruptures(segment(trial)) == []


def test_unloading_is_no_rupture() -> None:
    time = np.arange(0.0, 8.0, 0.01)
    depth = np.interp(time, [0, 4, 4.4, 8], [0, 4, 0, 0])
    assert ruptures(segment(Trial("unloaded", time, depth, 10.0 * depth))) == []


def test_the_user_may_say_it_is_none() -> None:
    trial = ramp(lambda x: np.where(x <= 4.0, 10.0 * x, 4.0 * x))
    found = segment(trial, options=SegmentOptions(rupture=False))
    assert found.events == ()
    assert "rupture" not in codes(found)


def test_a_drop_that_is_no_rupture_does_not_end_the_move_that_shows_contact(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    trial = ramp(lambda x: 10.0 * np.maximum(x - 1.0, 0.0))
    dropped = Event("rupture", 8, float(trial.time_s[8]), values={"drop_fraction": 0.4})
    # in air, and so only while it is not known where the contact lies
    monkeypatch.setattr(segmentation, "ruptures", lambda *given: [dropped] if given[2][0] < 0.0 else [])

    for options in (SegmentOptions(), SegmentOptions(rupture=False)):
        found = segment(trial, options=options)
        assert abs(found.contact.displacement_mm - 1.0) < 0.05


@pytest.mark.parametrize("seed", [0, 8, 22, 25])
def test_a_swing_of_correlated_noise_in_air_hides_no_contact(seed: int) -> None:
    # AR(1) of 0.9 and 0.25 N in 30 N: swings far beyond what differences of neighbours say of the noise
    trial = ramp(lambda x: 5.0 * x, sigma_N=0.0)
    rng, noise, noises = np.random.default_rng(seed), 0.0, []
    for fresh in rng.standard_normal(trial.time_s.size).tolist():
        noise = 0.9 * noise + 0.25 * np.sqrt(1.0 - 0.9**2) * fresh
        noises.append(noise)
    found = segment(Trial("swings", trial.time_s, trial.displacement_mm, trial.force_N + noises))
    assert found.contact is not None
    assert "no_contact" not in codes(found)
    assert "ramp" in kinds(found)
