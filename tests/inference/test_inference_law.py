"""The law's columns against recursions written out in Python, and its cone against a fine grid."""

from __future__ import annotations

import numpy as np
import pytest
from inference_cases import point_of, ramp_hold

from tissueid.inference.channel_law import ChannelLaw, kelvin_voigt_law
from tissueid.inference.law import Path, passive_rows, relaxation_states
from tissueid.model.base import ContactPath
from tissueid.model.grammar import parsed


def random_path(n=300, seed=1):
    rng = np.random.default_rng(seed)
    step = 0.01 * np.exp(rng.normal(size=n))
    step[[0, 120]] = np.inf
    depth = np.maximum(np.cumsum(rng.normal(size=n)), 0.0)
    share = np.ones(n)
    crossing = np.flatnonzero((depth[1:] > 0.0) & (depth[:-1] == 0.0)) + 1
    share[crossing] = rng.uniform(0.1, 1.0, crossing.size)
    share[[0, 120]] = 1.0
    return Path(step, depth, share, np.array([0, 120]))


def slow_states(path, value, tau):
    """s' = -s / tau + v' with v linear over the part of each step in contact; at rest where a log begins."""
    out = np.zeros(value.size)
    for i in range(value.size):
        if i in path.fresh:
            continue
        h = path.step_s[i]
        in_contact = h * path.share[i]
        rate = (value[i] - value[i - 1]) / in_contact
        out[i] = out[i - 1] * np.exp(-h / tau) + rate * tau * -np.expm1(-in_contact / tau)
    return out


def test_states_are_the_recursion_step_by_step():
    path = random_path()
    tau = np.array([1e-4, 0.02, 0.5, 1e3])
    found = relaxation_states(path, path.depth_mm, tau)
    for one, state in zip(tau, found, strict=True):
        expected = slow_states(path, path.depth_mm, float(one))
        np.testing.assert_allclose(state, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


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


def test_branches_of_theta_stand_by_ascending_time():
    law = kelvin_voigt_law(2, 0, 4.0)
    theta = law.theta(np.log([2.0, 0.1]), np.array([80.0, 0.0, 0.0, 4.0, 40.0]))[0]
    np.testing.assert_allclose(theta, [20.0, 0.0, 0.0, 10.0, 0.1, 1.0, 2.0])


@pytest.mark.parametrize("powers", [1, 2, 3])
def test_rows_of_the_cone_are_signs_of_the_polynomial(powers):
    rng = np.random.default_rng(3)
    rows = passive_rows(powers)
    u = np.linspace(0.0, 1.0, 2001)[:, None] ** np.arange(powers)
    for c in rng.standard_normal((2000, powers)):
        least = float((u @ c).min())
        if abs(least) > 1e-3:
            assert bool((rows @ c >= 0.0).all()) is (least > 0.0)


def test_lifted_polynomials_are_passive_and_others_stay():
    law = kelvin_voigt_law(1, 2, 1.0)
    rng = np.random.default_rng(4)
    linear = rng.standard_normal((500, law.linear))
    lifted = law.lifted(linear)
    u = np.linspace(0.0, 1.0, 501)[:, None] ** np.arange(3)
    for before, after in zip(linear, lifted, strict=True):
        for block in (slice(0, 3), slice(3, 6)):
            assert (u @ after[block]).min() >= -1e-12
            if (u @ before[block]).min() > 0.0:
                np.testing.assert_array_equal(before[block], after[block])
            else:
                # no more than it lacks
                assert (u @ after[block]).min() < 1e-4


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
