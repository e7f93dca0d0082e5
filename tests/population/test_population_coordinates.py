from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tissueid.population.coordinates import FLOOR_SHARE, Coordinates


@st.composite
def places(draw: st.DrawFn) -> tuple[Coordinates, np.ndarray]:
    coordinates = Coordinates(draw(st.integers(1, 3)), draw(st.integers(0, 2)), draw(st.floats(0.5, 30.0)))
    # e^-6 to e^6: six decades of force and time
    phi = draw(arrays(np.float64, coordinates.size, elements=st.floats(-6.0, 6.0)))
    return coordinates, phi


@settings(max_examples=60, deadline=None)
@given(places())
def test_theta_and_phi_are_one_to_one(case: tuple[Coordinates, np.ndarray]) -> None:
    coordinates, phi = case

    back, floored = coordinates.to_phi(coordinates.to_theta(phi))

    assert floored == 0
    # forces over six decades go through coefficients that cancel: 1e-6 of the largest is 1e-8 relative here
    assert back[0] == pytest.approx(phi, abs=1e-6)


@settings(max_examples=30, deadline=None)
@given(places())
def test_the_jacobian_is_that_of_the_map(case: tuple[Coordinates, np.ndarray]) -> None:
    coordinates, phi = case
    phi = 0.3 * phi
    step = 1e-5

    numeric = np.column_stack(
        [
            (coordinates.to_theta(phi + step * unit)[0] - coordinates.to_theta(phi - step * unit)[0])
            / (2 * step)
            for unit in np.eye(phi.size)
        ]
    )

    # central differences: step^2 of curvatures of order one, over 15 coordinates
    expected = np.linalg.slogdet(numeric)[1]
    assert coordinates.log_jacobian(phi)[0] == pytest.approx(expected, abs=1e-5)


def test_quantities_are_forces_and_viscosities_at_their_depths() -> None:
    coordinates = Coordinates(branches=2, stiffness_degree=1, depth_mm=6.0)
    theta = np.array([20.0, -1.2, 0.35, 60.0, 10.0, 0.02, 5.0, 1.0, 4.0])

    found = coordinates.quantities(theta)[0]

    static = [20.0 * x - 1.2 * x**2 + 0.35 * x**3 for x in (2.0, 4.0, 6.0)]
    first = [(60.0 + 10.0 * x) * 0.02 for x in (3.0, 6.0)]
    second = [(5.0 + 1.0 * x) * 4.0 for x in (3.0, 6.0)]
    assert found == pytest.approx([*static, *first, 0.02, *second, 4.0], rel=1e-12)
    assert len(coordinates.names) == len(coordinates.units) == len(coordinates.words) == 9


def test_what_is_zero_is_floored_and_counted() -> None:
    coordinates = Coordinates(branches=1, stiffness_degree=0, depth_mm=6.0)
    theta = np.tile([20.0, -1.2, 0.35, 60.0, 0.02], (5, 1))
    theta[1, 3] = 0.0

    phi, floored = coordinates.to_phi(theta)

    assert floored == 1
    assert phi[1, 3] == pytest.approx(np.log(60.0 * 0.02 * FLOOR_SHARE), rel=1e-12)


def test_tissue_that_pulls_or_whose_times_do_not_ascend_is_not_passive() -> None:
    coordinates = Coordinates(branches=2, stiffness_degree=0, depth_mm=6.0)
    good = [20.0, -1.2, 0.35, 60.0, 0.02, 5.0, 4.0]
    pulls = [20.0, -12.0, 1.5, 60.0, 0.02, 5.0, 4.0]
    swapped = [20.0, -1.2, 0.35, 60.0, 4.0, 5.0, 0.02]

    assert coordinates.passive(np.array([good, pulls, swapped])).tolist() == [True, False, False]
