"""Guidance to an axis: its surface by brute force, a continuous reference, closed paths, the bone."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial import KDTree

from tissueid.rendering import environment as env
from tissueid.rendering import guidance as gd
from tissueid.rendering.guidance_block import Bone, Funnel, Guidance, Pull, guidance_block
from tissueid.rendering.plan import _told_of

#: A funnel nothing here comes near to.
WIDE = Funnel(radius_m=0.5, offset_m=0.0, slope=0.01)
NO_BONE = Bone(radius_m=0.0)
PULL = Guidance((0.0, 0.0, 0.0), funnel=WIDE, bone=NO_BONE, pull=Pull(100.0, 500.0, 0.02))
TISSUE_DT = 1e-3


class Guided:
    """A running copy of the environment."""

    def __init__(self, plan: Guidance) -> None:
        self.block, self.memory = plan.numbers(), np.zeros(gd.GUIDANCE_MEMORY)
        self.said = np.zeros(gd.SAID_SIZE)

    def step(self, position: np.ndarray, dt: float) -> np.ndarray:
        force, place = np.zeros(3), np.asarray(position, dtype=float)
        gd.guidance_step(self.block, 0, self.memory, place, dt, force, self.said, 0)
        return force


def energy_of_loop(plan: Guidance, loop: np.ndarray) -> float:
    """Work the environment does on the hand over a closed path [J], by Simpson's rule a piece."""
    # without the term in the velocity
    guided = Guided(replace(plan, pull=replace(plan.pull, tau_s=0.0)))
    forces = np.array([guided.step(point, 0.0) for point in loop])
    middle = np.array([guided.step(point, 0.0) for point in 0.5 * (loop[1:] + loop[:-1])])
    mean = (forces[1:] + forces[:-1] + 4.0 * middle) / 6.0
    return float((mean * np.diff(loop, axis=0)).sum())


def square_loop(radius: float, height: float, n: int = 400) -> np.ndarray:
    """Out at a height, down, in, up."""
    corners = np.array([[0, 0, height], [radius, 0, height], [radius, 0, 0], [0, 0, 0], [0, 0, height]])
    return np.concatenate([np.linspace(a, b, n) for a, b in itertools.pairwise(corners)])


def test_the_stiffness_rises_as_the_height_falls_and_ends_flat() -> None:
    block = PULL.numbers()
    heights = np.array([0.2, 0.05, 0.03, 0.01, 0.0, -0.02])
    found = [gd.axial_stiffness(block, 0, z, False) for z in heights]
    assert found[0] == pytest.approx(100.0, abs=1e-6)
    assert found[-2:] == [500.0, 500.0]
    assert (np.diff(found[:-1]) > 0.0).all()
    for z in (0.05, 0.01, 1e-4):
        above, below = (gd.axial_stiffness(block, 0, z + step, False) for step in (1e-7, -1e-7))
        assert gd.axial_stiffness(block, 0, z, True) == pytest.approx((above - below) / 2e-7, rel=1e-5)
    assert gd.axial_stiffness(block, 0, 1e-9, True) == pytest.approx(0.0, abs=1e-2)


def test_no_closed_path_gives_energy_but_in_the_paper_s_variant() -> None:
    rng = np.random.default_rng(7)
    waves = rng.normal(0.0, 0.01, (3, 3)), rng.normal(0.0, 0.01, (3, 3))
    angle = np.linspace(0.0, 2.0 * math.pi, 1500)[:, None]
    order = np.arange(1, 4)
    tangle = np.sin(angle * order) @ waves[0] + np.cos(angle * order) @ waves[1] + [0.0, 0.0, 0.02]
    for loop in (square_loop(0.02, 0.05), tangle):
        assert abs(energy_of_loop(PULL, loop)) <= 1e-6
    printed = replace(PULL, pull=replace(PULL.pull, conservative=False))
    # out against K(50 mm), in along K(0): the difference of two springs
    block = PULL.numbers()
    expected = 0.5 * (500.0 - gd.axial_stiffness(block, 0, 0.05, False)) * 0.02**2
    assert energy_of_loop(printed, square_loop(0.02, 0.05)) == pytest.approx(expected, rel=1e-6)
    assert expected > 0.07


@pytest.mark.needs_jit
def test_wall_and_pull_together_are_conservative_without_damping() -> None:
    narrow = replace(PULL, funnel=Funnel(restitution=1.0))
    assert abs(energy_of_loop(narrow, square_loop(0.012, 0.02, 3000))) <= 1e-6


def test_the_force_is_that_of_a_continuous_reference_with_the_same_filter() -> None:
    pull = PULL.pull

    def place(t: float) -> np.ndarray:
        return np.array(
            [0.012 * math.sin(5.0 * t), 0.007 * math.cos(8.0 * t) - 0.007, 0.03 - 0.015 * math.sin(3.0 * t)]
        )

    def filtered(t: float, rate: np.ndarray) -> np.ndarray:
        speed = np.array([0.06 * math.cos(5.0 * t), -0.056 * math.sin(8.0 * t)])
        return (speed - rate) / pull.filter_s

    times = np.arange(0.0, 2.0, TISSUE_DT)
    # the tip rests before it moves
    rate = solve_ivp(filtered, (0.0, 2.0), np.zeros(2), t_eval=times, rtol=1e-9, atol=1e-12).y
    guided = Guided(PULL)
    guided.step(place(0.0), 0.0)
    worst, peak = 0.0, 0.0
    for k in range(1, times.size):
        force = guided.step(place(times[k]), TISSUE_DT)
        *beside, z = place(times[k])
        share = math.exp(-0.5 * (z / pull.reach_m) ** 2)
        lateral = -(100.0 + 400.0 * share) * (beside + pull.tau_s * rate[:, k])
        axial = 0.5 * 400.0 * share * z / pull.reach_m**2 * np.dot(beside, beside)
        expected = np.append(lateral, axial)
        worst = max(worst, float(np.abs(force - expected).max()))
        peak = max(peak, float(np.abs(expected).max()))
    assert worst <= 0.005 * peak


def test_an_axis_anywhere_is_the_same_environment_turned() -> None:
    rng = np.random.default_rng(3)
    axis = np.array([0.3, -0.5, 0.8])
    axis /= np.linalg.norm(axis)
    # a rotation that takes z to the axis
    turn = np.column_stack([np.cross([0.0, 1.0, 0.0], axis), np.zeros(3), axis])
    turn[:, 0] /= np.linalg.norm(turn[:, 0])
    turn[:, 1] = np.cross(axis, turn[:, 0])
    entry = np.array([0.01, -0.02, 0.13])
    plain = Guided(Guidance((0.0, 0.0, 0.0)))
    turned = Guided(Guidance(tuple(entry), tuple(axis)))
    path = np.array([0.005, 0.0, 0.004]) + np.cumsum(rng.normal(0.0, 4e-4, (300, 3)), axis=0)
    for point in path:
        expected = turn @ plain.step(point, TISSUE_DT)
        np.testing.assert_allclose(turned.step(entry + turn @ point, TISSUE_DT), expected, atol=1e-9)


def test_the_weight_is_carried_everywhere() -> None:
    weight = {"weight_N": (0.0, 0.0, 1.2), "weight_slope_N_per_m": ((0.0,) * 3, (0.0,) * 3, (0.0, 0.0, -4.0))}
    plan = replace(PULL, pull=Pull(0.0, 0.0, 0.02), **weight)
    np.testing.assert_allclose(Guided(plan).step(np.array([0.0, 0.0, 0.05]), 0.0), [0.0, 0.0, 1.0])


BONE = Bone(0.024, 800.0, 0.003, 400.0, 0.02)
DRILLED = Guidance((0.0, 0.0, 0.0), pull=Pull(0.0, 0.0, 0.02), bone=BONE)


def test_drilling_is_a_spring_on_a_dashpot_until_the_wire_is_through() -> None:
    guided, speed, dt = Guided(DRILLED), 0.01, 0.7e-3
    lag = BONE.resistance_N_s_per_m / BONE.stiffness_N_per_m
    through = None
    for k in range(4000):
        time = k * dt
        force = guided.step(np.array([0.0, 0.0, 0.001 - speed * time]), dt)
        pressed = max(time - 0.1, 0.0)
        # the front lags behind a tip that moves at constant speed: closed form
        front = speed * (pressed - lag * (1.0 - math.exp(-pressed / lag)))
        if front < BONE.drill_depth_m:
            expected = BONE.resistance_N_s_per_m * speed * (1.0 - math.exp(-pressed / lag))
            assert force[2] == pytest.approx(expected, abs=1e-9)
        else:
            through = through or time
            assert force[2] == 0.0
    assert through is not None
    # a second way down the drilled hole is free
    for z in np.linspace(0.01, -0.015, 200):
        assert guided.step(np.array([0.0, 0.0, z]), dt)[2] == 0.0


def test_the_hole_holds_the_tip_sideways_and_the_ball_pushes_it_off() -> None:
    guided = Guided(replace(DRILLED, funnel=WIDE))
    for z in np.linspace(0.002, -0.01, 600):
        guided.step(np.array([0.0, 0.0, z]), 5e-3)
    aside = guided.step(np.array([0.0035, 0.0, -0.01]), 1e-9)
    assert aside[0] == pytest.approx(-BONE.stiffness_N_per_m * 0.0005)
    # beside the hole the ball is met from above
    guided = Guided(replace(DRILLED, funnel=WIDE))
    for z in np.linspace(0.002, -0.003, 50):
        force = guided.step(np.array([0.006, 0.0, z]), 5e-3)
    distance = math.hypot(0.006, 0.024 - 0.003)
    expected = BONE.stiffness_N_per_m * (0.024 - distance)
    np.testing.assert_allclose(force, expected * np.array([0.006, 0.0, 0.021]) / distance, rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"axis": (0.0, 0.0, 0.0)}, "direction"),
        ({"pull": Pull(500.0, 100.0, 0.02)}, "rise toward the entry"),
        ({"pull": Pull(tau_s=-0.1)}, "negative"),
        ({"bone": Bone(hole_radius_m=0.05)}, "narrower"),
        ({"entry_m": (math.nan, 0.0, 0.0)}, "finite"),
        ({"funnel": Funnel(kind="cone", slope=0.0)}, "cone"),
        ({"funnel": Funnel(radius_m=0.0)}, "above 0"),
        ({"funnel": Funnel(offset_m=0.02)}, "closes a funnel"),
    ],
)
def test_numbers_that_guide_nowhere_are_refused(change: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replace(PULL, **change)


def test_the_environment_is_the_guidance_where_its_block_is_one() -> None:
    plan = Guidance((0.0, 0.0, 0.13))
    assert plan.numbers().shape == (gd.GUIDANCE_SIZE,)
    block, memory = guidance_block(plan, label=3), np.zeros(env.MEMORY_SIZE)
    alone, force, info = Guided(plan), np.zeros(3), np.zeros(env.INFO_SIZE)
    rng = np.random.default_rng(5)
    for point in np.array([0.004, 0.0, 0.134]) + np.cumsum(rng.normal(0.0, 2e-4, (200, 3)), axis=0):
        env.environment_step(block, memory, point, np.zeros(3), TISSUE_DT, force, info)
        np.testing.assert_array_equal(force, alone.step(point, TISSUE_DT))
        assert info[env.INFO_DEPTH_MM] == pytest.approx(1e3 * (0.13 - point[2]))
        assert info[env.INFO_LABEL] == 3
        assert info[env.INFO_PENETRATION_M] == alone.said[gd.SAID_PENETRATION_M]
    assert env.MEMORY_SIZE >= gd.GUIDANCE_MEMORY + gd.SAID_SIZE


def test_a_pull_is_no_contact_and_wall_and_bone_are() -> None:
    guided = Guided(Guidance((0.0, 0.0, 0.0)))
    places = [(0.001, 0.0, 0.01), (0.012, 0.0, 0.0), (0.001, 0.0, -0.002)]
    found = []
    for place in places:
        guided.step(np.array(place), TISSUE_DT)
        found.append(guided.said[gd.SAID_PENETRATION_M])
    assert found[0] < 0.0
    assert found[1] > 0.0
    assert found[2] == pytest.approx(0.002)


RADIUS_M, OFFSET_M, SLOPE = 0.004, 0.006, 0.35
HYPER = np.array([gd.HYPERBOLOID, *gd.hyperboloid_constants(RADIUS_M, OFFSET_M, SLOPE)])
PRINTED = np.array([gd.CONE, 0.004, 0.002, 0.012])
#: Distance between the points of a profile [m].
SPACING_M = 2e-7


def touched(funnel: np.ndarray, r: float, z: float) -> tuple[float, np.ndarray]:
    normal = np.zeros(2)
    return float(gd.funnel_touch(funnel, 0, r, z, normal, 0)), normal


def profile(funnel: np.ndarray) -> np.ndarray:
    """Points (r, z) of the surface as the equation gives them, up to 45 mm above the entry."""
    _, a, b, c = funnel
    if int(funnel[0]) == gd.CONE:
        z = np.arange(-gd.PRINTED_ONE_M - b, 0.045, SPACING_M)
        return np.column_stack([a * (z + gd.PRINTED_ONE_M + b) / c, z])
    z = np.arange(-0.03, 0.045, SPACING_M)
    radius = a * np.sqrt(1.0 + (np.maximum(z + b, 0.0) / c) ** 2)
    return np.column_stack([radius, z])


@pytest.mark.needs_jit
@pytest.mark.parametrize(("kind", "said"), [("hyperboloid", "4 mm"), ("cone", "2.45 mm")])
def test_the_radius_that_is_told_is_that_of_the_surface_at_the_entry(kind, said):
    # a cone's is slope x (offset + the printed 1 mm): 0.35 x 7 mm
    wall = _told_of(Guidance((0.0, 0.0, 0.0), funnel=Funnel(kind=kind)))[1]
    assert f"{kind}, {said} in radius at the entry" in wall


@pytest.mark.parametrize("funnel", [HYPER, PRINTED], ids=["hyperboloid", "cone"])
def test_penetration_and_normal_are_those_of_the_nearest_point(funnel: np.ndarray) -> None:
    points = profile(funnel)
    rng = np.random.default_rng(20)
    z = rng.uniform(-0.02, 0.02, 400)
    surface = np.interp(z, points[:, 1], points[:, 0], left=0.0)
    r = surface + rng.uniform(0.0, 0.008, z.size)
    distance, nearest = KDTree(points).query(np.column_stack([r, z]))
    for k in range(z.size):
        depth, normal = touched(funnel, r[k], z[k])
        assert depth == pytest.approx(distance[k], abs=1e-6)
        # the direction to a point among others a fifth of a micrometre apart
        if distance[k] > 5e-4:
            np.testing.assert_allclose(normal, (points[nearest[k]] - (r[k], z[k])) / distance[k], atol=1e-3)


def test_the_radius_at_the_entry_is_the_one_that_was_asked_for() -> None:
    depth, _ = touched(HYPER, RADIUS_M, 0.0)
    assert depth == pytest.approx(0.0, abs=1e-15)
    # the throat: radius a at -b, and the cylinder below it
    a = float(HYPER[1])
    assert touched(HYPER, a, -OFFSET_M)[0] == pytest.approx(0.0, abs=1e-15)
    assert touched(HYPER, a + 1e-3, -0.05)[0] == pytest.approx(1e-3)
    # far out the radius grows by the slope
    far = a * np.sqrt(1.0 + ((100.0 + OFFSET_M) / HYPER[3]) ** 2)
    assert far / 100.0 == pytest.approx(SLOPE, rel=1e-3)


def test_inside_nothing_is_touched_and_the_gap_is_right_near_the_wall() -> None:
    points = profile(HYPER)
    for z, gap in [(0.01, 1e-4), (0.0, 2e-4), (-0.01, 5e-4)]:
        surface = float(np.interp(z, points[:, 1], points[:, 0]))
        slope = (np.interp(z + 1e-6, points[:, 1], points[:, 0]) - surface) / 1e-6
        depth, _ = touched(HYPER, surface - gap, z)
        assert depth == pytest.approx(-gap / np.hypot(1.0, max(slope, 0.0)), rel=0.02)
    assert touched(HYPER, 0.0, 0.02)[0] < 0.0


@pytest.mark.parametrize("funnel", [HYPER, PRINTED], ids=["hyperboloid", "cone"])
def test_nothing_jumps_at_throat_or_apex(funnel: np.ndarray) -> None:
    end = -float(funnel[2]) - (gd.PRINTED_ONE_M if int(funnel[0]) == gd.CONE else 0.0)
    for r in (0.002, 0.0045, 0.009):
        # around the cone's apex the surfaces of equal distance meet along the normal through it
        height = end if int(funnel[0]) == gd.HYPERBOLOID else end - r * funnel[1] / funnel[3]
        above, below = touched(funnel, r, height + 1e-9), touched(funnel, r, height - 1e-9)
        assert above[0] == pytest.approx(below[0], abs=1e-8)
        np.testing.assert_allclose(above[1], below[1], atol=1e-5)


def test_on_the_axis_there_is_a_direction() -> None:
    _, normal = touched(PRINTED, 0.0, -0.01)
    np.testing.assert_allclose(normal, [0.0, 1.0])
    depth, normal = touched(PRINTED, 0.0, -gd.PRINTED_ONE_M - float(PRINTED[2]))
    assert depth == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(normal) == pytest.approx(1.0)
