"""The guard: states, limits and their precedence against closed forms; each fault is seen within its time."""

from dataclasses import replace

import numpy as np
import pytest
from guarded import FREE, MOVING, STILL, TICK, Guarded

from tissueid.haptics import guard as machine
from tissueid.haptics.guard import REPLY_APART, REPLY_DAMAGED, REPLY_LOST, REPLY_NONE, observe_wire
from tissueid.haptics.limits import GuardLimits, uncalibrated_clamp_N
from tissueid.haptics.states import Fault, Lamp, State

#: Scaling a vector to a length rounds each component once.
ROUNDING = 1e-14
LARGEST = replace(FREE, clamp_N=10.0, rms_limit_N=10.0)


@pytest.fixture
def guarded() -> Guarded:
    """Engaged, with the start-up ramp behind it."""
    return Guarded().to(machine.ENGAGED)


@pytest.fixture
def held() -> Guarded:
    """The same, with a dead-man button that is held."""
    return Guarded(replace(FREE, dead_man=True)).to(machine.ENGAGED)


@pytest.fixture
def starting() -> Guarded:
    """Armed, and asked for force."""
    guarded = Guarded().to(machine.ARMED)
    guarded.tell(machine.ENGAGE)
    return guarded


def lengths(forces: list[np.ndarray]) -> np.ndarray:
    return np.linalg.norm(forces, axis=1)


class TestLimits:
    def test_a_long_force_is_cut_to_the_clamp_and_keeps_its_direction(self, guarded):
        for force in ((0.1, 0.2, -0.3), (0.2, 0.3, -0.4)):
            # within every limit it is sent as it is
            assert tuple(guarded.tick(force)) == force
        assert guarded.lamps == Lamp.NONE
        outs = guarded.ticks(20, (30.0, 40.0, 0.0))
        assert outs[-1] == pytest.approx([3.0, 4.0, 0.0], rel=ROUNDING)
        assert guarded.lamps == Lamp.CLIPPED

    def test_a_rising_force_takes_one_slew_a_tick(self, guarded):
        outs = guarded.ticks(6, (0.0, 0.0, 2.2))
        assert lengths(outs) == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.2, 2.2], rel=ROUNDING)

    @pytest.mark.parametrize(
        ("before", "wanted", "sent"),
        [
            ((0.0, 0.0, 4.0), (0.0, 0.0, 0.3), (0.0, 0.0, 0.3)),
            # turned round from zero, turned by sixty degrees from half
            ((4.0, 0.0, 0.0), (-4.0, 0.0, 0.0), (-0.5, 0.0, 0.0)),
            ((4.0, 0.0, 0.0), (2.0, 2.0 * 3.0**0.5, 0.0), (1.25, 1.25 * 3.0**0.5, 0.0)),
        ],
    )
    def test_a_force_falls_at_once_and_rises_from_its_share_along_the_new_direction(
        self, guarded, before, wanted, sent
    ):
        guarded.ticks(10, before)
        assert guarded.tick(wanted) == pytest.approx(sent, rel=ROUNDING)

    @pytest.mark.parametrize("size", [1e-200, 1e160, 1.7e308])
    def test_a_force_whose_square_no_number_holds_keeps_its_direction(self, guarded, size):
        out = guarded.tick((0.6 * size, 0.8 * size, 0.0))
        assert out == pytest.approx(min(size, 0.5) * np.array([0.6, 0.8, 0.0]), rel=ROUNDING)

    def test_a_sustained_force_folds_back_to_what_the_motors_bear(self):
        limits = replace(FREE, clamp_N=5.0, rms_limit_N=3.0, rms_window_s=2.0)
        guarded = Guarded(limits).to(machine.ENGAGED)
        # ten windows: what is left of the start is exp(-10)
        outs = lengths(guarded.ticks(4000, (0.0, 0.0, 9.0), dt=5e-3))
        assert outs.max() == pytest.approx(5.0, rel=ROUNDING)
        assert outs[-1] == pytest.approx(3.0, rel=1e-3)
        assert guarded.lamps & Lamp.RMS_LIMITED
        assert guarded.state == State.ENGAGED

    def test_motors_that_are_over_their_limit_all_the_same_are_a_fault(self, guarded):
        guarded.memory[machine.MEAN_SQUARE] = 1.3 * 5.0**2
        guarded.tick((0.0, 0.0, 1.0))
        assert guarded.fault == Fault.OVERHEATED


class TestStart:
    def test_the_start_up_ramp_is_linear_over_its_time(self, starting):
        outs = starting.ticks(1100, (0.0, 0.0, 1.0))
        expected = np.minimum(TICK * np.arange(1, 1101), 1.0)
        # a thousand additions of a thousandth
        assert np.array(outs)[:, 2] == pytest.approx(expected, abs=1e-12)

    def test_while_the_force_rises_damping_fades(self, starting):
        starting.ticks(249, (0.0, 0.0, 1.0))
        out = starting.tick((0.0, 0.0, 1.0), velocity=(0.1, 0.0, 0.0))
        assert out == pytest.approx([-0.75 * FREE.damping_N_s_per_m * 0.1, 0.0, 0.25], abs=1e-12)

    @pytest.mark.parametrize(
        ("penetration", "wanted", "engages"),
        [(0.0, 4.0, True), (-1e-3, 4.0, True), (1e-3, 4.0, False), (1e-3, 0.19, True), (np.nan, 4.0, False)],
    )
    def test_a_device_engages_outside_tissue_or_with_a_small_force_alone(
        self, starting, penetration, wanted, engages
    ):
        starting.ticks(3, (0.0, 0.0, wanted), penetration=penetration)
        assert (starting.state == State.ENGAGED) is engages

    def test_a_device_is_armed_after_fifty_homed_replies_in_a_row(self):
        guarded = Guarded().to(machine.HOMING)
        for homed in [*[True] * 49, False, *[True] * 49]:
            guarded.tick(homed=homed)
        assert guarded.state == State.HOMING
        guarded.tick()
        assert guarded.state == State.ARMED


class TestFault:
    @pytest.mark.parametrize("limits", [FREE, LARGEST])
    def test_a_fault_is_zero_within_20_ms_and_falls_by_no_more_than_half_a_newton_a_tick(self, limits):
        guarded = Guarded(limits).to(machine.ENGAGED)
        for _ in range(30):
            before = guarded.tick((0.0, 9.0, 12.0))
        outs = [before, guarded.tick((0.0, 9.0, 12.0), homed=False)]
        outs += guarded.ticks(19, (0.0, 9.0, 12.0))
        sizes = lengths(outs)
        assert guarded.state == State.FAULT
        assert np.all(-np.diff(sizes) <= 0.5 + 1e-9)
        # a straight line from what was sent last; the tick that saw the fault is the first of 20
        assert sizes == pytest.approx(limits.clamp_N * np.linspace(1.0, 0.0, 21), abs=1e-9)
        assert sizes[-1] == 0.0

    def test_a_fault_does_not_wait_for_a_stall_of_the_loop(self, guarded):
        guarded.ticks(30, (0.0, 0.0, 5.0))
        guarded.tick((0.0, 0.0, 5.0), homed=False)
        assert guarded.tick((0.0, 0.0, 5.0), dt=0.1).tolist() == [0.0, 0.0, 0.0]

    @pytest.mark.parametrize("axis", range(3))
    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_a_force_of_which_one_component_is_no_number_ramps_the_last_one_to_zero(self, guarded, bad, axis):
        guarded.ticks(10, (0.0, 0.0, 2.0))
        force = np.array([0.0, 0.0, 2.0])
        force[axis] = bad
        assert guarded.tick(force) == pytest.approx([0.0, 0.0, 2.0 * 19 / 20], rel=1e-12)
        assert guarded.fault == Fault.NOT_A_NUMBER

    def test_the_first_fault_is_the_one_reported_and_nothing_leads_out_of_it_but_shutting(self, guarded):
        guarded.tick(homed=False)
        for event in np.arange(machine.SHUT):
            guarded.tell(event)
            guarded.tick((0.0, 0.0, 1.0))
            assert (guarded.state, guarded.fault) == (State.FAULT, Fault.NOT_HOMED)
        guarded.tell(machine.SHUT)
        assert guarded.state == State.CLOSED

    def test_silence_of_the_owner_is_damping_then_a_fault(self, guarded):
        guarded.ticks(10, (0.0, 0.0, 2.0))
        guarded.tell(machine.HEARTBEAT_LOST)
        outs = guarded.ticks(20, (0.0, 0.0, 2.0), velocity=(0.1, 0.0, 0.0))
        assert outs[-1] == pytest.approx([-FREE.damping_N_s_per_m * 0.1, 0.0, 0.0], abs=1e-12)
        assert guarded.state == State.ENGAGED
        guarded.ticks(100, (0.0, 0.0, 2.0))
        assert (guarded.state, guarded.fault) == (State.FAULT, Fault.HEARTBEAT)


class TestRelease:
    def test_letting_go_of_the_button_ramps_down_in_100_ms(self, held):
        held.ticks(10, (0.0, 0.0, 2.0), buttons=0x04)
        outs = lengths(held.ticks(100, (0.0, 0.0, 2.0), buttons=0x0B))
        assert outs == pytest.approx(2.0 * (1.0 - np.arange(1, 101) / 100), abs=1e-12)
        assert held.tick((0.0, 0.0, 2.0), buttons=0).tolist() == [0.0, 0.0, 0.0]
        assert held.state == State.ARMED
        assert held.lamps & Lamp.DEAD_MAN

    def test_pressing_it_again_in_tissue_waits_for_a_free_tool(self, held):
        held.ticks(110, (0.0, 0.0, 2.0), buttons=0, penetration=2e-3)
        held.tick((0.0, 0.0, 2.0), buttons=0x04, penetration=2e-3)
        assert held.state == State.ARMED
        held.tick((0.0, 0.0, 0.0), buttons=0x04, penetration=-1e-3)
        assert held.state == State.ENGAGED

    def test_pressing_it_again_during_the_ramp_turns_the_ramp(self, held):
        held.ticks(50, (0.0, 0.0, 0.4), buttons=0, penetration=1e-3)
        low, high = (held.tick((0.0, 0.0, 0.4), buttons=0x04, penetration=1e-3)[2] for _ in range(2))
        assert 0.2 < low < high
        assert held.state == State.ENGAGED


class TestStall:
    @pytest.mark.parametrize("dt", [0.1, 0.0051, 0.0, -1.0, np.nan, np.inf])
    def test_a_stalled_loop_ramps_down_and_resumes(self, guarded, dt):
        guarded.ticks(10, (0.0, 0.0, 4.0))
        outs = [guarded.tick((0.0, 0.0, 4.0), dt=dt)]
        assert guarded.lamps & Lamp.STALLED
        outs += guarded.ticks(140, (0.0, 0.0, 4.0))
        sizes = lengths(outs)
        assert np.all(sizes <= 4.0)
        assert sizes.min() == pytest.approx(0.0, abs=1e-9)
        assert sizes[-1] == pytest.approx(4.0, rel=ROUNDING)
        assert guarded.state == State.ENGAGED


#: What each event does in each state; where nothing is said nothing happens.
MOVES = {
    (State.CLOSED, machine.OPENED): State.OPEN,
    (State.OPEN, machine.FIRMWARE_OK): State.FIRMWARE,
    (State.FIRMWARE, machine.HOME): State.HOMING,
    **{(state, machine.SHUT): State.CLOSED for state in State},
    **{(state, machine.PARENT_DIED): State.FAULT for state in State if state is not State.CLOSED},
    **{(state, machine.TRANSPORT_LOST): State.FAULT for state in State if state is not State.CLOSED},
    # ENGAGED damps first
    **{(state, machine.HEARTBEAT_LOST): State.FAULT for state in {*State} - {State.CLOSED, State.ENGAGED}},
}


class TestStates:
    @pytest.mark.parametrize("state", list(State))
    @pytest.mark.parametrize("event", list(range(13)))
    def test_an_event_moves_a_state_as_the_diagram_says(self, state, event):
        guarded = Guarded()
        guarded.memory[machine.STATE] = float(state)
        guarded.tell(float(event))
        assert State(int(guarded.state)) == MOVES.get((state, float(event)), state)

    @pytest.mark.parametrize(("penetration", "may"), [(-1e-3, True), (0.0, True), (1e-6, False)])
    def test_parameters_may_be_exchanged_where_nothing_is_touched(self, guarded, penetration, may):
        guarded.tick(penetration=penetration)
        assert guarded.tell(machine.SWAP) is may


class TestGuardLimits:
    @pytest.mark.parametrize(
        "loose",
        [
            {"fault_ramp_s": 0.021}, {"clamp_N": 10.1}, {"slew_N_per_tick": 0.51}, {"ramp_s": 0.49},
            {"engage_below_N": 0.21}, {"motor_clamp": 4096.0}, {"clamp_N": 0.0}, {"no_reply_s": np.inf},
            {"rms_limit_N": np.nan},
        ],
    )  # fmt: skip
    def test_a_limit_looser_than_its_bar_is_refused(self, loose):
        with pytest.raises(ValueError, match=next(iter(loose))):
            GuardLimits(**loose)

    def test_an_uncalibrated_clamp_is_five_newton_with_the_worst_constant(self):
        clamps = {units: uncalibrated_clamp_N(units) for units in (3460.0, 6600.0, 10000.0)}
        # newtons times nominal units are motor units; with the worst constant these are 5 N
        forces = [clamp * units / 3460.0 for units, clamp in clamps.items()]
        assert forces == pytest.approx([5.0] * len(clamps))
        assert uncalibrated_clamp_N(1000.0) == 5.0
        with pytest.raises(ValueError, match="positive"):
            uncalibrated_clamp_N(0.0)


LEG_JUMP = np.array([0, -201, 0], np.int64)
LEG_FAST = np.array([0, -200, 0], np.int64)


def ticks_to_fault(guarded: Guarded, **seen: object) -> int:
    """Ticks until FAULT; -1 where none comes in a thousand."""
    for count in range(1, 1001):
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
        # what a hand can do
        ({"moved": LEG_FAST}, -1, Fault.NONE),
        ({"velocity": (1.2, 0.9, 0.0)}, -1, Fault.NONE),
    ],
)
def test_a_fault_of_the_device_is_seen_within_its_time(guarded, seen, ticks, fault):
    assert ticks_to_fault(guarded, **seen) == ticks
    assert guarded.fault == fault


def test_nine_damaged_packets_and_a_good_one_are_no_fault(guarded):
    for _ in range(20):
        guarded.ticks(9, (0.0, 0.0, 0.0), reply=REPLY_DAMAGED)
        guarded.tick()
    assert guarded.state == State.ENGAGED


def test_a_hand_that_moved_on_during_a_stall_or_a_silence_did_not_jump(guarded):
    guarded.tick(moved=np.array([900, 0, 0], np.int64), dt=5e-3)
    # neither did the device fall silent
    guarded.tick(dt=0.3, reply=REPLY_NONE)
    guarded.tick()
    guarded.ticks(30, (0.0, 0.0, 0.0), reply=REPLY_NONE)
    guarded.tick(moved=np.array([31 * 200, 0, 0], np.int64))
    assert guarded.state == State.ENGAGED
    guarded.ticks(30, (0.0, 0.0, 0.0), reply=REPLY_NONE)
    guarded.tick(moved=np.array([31 * 200 + 1, 0, 0], np.int64))
    assert guarded.fault == Fault.ENCODER_JUMP


def test_encoders_that_stand_still_while_the_force_changed_are_frozen(guarded):
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
def test_a_resting_hand_under_a_steady_force_is_not_frozen(guarded, change):
    guarded.ticks(5, (0.0, 0.0, 1.0), moved=MOVING)
    for k in range(2000):
        guarded.tick((0.0, 0.0, 1.0 - change * k / 2000), moved=STILL)
    assert guarded.state == State.ENGAGED


@pytest.mark.parametrize(
    ("state", "seen", "ticks"),
    [
        (machine.ARMED, {"reply": REPLY_NONE}, 100),
        # a device that is being homed by hand, without force, has more time
        (machine.HOMING, {"reply": REPLY_NONE}, 500),
        # firmware may be silent, and coordinates may jump while homing
        (machine.OPEN, {"reply": REPLY_LOST}, -1),
        (machine.FIRMWARE, {"reply": REPLY_LOST}, -1),
        (machine.HOMING, {"homed": False, "moved": np.array([5000, 0, 0], np.int64)}, -1),
    ],
)
def test_silence_is_a_fault_before_any_force_too(state, seen, ticks):
    assert ticks_to_fault(Guarded().to(state), **seen) == ticks


@pytest.mark.parametrize("reply", [REPLY_NONE, REPLY_DAMAGED])
@pytest.mark.parametrize("phase", [machine.RISING, machine.RELEASING, machine.RECOVERING, machine.YIELDING])
def test_a_silent_device_is_without_force_after_20_ms_whatever_went_on(guarded, reply, phase):
    guarded.ticks(5, (0.0, 0.0, 2.0), velocity=(0.3, 0.0, 0.0))
    guarded.memory[machine.PHASE] = phase
    sent = guarded.ticks(99, (0.0, 0.0, 2.0), velocity=(0.3, 0.0, 0.0), reply=reply)
    assert np.linalg.norm(sent[2]) > 0.5
    assert (np.array(sent[19:]) == 0.0).all()


def test_a_hiccup_of_30_ms_takes_the_force_away_and_gives_it_back(guarded):
    before = guarded.ticks(5, (0.0, 0.0, 2.0))[-1]
    silent = guarded.ticks(30, (0.0, 0.0, 2.0), reply=REPLY_NONE)
    assert (np.array(silent[19:]) == 0.0).all()
    assert guarded.lamps & Lamp.SILENT
    # in 30 ms a hand of 1 m/s made 30 mm, which is no jump
    after = [guarded.tick((0.0, 0.0, 2.0), moved=np.array([470, 0, 0], np.int64))]
    assert guarded.state == State.ENGAGED
    assert not guarded.lamps & Lamp.SILENT
    after += guarded.ticks(120, (0.0, 0.0, 2.0))
    rises = np.diff([0.0, *[np.linalg.norm(one) for one in after]])
    assert (rises >= 0.0).all()
    # over the recovery, not at once
    assert rises.max() <= 0.03
    np.testing.assert_allclose(after[-1], before)


@pytest.mark.parametrize(("delay_ticks", "punctual", "late"), [(1.5, 2, 3), (4.5, 5, 6), (0.5, 2, 3)])
def test_answers_are_late_beyond_the_delay_that_the_scale_was_worked_out_for(delay_ticks, punctual, late):
    guarded = Guarded(replace(FREE, delay_ticks=delay_ticks)).to(machine.ENGAGED)
    for unanswered in (punctual, late):
        for _ in range(30):
            observe_wire(guarded.memory, guarded.limits, unanswered, TICK)
        guarded.tick((0.0, 0.0, 1.0))
        assert bool(guarded.lamps & Lamp.LATENCY) is (unanswered == late)
