"""The guiding surface against brute force: penetration, normal, and no jump anywhere."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from tissueid.rendering.guidance import CONE, HYPERBOLOID, PRINTED_ONE_M, funnel_touch, hyperboloid_constants

RADIUS_M, OFFSET_M, SLOPE = 0.004, 0.006, 0.35
HYPER = np.array([HYPERBOLOID, *hyperboloid_constants(RADIUS_M, OFFSET_M, SLOPE)])
PRINTED = np.array([CONE, 0.004, 0.002, 0.012])
#: Distance between the points of a profile [m].
SPACING_M = 2e-7


def touched(funnel: np.ndarray, r: float, z: float) -> tuple[float, np.ndarray]:
    normal = np.zeros(2)
    return float(funnel_touch(funnel, 0, r, z, normal, 0)), normal


def profile(funnel: np.ndarray) -> np.ndarray:
    """Points (r, z) of the surface as the equation gives them, up to 45 mm above the entry."""
    _, a, b, c = funnel
    if int(funnel[0]) == CONE:
        z = np.arange(-PRINTED_ONE_M - b, 0.045, SPACING_M)
        return np.column_stack([a * (z + PRINTED_ONE_M + b) / c, z])
    z = np.arange(-0.03, 0.045, SPACING_M)
    radius = a * np.sqrt(1.0 + (np.maximum(z + b, 0.0) / c) ** 2)
    return np.column_stack([radius, z])


@pytest.mark.needs_jit
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
    end = -float(funnel[2]) - (PRINTED_ONE_M if int(funnel[0]) == CONE else 0.0)
    for r in (0.002, 0.0045, 0.009):
        # around the cone's apex the surfaces of equal distance meet along the normal through it
        height = end if int(funnel[0]) == HYPERBOLOID else end - r * funnel[1] / funnel[3]
        above, below = touched(funnel, r, height + 1e-9), touched(funnel, r, height - 1e-9)
        assert above[0] == pytest.approx(below[0], abs=1e-8)
        np.testing.assert_allclose(above[1], below[1], atol=1e-5)


def test_on_the_axis_there_is_a_direction() -> None:
    _, normal = touched(PRINTED, 0.0, -0.01)
    np.testing.assert_allclose(normal, [0.0, 1.0])
    depth, normal = touched(PRINTED, 0.0, -PRINTED_ONE_M - float(PRINTED[2]))
    assert depth == pytest.approx(0.0, abs=1e-12)
    assert np.linalg.norm(normal) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("numbers", "words"), [((0.0, 0.0, 0.3), "above 0"), ((0.004, 0.02, 0.35), "closes a funnel")]
)
def test_numbers_without_a_surface_are_refused(numbers: tuple[float, float, float], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        hyperboloid_constants(*numbers)
