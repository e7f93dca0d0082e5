"""Hands and scripts: where they move the arm, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.errors import UsageError
from tissueid.haptics import arm as a
from tissueid.haptics.arm import Arm, arm_step, new_arm
from tissueid.haptics.hand import PRESETS, Hand, parse_script, preset, scripted_hand

SURFACE = np.array([0.01, -0.02, 0.13])
INWARD = np.array([0.0, 0.0, -1.0])
STILL = np.zeros(3)


def test_a_script_moves_the_grip_in_tissue_units_whatever_the_force():
    hand = scripted_hand(
        "indent 8 mm at 250 mm/min; hold 0.1 s; retract to 3 mm at 10 mm/s",
        motion_scale=5.0,
        surface_m=SURFACE,
        inward=INWARD,
        rest_s=0.2,
    )
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
    losses = memory[a.DAMPING_LOSS] + memory[a.FRICTION_LOSS]
    kinetic = 0.5 * Arm().mass_kg * (memory[a.VELOCITY : a.VELOCITY + 3] ** 2).sum()
    assert memory[a.HAND_WORK] + memory[a.MOTOR_WORK] - losses == pytest.approx(kinetic, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "strokes"),
    [
        ("indent 8 mm at 250 mm/min; hold 2 s", [("indent", 8.0), ("hold", 8.0)]),
        (
            " indent 2mm at 1 mm/s;;hold .5s; indent 4 mm at 60mm/min ;",
            [("indent", 2.0), ("hold", 2.0), ("indent", 4.0)],
        ),
        (
            "hold 1 s; indent 1.5 mm at 5 mm/s; retract at 5 mm/s",
            [("hold", -0.5), ("indent", 1.5), ("retract", -0.5)],
        ),
    ],
)
def test_scripts_are_read(text, strokes):
    assert [(stroke.kind, stroke.depth_mm) for stroke in parse_script(text)] == strokes


@pytest.mark.parametrize(
    ("text", "reason"),
    [
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
def test_scripts_that_make_no_sense_are_refused(text, reason):
    with pytest.raises(UsageError, match=reason) as caught:
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
    memory, block = new_arm(hand.start_m), hand.write(Arm().block())
    seen = []
    for _ in range(500):
        arm_step(memory, block, STILL, 1e-3)
        seen.append(memory[a.POSITION + 2] - 0.1)
    time = 1e-3 * np.arange(1, 501)
    expected = 3e-4 * np.minimum(time / a.TREMOR_RISE_S, 1.0) * np.sin(2.0 * np.pi * 8.0 * time + 0.4)
    np.testing.assert_allclose(seen, expected, atol=1e-12)


def test_a_released_grip_flies_free():
    hand = Hand((0.0, 0.05), ((0.0, 0.0, 0.1),) * 2, (1.0, 0.0), stiffness_N_per_m=500.0)
    memory, block = new_arm(hand.start_m), hand.write(Arm(damping_N_s_per_m=0.0, friction_N=0.0).block())
    for _ in range(50):
        arm_step(memory, block, STILL, 1e-3)
    start = memory[a.POSITION + 2]
    for _ in range(100):
        arm_step(memory, block, np.array([0.0, 0.0, 1.0]), 1e-3)
    assert memory[a.POSITION + 2] - start == pytest.approx(0.5 * 1.0 / 0.25 * 0.1**2, rel=1e-9)


@pytest.mark.parametrize(
    ("times", "reason"), [((0.0, 0.0), "must rise"), ((0.0, float("nan")), "finite"), ((), "1 to 64 knots")]
)
def test_impossible_hands_are_refused(times, reason):
    with pytest.raises(ValueError, match=reason):
        Hand(times, ((0.0, 0.0, 0.1),) * len(times), (1.0,) * len(times))


def test_an_unknown_hand_is_named_with_those_there_are():
    with pytest.raises(UsageError, match="hands are step, slow press"):
        preset("punch", surface_m=SURFACE, inward=INWARD, depth_m=0.01)
