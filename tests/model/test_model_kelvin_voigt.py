"""Modified Kelvin-Voigt law: its recursion, closed forms, equation (5), sensitivities, its errors."""

from collections.abc import Callable

import numpy as np
import pytest
from closed_forms import ramp_hold_state
from hypothesis import given
from hypothesis import strategies as st
from passive_tissues import DEPTH_MM, SEED_MODEL, SEED_THETA, SETTINGS, derivative, legs, sampled, tissue
from scipy.integrate import solve_ivp
from tissue_stepper import TissueStepper

from tissueid.model.base import ContactPath
from tissueid.model.channels import loading_force
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.kernels import step_weights
from tissueid.model.states import branch_sensitivity, branch_states

BRANCHES_AND_DEGREES = [(b, d) for b in (1, 2, 3) for d in (0, 1, 2)]
every_tissue = pytest.mark.parametrize(("branches", "degree"), BRANCHES_AND_DEGREES)


def wavy_path(n: int) -> ContactPath:
    """Smooth loading and unloading between 0 and 7 mm in 1.6 s, unevenly sampled, at rest at the start."""
    time = 1.6 * np.linspace(0.0, 1.0, n) ** 1.5
    return ContactPath(time, 2.5 * (1.0 - np.cos(5.0 * time)) + 1.0 - np.cos(11.0 * time))


@every_tissue
@pytest.mark.parametrize("speed", [10.0 / 60.0, 500.0 / 60.0])
def test_constant_speed_from_rest_matches_closed_form(branches: int, degree: int, speed: float) -> None:
    model, theta = tissue(branches, degree)
    depth = np.linspace(0.0, DEPTH_MM, 300) ** 1.3 / DEPTH_MM**0.3
    expected = loading_force(model, theta, depth, speed_mm_s=speed)
    # both are exact; rounding of time steps over 300 samples
    np.testing.assert_allclose(model.force(theta, ContactPath(depth / speed, depth)), expected, rtol=1e-11)
    each = loading_force(model, theta, depth, speed_mm_s=np.full(300, speed))
    np.testing.assert_allclose(each, expected, rtol=1e-12)


@every_tissue
def test_ramp_and_hold_with_the_corner_on_the_grid_matches_closed_form(branches: int, degree: int) -> None:
    model, theta = tissue(branches, degree)
    speed, deepest = 4.0, 6.0
    time = np.concatenate([np.linspace(0.0, 1.5, 200), 1.5 + np.geomspace(1e-3, 40.0, 200)])
    depth = np.minimum(speed * time, deepest)
    taus = model.split(theta)[2]
    states = [ramp_hold_state(time, speed_mm_s=speed, depth_mm=deepest, tau_s=tau) for tau in taus]
    expected = model.static_force(theta, depth) + np.sum(model.stiffness(theta, depth) * states, axis=0)
    np.testing.assert_allclose(model.force(theta, ContactPath(time, depth)), expected, rtol=1e-9)


@pytest.mark.needs_jit
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_linear_legs_match_a_solver_of_equation_5(degree: int) -> None:
    (model, theta), path = tissue(1, degree), wavy_path(24)
    static, stiffness, tau = model.split(theta)
    fs, k = np.polynomial.Polynomial([0.0, *static]), np.polynomial.Polynomial(stiffness[0])

    def rate(x, v, f):
        return (fs.deriv()(x) + k(x)) * v + (k.deriv()(x) / k(x) * v - 1.0 / tau[0]) * (f - fs(x))

    # the same piecewise linear path for both: no error of sampling, only that of the solver
    force = np.zeros(path.time_s.size)
    for i in range(1, force.size):
        (start, end), (x0, x1) = path.time_s[i - 1 : i + 1], path.depth_mm[i - 1 : i + 1]
        v = (x1 - x0) / (end - start)
        leg = solve_ivp(
            lambda t, f, v=v, start=start, x0=x0: rate(x0 + v * (t - start), v, f),
            (start, end), force[i - 1 : i], method="DOP853", rtol=1e-12, atol=1e-12,
        )  # fmt: skip
        force[i] = leg.y[0, -1]
    # DOP853 at 1e-12 per step, some tens of steps a leg: 1e-10 of the 100 N peak is left to it
    np.testing.assert_allclose(model.force(theta, path), force, rtol=1e-9, atol=1e-8)


@every_tissue
def test_jacobian_matches_central_differences(branches: int, degree: int) -> None:
    model, theta = tissue(branches, degree)
    path = wavy_path(80)
    actual = model.jacobian(theta, path)
    assert actual.shape == (80, theta.size)
    for p, unit in enumerate(np.eye(theta.size)):
        d = 1e-4 * abs(theta[p])
        expected = derivative(lambda shift, unit=unit: model.force(theta + shift * unit, path), d)
        # truncation 1e-16; rounding of forces up to 300 N: 300 * 2e-16 / d
        np.testing.assert_allclose(actual[:, p], expected, rtol=1e-7, atol=3e-13 / d)


def test_model_without_branches_is_its_static_curve() -> None:
    model, theta, path = kelvin_voigt(0, 0, DEPTH_MM), np.array([12.0, -1.5, 0.35]), wavy_path(30)
    x = path.depth_mm
    expected = 12.0 * x - 1.5 * x**2 + 0.35 * x**3
    np.testing.assert_allclose(model.force(theta, path), expected, rtol=1e-13, atol=1e-13)
    assert model.is_passive(theta)


@pytest.mark.parametrize(
    "use",
    [
        lambda theta: SEED_MODEL.force(theta, wavy_path(3)),
        lambda theta: SEED_MODEL.jacobian(theta, wavy_path(3)),
        SEED_MODEL.is_passive,
        lambda theta: TissueStepper(SEED_MODEL, theta),
    ],
)
def test_theta_of_the_wrong_length_is_refused_with_the_length_needed(use: Callable[..., object]) -> None:
    with pytest.raises(ValueError, match=r"theta has shape \(4,\), \(5,\) is needed"):
        use(SEED_THETA[:-1])


def test_split_inverts_join_and_branches_are_ordered_by_relaxation_time() -> None:
    model, static = kelvin_voigt(2, 1, DEPTH_MM), np.array([1.0, 2.0, 3.0])
    theta = model.join(static, np.array([[10.0, 11.0], [20.0, 21.0]]), np.array([5.0, 0.1]))
    np.testing.assert_array_equal(theta, [1.0, 2.0, 3.0, 20.0, 21.0, 0.1, 10.0, 11.0, 5.0])
    np.testing.assert_array_equal(model.join(*model.split(theta)), theta)


@pytest.mark.parametrize(
    ("change", "passive"),
    [
        ({}, True),
        ({0: -1e-3}, False),  # F_s < 0 just after contact
        ({2: -1.0}, False),  # F_s < 0 at full depth
        ({3: -1e-6}, False),  # K < 0 throughout
        ({3: 0.0}, True),
        ({4: 0.0}, False),  # tau
        ({4: -0.1}, False),
        ({4: np.nan}, False),
        ({1: np.inf}, False),
    ],
)
def test_passive_means_static_force_and_stiffness_are_not_negative(change, passive) -> None:
    theta = SEED_THETA.copy()
    for i, value in change.items():
        theta[i] = value
    assert SEED_MODEL.is_passive(theta) is passive


def test_passivity_is_demanded_up_to_the_identified_depth_only() -> None:
    theta = np.array([10.0, 0.0, 0.0, 5.0, -1.0, 0.1])  # K = 5 - x
    verdicts = [kelvin_voigt(1, 1, depth).is_passive(theta) for depth in (4.999, 5.0, 5.001)]
    assert verdicts == [True, True, False]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((4, 0, 8.0), "4 branches are not offered, 0 to 3 are"),
        ((-1, 0, 8.0), "-1 branches are not offered"),
        ((1, 3, 8.0), "degree 3 of K is not offered, 0 to 2 are"),
        ((1, -1, 8.0), "degree -1 of K is not offered"),
        ((1, 0, 0.0), "depth_mm must be positive, is 0.0"),
        ((1, 0, float("nan")), "depth_mm must be positive, is nan"),
    ],
)
def test_model_refuses_what_it_does_not_offer(arguments: tuple[int, int, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kelvin_voigt(*arguments)


@every_tissue
def test_stepper_replays_a_path_as_force_computes_it(branches: int, degree: int) -> None:
    """In and hold, small withdrawals that keep contact, uneven steps, a row of dt = 0, a long gap."""
    model, theta = tissue(branches, degree)
    step = 10.0 ** np.random.default_rng(11).uniform(-3.5, -1.5, 199)
    step[50], step[120] = 0.0, 25.0
    held, back = np.full(40, 7.5), 7.5 - 0.01 * np.arange(1, 21)
    depth = np.concatenate([np.linspace(0.0, 7.5, 120), held, back, np.full(20, 7.3)])
    expected = model.force(theta, ContactPath(np.append(0.0, np.cumsum(step)), depth))
    assert expected[1:].min() > 0.0  # in contact throughout, so that the two must be the same
    stepper, other = TissueStepper(model, theta), TissueStepper(model, theta)
    actual = [stepper.step(x, h) for x, h in zip(depth, np.append(0.0, step), strict=True)]
    np.testing.assert_allclose(actual, expected, rtol=1e-9, atol=1e-12)
    # two steppers do not share their state
    assert other.step(2.0, 0.01) == TissueStepper(model, theta).step(2.0, 0.01)


FAST_S = 0.021
SPEED_MM_S = 250.0 / 60.0


def branch_state(time: np.ndarray, depth: np.ndarray, tau_s: float) -> np.ndarray:
    return branch_states(time, depth, np.array([tau_s]))[0]


def uneven_path(n: int = 60, seed: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Steps from 0.01 to 100 relaxation times, in and out, with rows of dt = 0."""
    rng = np.random.default_rng(seed)
    step = FAST_S * 10.0 ** rng.uniform(-2.0, 2.0, n)
    step[rng.random(n) < 0.1] = 0.0
    depth = np.abs(np.cumsum(rng.normal(0.0, 0.4, n + 1)))
    depth[0] = 0.0
    return np.concatenate([[0.0], np.cumsum(step)]), depth


def test_uneven_path_matches_an_ode_solver_leg_by_leg() -> None:
    time, depth = uneven_path(25)
    actual, state = branch_state(time, depth, FAST_S), 0.0
    for h, moved, expected in zip(np.diff(time), np.diff(depth), actual[1:], strict=True):
        if h == 0.0:
            state += moved
        else:
            leg = solve_ivp(
                lambda _t, s, v=moved / h: v - s / FAST_S, (0.0, h), [state],
                method="LSODA", rtol=1e-12, atol=1e-13,
            )  # fmt: skip
            state = leg.y[0, -1]
        # LSODA keeps 1e-12 per step of its own; some hundred of them may add up
        assert expected == pytest.approx(state, rel=1e-9, abs=1e-10)


def test_a_step_may_be_cut_anywhere_without_changing_the_state() -> None:
    time, depth = uneven_path(20)
    share = np.array([0.3, 0.9, 1.0])
    cut_time, cut_depth = (
        np.append(one[0], (one[:-1, None] + share * np.diff(one)[:, None]).ravel()) for one in (time, depth)
    )
    cut = branch_state(cut_time, cut_depth, FAST_S)
    # a step of 1e-2 tau at the end of a 40 tau record: times round at 1e-14 of the step
    np.testing.assert_allclose(cut[::3], branch_state(time, depth, FAST_S), rtol=1e-11, atol=1e-12)


def test_steps_without_time_jump_and_very_large_ones_forget() -> None:
    depth = np.array([0.0, 0.5, 1.5, 1.2])
    state = branch_state(np.array([0.0, 0.01, 0.01, 0.01]), depth, FAST_S)
    np.testing.assert_allclose(np.diff(state)[1:], [1.0, -0.3], rtol=1e-14)
    for h in (0.0, 5e-324, 1e-300):
        assert step_weights(h, 100.0) == (1.0, 1.0)
    time, depth = np.array([0.0, 1e6, 2e6, 1e12]), np.array([0.0, 5.0, 1.0, 6.0])
    # what remains is the steady state v tau of each leg
    expected = FAST_S * np.diff(depth) / np.diff(time)
    np.testing.assert_allclose(branch_state(time, depth, FAST_S)[1:], expected, rtol=1e-12)


def test_long_hold_ends_in_exact_zeros_without_denormals() -> None:
    time = np.concatenate([[0.0, 0.48], 0.48 + 0.01 * np.arange(1, 3001)])
    depth = np.minimum(SPEED_MM_S * time, 2.0)
    smallest = np.finfo(np.float64).tiny
    for values in (branch_state(time, depth, FAST_S), *branch_sensitivity(time, depth, FAST_S)):
        assert values[-1] == 0.0
        assert not np.any((values != 0.0) & (np.abs(values) < smallest))


@pytest.mark.parametrize("tau", [1e-3, FAST_S, 0.9, 30.0, 5e3])
def test_sensitivity_matches_central_differences(tau: float) -> None:
    time, depth = uneven_path()
    _, found = branch_sensitivity(time, depth, tau)
    expected = derivative(lambda shift: branch_state(time, depth, tau + shift), 1e-4 * tau)
    # fourth order in 1e-4: truncation 1e-16, rounding of states up to 2 mm 2e-16 * 2 / 1e-4 = 5e-12 / tau
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=2e-11 / tau)


@pytest.mark.parametrize("ratio", [1e-7, 0.99e-4, 1.01e-4, 1e-2])
def test_sensitivity_of_a_short_step_keeps_its_digits(ratio: float) -> None:
    # one step: ds/dtau = dphi/dtau dx = (r/2 - r^2/3 + r^3/8 - r^4/30 + ...) / tau, by its series
    expected = ratio * (1 / 2 - ratio * (1 / 3 - ratio * (1 / 8 - ratio * (1 / 30 - ratio / 144))))
    _, found = branch_sensitivity(np.array([0.0, ratio]), np.array([0.0, 1.0]), 1.0)
    # beyond 1e-4 the difference of two numbers near 1 leaves 1e-16 / (r/2) = 4e-12
    assert found[1] == pytest.approx(expected, rel=2e-11, abs=0.0)


@given(corners=legs(0.0, 8.0), tau=st.floats(-2.0, 1.0).map(lambda e: 10.0**e))
@SETTINGS
def test_state_is_bounded_by_the_largest_excursion(corners: list[tuple[float, float]], tau: float) -> None:
    # s = x - (1/tau) int exp(-(t-u)/tau) x du: between x - max x and x, for a path that starts at 0
    time, depth = sampled(corners, 5)
    state = branch_state(time, depth, tau)
    assert np.all(state <= depth + 1e-12)
    assert np.all(state >= depth - np.maximum.accumulate(depth) - 1e-12)
