"""The cone of polynomials that are non-negative on [0, 1]."""

from __future__ import annotations

import numpy as np
import pytest
from closed_forms import from_coordinates
from hypothesis import given
from hypothesis import strategies as st
from passive_tissues import MODEL_SETTINGS, cone_coordinates

from tissueid.model.channels import minimum_on_unit
from tissueid.model.kelvin_voigt import kelvin_voigt

U = np.linspace(0.0, 1.0, 2001)


@given(q=st.lists(st.floats(-3.0, 3.0, width=32), min_size=1, max_size=3).map(np.array))
@MODEL_SETTINGS
def test_minimum_is_the_smallest_of_a_dense_grid(q: np.ndarray) -> None:
    on_grid = np.polynomial.polynomial.polyval(U, q).min()
    minimum = minimum_on_unit(q)
    # half a grid step off the vertex, a quadratic with |q2| <= 3 has risen by at most 3 * (2.5e-4)^2
    assert on_grid - 3.0 * (0.5 / 2000.0) ** 2 - 1e-14 <= minimum <= on_grid + 1e-14


@given(p=st.sampled_from(range(3)).flatmap(cone_coordinates))
@MODEL_SETTINGS
def test_every_draw_in_cone_coordinates_is_non_negative(p: np.ndarray) -> None:
    # rounding of squares up to (2 + 2)^2
    assert minimum_on_unit(from_coordinates(p)) >= -1e-14


@pytest.mark.parametrize("root", [0.2, 0.5, 0.8])
def test_cone_is_exact_where_a_bernstein_coefficient_is_negative(root: float) -> None:
    # (u - r)^2 touches zero: Bernstein coefficients r^2, -r (1 - r), (1 - r)^2
    model = kelvin_voigt(branches=1, stiffness_degree=2, depth_mm=5.0)
    scale = 5.0 ** np.arange(3)
    touching = np.array([root**2, -2.0 * root, 1.0])
    fine, dip = np.array([1.0, 0.0, 0.0]), np.array([1e-8, 0.0, 0.0])
    for q, accepted in (
        (touching, True),
        (touching + dip, True),
        (touching - 1e-6 * dip, True),
        (touching - dip, False),
    ):
        as_static = model.join(q / scale, (fine / scale)[None, :], np.array([0.1]))
        as_stiffness = model.join(fine / scale, (q / scale)[None, :], np.array([0.1]))
        assert model.is_passive(as_static) is model.is_passive(as_stiffness) is accepted
