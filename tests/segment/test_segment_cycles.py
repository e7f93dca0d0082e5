"""Cycles: turning samples, speeds, and the verdict on preconditioning with its numbers."""

from __future__ import annotations

import numpy as np
import pytest
from told import codes, kinds

from tissueid.segment import segment
from tissueid.trial import Segmentation, Trial

SPEED = 2.0


def loops(peaks_N: list[float], *, then_hold: bool = False, eta: float = 2.0, sigma_N: float = 0.01) -> Trial:
    """Loops to 3 mm and back at 2 mm/s; a dashpot makes each loop lose 2 eta v d, softened with its peak."""
    count = len(peaks_N)
    knots = np.arange(2 * count + 1) * 3.0 / SPEED
    depths = np.where(np.arange(2 * count + 1) % 2, 3.0, 0.0)
    if then_hold:
        knots, depths = np.append(knots, knots[-1] + np.array([2.0, 8.0])), np.append(depths, [4.0, 4.0])
    time = np.arange(0.0, knots[-1], 0.01)
    depth = np.interp(time, knots, depths)
    loop = np.minimum((time / (6.0 / SPEED)).astype(int), count - 1)
    scale = np.array(peaks_N)[loop] / (30.0 + eta * SPEED)
    force = scale * (10.0 * depth + eta * np.gradient(depth, time))
    noise = sigma_N * np.random.default_rng(7).standard_normal(time.size)
    return Trial("loops", time, depth, force + noise)


def verdict(found: Segmentation):
    (flag,) = (f for f in found.flags if f.code in ("preconditioned", "not_preconditioned"))
    return flag


def test_a_cycle_has_its_turn_and_its_loading_speed() -> None:
    found = segment(loops([34.0] * 3))
    assert kinds(found) == ["cycle"] * 3
    for k, phase in enumerate(found.phases):
        assert phase.peak is not None
        assert phase.start_s + (phase.peak - phase.start) * 0.01 == pytest.approx(1.5 + 3.0 * k, abs=0.03)
        assert phase.speed_mm_s == pytest.approx(SPEED, rel=0.02)


def test_loops_that_repeat_are_preconditioned() -> None:
    flag = verdict(segment(loops([34.0, 32.0, 31.0, 30.9, 30.8], then_hold=True)))
    assert flag.code == "preconditioned"
    assert flag.values["before_test"] is True
    # 31.0 -> 30.9 -> 30.8 N: at most 0.33 %, told within the noise of 0.01 N
    assert flag.values["peak_force_change"] == pytest.approx(0.1 / 30.9, abs=1e-3)
    assert flag.values["work_change"] < 0.02


def test_loops_that_still_change_are_not() -> None:
    flag = verdict(segment(loops([40.0, 36.0, 34.0])))
    assert flag.code == "not_preconditioned"
    assert flag.values["before_test"] is False
    # 40 -> 36 N is the larger of the two changes; work goes with the peak
    assert flag.values["peak_force_change"] == pytest.approx(0.1, abs=0.01)
    assert flag.values["work_change"] == pytest.approx(0.1, abs=0.02)


def test_work_alone_may_still_change() -> None:
    found = segment(loops([34.0, 34.0, 34.0]))
    assert verdict(found).code == "preconditioned"
    trial = loops([34.0, 34.0, 34.0])
    depth, time = trial.displacement_mm, trial.time_s
    # the same peaks, but the last loop loses half as much
    force = np.array(trial.force_N)
    last = time >= 6.0
    force[last] = (34.0 / 32.0) * (10.0 * depth[last] + np.gradient(depth, time)[last])
    flag = verdict(segment(Trial("loops", time, depth, force)))
    assert flag.code == "not_preconditioned"
    assert flag.values["work_change"] == pytest.approx(0.5, abs=0.05)


def test_coarse_sampling_of_the_turn_is_no_change() -> None:
    trial = loops([34.0] * 4)
    # every 13th sample: the turns are missed by up to 0.13 mm, 1.3 N of 34
    coarse = Trial(
        "coarse", *(np.array(a)[::13] for a in (trial.time_s, trial.displacement_mm, trial.force_N))
    )
    flag = verdict(segment(coarse))
    assert flag.values["peak_force_change"] < 0.02


def test_one_loop_is_no_cyclic_test() -> None:
    found = segment(loops([34.0]))
    assert kinds(found) == ["ramp", "retract"]
    assert not codes(found) & {"cyclic", "preconditioned", "not_preconditioned"}


def test_loops_before_a_hold_come_before_the_test() -> None:
    found = segment(loops([34.0] * 3, then_hold=True))
    assert kinds(found)[:3] == ["cycle"] * 3
    assert kinds(found)[-2:] == ["ramp", "hold"]
    assert found.test == 3
    assert segment(loops([34.0] * 3)).test == 0
