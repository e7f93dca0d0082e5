"""No motion of the tool gets more energy out of a passive tissue than was put in; the passive cone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from passive_tissues import (
    DEPTH_MM,
    MODEL_SETTINGS,
    legs,
    passive_tissues,
    sampled,
    walked,
)

from tissueid.model.base import ContactPath
from tissueid.model.channels import minimum_on_unit
from tissueid.model.kelvin_voigt import kelvin_voigt

PER_LEG = 40
#: Work is summed by the trapezoidal rule, whose error is 1 / PER_LEG^2 of what a leg moves.
TOLERANCE = 1.0 / PER_LEG**2


def work(force: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, float]:
    """Work done on the tissue up to every sample, and all that was put in."""
    done = 0.5 * (force[1:] + force[:-1]) * np.diff(depth)
    return np.concatenate([[0.0], np.cumsum(done)]), float(np.abs(done).sum())


@pytest.mark.needs_jit
@given(tissue_=passive_tissues(), corners=legs(0.0, DEPTH_MM), back=st.floats(-2.5, 1.5))
@MODEL_SETTINGS
def test_permanent_contact_never_returns_more_than_was_put_in(tissue_, corners, back) -> None:
    model, theta = tissue_
    assert model.is_passive(theta)
    time, depth = sampled([*corners, (0.0, 10.0**back)], PER_LEG)
    balance, moved = work(model.force(theta, ContactPath(time, depth)), depth)
    assert balance.min() >= -TOLERANCE * moved


@pytest.mark.needs_jit
@given(tissue_=passive_tissues(), corners=legs(-1.0, DEPTH_MM + 1.0), back=st.floats(-2.5, 1.5))
@MODEL_SETTINGS
def test_contact_that_is_lost_and_found_never_returns_more_than_was_put_in(tissue_, corners, back) -> None:
    time, depth = sampled([*corners, (-0.5, 10.0**back)], PER_LEG)
    force = walked(*tissue_, time, depth)
    balance, moved = work(force, depth)
    assert force[-1] == 0.0
    assert balance.min() >= -TOLERANCE * moved


def test_measure_of_passivity_sees_a_law_that_is_not() -> None:
    # K(x) = 20 - 5 x turns negative at 4 mm: a fast cycle deep down gains energy, and is_passive says no
    model, theta = kelvin_voigt(1, 1, DEPTH_MM), np.array([1.0, 0.0, 0.0, 20.0, -5.0, 0.5])
    assert not model.is_passive(theta)
    time, depth = sampled([(6.0, 50.0), *[(8.0, 1.0), (6.0, 1.0)] * 6, (0.0, 50.0)], PER_LEG)
    balance, moved = work(model.force(theta, ContactPath(time, depth)), depth)
    assert balance.min() < -10.0 * TOLERANCE * moved


U = np.linspace(0.0, 1.0, 2001)


@given(q=st.lists(st.floats(-3.0, 3.0, width=32), min_size=1, max_size=3).map(np.array))
@MODEL_SETTINGS
def test_minimum_is_the_smallest_of_a_dense_grid(q: np.ndarray) -> None:
    on_grid = np.polynomial.polynomial.polyval(U, q).min()
    minimum = minimum_on_unit(q)
    # half a grid step off the vertex, a quadratic with |q2| <= 3 has risen by at most 3 * (2.5e-4)^2
    assert on_grid - 3.0 * (0.5 / 2000.0) ** 2 - 1e-14 <= minimum <= on_grid + 1e-14


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
