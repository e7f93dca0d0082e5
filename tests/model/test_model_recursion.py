"""Recursion of the branch state against closed forms, an ODE solver and itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from passive_tissues import MODEL_SETTINGS, derivative, legs, sampled
from scipy.integrate import solve_ivp

from tissueid.model.kernels import step_weights
from tissueid.model.states import branch_sensitivity, branch_states

TAU_S = 0.021
SPEED_MM_S = 250.0 / 60.0


def branch_state(time: np.ndarray, depth: np.ndarray, tau_s: float) -> np.ndarray:
    """State of one branch."""
    return branch_states(time, depth, np.array([tau_s]))[0]


def uneven_path(n: int = 60, seed: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Steps from 0.01 to 100 relaxation times, in and out, with rows of dt = 0."""
    rng = np.random.default_rng(seed)
    step = TAU_S * 10.0 ** rng.uniform(-2.0, 2.0, n)
    step[rng.random(n) < 0.1] = 0.0
    depth = np.abs(np.cumsum(rng.normal(0.0, 0.4, n + 1)))
    depth[0] = 0.0
    return np.concatenate([[0.0], np.cumsum(step)]), depth


def test_uneven_path_matches_an_ode_solver_leg_by_leg() -> None:
    time, depth = uneven_path(25)
    actual, state = branch_state(time, depth, TAU_S), 0.0
    for h, moved, expected in zip(np.diff(time), np.diff(depth), actual[1:], strict=True):
        if h == 0.0:
            state += moved
        else:
            leg = solve_ivp(
                lambda _t, s, v=moved / h: v - s / TAU_S, (0.0, h), [state],
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
    cut = branch_state(cut_time, cut_depth, TAU_S)
    # a step of 1e-2 tau at the end of a 40 tau record: times round at 1e-14 of the step
    np.testing.assert_allclose(cut[::3], branch_state(time, depth, TAU_S), rtol=1e-11, atol=1e-12)


def test_steps_without_time_jump_and_very_large_ones_forget() -> None:
    depth = np.array([0.0, 0.5, 1.5, 1.2])
    state = branch_state(np.array([0.0, 0.01, 0.01, 0.01]), depth, TAU_S)
    np.testing.assert_allclose(np.diff(state)[1:], [1.0, -0.3], rtol=1e-14)
    for h in (0.0, 5e-324, 1e-300):
        assert step_weights(h, 100.0) == (1.0, 1.0)
    time, depth = np.array([0.0, 1e6, 2e6, 1e12]), np.array([0.0, 5.0, 1.0, 6.0])
    # what remains is the steady state v tau of each leg
    expected = TAU_S * np.diff(depth) / np.diff(time)
    np.testing.assert_allclose(branch_state(time, depth, TAU_S)[1:], expected, rtol=1e-12)


def test_long_hold_ends_in_exact_zeros_without_denormals() -> None:
    time = np.concatenate([[0.0, 0.48], 0.48 + 0.01 * np.arange(1, 3001)])
    depth = np.minimum(SPEED_MM_S * time, 2.0)
    smallest = np.finfo(np.float64).tiny
    for values in (branch_state(time, depth, TAU_S), *branch_sensitivity(time, depth, TAU_S)):
        assert values[-1] == 0.0
        assert not np.any((values != 0.0) & (np.abs(values) < smallest))


@pytest.mark.parametrize("tau", [1e-3, TAU_S, 0.9, 30.0, 5e3])
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
@MODEL_SETTINGS
def test_state_is_bounded_by_the_largest_excursion(corners: list[tuple[float, float]], tau: float) -> None:
    # s = x - (1/tau) int exp(-(t-u)/tau) x du: between x - max x and x, for a path that starts at 0
    time, depth = sampled(corners, 5)
    state = branch_state(time, depth, tau)
    assert np.all(state <= depth + 1e-12)
    assert np.all(state >= depth - np.maximum.accumulate(depth) - 1e-12)
