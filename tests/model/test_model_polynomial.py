"""The cone of polynomials that are non-negative on [0, 1]."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from passive_tissues import MODEL_SETTINGS, cone_coordinates

from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.polynomial import (
    MAX_DEGREE,
    coordinates,
    coordinates_jacobian,
    from_coordinates,
    generators,
    minimum_on_unit,
    n_bounded,
    shift_matrix,
)

DEGREES = range(MAX_DEGREE + 1)
U = np.linspace(0.0, 1.0, 2001)

coefficient = st.floats(-3.0, 3.0, width=32)
any_polynomial = st.lists(coefficient, min_size=1, max_size=3).map(np.array)
any_coordinates = st.sampled_from(DEGREES).flatmap(cone_coordinates)


def values(q: np.ndarray, u: np.ndarray = U) -> np.ndarray:
    return np.polynomial.polynomial.polyval(u, q)


@given(q=any_polynomial)
@MODEL_SETTINGS
def test_minimum_is_the_smallest_of_a_dense_grid(q: np.ndarray) -> None:
    on_grid = values(q).min()
    minimum = minimum_on_unit(q)
    # half a grid step off the vertex, a quadratic with |q2| <= 3 has risen by at most 3 * (2.5e-4)^2
    assert minimum <= on_grid + 1e-14
    assert minimum >= on_grid - 3.0 * (0.5 / 2000.0) ** 2 - 1e-14


@given(p=any_coordinates)
@MODEL_SETTINGS
def test_every_draw_in_cone_coordinates_is_non_negative(p: np.ndarray) -> None:
    q = from_coordinates(p)
    # rounding of squares up to (2 + 2)^2
    assert values(q).min() >= -1e-14
    assert minimum_on_unit(q) >= -1e-14


@given(p=any_coordinates)
@MODEL_SETTINGS
def test_coordinates_give_the_same_polynomial_back(p: np.ndarray) -> None:
    q = from_coordinates(p)
    # coordinates fix signs, so polynomials are compared; at a double root the square roots of sums
    # that cancel to 1e-15 keep half the digits, which their squares give back
    np.testing.assert_allclose(from_coordinates(coordinates(q)), q, rtol=0.0, atol=1e-7)


@given(p=any_coordinates.map(np.abs))
@MODEL_SETTINGS
def test_positive_coordinates_come_back_themselves(p: np.ndarray) -> None:
    p = p + 0.05
    np.testing.assert_allclose(coordinates(from_coordinates(p)), p, rtol=0.0, atol=1e-12)


@given(q=st.lists(coefficient, min_size=3, max_size=3).map(np.array))
@MODEL_SETTINGS
def test_every_non_negative_quadratic_has_coordinates(q: np.ndarray) -> None:
    q = q.copy()
    q[0] += max(0.0, -minimum_on_unit(q))  # lifted to touch zero, or as drawn where it is non-negative
    np.testing.assert_allclose(from_coordinates(coordinates(q)), q, rtol=0.0, atol=1e-6)


def test_values_negative_by_rounding_count_as_zero() -> None:
    assert coordinates(np.array([-1e-17])) == pytest.approx([0.0], abs=0.0)
    np.testing.assert_array_equal(coordinates(np.array([-1e-17, 1e-18])), [0.0, 0.0])


@pytest.mark.parametrize("degree", DEGREES)
def test_coordinates_jacobian_matches_differences(degree: int) -> None:
    p = np.array([0.7, 0.4, -1.3])[: degree + 1]
    expected = np.empty((degree + 1, degree + 1))
    for k in range(degree + 1):
        # from_coordinates is quadratic: a central difference has no truncation error
        up, down = p.copy(), p.copy()
        up[k] += 0.5
        down[k] -= 0.5
        expected[:, k] = from_coordinates(up) - from_coordinates(down)
    np.testing.assert_allclose(coordinates_jacobian(p), expected, rtol=0.0, atol=1e-14)


def test_only_the_middle_coordinate_of_a_quadratic_is_bounded() -> None:
    assert [n_bounded(degree) for degree in DEGREES] == [(), (), (1,)]


@pytest.mark.parametrize("degree", DEGREES)
def test_generators_are_independent_extreme_members_of_the_cone(degree: int) -> None:
    rows = generators(degree)
    assert np.linalg.matrix_rank(rows) == degree + 1
    for row in rows:
        assert values(row).min() >= -1e-15
        if degree > 0:
            assert minimum_on_unit(row) == pytest.approx(0.0, abs=1e-15)


@given(q=st.lists(coefficient, min_size=2, max_size=2).map(np.array))
@MODEL_SETTINGS
def test_generators_of_a_line_span_exactly_the_non_negative_lines(q: np.ndarray) -> None:
    weights = np.linalg.solve(generators(1).T, q)
    assert (weights.min() >= 0.0) == (values(q).min() >= 0.0)


def test_generators_refuse_a_degree_that_is_not_offered() -> None:
    with pytest.raises(ValueError, match="degree 3 is not offered, 0 to 2"):
        generators(3)


@pytest.mark.parametrize("degree", DEGREES)
@pytest.mark.parametrize("shift", [-0.3, 0.0, 0.07, 2.0])
def test_shift_matrix_moves_the_argument(degree: int, shift: float) -> None:
    q = np.array([1.3, -0.7, 0.45])[: degree + 1]
    np.testing.assert_allclose(
        values(shift_matrix(degree, shift) @ q), values(q, U - shift), rtol=0.0, atol=1e-13
    )


def bernstein_middle(q: np.ndarray) -> float:
    return q[0] + q[1] / 2.0


@pytest.mark.parametrize("root", [0.2, 0.5, 0.8])
def test_cone_is_exact_where_a_bernstein_coefficient_is_negative(root: float) -> None:
    # (u - r)^2 touches zero: Bernstein coefficients r^2, -r (1 - r), (1 - r)^2
    model = kelvin_voigt(branches=1, stiffness_degree=2, depth_mm=5.0)
    scale = 5.0 ** np.arange(3)
    touching = np.array([root**2, -2.0 * root, 1.0])
    assert bernstein_middle(touching) < 0.0
    fine = np.array([1.0, 0.0, 0.0])
    dip = np.array([1e-8, 0.0, 0.0])
    rounding = 1e-6 * dip
    for q, accepted in (
        (touching, True),
        (touching + dip, True),
        (touching - rounding, True),
        (touching - dip, False),
    ):
        as_static = model.join(q / scale, (fine / scale)[None, :], np.array([0.1]))
        as_stiffness = model.join(fine / scale, (q / scale)[None, :], np.array([0.1]))
        assert model.is_passive(as_static) is accepted
        assert model.is_passive(as_stiffness) is accepted
