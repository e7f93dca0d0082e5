"""What of a recording is fitted where it broke, was preconditioned, or was cut by the user."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.inference.window import fitted_log
from tissueid.measured.relaxation import relaxation_rows
from tissueid.pipeline import identify
from tissueid.segment import SegmentOptions, segment
from tissueid.trial import Trial

RATE_HZ = 50.0
STIFFNESS, TAU_S = 20.0, 2.0
STATIC = (8.0, 0.0, 0.6)
SIGMA_N = 0.02


def recording(knots_s: list[float], depths_mm: list[float], *, lost: bool = False, seed: int = 1) -> Trial:
    """A tissue of one branch along a polyline, by the exact recursion; ``lost`` cuts off what would pull."""
    time = np.arange(0.0, knots_s[-1], 1.0 / RATE_HZ)
    depth = np.interp(time, knots_s, depths_mm)
    x = np.maximum(depth, 0.0)
    decay = np.exp(-1.0 / RATE_HZ / TAU_S)
    gain = TAU_S * RATE_HZ * (1.0 - decay)
    state = np.zeros(time.size)
    for n in range(time.size - 1):
        state[n + 1] = decay * state[n] + gain * (x[n + 1] - x[n])
    force = sum(a * x ** (k + 1) for k, a in enumerate(STATIC)) + STIFFNESS * state
    if lost:
        force = np.where(depth <= 0.0, 0.0, np.maximum(force, 0.0))
    noise = SIGMA_N * np.random.default_rng(seed).standard_normal(time.size)
    return Trial("tissue", time, depth, force + noise)


def kept_contact() -> Trial:
    """Three cycles between 2 and 1 mm, then 4 mm held for 10 s."""
    return recording([0, 2, 3, 4, 5, 6, 7, 10, 20], [0, 2, 1, 2, 1, 2, 1, 4, 4])


def test_cycles_in_contact_stay_out_of_the_likelihood_and_in_the_state() -> None:
    trial = kept_contact()
    divided = segment(trial)
    assert [phase.kind for phase in divided.phases] == ["cycle"] * 3 + ["ramp", "hold"]
    log = fitted_log(trial, divided)
    assert log is not None
    assert log.data.time_s[0] == 0.0
    assert log.data.depth_mm.size == trial.time_s.size
    first = int(np.argmax(log.data.include))
    # the third cycle ends at 7 s
    assert log.data.time_s[first] == pytest.approx(7.0, abs=3.0 / RATE_HZ)
    assert log.data.include[first:].all()
    assert log.has_hold
    assert log.speeds_mm_s == pytest.approx((1.0,), rel=0.01)
    assert log.depth_mm == pytest.approx(4.0)


def test_a_test_after_cycles_gives_back_the_tissue() -> None:
    found = identify([kept_contact()]).specimens[0]
    values = {one.name: one for one in found.parameters}
    tau = values["relaxation_time_s"]
    # the branch state at the test's start is some -1 mm: without its history tau is off by tens of per cent
    assert tau.value == pytest.approx(TAU_S, rel=0.03)
    said = [
        flag.message for trial in found.trials for flag in trial.flags if flag.code == "unloading_left_out"
    ]
    assert len(said) == 1
    assert "3 cycles before the test" in said[0]
    assert "state is carried on" in said[0]


def test_cycles_that_let_go_start_the_window_at_the_last_contact() -> None:
    knots = [0, 3, 6, 9, 12, 32, 35, 45]
    trial = recording(knots, [-1, 2, -1, 2, -1, -1, 2, 2], lost=True)
    divided = segment(trial)
    kinds = [phase.kind for phase in divided.phases]
    assert kinds == ["approach", "cycle", "cycle", "rest", "approach", "ramp", "hold"]
    assert divided.contact is not None
    # 20 s of rest are ten relaxation times: contact is met at 33 s again
    assert trial.time_s[divided.contact.index] == pytest.approx(33.0, abs=0.1)
    log = fitted_log(trial, divided)
    assert log is not None
    assert log.data.time_s[0] == pytest.approx(33.0, abs=0.1)
    left_out = identify([trial]).specimens[0].trials[0].flags
    assert any("let go" in flag.message for flag in left_out if flag.code == "unloading_left_out")


def test_cycles_without_a_test_are_fitted_on_their_first_rise() -> None:
    trial = recording([0, 2, 4, 6, 8], [0, 2, 0.5, 2, 0.5])
    divided = segment(trial)
    assert divided.test == 0
    log = fitted_log(trial, divided)
    assert log is not None
    assert log.data.time_s[-1] == pytest.approx(2.0, abs=3.0 / RATE_HZ)


def broken() -> Trial:
    """A ramp to 4 mm in 4 s that loses 60 % of its force at 3 mm, and a hold."""
    trial = recording([0, 4, 14], [0, 4, 4])
    return Trial(
        "broken", trial.time_s, trial.displacement_mm, np.where(trial.time_s > 3.0, 0.4, 1.0) * trial.force_N
    )


def test_samples_from_the_first_rupture_on_take_no_part() -> None:
    trial = broken()
    divided = segment(trial)
    assert [event.kind for event in divided.events] == ["rupture"]
    log = fitted_log(trial, divided)
    assert log is not None
    assert log.data.time_s[-1] == pytest.approx(3.0, abs=3.0 / RATE_HZ)
    assert not log.has_hold
    assert relaxation_rows(trial, divided) == ()
    flags = identify([trial]).specimens[0].trials[0].flags
    assert {"rupture", "unloading_left_out"} <= {flag.code for flag in flags}
    assert any("the first rupture" in flag.message for flag in flags if flag.code == "unloading_left_out")


def test_the_user_may_deny_a_rupture() -> None:
    trial = broken()
    divided = segment(trial, options=SegmentOptions(rupture=False))
    assert divided.events == ()
    log = fitted_log(trial, divided)
    assert log is not None
    assert log.data.time_s[-1] == trial.time_s[-1]


def test_the_user_may_cut_a_recording() -> None:
    trial = recording([0, 2, 3, 5, 15, 17], [0, 2, 0, 4, 4, 0])
    divided = segment(trial, options=SegmentOptions(start_s=3.0, end_s=12.0))
    assert [phase.kind for phase in divided.phases] == ["ramp", "hold"]
    assert divided.phases[0].start_s == 3.0
    assert divided.phases[-1].end_s == 12.0
    log = fitted_log(trial, divided)
    assert log is not None
    assert (log.data.time_s[0], log.data.time_s[-1]) == (3.0, 12.0)


def test_a_cut_without_samples_is_said() -> None:
    divided = segment(broken(), options=SegmentOptions(start_s=100.0))
    assert divided.phases == ()
    assert divided.contact is None
    assert "too_few_samples" in {flag.code for flag in divided.flags}
