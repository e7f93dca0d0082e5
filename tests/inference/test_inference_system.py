"""Forces of a law and a system against recursions and simulations written out, and their derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import log_data, point_of, ramp_hold, system_of
from scipy.signal import lfilter

from tissueid.inference.channel_law import kelvin_voigt_law, law_of
from tissueid.inference.law import Path, passive_rows, relaxation_states
from tissueid.inference.system import MACHINE, Effects
from tissueid.model.base import ContactPath
from tissueid.model.grammar import parsed

LAW = kelvin_voigt_law(2, 1, 4.0)
THETA = np.array([20.0, -1.2, 0.35, 60.0, 8.0, 0.05, 25.0, -2.0, 1.2])
ALL = Effects(gain=True, shape=True, time=True)


def force_of(time, depth, slower=1.0):
    theta = THETA * np.where(np.isin(np.arange(9), (5, 8)), slower, 1.0)
    return LAW.model().force(theta, ContactPath(time, depth))


def three_logs(rate=200.0):
    """A short log that is kept by samples cannot stand beside long ones: all are long."""
    logs = []
    for speed, depth, hold in ((1.0, 4.0, 0.0), (4.0, 4.0, 3.0), (8.0, 2.0, 4.0)):
        time, x = ramp_hold(rate, speed, depth, hold)
        logs.append(log_data(time, x, force_of(time, x)))
    return logs


def scattered(point, rng):
    """The point with something of its own in every log, all of them in contact from their first sample."""
    own = rng.normal(size=point.own.shape) * np.array([0.1, 0.01, 0.2, 0.1, 0.1])
    own[:, 1] = -np.abs(own[:, 1]) - 0.01
    return replace(point, own=own)


def difference(system, point, change):
    """Central difference of the predicted forces, the frame's deflection iterated until it stands."""
    out = []
    for sign in (1.0, -1.0):
        system.guess = system.tip_force(point)[0]
        out.append(system.predict(change(point, sign)))
    return out[0] - out[1]


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize(
    "machine", [(0.0, 0.0, 0.0), (0.0, 0.003, 0.004), (0.0, -0.003, 0.0), (5e-4, 0.002, 0.003)]
)
def test_derivatives_are_differences_of_predictions(machine, inside):
    law, at = LAW, point_of(LAW, THETA)
    if inside:  # a law inside the convolution
        law = law_of(parsed("polynomial * tangent * prony:2").model(4.0, 0.01, 10.0), 3)
        at = replace(at, log_times=np.log([0.05, 1.2, 2.0, 0.8]), linear=np.array([80.0, -19.0, 22.0]))
    system = system_of(three_logs(), law, effects=ALL)
    at = replace(at, machine=np.array(machine), own=np.zeros((3, ALL.size)))
    point = scattered(at, np.random.default_rng(1))
    for _ in range(6):
        system.guess = system.tip_force(point)[0]
    found = system.derivatives(point, machine=True)
    scale = np.abs(system.force).max()
    # behind a frame, what a coefficient adds makes it give way: its memory is left out
    worst = 2e-5 if machine[0] == 0.0 else 2e-2 if not inside else 1e-3

    def by(name, k, step):
        """Difference by shared parameters, or by the logs' own."""

        def change(at, sign):
            moved = {"shared": at.shared.copy(), "own": at.own.copy()}
            moved[name][..., k] += sign * step
            return at.moved(moved["shared"], moved["own"])

        return difference(system, point, change) / (2.0 * step)

    t = law.times
    for k in range(system.size):
        of_machine = t <= k < t + len(MACHINE)
        column = found.shared[:, k]
        # steps of the machine are one-sided where it ends at none
        if of_machine and machine[k - t] == 0.0:
            continue
        expected = by("shared", k, 1e-6 if of_machine else 1e-4)
        size = max(np.abs(expected).max(), 1e-3 * scale)
        assert np.abs(column - expected).max() <= max(worst, 1e-4) * size, k
    for k in range(ALL.size):
        expected = by("own", k, 1e-5 if k == 1 else 1e-4)
        # a shape adds most in the middle of a ramp, where that memory is longest
        least = max(worst, 1e-4) * (1.0 if k < 2 else 1.5)
        assert np.abs(found.own[:, k] - expected).max() <= least * np.abs(expected).max(), k


def test_a_closed_machine_has_no_derivatives():
    system, point = system_of(three_logs(), LAW, effects=ALL), point_of(LAW, THETA, logs=3, own=ALL.size)
    found = system.derivatives(point, machine=False)
    assert (found.shared[:, LAW.times : LAW.times + 3] == 0.0).all()
    np.testing.assert_allclose(found.force, system.predict(point))


def test_gain_contact_times_and_shape_of_a_log_are_its_own():
    system = system_of(three_logs(), LAW, effects=ALL, whole=True)
    own = np.zeros((3, ALL.size))
    own[1] = [np.log(1.1), 0.02, np.log(1.3), 0.3, -0.2]
    found = system.predict(replace(point_of(LAW, THETA, logs=3, own=ALL.size), own=own))
    time, depth = ramp_hold(200.0, 4.0, 4.0, 3.0)
    # contact lies 0.08 mm deeper: the samples before it are in air
    below = np.maximum(depth - 0.02 * 4.0, 0.0)
    fine = np.linspace(0.0, time[-1], 20 * (time.size - 1) + 1)
    exact = np.interp(time, fine, force_of(fine, np.maximum(np.minimum(4.0 * fine, 4.0) - 0.08, 0.0), 1.3))
    # a shape bends the gain of all forces between the surface and the largest depth
    u = below / 4.0
    expected = exact * 1.1 * np.exp(0.3 * (1.0 - u) ** 2 - 0.2 * 2.0 * u * (1.0 - u))
    mine = system.log == 1
    # the fine grid meets contact between two of its samples
    np.testing.assert_allclose(found[mine], expected, atol=2e-3 * expected.max())
    for i, log in enumerate(three_logs()):
        if i != 1:
            np.testing.assert_allclose(found[system.log == i], log.force_N, rtol=1e-9, atol=1e-12)


def test_the_load_channel_is_filtered_and_late():
    time, depth = ramp_hold(1000.0, 4.0, 4.0, 1.0)
    system = system_of([log_data(time, depth, force_of(time, depth))], LAW, whole=True)
    found = system.predict(point_of(LAW, THETA, machine=(0.0, 0.0005, 0.01)))
    fine = np.arange(20 * (time.size - 1) + 1) / 20_000.0
    exact = force_of(fine, np.minimum(4.0 * fine, 4.0))
    decay = np.exp(-1.0 / 20_000.0 / 0.01)
    expected = np.interp(time - 0.0005, fine, lfilter([1.0 - decay], [1.0, -decay], exact))
    # a first-order rule on the fine grid is late by half of its step
    np.testing.assert_allclose(found, expected, atol=1e-3 * expected.max())


def test_a_frame_takes_its_share_of_the_travel():
    compliance = 1e-3
    time, depth = ramp_hold(200.0, 4.0, 3.5, 3.0)
    force = force_of(time, depth)
    # the crosshead travels further than the tip, by what the frame gives
    system = system_of([log_data(time, depth + compliance * force, force)], LAW, whole=True)
    point = point_of(LAW, THETA, machine=(compliance, 0.0, 0.0))
    np.testing.assert_allclose(system.predict(point), force, atol=1e-9 * force.max())
    # started from none of it, iterations end there
    system.guess = np.zeros(time.size)
    for _ in range(20):
        system.guess = system.tip_force(point)[0]
    np.testing.assert_allclose(system.predict(point), force, atol=1e-9 * force.max())


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
    path = Path(step, value, crossing, share[crossing], np.array([0, 120]))
    expected = np.zeros(n)
    for i in set(range(n)) - {0, 120}:
        in_contact = step[i] * share[i]
        rate = (value[i] - value[i - 1]) / in_contact
        expected[i] = expected[i - 1] * np.exp(-step[i] / tau) + rate * tau * -np.expm1(-in_contact / tau)
    found = relaxation_states(path, value, np.array([tau]))[0]
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize(("branches", "degree"), [(1, 0), (1, 2), (2, 1)])
def test_columns_times_coefficients_are_the_contact_model(branches, degree):
    law = kelvin_voigt_law(branches, degree, 4.0)
    stiffness = np.array([[30.0, 6.0, 0.7], [12.0, -1.0, 0.2]])[:branches, : degree + 1]
    theta = law.model().join(np.array([20.0, -1.2, 0.35]), stiffness, np.array([0.05, 1.5])[:branches])
    time, depth = ramp_hold(200.0, 3.0, 4.0, 2.0)
    point = point_of(law, theta)
    path = Path(np.append(np.inf, np.diff(time)), depth, np.zeros(0, int), np.zeros(0), np.array([0]))
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
    law = law_of(model, 1)
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
