"""Deviation measures against their definitions."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.inference.trials import lag_one_correlation, nrmsd


def test_deviation_by_range_by_mean_and_in_newtons():
    force = np.array([0.0, 4.0, 8.0, 12.0])
    model = force + np.array([1.0, -1.0, 1.0, -1.0])
    found = nrmsd(force, model)
    assert found.rmse_N == pytest.approx(1.0)
    assert found.range == pytest.approx(1.0 / 12.0)
    assert found.mean == pytest.approx(1.0 / 6.0)


def test_range_is_that_of_the_measurement_not_of_the_model():
    assert nrmsd(np.array([0.0, 10.0]), np.array([0.0, 30.0])).range == pytest.approx(np.sqrt(200.0) / 10.0)


def test_negative_forces_have_a_positive_mean_deviation():
    assert nrmsd(np.array([-4.0, -8.0]), np.array([-5.0, -7.0])).mean == pytest.approx(1.0 / 6.0)


def test_constant_force_has_no_range():
    assert nrmsd(np.full(4, 5.0), np.full(4, 5.0)).range == 0.0
    assert nrmsd(np.full(4, 5.0), np.full(4, 6.0)).range == np.inf


def test_mean_deviation_of_a_force_of_both_signs_is_against_its_mean_size() -> None:
    # residuals 0 and 1: RMSE 1/sqrt(2); mean of |force| is 1
    assert nrmsd(np.array([-1.0, 1.0]), np.array([-1.0, 2.0])).mean == pytest.approx(np.sqrt(0.5))


def test_correlation_of_alternating_and_of_slow_residuals():
    n = 1000
    assert lag_one_correlation(np.resize([1.0, -1.0], n)) == pytest.approx(-(n - 1) / n)
    assert lag_one_correlation(np.sin(np.linspace(0.0, 6.28, n))) > 0.99


def test_correlation_of_an_autoregressive_residual():
    rng = np.random.default_rng(2)
    residual = np.zeros(200_000)
    noise = rng.normal(size=residual.size)
    for i in range(1, residual.size):
        residual[i] = 0.7 * residual[i - 1] + noise[i]
    # sd of the estimate is sqrt((1 - phi^2) / n) = 0.0016
    assert lag_one_correlation(residual + 100.0) == pytest.approx(0.7, abs=0.008)


@pytest.mark.parametrize("residual", [[1.0], [1.0, 2.0], [3.0, 3.0, 3.0]])
def test_too_little_to_correlate_is_no_correlation(residual):
    assert lag_one_correlation(np.array(residual)) == 0.0
