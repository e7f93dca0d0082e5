"""Things the guard never does, whatever a device, a law or a clock says."""

from dataclasses import replace

import numpy as np
import pytest
from guarded import FREE, Guarded
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.haptics import guard as machine
from tissueid.haptics.states import State

pytestmark = pytest.mark.needs_jit

#: Scaling a vector to a length rounds each component once.
ROUNDING = 1e-12
SLEW = 0.5

number = st.one_of(
    st.floats(-20.0, 20.0),
    st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -0.0, 1e308, -1e308, 1e-308, 5e-324]),
)
usual = st.floats(-12.0, 12.0)
#: Mostly good ticks: a guard that is always in FAULT shows little.
tick = st.fixed_dictionaries(
    {
        "force": st.tuples(usual, usual, usual),
        "dt": st.sampled_from([1e-3] * 8 + [2.5e-4, 4e-3, 0.1, 0.0, -1.0, np.nan, np.inf]),
        "reply": st.sampled_from([1] * 12 + [0, -1]),
        "homed": st.sampled_from([True] * 40 + [False]),
        "buttons": st.sampled_from([4] * 6 + [0, 15]),
        "moved": st.sampled_from([(1, 0, 0)] * 8 + [(0, 0, 0), (150, -199, 3), (0, 260, 0)]),
        "velocity": st.sampled_from([(0.0, 0.0, 0.0), (0.1, -0.2, 0.3), (1.0, 1.0, 1.0), (np.nan, 0.0, 0.0)]),
        "penetration": st.sampled_from([0.0, -1e-3, 1e-3, np.nan]),
        "event": st.sampled_from([None] * 30 + np.arange(machine.ENGAGE, machine.SHUT).tolist()),
    }
)
wild = st.fixed_dictionaries(
    {
        "force": st.tuples(number, number, number),
        "dt": number,
        "reply": st.integers(-3, 3),
        "homed": st.booleans(),
        "buttons": st.integers(0, 15),
        "moved": st.tuples(*[st.integers(-(2**40), 2**40)] * 3),
        "velocity": st.tuples(number, number, number),
        "penetration": number,
        "event": st.one_of(st.none(), st.integers(0, 14).map(float)),
    }
)
clamps = st.sampled_from([0.3, 2.0, 5.0, 10.0])


def run(clamp: float, ticks: list[dict], start: State = State.ENGAGED):
    """Every tick's sent force, state and dt, from a guard in a state, engaged with a force on."""
    guarded = Guarded(replace(FREE, clamp_N=clamp, rms_limit_N=clamp, dead_man=True)).to(float(start))
    sent, states, times = [guarded.tick((0.0, 0.0, 1.0), buttons=4)], [guarded.state], [1e-3]
    for words in ticks:
        seen = {key: words[key] for key in ("reply", "homed", "buttons", "velocity", "penetration")}
        if words["event"] is not None:
            guarded.tell(words["event"])
        moved = np.array(words["moved"], np.int64)
        sent.append(guarded.tick(words["force"], dt=words["dt"], moved=moved, **seen))
        states.append(guarded.state)
        times.append(words["dt"])
    return np.array(sent), np.array(states), np.array(times)


@settings(max_examples=150, deadline=None)
@given(
    clamps, st.lists(st.one_of(tick, wild), min_size=1, max_size=60), st.sampled_from([*State, State.ENGAGED])
)
def test_a_force_is_finite_within_clamp_and_slew_and_zero_in_every_state_but_two(clamp, ticks, start):
    sent, states, _ = run(clamp, ticks, start)
    size = np.linalg.norm(sent, axis=1)
    assert np.isfinite(sent).all()
    assert np.all(size <= clamp * (1.0 + ROUNDING))
    assert np.all(np.diff(size) <= SLEW + ROUNDING)
    quiet = (states != State.ENGAGED) & (states != State.FAULT)
    assert np.all(sent[quiet] == 0.0)
    # a device that was not engaged has no force to fade
    never = np.cumsum(states == State.ENGAGED) == 0
    assert np.all(sent[never] == 0.0)


@settings(max_examples=120, deadline=None)
@given(
    clamps,
    st.lists(tick, min_size=20, max_size=60),
    st.sampled_from([machine.PARENT_DIED, machine.TRANSPORT_LOST]),
)
def test_a_fault_never_rises_and_is_zero_after_20_ms(clamp, ticks, event):
    ticks[5]["event"] = event
    sent, states, times = run(clamp, ticks)
    faulted = np.flatnonzero(states == State.FAULT)
    # the tick that saw the fault counts; a tick that is no good one counts as at least 5 ms
    age = np.cumsum(np.where((times[faulted] > 0.0) & np.isfinite(times[faulted]), times[faulted], 5e-3))
    size = np.linalg.norm(sent[faulted], axis=1)
    assert faulted.size > 0
    assert np.all(states[faulted[0] :] == State.FAULT)
    assert np.all(np.diff(size) <= ROUNDING)
    assert np.all(size[age >= 0.020 - 1e-9] == 0.0)


@settings(max_examples=120, deadline=None)
@given(clamps, st.lists(st.tuples(usual, usual, usual), min_size=1, max_size=40))
def test_what_is_sent_points_where_it_was_wanted_and_is_no_longer(clamp, forces):
    guarded = Guarded(replace(FREE, clamp_N=clamp, rms_limit_N=clamp)).to(machine.ENGAGED)
    for force in forces:
        wanted = np.array(force)
        out = guarded.tick(force)
        across = np.linalg.norm(np.cross(out, wanted))
        assert across <= 1e-12 * (1.0 + np.linalg.norm(wanted) * np.linalg.norm(out))
        assert out @ wanted >= 0.0
        assert np.linalg.norm(out) <= np.linalg.norm(wanted) * (1.0 + ROUNDING)
