"""The arm against closed forms and its energies against each other; hands and scripts, where they move it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tissueid.errors import UsageError
from tissueid.haptics import arm as a
from tissueid.haptics import shared_hand as layout
from tissueid.haptics.arm import Arm, arm_step, new_arm
from tissueid.haptics.hand import PRESETS, Hand, parse_script, preset, scripted_hand

TICK = 1e-3
ORIGIN = np.zeros(3)
PLACE, SPEED = slice(a.POSITION, a.POSITION + 3), slice(a.VELOCITY, a.VELOCITY + 3)


def held(arm: Arm, stiffness: float, damping: float = 0.0) -> np.ndarray:
    """Block of an arm in a hand that holds where its target is."""
    block = arm.block()
    block[[layout.HAND_STIFFNESS, layout.HAND_DAMPING]] = stiffness, damping
    return block


def moved(block: np.ndarray, ticks: int, *, force=ORIGIN, place=ORIGIN, speed=ORIGIN):
    """Memory of an arm after some ticks, and all its places; the target of its hand is the origin."""
    memory, seen = new_arm(ORIGIN), np.zeros((ticks, 3))
    memory[PLACE], memory[SPEED] = place, speed
    for tick in range(ticks):
        arm_step(memory, block, np.array(force), TICK)
        seen[tick] = memory[PLACE]
    return memory, seen


def kinetic(memory: np.ndarray, arm: Arm) -> float:
    return float(0.5 * arm.mass_kg * (memory[SPEED] ** 2).sum())


def test_a_damped_oscillation_follows_its_closed_form():
    arm = Arm(mass_kg=0.2, damping_N_s_per_m=1.5, friction_N=0.0)
    start = np.array([0.01, -0.02, 0.005])
    memory, _ = moved(held(arm, 500.0, damping=3.0), 250, place=start)
    decay, t = (1.5 + 3.0) / (2.0 * 0.2), 0.25
    omega = math.sqrt(500.0 / 0.2 - decay**2)
    share = math.exp(-decay * t) * (math.cos(omega * t) + decay / omega * math.sin(omega * t))
    assert memory[PLACE] == pytest.approx(share * start, abs=2e-9)  # second order in h = 50 us


@pytest.mark.needs_jit
@pytest.mark.parametrize("force", [np.array([1.0, 0.0, 0.0]), np.array([0.6, -2.0, 0.5])])
def test_a_pushed_arm_ends_at_its_terminal_speed(force):
    arm = Arm(mass_kg=0.1, damping_N_s_per_m=2.0, friction_N=0.3)
    memory, _ = moved(arm.block(), 1000, force=force)  # twenty time constants m/b of 50 ms
    size = float(np.linalg.norm(force))
    np.testing.assert_allclose(memory[SPEED], force / size * (size - 0.3) / 2.0, rtol=1e-7)


def test_friction_stops_a_sliding_arm_where_its_energy_is_spent():
    arm = Arm(mass_kg=0.25, damping_N_s_per_m=0.0, friction_N=0.2)
    memory, _ = moved(arm.block(), 200, speed=(0.06, -0.08, 0.0))
    way = 0.5 * 0.25 * 0.1**2 / 0.2
    # the last sub-step of 50 us may end at rest inside it: at most fc/m h^2 = 2 nm
    np.testing.assert_allclose(memory[PLACE], way * np.array([0.6, -0.8, 0.0]), atol=2e-9)
    assert kinetic(memory, arm) == 0.0


def test_an_arm_that_sticks_does_not_move_at_all():
    block, force = held(Arm(friction_N=0.1), 300.0, 5.0), np.array([0.05, 0.05, 0.05])  # 0.087 N in all
    memory, _ = moved(block, 300, force=force)
    assert (memory[PLACE] == 0.0).all()
    assert (memory[SPEED] == 0.0).all()
    arm_step(memory, block, force * 1.2, TICK)  # 0.104 N
    assert (memory[PLACE] > 0.0).all()


@pytest.mark.needs_jit
def test_an_arm_comes_to_rest_in_the_band_of_friction_without_chatter():
    memory, seen = moved(held(Arm(friction_N=0.1), 300.0, 2.0), 1500, place=(0.004, 0.0, 0.0))
    assert (np.diff(seen[-1001:], axis=0) == 0.0).all()
    assert (memory[SPEED] == 0.0).all()
    assert abs(memory[a.POSITION]) <= 0.1 / 300.0


@pytest.mark.needs_jit
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_energies_close_to_rounding(seed):
    rng = np.random.default_rng(seed)
    arm = Arm(mass_kg=0.25, damping_N_s_per_m=0.5, friction_N=0.1)
    memory, block = new_arm(ORIGIN), held(arm, 800.0, 8.0)
    block[layout.POINTER_ON] = 1.0
    throughput = 0.0
    for tick in range(400):
        if tick % 40 == 0:
            block[layout.POINTER : layout.POINTER + 3] = rng.normal(0.0, 0.02, 3)
        force, before = rng.normal(0.0, 2.0, 3), memory[PLACE].copy()
        arm_step(memory, block, force, rng.uniform(2e-4, 2e-3))
        throughput += float(force @ (memory[PLACE] - before))
    losses = memory[a.DAMPING_LOSS] + memory[a.FRICTION_LOSS]
    assert memory[a.MOTOR_WORK] == pytest.approx(throughput, rel=1e-9)
    # friction that reverses within a sub-step counts by the mean speed, not by the one it acts at: < 1e-9 J
    work = memory[a.MOTOR_WORK] + memory[a.HAND_WORK]
    assert work - losses == pytest.approx(kinetic(memory, arm), abs=2e-9)
    assert (memory[[a.DAMPING_LOSS, a.FRICTION_LOSS]] > 0.0).all()


@pytest.mark.parametrize("dt", [0.0, -1e-3, math.nan])
def test_no_time_moves_nothing(dt):
    memory, _ = moved(held(Arm(), 300.0), 1, place=(0.01, 0.0, 0.0))
    before = memory.copy()
    arm_step(memory, held(Arm(), 300.0), np.ones(3), dt)
    assert (memory == before).all()


SURFACE = np.array([0.01, -0.02, 0.13])
INWARD = np.array([0.0, 0.0, -1.0])


def test_a_script_moves_the_grip_in_tissue_units_whatever_the_force():
    hand = scripted_hand(
        "indent 8 mm at 250 mm/min; hold 0.1 s; retract to 3 mm at 10 mm/s",
        motion_scale=5.0, surface_m=SURFACE, inward=INWARD, rest_s=0.2,
    )  # fmt: skip
    memory, block = new_arm(hand.start_m), hand.write(Arm().block())
    speed = 250.0 / 60.0
    corner = 0.2 + 8.5 / speed  # from half a millimetre above the tissue
    assert hand.duration_s == pytest.approx(corner + 0.1 + 0.5, abs=1e-12)
    depths, times = [], []
    push = np.array([0.3, 0.0, 7.0])
    while memory[a.TIME] < hand.duration_s:
        arm_step(memory, block, push, 5e-3)
        times.append(memory[a.TIME])
        depths.append((SURFACE[2] - memory[a.POSITION + 2]) * 1e3 / 5.0)
    time = np.array(times)
    expected = np.interp(time, [0.2, corner, corner + 0.1, corner + 0.6], [-0.5, 8.0, 8.0, 3.0])
    np.testing.assert_allclose(depths, expected, atol=1e-9)
    np.testing.assert_allclose(memory[a.POSITION : a.POSITION + 2], SURFACE[:2], atol=1e-15)
    # the machine's work is what the motors took, and what damping, friction and motion took
    work = memory[a.HAND_WORK] + memory[a.MOTOR_WORK] - memory[a.DAMPING_LOSS] - memory[a.FRICTION_LOSS]
    assert work == pytest.approx(kinetic(memory, Arm()), abs=1e-9)


@pytest.mark.parametrize(
    ("text", "strokes"),
    [
        (
            " indent 2mm at 1 mm/s;;hold .5s; indent 4 mm at 60mm/min; retract at 5 mm/s; hold 2 s ;",
            [("indent", 2.0), ("hold", 2.0), ("indent", 4.0), ("retract", -0.5), ("hold", -0.5)],
        ),
        ("", "1 to 62 strokes"),
        ("press 8 mm", "is no stroke"),
        ("indent 8 at 250 mm/min", "is no stroke"),
        ("indent 8 mm at 0 mm/min", "speed of"),
        ("indent 8 mm at 20000 mm/min", "speed of"),
        ("indent 4 mm at 5 mm/s; indent 3 mm at 5 mm/s", "does not go deeper"),
        ("indent 4 mm at 5 mm/s; retract to 5 mm at 5 mm/s", "does not go back"),
        ("hold 0 s", "is no stroke"),
        ("hold 1e9 s", "is no stroke"),
        ("indent 8 mm at 250 mm/min\x1b[2J", "is no stroke"),
        ("hold 1 s;" * 63, "1 to 62 strokes"),
    ],
)
def test_scripts_are_read_and_those_that_make_no_sense_refused(text, strokes):
    if not isinstance(strokes, str):
        assert [(stroke.kind, stroke.depth_mm) for stroke in parse_script(text)] == strokes
        return
    with pytest.raises(UsageError, match=strokes) as caught:
        parse_script(text)
    assert "\x1b" not in caught.value.message


@pytest.mark.parametrize("name", PRESETS)
def test_presets_start_in_air_reach_their_depth_and_move_no_faster_than_a_hand(name):
    hand = preset(
        name, surface_m=SURFACE, inward=INWARD, depth_m=0.003, speed_m_per_s=2e-3, rest_s=0.1, stay_s=0.5
    )
    knots = hand.knots()
    depth = SURFACE[2] - knots[:, 3]
    speed = np.abs(np.diff(depth) / np.diff(knots[:, 0]))
    assert depth[0] < 0.0
    assert depth.max() == pytest.approx(0.003, abs=1e-12)
    assert speed.max() < 0.5
    if name == "slow press":
        assert speed.max() == pytest.approx(2e-3, rel=1e-9)
    assert (knots[-1, 4] == 0.0) == (name == "release")
    assert (hand.tremor_m > 0.0) == (name == "tremor")


def test_a_tremor_swings_by_its_amplitude_at_its_frequency():
    hand = Hand(
        (0.0,), ((0.0, 0.0, 0.1),), (1.0,), rigid=True, tremor_m=3e-4, tremor_hz=8.0, tremor_phase=0.4
    )
    _, seen = moved(hand.write(Arm().block()), 500, place=hand.start_m)
    time = 1e-3 * np.arange(1, 501)
    expected = 3e-4 * np.minimum(time / a.TREMOR_RISE_S, 1.0) * np.sin(2.0 * np.pi * 8.0 * time + 0.4)
    np.testing.assert_allclose(seen[:, 2] - 0.1, expected, atol=1e-12)


def test_a_released_grip_flies_free():
    hand = Hand((0.0, 0.05), ((0.0, 0.0, 0.1),) * 2, (1.0, 0.0), stiffness_N_per_m=500.0)
    memory, block = new_arm(hand.start_m), hand.write(Arm(damping_N_s_per_m=0.0, friction_N=0.0).block())
    arm_step(memory, block, ORIGIN, 0.05)
    start = memory[a.POSITION + 2]
    arm_step(memory, block, np.array([0.0, 0.0, 1.0]), 0.1)
    assert memory[a.POSITION + 2] - start == pytest.approx(0.5 * 1.0 / 0.25 * 0.1**2, rel=1e-9)


def test_impossible_arms_and_hands_and_unknown_ones_are_refused():
    impossible = {"mass_kg": 0.0, "substep_s": 0.0, "damping_N_s_per_m": -1.0, "friction_N": math.nan}
    for name, value in impossible.items():
        with pytest.raises(ValueError, match=r"must be positive|can't be negative"):
            Arm(**{name: value})
    for times, reason in (((0.0, 0.0), "must rise"), ((0.0, math.nan), "finite"), ((), "1 to 64 knots")):
        with pytest.raises(ValueError, match=reason):
            Hand(times, ((0.0, 0.0, 0.1),) * len(times), (1.0,) * len(times))
    with pytest.raises(UsageError, match="hands are step, slow press"):
        preset("punch", surface_m=SURFACE, inward=INWARD, depth_m=0.01)
