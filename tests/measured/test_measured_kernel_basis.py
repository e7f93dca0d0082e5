"""The node basis against the exact recursion."""

from __future__ import annotations

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tissueid.measured.exponentials import TAU_ABOVE_LENGTH, TAU_BELOW_STEP, kernel_basis
from tissueid.model.states import branch_sensitivity

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"
LONG = 300 if JIT_OFF else 5000

#: Pivots are dropped below 1e-10, so states come out a little better than 1e-9 relative.
STATE = 1e-9
SLOPE = 3e-8


def bounds(step_s, length_s):
    """Range of ln tau that recordings of a step and a length are fitted in."""
    return np.log(step_s / TAU_BELOW_STEP), np.log(length_s * TAU_ABOVE_LENGTH)


def node_states(basis, time_s, depth_mm):
    return np.stack([branch_sensitivity(time_s, depth_mm, float(tau))[0] for tau in basis.tau_s])


def worst_errors(basis, time_s, depth_mm, log_taus):
    """Largest error of state and slope by ln tau, relative to the largest value along the path."""
    states = node_states(basis, time_s, depth_mm)
    value, slope = 0.0, 0.0
    c, dc = basis.weights(np.asarray(log_taus, dtype=float))
    for j, log_tau in enumerate(log_taus):
        exact, by_tau = branch_sensitivity(time_s, depth_mm, float(np.exp(log_tau)))
        by_log = by_tau * np.exp(log_tau)
        value = max(value, np.abs(c[:, j] @ states - exact).max() / np.abs(exact).max())
        slope = max(slope, np.abs(dc[:, j] @ states - by_log).max() / np.abs(by_log).max())
    return value, slope


@pytest.mark.needs_jit
@pytest.mark.parametrize("step_s", [1e-3, 0.01, 0.1])
@pytest.mark.parametrize("path", ["ramp", "ramp and hold", "walk", "sine"])
def test_states_of_any_relaxation_time_follow_from_the_nodes(step_s, path):
    n = LONG
    count = np.arange(n)
    depth = {
        "ramp": count * 1e-3,
        "ramp and hold": np.minimum(count, n // 10) * 1e-3,
        "walk": np.cumsum(np.random.default_rng(1).normal(size=n)),
        "sine": 1.0 - np.cos(count / n * 20.0),
    }[path]
    time = count * step_s
    basis = kernel_basis(step_s=step_s, length_s=time[-1])
    taus = np.linspace(*bounds(step_s, time[-1]), 9 if JIT_OFF else 61)
    value, slope = worst_errors(basis, time, depth, taus)
    assert value <= STATE
    assert slope <= SLOPE


@settings(max_examples=8 if JIT_OFF else 60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(8, 400),
    log_step=st.floats(-7.0, -1.0),
    spread=st.floats(0.0, 3.0),
    share=st.floats(0.0, 1.0),
)
def test_states_follow_from_the_nodes_on_random_paths_with_uneven_steps(seed, n, log_step, spread, share):
    rng = np.random.default_rng(seed)
    step = float(np.exp(log_step))
    steps = step * np.exp(spread * rng.uniform(0.0, 1.0, size=n - 1))
    steps[0] = step
    time = np.concatenate([[0.0], np.cumsum(steps)])
    depth = np.concatenate([[0.0], np.cumsum(rng.normal(size=n - 1))])
    basis = kernel_basis(step_s=step, length_s=time[-1])
    low, high = bounds(step, time[-1])
    value, slope = worst_errors(basis, time, depth, [low + share * (high - low)])
    assert value <= STATE
    assert slope <= SLOPE


def test_repeated_times_and_bursts_of_finer_steps_cost_one_digit_only():
    # both are faster than the step the basis was built for; they are allowed, at a lower accuracy
    rng = np.random.default_rng(4)
    for finer in (0.0, 0.02):
        steps = np.full(LONG - 1, 0.01)
        steps[::7] *= finer
        time = np.concatenate([[0.0], np.cumsum(steps)])
        depth = np.concatenate([[0.0], np.cumsum(rng.normal(size=LONG - 1))])
        basis = kernel_basis(step_s=0.01, length_s=time[-1])
        taus = np.linspace(*bounds(0.01, time[-1]), 7 if JIT_OFF else 31)
        value, _ = worst_errors(basis, time, depth, taus)
        assert value <= 3e-8


def test_weights_slope_is_the_derivative_of_the_weights():
    basis = kernel_basis(step_s=0.01, length_s=20.0)
    at = np.array([-3.0, 0.2, 2.5])
    h = 1e-4
    # single weights are ill-determined, what they do to a decay is not
    decay = np.exp(-np.array([[0.02], [0.5], [3.0]]) / basis.tau_s) * basis.mean_over_step(basis.tau_s)
    difference = decay @ (basis.weights(at + h)[0] - basis.weights(at - h)[0]) / (2 * h)
    np.testing.assert_allclose(decay @ basis.weights(at)[1], difference, atol=1e-7)


def test_nodes_are_ascending_and_few():
    basis = kernel_basis(step_s=1e-3, length_s=48.0)
    assert (np.diff(basis.tau_s) > 0.0).all()
    assert basis.tau_s.size <= 65
    assert basis.log_bounds[0] <= np.log(1e-3 / 5.0)
    assert basis.log_bounds[1] >= np.log(480.0)


def test_recordings_of_nearly_the_same_step_and_length_share_one_basis():
    first = kernel_basis(step_s=0.0100, length_s=30.0)
    assert kernel_basis(step_s=0.0101, length_s=30.2) is first
    assert kernel_basis(step_s=0.02, length_s=30.0) is not first


def test_rounding_of_step_and_length_is_outwards():
    rng = np.random.default_rng(7)
    for _ in range(20):
        step = float(np.exp(rng.uniform(-8.0, 0.0)))
        length = step * float(np.exp(rng.uniform(1.0, 8.0)))
        found, wanted = kernel_basis(step_s=step, length_s=length).log_bounds, bounds(step, length)
        assert found[0] <= wanted[0] + 1e-12
        assert found[1] >= wanted[1] - 1e-12


@pytest.mark.parametrize(
    ("step", "length"),
    [(0.0, 1.0), (-0.1, 1.0), (1.0, 1.0), (2.0, 1.0), (0.1, float("inf")), (float("nan"), 1.0)],
)
def test_step_and_length_out_of_order_are_refused_with_both_numbers(step, length):
    with pytest.raises(ValueError, match=r"0 < step < length.*step .* s and length"):
        kernel_basis(step_s=step, length_s=length)
