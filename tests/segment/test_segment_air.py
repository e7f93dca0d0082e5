"""Drift of the load cell in air is told with its slope; noise, hum and a late contact are no drift."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.flags import Flag
from tissueid.segment import segment
from tissueid.trial import Trial


def recording(
    seed: int, *, drift: float = 0.0, noise: str = "white", softness: float = 1.0, rate: float = 100.0
) -> Trial:
    """6 s in air, 4 s of ramp at 1 mm/s, 10 s of hold; drift in N/s, noise of 0.05 N."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 20.0, 1.0 / rate)
    x = np.minimum(time, 10.0)
    depth = np.maximum(x - 6.0, 0.0)
    off = rng.normal(0.0, 0.05, time.size)
    if noise == "correlated":
        for i in range(1, off.size):
            off[i] += 0.7 * off[i - 1]
    elif noise == "hum":
        off += 0.1 * np.sin(2.0 * np.pi * 50.0 * time + rng.uniform(0.0, 6.0))
    force = (10.0 if softness == 1.0 else 0.0) * depth + 2.0 * depth**2 + drift * time + off
    return Trial("s", time, x, force)


def drifts(trial: Trial) -> list[Flag]:
    return [flag for flag in segment(trial).flags if flag.code == "baseline_drift"]


@pytest.mark.parametrize("noise", ["white", "correlated", "hum"])
@pytest.mark.parametrize("softness", [1.0, 2.0])
@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_steady_zeros_are_no_drift(noise: str, softness: float, rate: float) -> None:
    told = [drifts(recording(seed, noise=noise, softness=softness, rate=rate)) for seed in range(12)]
    assert told == [[]] * 12


@pytest.mark.parametrize("drift", [-0.5, 0.2, 1.0])
def test_a_drift_is_told_with_its_slope(drift: float) -> None:
    (flag,) = drifts(recording(1, drift=drift))
    assert flag.values["slope_N_per_s"] == pytest.approx(drift, abs=5 * flag.values["slope_sd_N_per_s"])
    # from the middle of what was looked at, 2.4 s, to the end at 20 s
    assert flag.values["by_the_end_N"] == pytest.approx(drift * 17.6, rel=0.15)


def test_a_drift_that_would_not_matter_is_not_told() -> None:
    # 0.03 N/s: half a newton by the end, of 72
    assert drifts(recording(2, drift=0.03)) == []


def test_a_specimen_that_pulls_from_the_start_is_no_drift() -> None:
    # a stiff specimen with a weak toe: half the stiffness over the first third of the travel
    time = np.arange(0.0, 30.0, 0.02)
    x = 0.02 * np.minimum(time, 20.0)
    force = (
        1000.0 * x + 1000.0 * np.maximum(x - 0.12, 0.0) + np.random.default_rng(3).normal(0.0, 0.5, time.size)
    )
    assert drifts(Trial("s", time, x, force)) == []
