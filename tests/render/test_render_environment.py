"""The rendered force is the fitted law's, along the normal, at the stated scale; the lamps tell the rest."""

from dataclasses import replace

import numpy as np
import pytest
from rendered_tissues import DEPTH_MM, PAPER_A, TWO_BRANCHES, pressed, walk
from tissue_stepper import TissueStepper

from tissueid.arrays import FloatArray
from tissueid.model.base import ContactPath
from tissueid.model.rupture import rupture_measures
from tissueid.rendering import environment as env
from tissueid.rendering.tissue_block import Box, Plane, Sphere, Tissue, free_air_block, tissue_block
from tissueid.rupture_law import RuptureLaw

FORCE_SCALE = 0.0125
MOTION_SCALE = 5.0
SCALES = {"force_scale": FORCE_SCALE, "motion_scale": MOTION_SCALE}
PERIOD_S = 0.001


def felt(depth: FloatArray, times: FloatArray, tissue: Tissue = PAPER_A) -> tuple[FloatArray, FloatArray]:
    """Forces and infos of a press through depths [mm] behind a plane."""
    return walk(tissue_block(tissue, Plane(), **SCALES), pressed(depth, motion=MOTION_SCALE), times)


def lit(infos: FloatArray, lamp: int) -> FloatArray:
    """True where a lamp was on, tick by tick."""
    return (infos[:, env.INFO_FLAGS].astype(int) & lamp) > 0


def test_what_is_felt_is_what_was_fitted_on_any_path_through_loss_of_contact():
    times = np.cumsum(np.random.default_rng(11).uniform(0.0005, 0.002, 1000))
    depth = 3.0 * np.sin(7.0 * times) + 1.5 * np.sin(31.0 * times)
    forces, infos = felt(depth, times, TWO_BRANCHES)
    stepper = TissueStepper(TWO_BRANCHES.model, TWO_BRANCHES.theta)
    steps = np.concatenate([[0.001], np.diff(times)])
    expected = [stepper.step(x, h) for x, h in zip(depth, steps, strict=True)]
    assert infos[:, env.INFO_TISSUE_FORCE_N] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert (forces[:, 2] >= 0.0).all()
    assert (forces[depth < 0.0] == 0.0).all()
    # the tool left the tissue behind at least once
    assert (infos[:, env.INFO_SURFACE_MM] > np.maximum(infos[:, env.INFO_DEPTH_MM], 0.0) + 0.01).any()


def test_the_force_has_the_direction_of_the_normal_of_a_tilted_plane():
    normal = np.array([1.0, 2.0, 2.0]) / 3.0
    block = tissue_block(PAPER_A, Plane((0.01, 0.0, 0.13), (1.0, 2.0, 2.0)), **SCALES)
    times = np.arange(0.0, 0.2, PERIOD_S)
    positions = np.array([0.01, 0.0, 0.13]) - np.outer(0.05 * times, normal)
    # sliding along the surface changes nothing: there is no friction
    positions[:, 0] += 0.02 * times * normal[1]
    positions[:, 1] -= 0.02 * times * normal[0]
    forces, infos = walk(block, positions, times)
    assert forces == pytest.approx(np.outer(infos[:, env.INFO_DEVICE_FORCE_N], normal), abs=1e-12)
    assert infos[-1, env.INFO_PENETRATION_M] == pytest.approx(0.05 * times[-1], rel=1e-9)


def test_a_sphere_pushes_radially_and_counts_the_tip():
    block = tissue_block(PAPER_A, Sphere((0.0, 0.0, 0.1), 0.03), **SCALES, tool_radius_m=0.002)
    direction = np.array([0.6, 0.0, 0.8])
    times = np.arange(0.0, 0.2, PERIOD_S)
    distance = 0.033 - 0.05 * times
    forces, infos = walk(block, np.array([0.0, 0.0, 0.1]) + np.outer(distance, direction), times)
    assert infos[:, env.INFO_PENETRATION_M] == pytest.approx(0.032 - distance, abs=1e-12)
    touched = infos[:, env.INFO_PENETRATION_M] > 0.0
    assert (forces[~touched] == 0.0).all()
    expected = np.outer(infos[touched, env.INFO_DEVICE_FORCE_N], direction)
    assert forces[touched] == pytest.approx(expected, abs=1e-12)


def test_a_box_keeps_the_face_the_tip_came_in_by():
    block = tissue_block(PAPER_A, Box((0.0, 0.0, 0.1), (0.03, 0.03, 0.01)), **SCALES)
    times = np.arange(0.0, 0.5, PERIOD_S)
    positions = np.zeros((len(times), 3))
    # straight through the thin side: past the middle the nearest face is the opposite one
    positions[:, 2] = 0.112 - 0.036 * times
    forces, infos = walk(block, positions, times)
    inside = (positions[:, 2] < 0.11) & (positions[:, 2] > 0.0941)
    assert (forces[inside, 2] > 0.0).all()
    assert infos[inside, env.INFO_PENETRATION_M] == pytest.approx(0.11 - positions[inside, 2], abs=1e-12)


def test_an_edge_of_a_box_is_rounded_by_the_tip():
    block = tissue_block(PAPER_A, Box((0.0, 0.0, 0.1), (0.03, 0.03, 0.01)), **SCALES, tool_radius_m=0.004)
    # 3 mm beside and 1 mm above the edge: sqrt(10) mm away, the tip reaches 4 mm
    position = np.array([[0.033, 0.0, 0.111], [0.033, 0.0, 0.111]])
    forces, infos = walk(block, position, np.array([0.0, 0.001]))
    expected = 0.004 - np.hypot(0.003, 0.001)
    assert infos[-1, env.INFO_PENETRATION_M] == pytest.approx(expected, abs=1e-12)
    assert forces[-1, 0] / forces[-1, 2] == pytest.approx(3.0, rel=1e-9)


def test_the_centre_of_a_sphere_has_a_direction():
    block = tissue_block(PAPER_A, Sphere((0.0, 0.0, 0.1), 0.02), **SCALES)
    forces, _ = walk(block, np.array([[0.0, 0.0, 0.1]] * 2), np.array([0.0, 0.001]))
    assert np.isfinite(forces).all()
    assert forces[-1, 2] > 0.0


def test_free_air_has_no_force_and_says_its_label():
    times = np.arange(0.0, 0.05, PERIOD_S)
    forces, infos = walk(free_air_block(label=3), pressed(100.0 * times, motion=1.0), times)
    assert (forces == 0.0).all()
    assert (infos[:, env.INFO_LABEL] == 3.0).all()
    assert (infos[:, env.INFO_FLAGS] == 0.0).all()


def test_lamps_tell_when_the_law_is_continued():
    fastest = PAPER_A.speeds_mm_s[1]
    times = np.arange(0.0, 3.0, PERIOD_S)
    slow = np.minimum(0.5 * fastest * times, 9.0)
    _, infos = felt(slow, times)
    assert lit(infos, env.OUTSIDE_DEPTH).tolist() == (slow > DEPTH_MM * 1.01).tolist()
    assert not lit(infos, env.OUTSIDE_SPEED).any()
    _, infos = felt(2.0 * fastest * times[:400], times[:400])
    # the lamp waits for the speed's filter, 50 ms, then stays
    assert not lit(infos, env.OUTSIDE_SPEED)[:20].any()
    assert lit(infos, env.OUTSIDE_SPEED)[100:].all()
    # within the margin of rounding and ripple it stays dark
    assert not lit(felt(1.03 * fastest * times[:400], times[:400])[1], env.OUTSIDE_SPEED).any()


def test_beyond_the_identified_depth_the_force_grows_with_its_end_slope():
    times = np.arange(0.0, 20.0, 0.01)
    _, infos = felt(np.minimum(times, 10.0), times)
    a1, a2, a3 = PAPER_A.theta[:3]
    end = a1 * 8.0 + a2 * 64.0 + a3 * 512.0
    slope = a1 + 2.0 * a2 * 8.0 + 3.0 * a3 * 64.0
    assert infos[-1, env.INFO_TISSUE_FORCE_N] == pytest.approx(end + 2.0 * slope, rel=1e-9)


RESIDUAL = 0.25


def breaking(criterion: str, threshold: float, weight: float = 1.5) -> Tissue:
    law = RuptureLaw(criterion, threshold, weight, 0.1, 0.15, threshold, (threshold, threshold), RESIDUAL)
    return replace(PAPER_A, rupture=law)


@pytest.mark.parametrize(
    ("criterion", "threshold"),
    [("work", 80.0), ("weighted-force", 60.0), ("stored-energy", 40.0), ("depth", 2.501)],
)
def test_a_rupture_leaves_a_share_of_the_force_until_the_tissue_is_put_at_rest(criterion, threshold):
    times = np.arange(0.0, 2.0, PERIOD_S)
    depth = 4.0 * np.minimum(times, 1.0)
    whole, never = felt(depth, times)
    assert not lit(never, env.RUPTURED).any()
    broken, infos = felt(depth, times, breaking(criterion, threshold))
    # the same measures, worked out for the whole path in numpy
    measures = rupture_measures(PAPER_A.model, PAPER_A.theta, ContactPath(times, depth), weight=1.5)
    expected = int(np.argmax(measures[criterion] >= threshold))
    assert expected > 0
    assert (broken[:expected] == whole[:expected]).all()
    assert broken[expected:, 2] == pytest.approx(RESIDUAL * whole[expected:, 2], rel=1e-12)
    assert lit(infos, env.RUPTURED)[expected:].all()


@pytest.mark.parametrize("criterion", ["weighted-force", "stored-energy"])
def test_a_tool_in_air_breaks_nothing_however_low_the_threshold(criterion):
    times = np.arange(0.0, 0.1, PERIOD_S)
    _, infos = felt(np.full(times.size, -1.0), times, breaking(criterion, 1e-12))
    assert not lit(infos, env.RUPTURED).any()


def test_a_rupture_beyond_the_identified_depth_counts_the_energy_of_the_continued_law():
    times = np.arange(0.0, 100.0, 0.02)
    depth = np.minimum(0.1 * times, 10.0)
    a1, a2, a3 = PAPER_A.theta[:3]
    at_end = a1 * 8.0 + a2 * 64.0 + a3 * 512.0
    slope = a1 + 2.0 * a2 * 8.0 + 3.0 * a3 * 64.0
    inside = a1 * 32.0 + a2 * 512.0 / 3.0 + a3 * 1024.0
    # 1 mm beyond, so slowly that the branch holds next to nothing
    threshold = inside + at_end + 0.5 * slope
    _, infos = felt(depth, times, breaking("stored-energy", threshold))
    assert depth[int(np.argmax(lit(infos, env.RUPTURED)))] == pytest.approx(9.0, abs=3e-3)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: tissue_block(PAPER_A, Plane(), force_scale=0.0, motion_scale=1.0),
        lambda: tissue_block(PAPER_A, Plane(), force_scale=1.0, motion_scale=float("nan")),
        lambda: tissue_block(replace(PAPER_A, theta=-PAPER_A.theta), Plane(), **SCALES),
        lambda: Plane((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        lambda: Sphere((0.0, 0.0, 0.0), 0.0),
        lambda: Box((0.0, 0.0, 0.0), (1.0, -1.0, 1.0)),
    ],
)
def test_what_is_no_tissue_or_surface_never_becomes_a_block(wrong):
    with pytest.raises(ValueError, match=r"above 0|not passive|direction"):
        wrong()
