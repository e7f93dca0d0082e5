"""The node basis: every exponential of a window is a mixture of a few."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.measured.exponentials import TAU_ABOVE_LENGTH, TAU_BELOW_STEP, kernel_basis


def bounds(step_s, length_s):
    """Range of ln tau that recordings of a step and a length are fitted in."""
    return np.log(step_s / TAU_BELOW_STEP), np.log(length_s * TAU_ABOVE_LENGTH)


def decays(basis, time_s, tau_s):
    """Exponentials as the basis mixes them: each times the mean over the step that it is averaged over."""
    return np.exp(-time_s[:, None] / tau_s) * basis.mean_over_step(tau_s)


@pytest.mark.parametrize(
    ("step_s", "length_s"), [(1e-3, 5.0), (1e-3, 48.0), (0.01, 50.0), (0.1, 500.0), (0.5, 4.0)]
)
def test_exponentials_of_any_relaxation_time_follow_from_the_nodes(step_s, length_s):
    basis = kernel_basis(step_s=step_s, length_s=length_s)
    log_tau = np.linspace(*bounds(step_s, length_s), 61)
    time = np.concatenate([np.arange(0.0, length_s, max(step_s, length_s / 5000)), [length_s]])
    value, slope = (decays(basis, time, basis.tau_s) @ weights for weights in basis.weights(log_tau))
    # pivots are dropped below 1e-10
    np.testing.assert_allclose(value, decays(basis, time, np.exp(log_tau)), atol=1e-9)
    h = 1e-4
    changed = decays(basis, time, np.exp(log_tau + h)) - decays(basis, time, np.exp(log_tau - h))
    np.testing.assert_allclose(slope, changed / (2 * h), atol=1e-7)


def test_nodes_are_ascending_and_few():
    basis = kernel_basis(step_s=1e-3, length_s=48.0)
    assert (np.diff(basis.tau_s) > 0.0).all()
    assert basis.tau_s.size <= 65


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
