"""The guard: state machine, limits and their precedence, against closed forms."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from guarded import FREE, STILL, TICK, Guarded

from tissueid.haptics import guard as machine
from tissueid.haptics.limits import GuardLimits, uncalibrated_clamp_N
from tissueid.haptics.states import Fault, Lamp, State

#: Scaling a vector to a length rounds each component once.
ROUNDING = 1e-14
LARGEST = replace(FREE, clamp_N=10.0, rms_limit_N=10.0)


def lengths(forces: list[np.ndarray]) -> np.ndarray:
    return np.linalg.norm(forces, axis=1)


class TestLimits:
    def test_a_long_force_is_cut_to_the_clamp_and_keeps_its_direction(self):
        guarded = Guarded().to(machine.ENGAGED)
        outs = [guarded.tick((30.0, 40.0, 0.0)) for _ in range(20)]
        assert outs[-1] == pytest.approx([3.0, 4.0, 0.0], rel=ROUNDING)
        assert guarded.lamps == Lamp.CLIPPED

    def test_a_rising_force_takes_one_slew_a_tick(self):
        guarded = Guarded().to(machine.ENGAGED)
        outs = [guarded.tick((0.0, 0.0, 2.2)) for _ in range(6)]
        assert lengths(outs) == pytest.approx([0.5, 1.0, 1.5, 2.0, 2.2, 2.2], rel=ROUNDING)

    def test_a_falling_force_falls_at_once(self):
        guarded = Guarded().to(machine.ENGAGED)
        for _ in range(10):
            guarded.tick((0.0, 0.0, 4.0))
        assert guarded.tick((0.0, 0.0, 0.3)).tolist() == [0.0, 0.0, 0.3]

    def test_a_force_that_turns_round_starts_from_zero(self):
        guarded = Guarded().to(machine.ENGAGED)
        for _ in range(10):
            guarded.tick((4.0, 0.0, 0.0))
        assert guarded.tick((-4.0, 0.0, 0.0)).tolist() == [-0.5, 0.0, 0.0]

    def test_a_force_that_turns_by_sixty_degrees_starts_from_half(self):
        guarded = Guarded().to(machine.ENGAGED)
        for _ in range(10):
            guarded.tick((4.0, 0.0, 0.0))
        turned = np.array([np.cos(np.pi / 3), np.sin(np.pi / 3), 0.0])
        assert guarded.tick(4.0 * turned) == pytest.approx(2.5 * turned, rel=ROUNDING)

    def test_a_force_within_every_limit_is_sent_as_it_is(self):
        guarded = Guarded().to(machine.ENGAGED)
        for force in ((0.1, 0.2, -0.3), (0.2, 0.3, -0.4)):
            assert tuple(guarded.tick(force)) == force
        assert guarded.lamps == Lamp.NONE

    @pytest.mark.parametrize("size", [1e-200, 1e160, 1.7e308])
    def test_a_force_whose_square_no_number_holds_keeps_its_direction(self, size):
        guarded = Guarded().to(machine.ENGAGED)
        out = guarded.tick((0.6 * size, 0.8 * size, 0.0))
        assert out == pytest.approx(min(size, 0.5) * np.array([0.6, 0.8, 0.0]), rel=ROUNDING)

    def test_a_sustained_force_folds_back_to_what_the_motors_bear(self):
        limits = replace(FREE, clamp_N=5.0, rms_limit_N=3.0, rms_window_s=2.0)
        guarded = Guarded(limits).to(machine.ENGAGED)
        # ten windows: what is left of the start is exp(-10)
        outs = lengths([guarded.tick((0.0, 0.0, 9.0), dt=5e-3) for _ in range(4000)])
        assert outs.max() == pytest.approx(5.0, rel=ROUNDING)
        assert outs[-1] == pytest.approx(3.0, rel=1e-3)
        assert guarded.lamps & Lamp.RMS_LIMITED
        assert guarded.state == State.ENGAGED

    def test_motors_that_are_over_their_limit_all_the_same_are_a_fault(self):
        guarded = Guarded().to(machine.ENGAGED)
        guarded.memory[machine.MEAN_SQUARE] = 1.3 * 5.0**2
        guarded.tick((0.0, 0.0, 1.0))
        assert guarded.fault == Fault.OVERHEATED


class TestStart:
    def test_the_start_up_ramp_is_linear_over_its_time(self):
        guarded = Guarded().to(machine.ARMED)
        guarded.tell(machine.ENGAGE)
        outs = [guarded.tick((0.0, 0.0, 1.0)) for _ in range(1100)]
        expected = np.minimum(TICK * np.arange(1, 1101), 1.0)
        # a thousand additions of a thousandth
        assert np.array(outs)[:, 2] == pytest.approx(expected, abs=1e-12)

    def test_while_the_force_rises_damping_fades(self):
        guarded = Guarded().to(machine.ARMED)
        guarded.tell(machine.ENGAGE)
        for _ in range(249):
            guarded.tick((0.0, 0.0, 1.0))
        out = guarded.tick((0.0, 0.0, 1.0), velocity=(0.1, 0.0, 0.0))
        assert out == pytest.approx([-0.75 * FREE.damping_N_s_per_m * 0.1, 0.0, 0.25], abs=1e-12)

    @pytest.mark.parametrize(
        ("penetration", "wanted", "engages"),
        [(0.0, 4.0, True), (-1e-3, 4.0, True), (1e-3, 4.0, False), (1e-3, 0.19, True), (np.nan, 4.0, False)],
    )
    def test_a_device_engages_outside_tissue_or_with_a_small_force_alone(self, penetration, wanted, engages):
        guarded = Guarded().to(machine.ARMED)
        guarded.tell(machine.ENGAGE)
        for _ in range(3):
            guarded.tick((0.0, 0.0, wanted), penetration=penetration)
        assert (guarded.state == State.ENGAGED) is engages

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
        outs += [guarded.tick((0.0, 9.0, 12.0)) for _ in range(19)]
        sizes = lengths(outs)
        assert guarded.state == State.FAULT
        assert np.all(-np.diff(sizes) <= 0.5 + 1e-9)
        # a straight line from what was sent last; the tick that saw the fault is the first of 20
        assert sizes == pytest.approx(limits.clamp_N * np.linspace(1.0, 0.0, 21), abs=1e-9)
        assert sizes[-1] == 0.0

    def test_a_fault_does_not_wait_for_a_stall_of_the_loop(self):
        guarded = Guarded().to(machine.ENGAGED)
        for _ in range(30):
            guarded.tick((0.0, 0.0, 5.0))
        guarded.tick((0.0, 0.0, 5.0), homed=False)
        assert guarded.tick((0.0, 0.0, 5.0), dt=0.1).tolist() == [0.0, 0.0, 0.0]

    @pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
    def test_a_force_that_is_no_number_ramps_the_last_one_to_zero(self, bad):
        guarded = Guarded().to(machine.ENGAGED)
        for _ in range(10):
            guarded.tick((0.0, 0.0, 2.0))
        out = guarded.tick((0.0, bad, 2.0))
        assert out == pytest.approx([0.0, 0.0, 2.0 * 19 / 20], rel=1e-12)
        assert guarded.fault == Fault.NOT_A_NUMBER

    def test_the_first_fault_is_the_one_reported(self):
        guarded = Guarded().to(machine.ENGAGED)
        guarded.tick(homed=False)
        guarded.tell(machine.TRANSPORT_LOST)
        assert guarded.fault == Fault.NOT_HOMED

    def test_nothing_leads_out_of_a_fault_but_shutting(self):
        guarded = Guarded().to(machine.ENGAGED)
        guarded.tick(homed=False)
        for event in np.arange(machine.SHUT):
            guarded.tell(event)
            guarded.tick((0.0, 0.0, 1.0))
            assert guarded.state == State.FAULT
        guarded.tell(machine.SHUT)
        assert guarded.state == State.CLOSED

    def test_silence_of_the_owner_is_damping_then_a_fault(self):
        guarded = Guarded().to(machine.ENGAGED)
        for _ in range(10):
            guarded.tick((0.0, 0.0, 2.0))
        guarded.tell(machine.HEARTBEAT_LOST)
        outs = [guarded.tick((0.0, 0.0, 2.0), velocity=(0.1, 0.0, 0.0)) for _ in range(20)]
        assert outs[-1] == pytest.approx([-FREE.damping_N_s_per_m * 0.1, 0.0, 0.0], abs=1e-12)
        assert guarded.state == State.ENGAGED
        for _ in range(100):
            guarded.tick((0.0, 0.0, 2.0))
        assert guarded.state == State.FAULT
        assert guarded.fault == Fault.HEARTBEAT


class TestRelease:
    def test_letting_go_of_the_button_ramps_down_in_100_ms(self):
        guarded = Guarded(replace(FREE, dead_man=True)).to(machine.ENGAGED)
        for _ in range(10):
            guarded.tick((0.0, 0.0, 2.0), buttons=0x04)
        outs = lengths([guarded.tick((0.0, 0.0, 2.0), buttons=0x0B) for _ in range(100)])
        assert outs == pytest.approx(2.0 * (1.0 - np.arange(1, 101) / 100), abs=1e-12)
        assert guarded.tick((0.0, 0.0, 2.0), buttons=0).tolist() == [0.0, 0.0, 0.0]
        assert guarded.state == State.ARMED
        assert guarded.lamps & Lamp.DEAD_MAN

    def test_pressing_it_again_in_tissue_waits_for_a_free_tool(self):
        guarded = Guarded(replace(FREE, dead_man=True)).to(machine.ENGAGED)
        for _ in range(110):
            guarded.tick((0.0, 0.0, 2.0), buttons=0, penetration=2e-3)
        guarded.tick((0.0, 0.0, 2.0), buttons=0x04, penetration=2e-3)
        assert guarded.state == State.ARMED
        guarded.tick((0.0, 0.0, 0.0), buttons=0x04, penetration=-1e-3)
        assert guarded.state == State.ENGAGED

    def test_pressing_it_again_during_the_ramp_turns_the_ramp(self):
        guarded = Guarded(replace(FREE, dead_man=True)).to(machine.ENGAGED)
        for _ in range(50):
            guarded.tick((0.0, 0.0, 0.4), buttons=0, penetration=1e-3)
        low, high = (guarded.tick((0.0, 0.0, 0.4), buttons=0x04, penetration=1e-3)[2] for _ in range(2))
        assert 0.2 < low < high
        assert guarded.state == State.ENGAGED

    def test_disengaging_ends_in_armed_and_stays_there(self):
        guarded = Guarded().to(machine.ENGAGED)
        guarded.tell(machine.DISENGAGE)
        for _ in range(200):
            out = guarded.tick((0.0, 0.0, 2.0))
        assert guarded.state == State.ARMED
        assert out.tolist() == [0.0, 0.0, 0.0]


class TestStall:
    @pytest.mark.parametrize("dt", [0.1, 0.0051, 0.0, -1.0, np.nan, np.inf])
    def test_a_stalled_loop_ramps_down_and_resumes(self, dt):
        guarded = Guarded().to(machine.ENGAGED)
        for _ in range(10):
            guarded.tick((0.0, 0.0, 4.0))
        outs = [guarded.tick((0.0, 0.0, 4.0), dt=dt)]
        assert guarded.lamps & Lamp.STALLED
        outs += [guarded.tick((0.0, 0.0, 4.0)) for _ in range(140)]
        sizes = lengths(outs)
        assert np.all(sizes <= 4.0)
        assert sizes.min() == pytest.approx(0.0, abs=1e-9)
        assert sizes[-1] == pytest.approx(4.0, rel=ROUNDING)
        assert guarded.state == State.ENGAGED

    def test_a_stall_is_not_the_devices_silence(self):
        guarded = Guarded().to(machine.ENGAGED)
        guarded.tick(dt=0.3, reply=0)
        guarded.tick()
        assert guarded.state == State.ENGAGED


#: What each event does in each state; where nothing is said nothing happens.
MOVES = {
    (State.CLOSED, machine.OPENED): State.OPEN,
    (State.OPEN, machine.FIRMWARE_OK): State.FIRMWARE,
    (State.FIRMWARE, machine.HOME): State.HOMING,
    (State.HOMING, machine.HOMED): State.ARMED,
    **{(state, machine.SHUT): State.CLOSED for state in State},
    **{
        (state, event): State.FAULT
        for state in State
        for event in (machine.PARENT_DIED, machine.TRANSPORT_LOST)
        if state is not State.CLOSED
    },
    # ENGAGED damps first
    **{
        (state, machine.HEARTBEAT_LOST): State.FAULT
        for state in State
        if state not in {State.CLOSED, State.ENGAGED}
    },
}


class TestStates:
    @pytest.mark.parametrize("state", list(State))
    @pytest.mark.parametrize("event", list(range(14)))
    def test_an_event_moves_a_state_as_the_diagram_says(self, state, event):
        guarded = Guarded()
        guarded.memory[machine.STATE] = float(state)
        guarded.tell(float(event))
        assert State(int(guarded.state)) == MOVES.get((state, float(event)), state)

    @pytest.mark.parametrize("state", [state for state in State if state is not State.ENGAGED])
    def test_no_force_passes_in_any_state_but_engaged(self, state):
        guarded = Guarded().to(machine.ARMED)
        guarded.memory[machine.STATE] = float(state)
        assert guarded.tick((1.0, 2.0, 3.0), moved=STILL).tolist() == [0.0, 0.0, 0.0]

    @pytest.mark.parametrize(("penetration", "may"), [(-1e-3, True), (0.0, True), (1e-6, False)])
    def test_parameters_may_be_exchanged_where_nothing_is_touched(self, penetration, may):
        guarded = Guarded().to(machine.ENGAGED)
        guarded.tick(penetration=penetration)
        assert guarded.tell(machine.SWAP) is may


class TestGuardLimits:
    def test_the_block_has_the_fields_in_order(self):
        limits = GuardLimits()
        assert limits.block().tolist() == [
            float(getattr(limits, name)) for name in GuardLimits.__dataclass_fields__
        ]

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
        assert {units: clamp * units / 3460.0 for units, clamp in clamps.items()} == pytest.approx(
            dict.fromkeys(clamps, 5.0)
        )
        assert uncalibrated_clamp_N(1000.0) == 5.0
        with pytest.raises(ValueError, match="positive"):
            uncalibrated_clamp_N(0.0)

    def test_ramps_of_a_whole_session_never_rise_by_more_than_the_slew(self):
        guarded = Guarded(LARGEST).to(machine.ARMED)
        guarded.tell(machine.ENGAGE)
        outs = [guarded.tick((0.0, 0.0, 40.0 if k % 700 < 500 else 0.0)) for k in range(2100)]
        assert max(b - a for a, b in pairwise(lengths(outs))) <= 0.5 + ROUNDING


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_force_of_which_one_component_is_no_number_is_a_fault(axis, bad):
    guarded = Guarded().to(machine.ENGAGED)
    before = [guarded.tick((0.1, 0.1, 0.1)) for _ in range(3)][-1]
    force = np.full(3, 0.1)
    force[axis] = bad
    sent = guarded.tick(force)
    assert guarded.state == State.FAULT
    assert guarded.fault == Fault.NOT_A_NUMBER
    assert np.isfinite(sent).all()
    assert np.linalg.norm(sent) <= np.linalg.norm(before)
