"""Clocks that are coarser than the sampling: several rows carry one time, and lie between its ticks."""

from __future__ import annotations

import numpy as np
import pytest
from ingest_files import codes, put, read

from tissueid.segment import segment
from tissueid.signal_noise import between_ticks


def recording(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A ramp of 6 mm at 1 mm/s that meets the tissue after 1 mm, and its hold."""
    rng = np.random.default_rng(3)
    x = np.minimum(time_s, 6.0) + rng.normal(0.0, 3e-4, time_s.size)
    depth = np.maximum(np.minimum(time_s, 6.0) - 1.0, 0.0)
    force = (2 * depth + 0.3 * depth**3) * np.where(
        time_s > 6.0, 0.7 + 0.3 * np.exp(-(time_s - 6.0) / 5), 1.0
    )
    return x, force + rng.normal(0.0, 0.01, time_s.size)


@pytest.mark.parametrize(
    ("rate_hz", "tick_s"), [(50.0, 0.1), (20.0, 0.1), (30.0, 0.1), (10.0, 1.0), (7.0, 1.0)]
)
@pytest.mark.parametrize("rounds", [np.floor, np.round])
def test_rows_of_one_tick_are_spread_and_divided_as_if_the_clock_were_fine(tmp_path, rate_hz, tick_s, rounds):
    true = np.arange(0.0, 66.0, 1.0 / rate_hz)
    x, force = recording(true)
    shown = rounds(true / tick_s + 1e-9) * tick_s
    lines = (f"{t:.1f},{d:.5f},{f:.5f}\n" for t, d, f in zip(shown, x, force, strict=True))
    trial = read(put(tmp_path / "a.csv", "Time (s),Extension (mm),Load (N)\n" + "".join(lines)))
    assert codes(trial) == ["zero_dt"]
    assert trial.flags[0].values["tick_s"] == pytest.approx(tick_s)
    assert np.abs(trial.time_s - true).max() <= tick_s + 1.0 / rate_hz
    assert np.ptp(np.diff(trial.time_s)) < 1e-9
    found = segment(trial)
    assert [phase.kind for phase in found.phases] == ["approach", "ramp", "hold"]
    assert found.phases[2].start_s == pytest.approx(6.0, abs=1.5 * tick_s)
    assert found.contact is not None
    assert found.contact.displacement_mm == pytest.approx(1.0, abs=0.06)


def test_a_sampling_that_changes_is_spread_tick_by_tick() -> None:
    true = np.concatenate([np.arange(0.0, 10.0, 0.02), np.arange(10.0, 100.0, 0.5)])
    shown = np.floor(true / 0.1 + 1e-9) * 0.1
    spread, tick = between_ticks(shown)
    assert tick == pytest.approx(0.1)
    np.testing.assert_allclose(spread, true, atol=0.1)
    assert np.all(np.diff(spread) > 0.0)


def test_single_rows_of_one_time_stay_as_they_are() -> None:
    time_s = np.arange(0.0, 20.0, 0.1)
    time_s[50] = time_s[49]
    same, tick = between_ticks(time_s)
    assert same is time_s
    assert tick == 0.0
