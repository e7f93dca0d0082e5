"""Loggers whose channels are not sampled together: held displacements, and time stamps that jitter."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.segment import segment
from tissueid.segment.motion import _held_step, _moving, path_noise
from tissueid.trial import Trial

RAMP_S, HOLD_S, CONTACT_MM, SPEED_MM_S = 6.0, 60.0, 1.0, 1.0


def recording(rate_hz: float, *, noise_mm: float = 3e-4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A ramp of 6 mm at 1 mm/s, contact after 1 mm, and its hold."""
    rng = np.random.default_rng(11)
    time = np.arange(0.0, RAMP_S + HOLD_S, 1.0 / rate_hz)
    travel = SPEED_MM_S * np.minimum(time, RAMP_S)
    depth = np.maximum(travel - CONTACT_MM, 0.0)
    kept = np.where(time > RAMP_S, 0.7 + 0.3 * np.exp(-np.maximum(time - RAMP_S, 0.0) / 5.0), 1.0)
    force = (2.0 * depth + 0.3 * depth**3) * kept
    return time, travel + rng.normal(0.0, noise_mm, time.size), force + rng.normal(0.0, 0.01, time.size)


@pytest.mark.parametrize(("rate_hz", "held"), [(100.0, 2), (100.0, 5), (100.0, 10), (50.0, 5), (500.0, 50)])
@pytest.mark.parametrize("noise_mm", [0.0, 3e-4])
def test_a_displacement_sampled_slower_than_the_force_is_one_ramp(rate_hz, held, noise_mm) -> None:
    time, travel, force = recording(rate_hz, noise_mm=noise_mm)
    travel = travel[np.arange(travel.size) // held * held]
    found = segment(Trial("a", time, travel, force))
    period = held / rate_hz
    assert [phase.kind for phase in found.phases] == ["approach", "ramp", "hold"]
    assert found.phases[2].start_s == pytest.approx(RAMP_S, abs=1.5 * period)
    assert found.contact is not None
    # a held displacement lags by half of its period
    assert found.contact.displacement_mm == pytest.approx(CONTACT_MM, abs=SPEED_MM_S * period + 0.02)


@pytest.mark.parametrize("share", [0.3, 0.45])
def test_stamps_that_jitter_make_no_moves(share: float) -> None:
    time, travel, force = recording(100.0)
    rng = np.random.default_rng(1)
    stamps = time + rng.uniform(-share, share, time.size) * 0.01
    found = segment(Trial("a", stamps, travel, force))
    assert [phase.kind for phase in found.phases] == ["approach", "ramp", "hold"]
    assert found.phases[2].start_s == pytest.approx(RAMP_S, abs=0.03)
    assert found.contact is not None
    assert found.contact.displacement_mm == pytest.approx(CONTACT_MM, abs=0.02)


def test_neither_a_fast_ramp_beside_a_long_hold_nor_a_bend_is_noise() -> None:
    time = np.arange(0.0, 60.0, 0.01)
    rng = np.random.default_rng(2)
    noise = rng.normal(0.0, 3e-4, time.size)
    fast = np.minimum(20.0 * time, 4.0)
    assert path_noise(time, fast + noise) < 4e-3
    assert _held_step(np.round(fast, 2), _moving(np.round(fast, 2))) == 0.0
    sine = 2.0 * np.sin(2.0 * np.pi * 0.5 * time)
    assert path_noise(time, sine + noise) < 4e-3


@pytest.mark.parametrize("value", [0.0, 50.0])
def test_a_single_sample_far_off_parts_no_ramp(value: float) -> None:
    time, travel, force = recording(100.0)
    travel[300] = value
    found = segment(Trial("a", time, travel, force))
    assert [phase.kind for phase in found.phases] == ["approach", "ramp", "hold"]
    assert found.contact is not None
    assert found.contact.displacement_mm == pytest.approx(CONTACT_MM, abs=0.02)


@pytest.mark.parametrize("samples", [1, 2, 3, 5])
def test_a_step_of_few_samples_and_its_hold_are_told(samples: int) -> None:
    time = np.arange(0.0, 12.0, 0.01)
    travel = np.interp(time, [1.0, 1.0 + 0.01 * samples], [-0.5, 4.0])
    held = np.maximum(time - 1.0, 0.0)
    force = 2.0 * np.maximum(travel, 0.0) * (0.6 + 0.4 * np.exp(-held / 2.0))
    force += np.random.default_rng(4).normal(0.0, 0.01, time.size)
    found = segment(Trial("step", time, travel, force))
    assert [phase.kind for phase in found.phases] == ["approach", "ramp", "hold"]
    assert found.phases[-1].start_s == pytest.approx(1.0, abs=0.011 * samples + 0.011)
    assert found.contact is not None
    assert abs(found.contact.displacement_mm) < 2.5 * found.contact.sd_mm
