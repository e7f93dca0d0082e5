"""The tissue under a tool that can push but not pull, and the energy that it may return."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from passive_tissues import DEPTH_MM, SETTINGS, legs, passive_tissues, sampled, tissue, walked
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from tissue_stepper import TissueStepper

from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel, minimum_on_unit
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.kernels import _DRIVERS, _STATES, LAW_SIZE, STATE_SIZE, pack_law, tissue_step_in

IN_AIR_MM = -1.0
A1, K0, TAU_S = 12.0, 20.0, 0.05


def linear_tissue() -> TissueStepper:
    """F_s = a1 x and one branch of constant K: everything has a closed form."""
    model = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=DEPTH_MM)
    return TissueStepper(model, np.array([A1, 0.0, 0.0, K0, TAU_S]))


def settled(theta_model: tuple[ChannelModel, np.ndarray], depth_mm: float) -> TissueStepper:
    """A tissue that was pushed to a depth and has forgotten how."""
    model, theta = theta_model
    stepper = TissueStepper(model, theta)
    stepper.step(depth_mm, 1e9)
    stepper.step(depth_mm, 1e9)
    return stepper


def test_sudden_release_leaves_the_surface_where_spring_and_branch_balance() -> None:
    stepper = linear_tissue()
    stepper.step(4.0, 0.1)
    state = 4.0 / 0.1 * TAU_S * -np.expm1(-0.1 / TAU_S)
    assert stepper.step(IN_AIR_MM, 0.0) == 0.0
    # a1 y + K (s + y - 4) = 0, an elastic jump
    assert stepper.surface_mm == pytest.approx(K0 * (4.0 - state) / (A1 + K0), rel=1e-12)


def test_recovery_of_a_nonlinear_tissue_follows_its_differential_equation() -> None:
    model, theta = tissue(1, 2)
    static, stiffness, tau = model.split(theta)
    fs = np.polynomial.Polynomial([0.0, *static])
    k = np.polynomial.Polynomial(stiffness[0])

    def recovery(_t: float, y: np.ndarray) -> np.ndarray:
        g = fs(y) / k(y)
        slope = (fs.deriv()(y) - g * k.deriv()(y)) / k(y)
        return -g / (tau[0] * (1.0 + slope))

    stepper = settled((model, theta), 7.0)
    stepper.step(IN_AIR_MM, 0.0)
    start = stepper.surface_mm
    duration, n = 2.0 * tau[0], 400
    for _ in range(n):
        stepper.step(IN_AIR_MM, duration / n)
    expected = solve_ivp(recovery, (0.0, duration), [start], method="DOP853", rtol=1e-11, atol=1e-12).y[0, -1]
    # second order in h = tau / 200
    assert stepper.surface_mm == pytest.approx(expected, rel=1e-5)
    assert expected < 0.7 * start


def test_contact_resumes_at_the_surface_with_the_slope_of_an_elastic_jump() -> None:
    stepper = linear_tissue()
    stepper.step(4.0, 10.0)
    stepper.step(IN_AIR_MM, 0.01)
    surface = stepper.surface_mm
    assert surface > 0.5
    assert stepper.step(surface - 0.3, 0.0) == 0.0
    assert stepper.surface_mm == pytest.approx(surface, rel=1e-12)
    # with the state left at -g(y), the force is that of the push beyond the surface
    assert stepper.step(surface + 0.3, 0.0) == pytest.approx((A1 + K0) * 0.3, rel=1e-11)
    assert stepper.surface_mm == surface + 0.3


def test_force_is_clipped_exactly_where_the_law_would_pull() -> None:
    # until the first loss of contact the stepper and the law of permanent contact are the same
    model, theta = tissue(2, 1)
    depth = np.concatenate([np.linspace(0.0, 5.0, 40), np.full(10, 5.0), np.linspace(5.0, 0.0, 60)])
    time = 0.01 * np.arange(depth.size)
    stepper = TissueStepper(model, theta)
    stepped = np.array([stepper.step(x, 0.01 if i else 0.0) for i, x in enumerate(depth)])
    permanent = model.force(theta, ContactPath(time, depth))
    lost = int(np.argmax(permanent < 0.0))
    assert lost > 50
    np.testing.assert_allclose(stepped[:lost], permanent[:lost], rtol=1e-9, atol=1e-12)
    assert np.all(stepped[lost:] == 0.0)
    assert permanent.min() < -1.0


@pytest.mark.needs_jit
@given(tissue_=passive_tissues(), corners=legs(-1.0, 9.0))
@SETTINGS
def test_contact_is_unilateral(tissue_, corners) -> None:
    """Force never negative, surface never above tool or rest level, a detached surface free of force."""
    model, theta = tissue_
    stepper = TissueStepper(model, theta)
    scale = model.static_force(theta, np.array([DEPTH_MM]))[0] + DEPTH_MM * np.abs(theta).max()
    for x, duration in corners:
        for fraction in (0.0, 0.01, 1.0):
            force = stepper.step(x, fraction * duration)
            surface = stepper.surface_mm
            assert force >= 0.0
            assert surface >= max(x, 0.0)
            if surface > max(x, 0.0):
                assert force == 0.0
                # touching it without moving it: the root is found to 1e-14 of the depth
                assert stepper.step(surface, 0.0) <= 1e-11 * scale


def test_surface_ends_deeper_than_it_started_where_a_slow_branch_pulls_on() -> None:
    # in balance at 3 mm: spring 3 N, fast branch pushes 15 N, slow branch pulls 18 N; the push dies first
    a1, k, tau, depth = 1.0, np.array([30.0, 30.0]), np.array([0.01, 10.0]), 8.0
    states, surface, h = np.array([0.5, -0.6]), 3.0, 0.03
    a = np.exp(-h / tau)
    phi = (1.0 - a) * tau / h
    expected = brentq(lambda y: a1 * y + k @ (a * states + phi * (y - surface)), 0.0, 20.0, xtol=1e-13)
    law, state = np.empty(LAW_SIZE), np.zeros(STATE_SIZE)
    pack_law(np.array([0.0, a1, 0.0, 0.0]), k[:, None], tau, depth, law, 0)
    state[0], state[_STATES : _STATES + 2], state[_DRIVERS : _DRIVERS + 2] = surface, states, surface
    assert tissue_step_in(law, 0, state, 0, IN_AIR_MM, h) == 0.0
    assert state[0] == pytest.approx(expected, rel=1e-12)
    assert state[0] > surface + 0.01


def test_fast_release_stops_at_the_first_balance_on_the_way_out() -> None:
    # F_s = x (x - 5)^2 is soft at 5 mm; let go from 8 mm the law is free of force at three depths
    model = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=DEPTH_MM)
    theta = np.array([25.0, -10.0, 1.0, 2.5, 1.0])
    roots = np.sort(np.polynomial.Polynomial([-20.0, 27.5, -10.0, 1.0]).roots().real)
    assert roots[0] > 1.0
    stepper = settled((model, theta), 8.0)
    assert stepper.step(1.0, 0.0) == 0.0
    assert stepper.surface_mm == pytest.approx(roots[2], rel=1e-10)


def test_states_of_a_long_hold_end_in_zero_without_denormals() -> None:
    law, state = np.empty(LAW_SIZE), np.zeros(STATE_SIZE)
    static, stiffness = np.array([0.0, A1, 0.0, 0.0]), np.full((2, 1), K0)
    pack_law(static, stiffness, np.array([0.02, 0.03]), DEPTH_MM, law, 0)
    states = state[_STATES : _STATES + 2]
    tissue_step_in(law, 0, state, 0, 3.0, 0.01)
    assert states.min() > 0.5
    for _ in range(500):
        force = tissue_step_in(law, 0, state, 0, 3.0, 0.05)
        assert not np.any((states != 0.0) & (states < np.finfo(np.float64).tiny))
    assert np.all(states == 0.0)
    assert force == pytest.approx(3.0 * A1, rel=1e-14)


def test_tool_in_air_feels_nothing_and_leaves_a_resting_tissue_at_rest() -> None:
    stepper = linear_tissue()
    for x in (-3.0, -0.001, 0.0, -2.0):
        assert stepper.step(x, 0.01) == stepper.surface_mm == 0.0
    assert stepper.step(1.0, 0.01) == linear_tissue().step(1.0, 0.01)
    model, theta = tissue(2, 1)
    depth = np.concatenate([np.linspace(-2.0, -0.1, 20), np.linspace(0.0, 3.0, 30)])
    stepper = TissueStepper(model, theta)
    stepped = [stepper.step(x, 0.01) for x in depth]
    clipped = ContactPath(0.01 * np.arange(depth.size), np.maximum(depth, 0.0))
    np.testing.assert_allclose(stepped, model.force(theta, clipped), rtol=1e-10, atol=1e-13)


def test_elastic_tissue_without_branches_never_detaches() -> None:
    stepper = TissueStepper(kelvin_voigt(0, 0, DEPTH_MM), np.array([12.0, -1.5, 0.35]))
    for x in (3.0, 1.0, -1.0, 2.0):
        at = max(x, 0.0)
        assert stepper.step(x, 0.001) == pytest.approx(12.0 * at - 1.5 * at**2 + 0.35 * at**3, rel=1e-13)
        assert stepper.surface_mm == at


def test_tissue_that_is_not_passive_is_not_rendered() -> None:
    model, theta = tissue(1, 0)
    theta[3] = -1.0
    with pytest.raises(ValueError, match="not passive"):
        TissueStepper(model, theta)


def law_at(part: str, coefficients: tuple[float, ...], x: float) -> float:
    """F_s, or K by an elastic jump of a tissue with next to no static force: F = K(x) x."""
    if part == "static":
        return TissueStepper(kelvin_voigt(0, 0, 4.0), np.array(coefficients)).step(x, 0.0)
    theta = np.array([0.0, 0.0, 0.0, *coefficients, 1.0])
    return TissueStepper(kelvin_voigt(1, 2, 4.0), theta).step(x, 0.0) / x


@pytest.mark.parametrize("part", ["static", "stiffness"])
def test_law_is_continued_along_its_end_tangent_where_it_grows_and_as_a_constant_where_it_falls(part) -> None:
    d, rising, falling = 1e-5, (2.0, 0.5, 0.3), (10.0, 0.0, -0.4)
    end = law_at(part, rising, 4.0)
    tangent = (end - law_at(part, rising, 4.0 - d)) / d
    # C0 and C1 at the end, and straight from there on
    assert law_at(part, rising, 4.0 + d) == pytest.approx(end, abs=2.0 * tangent * d)
    assert (law_at(part, rising, 4.0 + d) - end) / d == pytest.approx(tangent, rel=1e-4)
    assert law_at(part, rising, 9.0) == pytest.approx(end + 5.0 * tangent, rel=1e-4)
    end = law_at(part, falling, 4.0)
    assert law_at(part, falling, 3.9) > end > 0.0
    for x in (4.0001, 6.0, 400.0):
        assert law_at(part, falling, x) == pytest.approx(end, rel=1e-13)


@pytest.mark.parametrize(
    ("branches", "degree", "theta", "unique"),
    [
        (1, 0, [20.0, -1.2, 0.35, 63.62, 0.021], True),
        # F_s = 10 x, K = 0.1 + x^2: at x = 3, (F_s / K)' = (10 K - F_s K') / K^2 = (91 - 180) / 82.8 = -1.07
        (1, 2, [10.0, 0.0, 0.0, 0.1, 0.0, 1.0, 0.5], False),
        (0, 0, [1.0, 0.0, 0.0], True),
    ],
)
def test_the_free_surface_is_unique_unless_k_grows_faster_than_the_static_force(
    branches: int, degree: int, theta: list[float], unique: bool
) -> None:
    assert kelvin_voigt(branches, degree, 8.0).contact_loss_is_unique(np.array(theta)) is unique


PER_LEG = 40
#: Work is summed by the trapezoidal rule, whose error is 1 / PER_LEG^2 of what a leg moves.
TOLERANCE = 1.0 / PER_LEG**2


def work(force: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, float]:
    """Work done on the tissue up to every sample, and all that was put in."""
    done = 0.5 * (force[1:] + force[:-1]) * np.diff(depth)
    return np.concatenate([[0.0], np.cumsum(done)]), float(np.abs(done).sum())


@pytest.mark.needs_jit
@given(tissue_=passive_tissues(), corners=legs(0.0, DEPTH_MM), back=st.floats(-2.5, 1.5))
@SETTINGS
def test_permanent_contact_never_returns_more_than_was_put_in(tissue_, corners, back) -> None:
    model, theta = tissue_
    assert model.is_passive(theta)
    time, depth = sampled([*corners, (0.0, 10.0**back)], PER_LEG)
    balance, moved = work(model.force(theta, ContactPath(time, depth)), depth)
    assert balance.min() >= -TOLERANCE * moved


@pytest.mark.needs_jit
@given(tissue_=passive_tissues(), corners=legs(-1.0, DEPTH_MM + 1.0), back=st.floats(-2.5, 1.5))
@SETTINGS
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
@SETTINGS
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
    for dips, accepted in ((0.0, True), (1.0, True), (-1e-6, True), (-1.0, False)):
        q = touching + dips * dip
        as_static = model.join(q / scale, (fine / scale)[None, :], np.array([0.1]))
        as_stiffness = model.join(fine / scale, (q / scale)[None, :], np.array([0.1]))
        assert model.is_passive(as_static) is model.is_passive(as_stiffness) is accepted
