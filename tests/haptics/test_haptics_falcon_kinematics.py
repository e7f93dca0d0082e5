"""Kinematics of the Falcon against itself, finite differences, another formula and recorded signs."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError
from tissueid.haptics.falcon import kinematics
from tissueid.haptics.falcon.kinematics import DEFAULT_GEOMETRY, forward, inverse, motor_units, torque

#: Counts of the legs' stops.
STOP = 1600
MIDDLE = np.array([0.0, 0.0, 0.130])
both = pytest.mark.parametrize("geometry", kinematics.GEOMETRIES.values(), ids=list(kinematics.GEOMETRIES))


def stops(geometry: kinematics.Geometry) -> tuple[float, float]:
    zero = math.radians(geometry.zero_angle_deg)
    return zero - STOP * geometry.radians_per_count, zero + STOP * geometry.radians_per_count


def reachable(geometry: kinematics.Geometry, count: int, seed: int) -> FloatArray:
    """Positions from everywhere within the stops, shape (count, 3)."""
    random = np.random.default_rng(seed)
    (low, high), block, angles = stops(geometry), geometry.block(), np.empty(3)
    found: list[FloatArray] = []
    while len(found) < count:
        position = random.uniform((-0.11, -0.11, 0.04), (0.11, 0.11, 0.19))
        if kinematics.inverse_kernel(position, block, angles) and angles.min() > low and angles.max() < high:
            found.append(position)
    return np.array(found)


def working_sphere(count: int, seed: int) -> FloatArray:
    """Positions within 47 mm of the middle: the largest sphere that is reached."""
    random = np.random.default_rng(seed)
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return np.asarray(MIDDLE + 0.047 * random.uniform(size=(count, 1)) ** (1 / 3) * direction)


def jacobian(position: FloatArray, geometry: kinematics.Geometry = DEFAULT_GEOMETRY) -> FloatArray:
    """``dp/dtheta`` (row: coordinate; column: leg) [m/rad]: torques of one newton along each axis."""
    return np.array([torque(position, push, geometry=geometry) for push in np.eye(3)])


@pytest.mark.needs_jit
@both
def test_inverse_of_forward_is_the_identity_everywhere_within_the_stops(geometry):
    none = 0
    for angles in np.random.default_rng(2).uniform(*stops(geometry), (4000, 3)):
        try:
            position = forward(angles, geometry=geometry)
        except kinematics.WorkspaceError:
            none += 1
        else:
            assert np.abs(inverse(position, geometry=geometry) - angles).max() < 1e-9
    # every triple of angles within the stops has a grip position; of the second geometry a few near +90
    # degrees are stretched
    assert none <= (0 if geometry is DEFAULT_GEOMETRY else 0.005 * 4000)


@pytest.mark.needs_jit
def test_forward_of_inverse_is_the_identity_from_any_guess():
    random = np.random.default_rng(3)
    positions = reachable(DEFAULT_GEOMETRY, 2000, seed=4)
    for position in positions:
        angles = inverse(position)
        near = position + random.normal(scale=1e-3, size=3)
        # a wild guess may not lead astray
        far = positions[random.integers(len(positions))]
        for guess in (None, near, far):
            assert np.abs(forward(angles, guess) - position).max() < 1e-9


@both
def test_tracking_takes_three_steps_and_a_cold_start_seven(geometry):
    block = geometry.block()
    cold, warm = [], []
    for position in working_sphere(500, seed=5):
        angles = inverse(position, geometry=geometry)
        cold.append(kinematics.forward_kernel(angles, block, np.array([0.0, 0.0, 0.12])))
        warm.append(kinematics.forward_kernel(angles, block, position + 3e-4))
    # the last of them is rounding
    assert max(cold) <= 9
    assert np.median(warm) <= 3
    assert min(cold + warm) >= 0


@both
def test_work_at_the_legs_is_work_at_the_grip(geometry):
    random = np.random.default_rng(8)
    for position in working_sphere(300, seed=9):
        force, shift = random.normal(size=3), 1e-7 * random.normal(size=3)
        turned = inverse(position + shift, geometry=geometry) - inverse(position - shift, geometry=geometry)
        at_legs = torque(position, force, geometry=geometry) @ turned / 2.0
        # work of 1e-7 J, differences to 1e-16 rad
        assert at_legs == pytest.approx(force @ shift, abs=1e-15)


def test_whole_sphere_of_47_mm_is_reached_and_forces_of_8_9_N():
    # the sphere about (0, 0, 0.130), and the vendor's "> 8.9 N" with 6616 units per N m
    assert all(np.isfinite(jacobian(position)).all() for position in working_sphere(500, seed=10))
    weakest = (4095 / 6616) / np.linalg.norm(jacobian(MIDDLE), axis=0).max()
    assert weakest == pytest.approx(8.9, abs=0.05)


def test_one_count_is_38_to_48_micrometres_and_is_an_angle_from_the_zero_angle():
    assert np.degrees(inverse(MIDDLE)) == pytest.approx([31.1] * 3, abs=1.0)
    per_count = DEFAULT_GEOMETRY.radians_per_count
    assert math.degrees(per_count) == pytest.approx(0.0364347, abs=1e-7)
    along_z = [1e6 * per_count * jacobian([0.0, 0.0, z])[2].sum() for z in (0.09, 0.13, 0.16)]
    assert all(35.0 < size < 55.0 for size in along_z)
    out = np.empty(3)
    at_40 = replace(DEFAULT_GEOMETRY, zero_angle_deg=40.0).block()
    kinematics.angles_of_counts(np.array([0, 1000, -1000]), at_40, out)
    assert np.degrees(out) == pytest.approx([40.0, 40.0 + 36.4347, 40.0 - 36.4347], abs=1e-4)


@pytest.mark.parametrize("position", [(0.0, 0.0, 0.30), (0.2, 0.0, 0.13), (0.0, 0.5, 0.1), (0.0,) * 3])
def test_positions_out_of_reach_are_errors(position):
    with pytest.raises(kinematics.WorkspaceError, match="outside the workspace"):
        inverse(position)
    for kind in (DeviceError, ValueError):
        with pytest.raises(kind, match="no Jacobian"):
            torque(position, (0.0, 0.0, 1.0))


def test_angles_that_no_position_has_in_front_of_the_base_are_errors():
    behind = inverse((0.0, 0.0, -0.13))
    for angles in ((3.0, 0.0, 0.0), (-1.5, 1.6, 1.6), (2.5, 2.5, 2.5), (7.0, 0.6, 0.6), behind):
        with pytest.raises(kinematics.WorkspaceError, match="no grip position"):
            forward(angles)


@pytest.mark.parametrize(
    "wrong", [(0.0, 0.0), (0.0, 0.0, math.nan), (0.0, 0.0, math.inf), ((0.0, 0.0, 0.1),)]
)
def test_what_is_no_vector_is_refused(wrong):
    for function in (inverse, forward, lambda one: torque(one, MIDDLE), lambda one: torque(MIDDLE, one)):
        with pytest.raises(ValueError, match="three finite numbers"):
            function(wrong)


def units(force: FloatArray, clamp: float, position: FloatArray = MIDDLE) -> tuple[NDArray[np.int64], bool]:
    out = np.zeros(3, np.int64)
    return out, motor_units(force, position, DEFAULT_GEOMETRY.block(), 6600.0, clamp, out, np.zeros(3))


def test_motor_signs_are_those_of_a_recorded_driver():
    # recorded for 10 N to the right, at an unknown place: (-679, 2529, -1862)
    sideways, _ = units(np.array([10.0, 0.0, 0.0]), 4095.0)
    assert np.sign(sideways).tolist() == [-1, 1, -1]
    assert (sideways / sideways[1])[[0, 2]] == pytest.approx([-679 / 2529, -1862 / 2529], abs=0.05)
    # and -100 N along z saturated all three, positive
    inward, clipped = units(np.array([0.0, 0.0, -100.0]), 4095.0)
    assert clipped
    assert inward.min() > 3900 / np.sqrt(3.0)


def test_motor_values_are_the_torques_and_clipping_keeps_their_direction_within_the_clamp():
    random = np.random.default_rng(11)
    for position in working_sphere(200, seed=12):
        force = 40.0 * random.normal(size=3)
        clamp = float(random.integers(500, 4096))
        found, clipped = units(force, clamp, position)
        wanted = -6600.0 * torque(position, force)
        size = np.linalg.norm(wanted)
        assert clipped == (size > clamp)
        # rounded to whole motor units, or each cut to one
        assert found == pytest.approx(wanted * min(clamp / size, 1.0), abs=1.001 if clipped else 0.5)
        if clipped:
            assert clamp - 2.0 < np.linalg.norm(found) <= clamp


def test_the_mean_of_motor_values_is_the_torque_and_no_force_is_zero_at_once():
    random, out, left = np.random.default_rng(13), np.zeros(3, np.int64), np.zeros(3)
    geometry = DEFAULT_GEOMETRY.block()
    for position in working_sphere(20, seed=14):
        force = random.normal(size=3)
        wanted, sent = -6600.0 * torque(position, force), []
        for _ in range(400):
            assert not motor_units(force, position, geometry, 6600.0, 4095.0, out, left)
            assert out == pytest.approx(wanted, abs=1.0)
            sent.append(out.copy())
        assert np.mean(sent, axis=0) == pytest.approx(wanted, abs=1.0 / 400.0)
        # what rounding left never exceeds the clamp
        clamp = float(np.linalg.norm(wanted)) + 0.01
        for _ in range(400):
            assert not motor_units(force, position, geometry, 6600.0, clamp, out, left)
            assert np.linalg.norm(out) <= clamp
        assert not motor_units(np.zeros(3), position, geometry, 6600.0, 4095.0, out, left)
        assert (out.tolist(), left.tolist()) == ([0, 0, 0], [0.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("force", "position"),
    [
        ([math.nan, 0.0, 0.0], MIDDLE),
        ([0.0, math.inf, 0.0], MIDDLE),
        ([1.0, 0.0, 0.0], np.array([0.0, 0.0, 0.4])),
        ([1.0, 0.0, 0.0], np.array([0.0, math.nan, 0.13])),
    ],
)
def test_what_has_no_torque_sends_zero(force, position):
    found, clipped = units(np.array(force), 4095.0, position)
    assert clipped
    assert found.tolist() == [0, 0, 0]
