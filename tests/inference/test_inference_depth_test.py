"""Drainage or viscosity: the slope of ln time on ln contact radius, and when nothing is decided."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.inference.holds import drainage_time, drained_share
from tissueid.inference.quoted import depth_test
from tissueid.measured.geometry import Geometry
from tissueid.model.moduli import Indenter

DEPTHS = np.repeat([1.0, 2.0, 4.0, 8.0], 2)
BALL = Geometry(Indenter("sphere", 20.0))


def scattered(times: np.ndarray, sd: float = 0.05) -> list[float]:
    return list(times * np.exp(sd * np.random.default_rng(3).standard_normal(times.size)))


@pytest.mark.parametrize(
    ("times", "verdict"),
    [(0.4 * DEPTHS, "drainage"), (np.full(8, 0.4), "viscous"), (0.4 * DEPTHS**0.5, "neither")],
)
def test_the_slope_decides(times: np.ndarray, verdict: str) -> None:
    slope, flags = depth_test(BALL, list(DEPTHS), scattered(times))
    assert slope is not None
    assert slope.at["verdict"] == verdict
    assert slope.at["low"] <= slope.value <= slope.at["high"]
    assert [flag.code for flag in flags] == ["poroelastic"] * (verdict == "drainage")


def test_times_that_scatter_decide_nothing() -> None:
    slope, flags = depth_test(BALL, [1.0, 2.0, 4.0], [0.2, 3.0, 0.4])
    assert slope is not None
    assert slope.at["verdict"] == "can't decide"
    assert flags == ()


def test_a_buried_tip_decides_nothing_and_says_so() -> None:
    slope, flags = depth_test(Geometry(Indenter("sphere", 5.0)), [1.0, 2.0, 4.0], [1.0, 2.0, 4.0])
    assert slope is not None
    assert slope.value is None
    assert "4 mm of depth, 5 mm of radius" in slope.reason
    assert flags == ()


@pytest.mark.parametrize(
    ("geometry", "depths"),
    [
        (None, [1.0, 2.0, 4.0]),
        (Geometry(Indenter("flat", 5.0)), [1.0, 2.0, 4.0]),
        (BALL, [4.0, 4.0, 4.0]),
        (BALL, [1.0, 4.0]),
    ],
)
def test_without_two_contacts_there_is_no_test(geometry: Geometry | None, depths: list[float]) -> None:
    assert depth_test(geometry, depths, [1.0] * len(depths)) == (None, ())


@pytest.mark.parametrize("ramp_s", [0.0, 0.5])
@pytest.mark.parametrize("truth", [0.3, 3.0])
def test_the_time_of_drainage_is_found_behind_its_ramp(truth: float, ramp_s: float) -> None:
    """Parts of a ramp under a sphere, drained each from its own moment, by a fine sum."""
    time = np.arange(0.0, 10.0, 0.01)
    part = (np.arange(4000) + 0.5) / 4000
    weight = np.diff(np.append(0.0, ((np.arange(4000) + 1.0) / 4000) ** 1.5))
    since = time[:, None] + ramp_s * (1.0 - part)
    force = 5.0 + 20.0 * drained_share(since / truth) @ weight
    force += 0.01 * np.random.default_rng(1).standard_normal(time.size)
    assert drainage_time(time, force, ramp_s) == pytest.approx(truth, rel=0.01)


def test_the_function_of_drainage_begins_at_one_and_ends_at_none() -> None:
    """Hu et al. 2010, the printed coefficients."""
    np.testing.assert_allclose(drained_share(np.array([0.0, 1.0, 1e4])), [1.0, 0.2930, 0.0], atol=2e-4)
    assert drainage_time(np.arange(5.0), np.ones(5), 0.0) == 0.0
