import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tissueid.model.grammar import parsed
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.population.coordinates import FLOOR_SHARE, Coordinates


@st.composite
def places(draw: st.DrawFn) -> tuple[Coordinates, np.ndarray]:
    coordinates = Coordinates(
        kelvin_voigt(draw(st.integers(1, 3)), draw(st.integers(0, 2)), draw(st.floats(0.5, 30.0)))
    )
    # e^-6 to e^6: six decades of force and time
    return coordinates, draw(arrays(np.float64, coordinates.size, elements=st.floats(-6.0, 6.0)))


#: Laws of every kind of static law, stiffness and relaxation, and shapes within their bounds.
LAWS = (
    "kelvin-voigt", "power * prony:2", "exponential * linear * fung", "hertz * fractional",
    "polynomial:2 * tangent * power-law", "sneddon * tangent * prony:2", "flat * quadratic * stretched",
    "polynomial * linear * spectrum:3", "polynomial * tangent * poroelastic", "power * impact",
)  # fmt: skip


def numeric_jacobian(coordinates: Coordinates, phi: np.ndarray) -> float:
    """Ln of abs det(d theta / d phi) by central differences: step^2 of curvatures of order one."""
    step = 1e-5
    columns = [
        (coordinates.to_theta(phi + step * unit)[0] - coordinates.to_theta(phi - step * unit)[0]) / (2 * step)
        for unit in np.eye(phi.size)
    ]
    return float(np.linalg.slogdet(columns)[1])


@pytest.mark.parametrize("name", LAWS)
def test_every_law_has_as_many_coordinates_as_parameters_and_comes_back(name):
    rng = np.random.default_rng(43)
    law = kelvin_voigt(2, 1, 6.0) if name == "kelvin-voigt" else parsed(name).model(6.0, 0.01, 8.0)
    coordinates = Coordinates(law)
    phi = 0.3 * rng.standard_normal((4, coordinates.size))
    theta = coordinates.to_theta(phi)
    assert coordinates.to_phi(theta)[0] == pytest.approx(phi, abs=1e-9)
    assert coordinates.log_jacobian(phi)[0] == pytest.approx(numeric_jacobian(coordinates, phi[0]), abs=1e-6)
    assert len(coordinates.names) == len(coordinates.words) == len(coordinates.units) == phi.shape[1]
    assert len(set(coordinates.names)) == phi.shape[1]
    # the quantity at the common depth is the static force there
    force = [float(law.static_force(one, np.array([6.0]))[0]) for one in theta]
    assert coordinates.quantities(theta)[:, coordinates.static_at_depth] == pytest.approx(force, rel=1e-9)


def test_tissue_that_is_not_passive_is_told_and_what_is_zero_is_floored_and_counted():
    coordinates = Coordinates(parsed("power * stretched").model(6.0, 0.01, 8.0))
    good, steep = [12.0, 1.5, 30.0, 0.4, 0.5], [12.0, 4.5, 30.0, 0.4, 0.5]
    assert coordinates.passive(np.array([good, steep])).tolist() == [True, False]
    coordinates = Coordinates(kelvin_voigt(1, 0, 6.0))
    theta = np.tile([20.0, -1.2, 0.35, 60.0, 0.02], (5, 1))
    theta[1, 3] = 0.0
    phi, floored = coordinates.to_phi(theta)
    assert floored == 1
    assert (phi @ coordinates.logs.T)[1, 3] == pytest.approx(np.log(60.0 * 0.02 * FLOOR_SHARE), rel=1e-12)
    coordinates = Coordinates(kelvin_voigt(2, 0, 6.0))
    good = [20.0, -1.2, 0.35, 60.0, 0.02, 5.0, 4.0]
    pulls = [20.0, -12.0, 1.5, 60.0, 0.02, 5.0, 4.0]
    swapped = [20.0, -1.2, 0.35, 60.0, 4.0, 5.0, 0.02]
    assert coordinates.passive(np.array([good, pulls, swapped])).tolist() == [True, False, False]


@settings(max_examples=50, deadline=None)
@given(places())
def test_theta_and_phi_are_one_to_one_and_the_jacobian_is_that_of_the_map(case):
    coordinates, phi = case
    back, floored = coordinates.to_phi(coordinates.to_theta(phi))
    assert floored == 0
    # forces over six decades go through coefficients that cancel: 1e-6 of the largest is 1e-8 relative here
    assert back[0] == pytest.approx(phi, abs=1e-6)
    # over 15 coordinates
    near = 0.3 * phi
    assert coordinates.log_jacobian(near)[0] == pytest.approx(numeric_jacobian(coordinates, near), abs=1e-5)


def test_quantities_are_forces_and_viscosities_at_their_depths():
    coordinates = Coordinates(kelvin_voigt(2, 1, 6.0))
    found = coordinates.quantities(np.array([20.0, -1.2, 0.35, 60.0, 10.0, 0.02, 5.0, 1.0, 4.0]))[0]
    static = [20.0 * x - 1.2 * x**2 + 0.35 * x**3 for x in (2.0, 4.0, 6.0)]
    first = [(60.0 + 10.0 * x) * 0.02 for x in (3.0, 6.0)]
    second = [(5.0 + 1.0 * x) * 4.0 for x in (3.0, 6.0)]
    assert found == pytest.approx([*static, *first, 0.02, *second, 4.0], rel=1e-12)
    assert len(coordinates.names) == len(coordinates.units) == len(coordinates.words) == 9
