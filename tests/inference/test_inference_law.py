"""The law's columns against recursions written out in Python, and its cone against a fine grid."""

from __future__ import annotations

import numpy as np
import pytest
from inference_cases import point_of, ramp_hold

from tissueid.inference.channel_law import ChannelLaw, kelvin_voigt_law
from tissueid.inference.law import Path, passive_rows, relaxation_states
from tissueid.model.base import ContactPath
from tissueid.model.grammar import parsed


@pytest.mark.parametrize("tau", [1e-4, 0.02, 0.5, 1e3])
def test_states_are_the_recursion_step_by_step(tau):
    """s' = -s / tau + v' with v linear over the part of each step in contact; at rest where a log begins."""
    rng, n = np.random.default_rng(1), 300
    step = 0.01 * np.exp(rng.normal(size=n))
    step[[0, 120]] = np.inf
    value = np.maximum(np.cumsum(rng.normal(size=n)), 0.0)
    share = np.ones(n)
    crossing = np.flatnonzero((value[1:] > 0.0) & (value[:-1] == 0.0)) + 1
    share[crossing] = rng.uniform(0.1, 1.0, crossing.size)
    share[[0, 120]] = 1.0
    expected = np.zeros(n)
    for i in set(range(n)) - {0, 120}:
        in_contact = step[i] * share[i]
        rate = (value[i] - value[i - 1]) / in_contact
        expected[i] = expected[i - 1] * np.exp(-step[i] / tau) + rate * tau * -np.expm1(-in_contact / tau)
    found = relaxation_states(Path(step, value, share, np.array([0, 120])), value, np.array([tau]))[0]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(("branches", "degree"), [(1, 0), (1, 2), (2, 1)])
def test_columns_times_coefficients_are_the_contact_model(branches, degree):
    law = kelvin_voigt_law(branches, degree, 4.0)
    stiffness = np.array([[30.0, 6.0, 0.7], [12.0, -1.0, 0.2]])[:branches, : degree + 1]
    theta = law.model().join(np.array([20.0, -1.2, 0.35]), stiffness, np.array([0.05, 1.5])[:branches])
    time, depth = ramp_hold(200.0, 3.0, 4.0, 2.0)
    point = point_of(law, theta)
    path = Path(np.append(np.inf, np.diff(time)), depth, np.ones(time.size), np.array([0]))
    force = point.linear @ law.columns(point.log_times, path)
    expected = law.model().force(theta, ContactPath(time, depth))
    np.testing.assert_allclose(force, expected, atol=1e-11 * expected.max())
    np.testing.assert_allclose(law.theta(point.log_times, point.linear)[0], theta, rtol=1e-12)


@pytest.mark.parametrize("powers", [1, 2, 3])
def test_rows_of_the_cone_are_signs_of_the_polynomial(powers):
    u = np.linspace(0.0, 1.0, 2001)[:, None] ** np.arange(powers)
    for c in np.random.default_rng(3).standard_normal((2000, powers)):
        least = float((u @ c).min())
        if abs(least) > 1e-3:
            assert bool((passive_rows(powers) @ c >= 0.0).all()) is (least > 0.0)


def test_lifted_polynomials_are_passive_and_others_stay():
    law = kelvin_voigt_law(1, 2, 1.0)
    linear = np.random.default_rng(4).standard_normal((500, law.linear))
    u = np.linspace(0.0, 1.0, 501)[:, None] ** np.arange(3)
    before, after = linear.reshape(-1, 3), law.lifted(linear).reshape(-1, 3)
    least, lifted = (before @ u.T).min(axis=1), (after @ u.T).min(axis=1)
    assert lifted.min() >= -1e-12
    np.testing.assert_array_equal(before[least > 0.0], after[least > 0.0])
    # no more than it lacks
    assert lifted[least <= 0.0].max() < 1e-4


def test_a_static_law_that_is_convolved_is_lifted_until_it_grows():
    model = parsed("polynomial * tangent * prony:2").model(4.0, 0.01, 8.0)
    law = ChannelLaw.of(model)
    rng = np.random.default_rng(12)
    # forces that are positive throughout and sink between their ends
    size = 200
    linear = rng.uniform([1.0, -6.0, 3.0], [3.0, -2.0, 6.0], (size, 3))
    times = np.repeat(np.log([[0.1, 1.0, 0.5, 0.5]]), size, axis=0)
    before, after = law.theta(times, linear, exact=True), law.theta(times, linear)

    assert not model.passive(before).all()
    assert model.passive(after).all()
    grows = model.passive(before)
    assert after[grows] == pytest.approx(before[grows], rel=1e-12)
    slopes = np.array([model.static_slope(one, np.linspace(0.0, 4.0, 2001)) for one in after])
    assert slopes.min() > -1e-12 * slopes.max()
