"""Measures of an attempt against ways that are known."""

import math

import numpy as np
import pytest

from tissueid.haptics.ring import RECORD
from tissueid.haptics.states import State
from tissueid.rendering.guidance_block import Guidance, guidance_block
from tissueid.training import learning_curve, measured

ENTRY = np.array([0.004, -0.002, 0.120])
AXIS = np.array([0.0, 0.6, 0.8])
PLAN = Guidance((0.004, -0.002, 0.120), (0.0, 0.6, 0.8))
HEAD = {"environment": "guidance", "tissues": [{"block": guidance_block(PLAN).tolist()}]}
#: Across the axis: x, and what is left.
ACROSS = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6]])


def session(height_mm: np.ndarray, aside_mm: np.ndarray, *, hz: float = 1000.0) -> np.ndarray:
    """Records of a tip at heights along the axis and places (n, 2) across it."""
    records = np.zeros(height_mm.size, RECORD)
    records["time_s"] = 5.0 + np.arange(height_mm.size) / hz
    records["state"] = State.ENGAGED
    records["position_m"] = ENTRY + 1e-3 * (height_mm[:, None] * AXIS + aside_mm @ ACROSS)
    return records


def straight(angle_deg: float, aside_mm: float, *, seconds: float = 4.0, end_mm: float = -20.5) -> np.ndarray:
    """Down from 60 mm at constant speed, on a line that passes the entry point at a distance."""
    height = np.linspace(60.0, end_mm, int(1000 * seconds))
    slope = math.tan(math.radians(angle_deg))
    return session(height, np.column_stack([aside_mm - slope * height, np.zeros_like(height)]))


def test_a_straight_way_has_its_angle_and_its_errors():
    found = measured(HEAD, straight(2.0, 1.5))
    assert found.complete
    assert found.angle_deg == pytest.approx(2.0, abs=1e-6)
    assert found.angle_se_deg == pytest.approx(0.0, abs=1e-9)
    slope = math.tan(math.radians(2.0))
    # within a sample of 20 micrometres of the way
    assert found.entry_error_mm == pytest.approx(1.5, abs=1e-3)
    assert found.end_error_mm == pytest.approx(1.5 + 20.0 * slope, abs=1e-3)
    assert found.path_over_chord == pytest.approx(1.0, abs=0.02)
    # from 40 mm above to 20 mm below, at 80.5 mm in 4 s
    assert found.seconds == pytest.approx(60.0 / (80.5 / 4.0), rel=1e-3)


def test_the_standard_error_is_the_scatter_of_the_angle():
    rng = np.random.default_rng(8)
    clean = straight(1.0, 0.0)
    angles, errors = [], []
    for _ in range(100):
        noisy = clean.copy()
        # encoder noise of 0.05 mm across the axis
        noisy["position_m"] += 5e-5 * rng.standard_normal((clean.size, 2)) @ ACROSS
        found = measured(HEAD, noisy)
        angles.append(found.angle_deg)
        errors.append(found.angle_se_deg)
    # the standard error is of both directions across, the angle's scatter of one
    assert np.std(angles) == pytest.approx(np.median(errors) / math.sqrt(2.0), rel=0.2)


def test_an_attempt_ends_at_the_deepest_place_where_the_wire_is_not_through():
    records = np.concatenate([straight(0.0, 2.0, end_mm=-12.0), straight(0.0, 2.0, end_mm=-12.0)[::-1]])
    records["time_s"] = 5.0 + 1e-3 * np.arange(records.size)
    found = measured(HEAD, records)
    assert not found.complete
    assert found.end_error_mm == pytest.approx(2.0, abs=1e-6)


def test_an_attempt_begins_where_the_tip_came_down_last():
    again = np.concatenate([straight(0.0, 9.0, end_mm=30.0), straight(0.0, 1.0)])
    again["time_s"] = 5.0 + 1e-3 * np.arange(again.size)
    alone = measured(HEAD, straight(0.0, 1.0))
    assert measured(HEAD, again).seconds == pytest.approx(alone.seconds)


def test_a_smooth_reach_has_the_jerk_of_its_closed_form():
    # the way of least jerk, 10 s^3 - 15 s^4 + 6 s^5, cut where it passes 40 mm and -20 mm
    s = np.linspace(0.0, 1.0, 20_001)
    height = 40.001 - 60.5 * (10 * s**3 - 15 * s**4 + 6 * s**5)
    cut = (height <= 40.0) & (height >= -20.0)
    jerk = 60.5 * (60.0 - 360.0 * s[cut] + 360.0 * s[cut] ** 2)
    span, length = np.ptp(s[cut]), np.ptp(height[cut])
    expected = -math.log((jerk**2).mean() * span**6 / length**2)
    found = measured(HEAD, session(height, np.zeros((s.size, 2)), hz=10_000.0))
    shaky = session(height, 0.5 * np.column_stack([np.sin(60.0 * s), np.cos(60.0 * s)]), hz=10_000.0)
    # a running mean of 50 ms takes a little of a way of 1.6 s
    assert found.log_jerk == pytest.approx(expected, abs=0.05)
    assert measured(HEAD, shaky).log_jerk < found.log_jerk - 2.0
    assert measured(HEAD, shaky).path_over_chord > found.path_over_chord


def test_forces_are_those_of_the_way():
    records = straight(0.0, 0.0)
    records["force_N"][:, 0] = 1.0
    records["force_N"][2500] = [0.0, 3.0, 4.0]
    records["force_N"][10] = [9.0, 0.0, 0.0]  # above the cone
    found = measured(HEAD, records)
    assert found.peak_force_N == 5.0
    assert found.mean_force_N == pytest.approx(1.0, abs=0.01)


def test_a_session_without_an_attempt_is_refused():
    with pytest.raises(ValueError, match="never came"):
        measured(HEAD, straight(0.0, 0.0)[:100])
    with pytest.raises(ValueError, match="never came"):
        measured(HEAD, straight(0.0, 0.0)[:0])
    with pytest.raises(ValueError, match="not guided"):
        measured({**HEAD, "environment": "tissue"}, straight(0.0, 0.0))


def test_the_law_of_practice_is_found_with_its_error():
    rng = np.random.default_rng(2)
    number = np.arange(1, 31)
    found = [learning_curve(8.0 * number**-0.4 * np.exp(0.1 * rng.standard_normal(30))) for _ in range(200)]
    exponents = np.array([one.exponent for one in found if one is not None])
    errors = np.array([one.exponent_se for one in found if one is not None])
    assert exponents.mean() == pytest.approx(-0.4, abs=4 * exponents.std() / math.sqrt(200))
    assert np.median(errors) == pytest.approx(exponents.std(), rel=0.2)
    assert learning_curve([3.0, math.nan, 2.0, 1.0]) is None
