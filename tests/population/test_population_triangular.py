"""Products of small triangular factors."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.population.triangular import squared_distances


def test_squared_distances_are_those_of_the_inverse_covariance() -> None:
    rng = np.random.default_rng(3)
    points, means = rng.standard_normal((50, 4)), rng.standard_normal((3, 4))
    lows = np.linalg.cholesky(np.array([np.cov(rng.standard_normal((4, 20))) for _ in means]))
    found = squared_distances(points, means, lows)

    away = points[:, None] - means
    expected = np.einsum("nki,kij,nkj->nk", away, np.linalg.inv(lows @ lows.transpose(0, 2, 1)), away)
    # condition numbers below a hundred: rounding only
    assert found == pytest.approx(expected, rel=1e-10)
