"""The observer counts exactly what a held force did; the controller brakes without a kick."""

import numpy as np
import pytest

from tissueid.arrays import FloatArray
from tissueid.rendering import passivity_control as control
from tissueid.rendering.passivity_control import PassivityLimits, note_sent, passivity_step

PERIOD_S = 0.001
COUNT_M = 45e-6


def run_law(
    positions_m: FloatArray, forces_N: FloatArray, limits: PassivityLimits
) -> tuple[FloatArray, FloatArray]:
    """Forces after the controller, and the memory after every tick."""
    memory, block = np.zeros(control.CONTROL_MEMORY_SIZE), limits.block()
    sent, memories = np.zeros_like(forces_N), np.zeros((len(forces_N), memory.size))
    for i, (position, wanted) in enumerate(zip(positions_m, forces_N, strict=True)):
        force = wanted.copy()
        passivity_step(memory, block, position.copy(), force, PERIOD_S)
        sent[i], memories[i] = force, memory
    return sent, memories


def press(stiffness: float, *, ticks_late: int, count_m: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """A spring that is pressed 10 mm and released at 40 mm/s, its force some ticks old."""
    times = PERIOD_S * np.arange(1000)
    depth = 0.01 * (1.0 - np.abs(np.clip(times / 0.25, 0.0, 4.0) % 2.0 - 1.0))
    seen = np.round(depth / count_m) * count_m if count_m else depth
    late = np.concatenate([np.zeros(ticks_late), seen[: len(seen) - ticks_late]])
    positions, forces = np.zeros((1000, 3)), np.zeros((1000, 3))
    positions[:, 2] = -seen
    forces[:, 2] = stiffness * late
    return positions, forces


def test_the_ledger_is_the_exact_sum_of_held_force_times_motion():
    rng = np.random.default_rng(1)
    positions = np.cumsum(1e-4 * rng.standard_normal((200, 3)), axis=0)
    forces = rng.standard_normal((200, 3))
    _, memories = run_law(positions, forces, PassivityLimits(on=False))
    expected = -np.cumsum((forces[:-1] * np.diff(positions, axis=0)).sum(axis=1))
    assert memories[1:, control.TOTAL_J] == pytest.approx(expected, rel=1e-9, abs=1e-15)


def test_the_ledger_counts_what_the_guard_let_through():
    memory = np.zeros(control.CONTROL_MEMORY_SIZE)
    block = PassivityLimits(on=False).block()
    force = np.array([0.0, 0.0, 8.0])
    passivity_step(memory, block, np.zeros(3), force, PERIOD_S)
    note_sent(memory, np.array([0.0, 0.0, 5.0]))
    passivity_step(memory, block, np.array([0.0, 0.0, -1e-3]), force, PERIOD_S)
    assert memory[control.TOTAL_J] == pytest.approx(5e-3, rel=1e-12)


def test_a_late_spring_gives_energy_back_and_is_braked():
    positions, forces = press(400.0, ticks_late=3)
    _, free = run_law(positions, forces, PassivityLimits(on=False, stiffness_N_per_m=400.0))
    held, braked = run_law(positions, forces, PassivityLimits(stiffness_N_per_m=400.0))
    # a spring 3 ticks late returns 2 k v (3 T) d more than it took, in each of two presses
    assert free[-1, control.TOTAL_J] == pytest.approx(-2 * 2 * 400.0 * 0.04 * 0.003 * 0.01, rel=0.2)
    # the debt shows at the end of a release alone, so that a part of it is all that can be taken back
    assert braked[-1, control.TOTAL_J] > 0.9 * free[-1, control.TOTAL_J]
    corrected = np.abs(held - forces).max(axis=1) > 0.0
    assert corrected.any()
    assert braked[corrected, control.ACTIVE].min() == 1.0
    # against the motion: on the way out the grip is pushed back in
    moving = corrected[1:] & (np.diff(positions[:, 2]) > 0.0)
    assert ((held - forces)[1:][moving, 2] < 0.0).mean() > 0.9


@pytest.mark.parametrize("count_m", [0.0, COUNT_M])
def test_the_correction_never_jumps_nor_exceeds_its_limit(count_m):
    limits = PassivityLimits(stiffness_N_per_m=3000.0, largest_damping_N_s_per_m=50.0)
    positions, forces = press(3000.0, ticks_late=3, count_m=count_m)
    sent, _ = run_law(positions, forces, limits)
    correction = sent - forces
    size = np.linalg.norm(correction, axis=1)
    assert size.max() > 0.5
    assert size.max() <= limits.largest_correction_N * (1.0 + 1e-9)
    assert np.linalg.norm(np.diff(correction, axis=0), axis=1).max() <= 0.5 * (1.0 + 1e-9)


@pytest.mark.needs_jit
def test_a_slow_press_through_rounded_positions_is_left_alone():
    # 0.8 mm/s: the rounded ledger is short of energy that no hand ever got
    times = PERIOD_S * np.arange(8000)
    depth = np.round(8e-4 * np.minimum(times, 8.0 - times) / COUNT_M) * COUNT_M
    positions, forces = np.zeros((8000, 3)), np.zeros((8000, 3))
    positions[:, 2], forces[:, 2] = -depth, 450.0 * depth
    sent, memories = run_law(positions, forces, PassivityLimits(count_m=COUNT_M, stiffness_N_per_m=450.0))
    assert memories[:, control.TOTAL_J].min() < 0.0
    assert (sent == forces).all()


def test_a_brake_never_pulls_and_lets_go_of_a_grip_that_stops():
    limits = PassivityLimits(count_m=0.0, stiffness_N_per_m=0.0)
    depth = np.concatenate([np.linspace(5.0, 0.5, 10), np.full(20, 0.5), np.linspace(0.5, -0.5, 6)]) * 1e-3
    positions, forces = np.zeros((depth.size, 3)), np.zeros((depth.size, 3))
    positions[:, 2], forces[:, 2] = -depth, 400.0 * np.maximum(depth, 0.0)
    sent, _ = run_law(positions, forces, limits)
    assert sent[:, 2].min() >= -1e-12
    correction = (sent - forces)[:, 2]
    assert correction[:11].min() < -0.1
    assert (np.diff(correction[10:30]) >= 0.0).all()
    assert (correction[forces[:, 2] == 0.0] == 0.0).all()


def test_out_of_contact_the_ledger_begins_anew():
    positions, forces = press(400.0, ticks_late=3)
    _, memories = run_law(positions, forces, PassivityLimits(on=False))
    apart = np.flatnonzero(forces[:, 2] == 0.0)
    between = apart[(apart > 100) & (apart < 900)]
    assert between.size
    assert (memories[between, control.TOUCH_J] == 0.0).all()
    assert (memories[between, control.TOTAL_J] < -1e-4).all()


@pytest.mark.parametrize(
    "wrong", [{"count_m": -1.0}, {"largest_change_N": 0.6}, {"stiffness_N_per_m": np.inf}]
)
def test_limits_that_allow_too_much_are_refused(wrong):
    with pytest.raises(ValueError, match=r"must be|is allowed"):
        PassivityLimits(**wrong)
