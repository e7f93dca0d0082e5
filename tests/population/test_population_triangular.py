"""Triangular factors of small matrices."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.population.kernels import factor, inverse_factor, solved


def test_factors_are_those_of_numpy() -> None:
    rng = np.random.default_rng(3)
    matrix, away = np.cov(rng.standard_normal((4, 20))), rng.standard_normal(4)
    low = np.linalg.cholesky(matrix)
    # condition numbers below a hundred: rounding only
    assert factor(matrix) == pytest.approx(low, rel=1e-10)
    assert inverse_factor(low) == pytest.approx(np.linalg.inv(low), rel=1e-10)
    assert solved(low, away) == pytest.approx(np.linalg.solve(low, away), rel=1e-10)


def test_a_matrix_that_is_not_positive_definite_has_no_factor() -> None:
    assert np.isnan(np.diag(factor(np.array([[1.0, 2.0], [2.0, 1.0]])))).any()
