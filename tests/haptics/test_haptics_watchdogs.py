"""Watchdogs: each fault is seen within its time, and what is none is not taken for one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from guarded import FREE, MOVING, STILL, TICK, Guarded

from tissueid.haptics import guard as machine
from tissueid.haptics.guard import REPLY_APART, REPLY_DAMAGED, REPLY_LOST, REPLY_NONE, observe_wire
from tissueid.haptics.states import Fault, Lamp, State

LEG_JUMP = np.array([0, -201, 0], np.int64)
LEG_FAST = np.array([0, -200, 0], np.int64)


def ticks_to_fault(guarded: Guarded, limit: int = 1000, **seen: object) -> int:
    """Ticks until FAULT."""
    for count in range(1, limit + 1):
        guarded.tick((0.0, 0.0, 2.0), **seen)
        if guarded.state == State.FAULT:
            return count
    return -1


@pytest.mark.parametrize(
    ("seen", "ticks", "fault"),
    [
        ({"reply": REPLY_LOST}, 1, Fault.TRANSPORT),
        ({"reply": REPLY_NONE}, 100, Fault.NO_REPLY),
        ({"reply": REPLY_DAMAGED}, 10, Fault.BAD_PACKETS),
        ({"reply": REPLY_APART}, 10, Fault.LEGS_APART),
        ({"moved": LEG_JUMP}, 1, Fault.ENCODER_JUMP),
        ({"velocity": (1.2, 0.9, 0.1)}, 1, Fault.OVERSPEED),
        ({"velocity": (np.nan, 0.0, 0.0)}, 1, Fault.OVERSPEED),
        ({"homed": False}, 1, Fault.NOT_HOMED),
    ],
)
def test_a_fault_of_the_device_is_seen_within_its_time(seen, ticks, fault):
    guarded = Guarded().to(machine.ENGAGED)
    assert ticks_to_fault(guarded, **seen) == ticks
    assert guarded.fault == fault


@pytest.mark.parametrize("seen", [{"moved": LEG_FAST}, {"velocity": (1.2, 0.9, 0.0)}])
def test_what_a_hand_can_do_is_no_fault(seen):
    guarded = Guarded().to(machine.ENGAGED)
    assert ticks_to_fault(guarded, 300, **seen) == -1


def test_nine_damaged_packets_and_a_good_one_are_no_fault():
    guarded = Guarded().to(machine.ENGAGED)
    for _ in range(20):
        for _ in range(9):
            guarded.tick(reply=REPLY_DAMAGED)
        guarded.tick()
    assert guarded.state == State.ENGAGED


def test_a_hand_that_moved_on_during_a_stall_did_not_jump():
    guarded = Guarded().to(machine.ENGAGED)
    guarded.tick(moved=np.array([900, 0, 0], np.int64), dt=5e-3)
    assert guarded.state == State.ENGAGED
    guarded.tick(moved=np.array([1001, 0, 0], np.int64), dt=5e-3)
    assert guarded.fault == Fault.ENCODER_JUMP


def test_encoders_that_stand_still_while_the_force_changed_are_frozen():
    guarded = Guarded().to(machine.ENGAGED)
    guarded.tick((0.0, 0.0, 0.5))
    count = 0
    while guarded.memory[machine.PHASE] != machine.YIELDING and count < 1000:
        guarded.tick((0.0, 0.0, 1.0), moved=STILL)
        count += 1
    # 200 ms from the first tick that saw the changed force
    assert count == pytest.approx(0.2 / TICK, abs=2)
    assert guarded.state == State.ENGAGED
    damped = ticks_to_fault(guarded, moved=STILL)
    # 20 ms of ramp, 100 ms of damping alone
    assert damped == pytest.approx((FREE.fault_ramp_s + FREE.damping_s) / TICK, abs=2)
    assert guarded.fault == Fault.ENCODER_FROZEN


@pytest.mark.parametrize("change", [0.0, 0.15])
def test_a_resting_hand_under_a_steady_force_is_not_frozen(change):
    guarded = Guarded().to(machine.ENGAGED)
    for _ in range(5):
        guarded.tick((0.0, 0.0, 1.0), moved=MOVING)
    for k in range(2000):
        guarded.tick((0.0, 0.0, 1.0 - change * k / 2000), moved=STILL)
    assert guarded.state == State.ENGAGED


@pytest.mark.parametrize(("state", "ticks"), [(machine.HOMING, 500), (machine.ARMED, 100)])
def test_silence_is_a_fault_before_any_force_too(state, ticks):
    guarded = Guarded().to(state)
    # a device that is being homed by hand, without force, has more time
    assert ticks_to_fault(guarded, reply=REPLY_NONE) == ticks


@pytest.mark.parametrize("state", [machine.OPEN, machine.FIRMWARE])
def test_a_device_that_loads_its_firmware_is_not_watched(state):
    guarded = Guarded().to(state)
    assert ticks_to_fault(guarded, 100, reply=REPLY_LOST) == -1


def test_coordinates_may_jump_while_homing():
    guarded = Guarded().to(machine.HOMING)
    guarded.tick(moved=np.array([5000, 0, 0], np.int64))
    assert guarded.state == State.HOMING


@pytest.mark.parametrize("reply", [REPLY_NONE, REPLY_DAMAGED])
@pytest.mark.parametrize("phase", [machine.RISING, machine.RELEASING, machine.RECOVERING, machine.YIELDING])
def test_a_silent_device_is_without_force_after_20_ms_whatever_went_on(reply, phase):
    guarded = Guarded().to(machine.ENGAGED)
    for _ in range(5):
        guarded.tick((0.0, 0.0, 2.0), velocity=(0.3, 0.0, 0.0))
    guarded.memory[machine.PHASE] = phase
    sent = [guarded.tick((0.0, 0.0, 2.0), velocity=(0.3, 0.0, 0.0), reply=reply) for _ in range(99)]
    assert np.linalg.norm(sent[2]) > 0.5
    assert (np.array(sent[19:]) == 0.0).all()


def test_a_hiccup_of_30_ms_takes_the_force_away_and_gives_it_back():
    guarded = Guarded().to(machine.ENGAGED)
    before = [guarded.tick((0.0, 0.0, 2.0)) for _ in range(5)][-1]
    silent = [guarded.tick((0.0, 0.0, 2.0), reply=REPLY_NONE) for _ in range(30)]
    assert (np.array(silent[19:]) == 0.0).all()
    assert guarded.lamps & Lamp.SILENT
    # in 30 ms a hand of 1 m/s made 30 mm, which is no jump
    after = [guarded.tick((0.0, 0.0, 2.0), moved=np.array([470, 0, 0], np.int64))]
    assert guarded.state == State.ENGAGED
    assert not guarded.lamps & Lamp.SILENT
    after += [guarded.tick((0.0, 0.0, 2.0)) for _ in range(120)]
    rises = np.diff([0.0, *[np.linalg.norm(one) for one in after]])
    assert (rises >= 0.0).all()
    # over the recovery, not at once
    assert rises.max() <= 0.03
    np.testing.assert_allclose(after[-1], before)


def test_an_encoder_that_jumps_after_a_hiccup_is_a_fault_nevertheless():
    guarded = Guarded().to(machine.ENGAGED)
    for _ in range(30):
        guarded.tick(reply=REPLY_NONE)
    guarded.tick(moved=np.array([31 * 200 + 1, 0, 0], np.int64))
    assert guarded.fault == Fault.ENCODER_JUMP


@pytest.mark.parametrize(("delay_ticks", "punctual", "late"), [(1.5, 2, 3), (4.5, 5, 6), (0.5, 2, 3)])
def test_answers_are_late_beyond_the_delay_that_the_scale_was_worked_out_for(delay_ticks, punctual, late):
    guarded = Guarded(replace(FREE, delay_ticks=delay_ticks)).to(machine.ENGAGED)
    for unanswered in (punctual, late):
        for _ in range(30):
            observe_wire(guarded.memory, guarded.limits, unanswered, TICK)
        guarded.tick((0.0, 0.0, 1.0))
        assert bool(guarded.lamps & Lamp.LATENCY) is (unanswered == late)
