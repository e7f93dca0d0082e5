"""The path that a machine takes, and the time it needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tissueid.design.information import Indentation, ramp_of, seconds_of
from tissueid.design.machine import PRESETS

MACHINE = PRESETS["paper-a"]


@pytest.mark.parametrize("acceleration", [20.0, 200.0, 5e4])
@pytest.mark.parametrize("speed", [10.0, 250.0, 500.0])
@pytest.mark.parametrize("depth", [0.05, 2.0, 8.0])
def test_the_ramp_keeps_speed_and_acceleration_and_ends_at_the_depth(
    acceleration: float, speed: float, depth: float
) -> None:
    machine = replace(MACHINE, acceleration_mm_s2=acceleration)
    ramp = ramp_of(Indentation(speed, depth), machine)
    time = np.linspace(0.0, ramp.seconds, 20_001)
    x = ramp.depth(time)
    v = np.diff(x) / np.diff(time)
    assert x[0] == 0.0
    assert x[-1] == pytest.approx(depth, rel=1e-9)
    assert ramp.depth(np.array([ramp.seconds + 5.0]))[0] == pytest.approx(depth, rel=1e-9)
    # differences of a parabola carry rounding errors of 1e-16 over steps of microseconds
    assert v.max() <= speed / 60.0 * (1.0 + 1e-6)
    assert v.min() >= -1e-9
    assert np.abs(np.diff(v)).max() <= acceleration * (time[1] - time[0]) * (1.0 + 1e-6) + 1e-7


def test_a_machine_of_endless_acceleration_has_the_nominal_ramp() -> None:
    ramp = ramp_of(Indentation(250.0, 4.0), replace(MACHINE, acceleration_mm_s2=1e9))
    assert ramp.seconds == pytest.approx(4.0 / (250.0 / 60.0), rel=1e-6)


def test_a_short_way_does_not_reach_the_speed() -> None:
    machine = replace(MACHINE, acceleration_mm_s2=10.0, standoff_mm=0.1)
    ramp = ramp_of(Indentation(500.0, 1.0), machine)
    # from rest over 1.1 mm and to rest again: the way is halved between them
    assert ramp.top_mm_s == pytest.approx(np.sqrt(10.0 * 1.1), rel=1e-9)


def test_machine_time_counts_approach_ramp_hold_and_return() -> None:
    machine = replace(MACHINE, acceleration_mm_s2=1e9, standoff_mm=2.0, return_speed_mm_min=300.0)
    seconds = seconds_of(Indentation(120.0, 4.0, 30.0), machine)
    # 2 mm and 4 mm at 2 mm/s, 30 s, 6 mm at 5 mm/s
    assert seconds == pytest.approx(1.0 + 2.0 + 30.0 + 1.2, rel=1e-6)
