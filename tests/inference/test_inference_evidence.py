"""Noise that a fit needs, against noise that a recording shows: memory passes, a model's miss does not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tissueid.inference.evidence import HOLD_DEGREE, LogEvidence, NoiseVerdict, _quiet, verdict_on_noise
from tissueid.inference.noise import Memory
from tissueid.inference.optimum import Noise
from tissueid.signal_noise import white_noise_sd

STEP = 0.1


def autoregression(rng: np.random.Generator, count: int, phi: float, sigma: float) -> np.ndarray:
    fresh = rng.standard_normal(count) * sigma * np.sqrt(1.0 - phi * phi)
    return lfilter([1.0], [1.0, -phi], fresh, zi=[phi * sigma * rng.standard_normal()])[0]


def noise_of(residual: np.ndarray) -> Noise:
    """White, or an AR(1), by the likelihood of the samples."""
    count, best = residual.size, (-np.inf, Noise(float(residual.std())))
    for phi in (0.0, *np.linspace(0.05, 0.999, 60)):
        new = np.append(np.sqrt(1.0 - phi * phi) * residual[0], residual[1:] - phi * residual[:-1])
        variance = float(new @ new) / count
        value = -0.5 * count * np.log(variance) + 0.5 * np.log(1.0 - phi * phi)
        if value > best[0] + (5.0 if best[1].memory.time_s == 0.0 and phi > 0.0 else 0.0):
            memory = Memory(-STEP / np.log(phi)) if phi > 0.0 else Memory()
            best = (value, Noise(float(np.sqrt(variance / (1.0 - phi * phi))), memory))
    return best[1]


def judged(
    residual: np.ndarray, quiet: slice | None, *, quantum: float = 0.0, alone: bool = False
) -> NoiseVerdict:
    count = residual.size
    time = STEP * np.arange(count)
    stretches = () if quiet is None else (_quiet(time[quiet], residual[quiet], HOLD_DEGREE),)
    log = LogEvidence(stretches, white_noise_sd(time, residual), quantum, count)
    return verdict_on_noise(noise_of(residual), [log], step_s=STEP, alone=alone)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9, 0.99])
def test_noise_with_any_memory_is_refuted_in_at_most_three_per_cent(phi: float) -> None:
    rng = np.random.default_rng(41)
    refuted = sum(judged(autoregression(rng, 300, phi, 0.2), slice(150, 300)).refuted for _ in range(33))
    assert refuted <= 1


@pytest.mark.parametrize("size", [0.02, 0.1, 1.0])
def test_a_smooth_miss_of_a_model_is_no_noise(size: float) -> None:
    # a ramp and the start of its hold are missed by far more than what the late hold shows
    rng = np.random.default_rng(5)
    time = STEP * np.arange(150)
    for _ in range(20):
        miss = size * np.sin(2.0 * time) * np.exp(-((time - 3.0) ** 2))
        verdict = judged(miss + 0.001 * rng.standard_normal(150), slice(75, 150))
        assert verdict.refuted
        assert verdict.measured_N == pytest.approx(0.001, rel=0.5)


def test_noise_that_is_louder_in_the_ramp_but_white_is_told_by_its_size() -> None:
    rng = np.random.default_rng(6)
    residual = rng.standard_normal(400)
    residual[:200] *= 30.0
    residual[200:] *= 0.1
    assert judged(residual, slice(200, 400)).refuted


def test_digits_set_a_floor_to_the_noise() -> None:
    rng = np.random.default_rng(7)
    quantum = 0.1
    force = np.round(np.linspace(0.0, 5.0, 300) + 0.02 * rng.standard_normal(300), 1)
    residual = force - np.linspace(0.0, 5.0, 300)
    residual[150:] = quantum / 4.0
    assert not judged(residual, slice(150, 300), quantum=quantum).refuted


def test_one_log_without_a_quiet_stretch_does_not_bend_to_correlation() -> None:
    rng = np.random.default_rng(8)
    residual = autoregression(rng, 300, 0.95, 0.2)
    assert judged(residual, None, alone=True).refuted
    assert not judged(residual, None).refuted
    assert not judged(rng.standard_normal(300), None, alone=True).refuted


def test_the_restricted_likelihood_is_that_of_the_differences_from_any_slow_force() -> None:
    # adding any cubic changes nothing, and white noise has the variance of its residual
    rng = np.random.default_rng(9)
    time = STEP * np.arange(60)
    noise = rng.standard_normal(60)
    plain = _quiet(time, noise, 3)
    slow = _quiet(time, noise + 3.0 - time + 0.2 * time**3, 3)
    for memory in (Memory(), Memory(0.3), Memory(1.0, 0.3)):
        assert slow.restricted(memory) == pytest.approx(plain.restricted(memory), rel=1e-7)
    left = noise - np.polynomial.Polynomial.fit(time, noise, 3)(time)
    square, log_det = plain.restricted(Memory())
    assert square == pytest.approx(float(left @ left))
    assert log_det == pytest.approx(0.0, abs=1e-9)
    assert plain.freedom == 56


def test_the_restricted_likelihood_is_that_of_contrasts_under_a_dense_covariance() -> None:
    rng = np.random.default_rng(10)
    time, memory = STEP * np.arange(40), Memory(0.4, 0.25)
    noise = rng.standard_normal(40)
    phi = np.exp(-STEP / 0.4)
    lag = np.abs(np.subtract.outer(np.arange(40), np.arange(40)))
    covariance = 0.75 * phi**lag + 0.25 * np.eye(40)
    slow = np.linalg.qr(np.vander(time, 4))[0]
    contrasts = np.linalg.qr(np.hstack([slow, rng.standard_normal((40, 36))]))[0][:, 4:]
    inner = contrasts.T @ covariance @ contrasts
    square, log_det = _quiet(time, noise, 3).restricted(memory)
    assert square == pytest.approx(float(noise @ contrasts @ np.linalg.solve(inner, contrasts.T @ noise)))
    assert log_det == pytest.approx(float(np.linalg.slogdet(inner)[1]))
