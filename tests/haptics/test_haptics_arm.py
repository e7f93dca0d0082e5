"""The arm against closed forms of its equation, and its energies against each other."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tissueid.haptics import arm as a
from tissueid.haptics.arm import Arm, arm_step, new_arm, port_energy

TICK = 1e-3
ORIGIN = np.zeros(3)


def held(arm: Arm, stiffness: float, damping: float = 0.0) -> np.ndarray:
    """Block of an arm in a hand that holds where its target is."""
    block = arm.block()
    block[[a.HAND_STIFFNESS, a.HAND_DAMPING]] = stiffness, damping
    return block


def pulled(offset: np.ndarray) -> np.ndarray:
    """Memory of an arm at rest, away from the target of its hand at the origin."""
    memory = new_arm(ORIGIN)
    memory[a.POSITION : a.POSITION + 3] = offset
    return memory


def kinetic(memory: np.ndarray, arm: Arm) -> float:
    return float(0.5 * arm.mass_kg * (memory[a.VELOCITY : a.VELOCITY + 3] ** 2).sum())


def test_a_free_oscillation_keeps_amplitude_and_frequency():
    arm = Arm(mass_kg=0.25, damping_N_s_per_m=0.0, friction_N=0.0)
    block = held(arm, 300.0)
    memory = pulled(np.array([0.01, -0.02, 0.005]))
    omega = math.sqrt(300.0 / 0.25)
    seen = np.zeros((400, 3))
    for tick in range(400):
        arm_step(memory, block, ORIGIN, TICK)
        seen[tick] = memory[a.POSITION : a.POSITION + 3]
    expected = np.cos(omega * TICK * np.arange(1, 401))[:, None] * np.array([0.01, -0.02, 0.005])
    # the midpoint rule turns (omega h)^2/12 = 2.5e-7 too slowly: 3.5e-6 rad in 14 rad of 20 mm
    assert np.abs(seen - expected).max() < 1e-7
    energy = kinetic(memory, arm) + 0.5 * 300.0 * (memory[a.POSITION : a.POSITION + 3] ** 2).sum()
    assert energy == pytest.approx(0.5 * 300.0 * (0.01**2 + 0.02**2 + 0.005**2), rel=1e-10)


def test_a_damped_oscillation_follows_its_closed_form():
    arm = Arm(mass_kg=0.2, damping_N_s_per_m=1.5, friction_N=0.0)
    block = held(arm, 500.0, damping=3.0)
    memory = pulled(np.array([0.0, 0.0, 0.01]))
    decay = (1.5 + 3.0) / (2.0 * 0.2)
    omega = math.sqrt(500.0 / 0.2 - decay**2)
    for _ in range(250):
        arm_step(memory, block, ORIGIN, TICK)
    t = 0.25
    expected = 0.01 * math.exp(-decay * t) * (math.cos(omega * t) + decay / omega * math.sin(omega * t))
    assert memory[a.POSITION + 2] == pytest.approx(expected, abs=1e-9)  # second order in h = 50 us


@pytest.mark.needs_jit
@pytest.mark.parametrize("force", [np.array([1.0, 0.0, 0.0]), np.array([0.6, -2.0, 0.5])])
def test_a_pushed_arm_ends_at_its_terminal_speed(force):
    arm = Arm(mass_kg=0.1, damping_N_s_per_m=2.0, friction_N=0.3)
    memory, block = new_arm(ORIGIN), arm.block()
    for _ in range(1000):  # twenty time constants m/b of 50 ms
        arm_step(memory, block, force, TICK)
    size = float(np.linalg.norm(force))
    expected = force / size * (size - 0.3) / 2.0
    np.testing.assert_allclose(memory[a.VELOCITY : a.VELOCITY + 3], expected, rtol=1e-7)


def test_friction_stops_a_sliding_arm_where_its_energy_is_spent():
    arm = Arm(mass_kg=0.25, damping_N_s_per_m=0.0, friction_N=0.2)
    memory, block = new_arm(ORIGIN), arm.block()
    memory[a.VELOCITY : a.VELOCITY + 3] = np.array([0.06, -0.08, 0.0])
    for _ in range(200):
        arm_step(memory, block, ORIGIN, TICK)
    way = 0.5 * 0.25 * 0.1**2 / 0.2
    # the last sub-step of 50 us may end at rest inside it: at most fc/m h^2 = 2 nm
    np.testing.assert_allclose(
        memory[a.POSITION : a.POSITION + 3], way * np.array([0.6, -0.8, 0.0]), atol=2e-9
    )
    assert kinetic(memory, arm) == 0.0


def test_an_arm_that_sticks_does_not_move_at_all():
    arm = Arm(friction_N=0.1)
    memory, block = new_arm(ORIGIN), held(arm, 300.0, 5.0)
    force = np.array([0.05, 0.05, 0.05])  # 0.087 N in all
    for _ in range(300):
        arm_step(memory, block, force, TICK)
    assert (memory[a.POSITION : a.POSITION + 3] == 0.0).all()
    assert (memory[a.VELOCITY : a.VELOCITY + 3] == 0.0).all()
    arm_step(memory, block, force * 1.2, TICK)  # 0.104 N
    assert (memory[a.POSITION : a.POSITION + 3] > 0.0).all()


@pytest.mark.needs_jit
def test_an_arm_comes_to_rest_in_the_band_of_friction_without_chatter():
    arm = Arm(friction_N=0.1)
    memory, block = pulled(np.array([0.004, 0.0, 0.0])), held(arm, 300.0, 2.0)
    speeds = np.zeros(1500)
    for tick in range(1500):
        arm_step(memory, block, ORIGIN, TICK)
        speeds[tick] = memory[a.VELOCITY]
    at_rest = np.flatnonzero(speeds == 0.0)
    assert at_rest.size > 1000
    assert (speeds[at_rest[-1000] :] == 0.0).all()
    assert abs(memory[a.POSITION]) <= 0.1 / 300.0


@pytest.mark.needs_jit
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_energies_close_to_rounding(seed):
    rng = np.random.default_rng(seed)
    arm = Arm(mass_kg=0.25, damping_N_s_per_m=0.5, friction_N=0.1)
    block = held(arm, 800.0, 8.0)
    memory = new_arm(ORIGIN)
    block[a.POINTER_ON] = 1.0
    throughput = 0.0
    for tick in range(400):
        if tick % 40 == 0:
            block[a.POINTER : a.POINTER + 3] = rng.normal(0.0, 0.02, 3)
        force = rng.normal(0.0, 2.0, 3)
        before = memory[a.POSITION : a.POSITION + 3].copy()
        arm_step(memory, block, force, rng.uniform(2e-4, 2e-3))
        throughput += float(force @ (memory[a.POSITION : a.POSITION + 3] - before))
    work = memory[a.MOTOR_WORK] + memory[a.HAND_WORK]
    losses = memory[a.DAMPING_LOSS] + memory[a.FRICTION_LOSS]
    assert memory[a.MOTOR_WORK] == pytest.approx(throughput, rel=1e-9)
    # friction that reverses within a sub-step counts by the mean speed, not by the one it acts at: < 1e-9 J
    assert work - losses == pytest.approx(kinetic(memory, arm), abs=2e-9)
    assert memory[a.DAMPING_LOSS] > 0.0
    assert memory[a.FRICTION_LOSS] > 0.0
    assert port_energy(memory) == pytest.approx(losses - memory[a.MOTOR_WORK], rel=1e-12)


def test_a_spring_rendered_without_delay_in_continuous_time_would_be_passive():
    """The ledger itself: a force that follows the position exactly gives back no more than it took."""
    arm = Arm(damping_N_s_per_m=0.0, friction_N=0.0, substep_s=1e-5)
    memory, block = new_arm(ORIGIN), held(arm, 300.0, 5.0)
    block[a.POINTER_ON] = 1.0
    least = 0.0
    for tick in range(4000):
        block[a.POINTER + 2] = 0.01 if (tick // 1000) % 2 == 0 else -0.01
        arm_step(memory, block, -800.0 * memory[a.POSITION : a.POSITION + 3], 1e-5)
        least = min(least, port_energy(memory))
    # held for 10 us a step, the spring has a negative damping of k h/2 = 4e-3 N s/m: of 5 mm at 0.2 m/s, uJ
    assert -8e-6 < least <= 0.0


def test_a_knock_of_the_force_turns_with_the_axes():
    arm = Arm(friction_N=0.15)
    turn = np.array([[0.0, -1.0, 0.0], [0.6, 0.0, -0.8], [0.8, 0.0, 0.6]])
    force = np.array([0.7, -0.4, 1.1])
    plain, turned = new_arm(ORIGIN), new_arm(ORIGIN)
    block = held(arm, 200.0, 3.0)
    for _ in range(100):
        arm_step(plain, block, force, TICK)
        arm_step(turned, block, turn @ force, TICK)
    np.testing.assert_allclose(
        turned[a.POSITION : a.POSITION + 3], turn @ plain[a.POSITION : a.POSITION + 3], atol=1e-15
    )


def test_a_tick_and_its_parts_agree_to_second_order():
    arm = Arm(friction_N=0.0)
    whole, parts = new_arm(ORIGIN), new_arm(ORIGIN)
    block = held(arm, 1000.0, 10.0)
    force = np.array([1.0, 0.0, -2.0])
    for _ in range(100):
        arm_step(whole, block, force, TICK)
        arm_step(parts, block, force, 0.37 * TICK)
        arm_step(parts, block, force, 0.63 * TICK)
    np.testing.assert_allclose(
        whole[a.POSITION : a.POSITION + 3], parts[a.POSITION : a.POSITION + 3], atol=1e-9
    )


@pytest.mark.parametrize("dt", [0.0, -1e-3, math.nan])
def test_no_time_moves_nothing(dt):
    memory, block = pulled(np.array([0.01, 0.0, 0.0])), held(Arm(), 300.0)
    before = memory.copy()
    arm_step(memory, block, np.ones(3), dt)
    assert (memory == before).all()


@pytest.mark.parametrize(
    "wrong", [{"mass_kg": 0.0}, {"substep_s": 0.0}, {"damping_N_s_per_m": -1.0}, {"friction_N": math.nan}]
)
def test_impossible_arms_are_refused(wrong):
    with pytest.raises(ValueError, match=r"must be positive|can't be negative"):
        Arm(**wrong)
