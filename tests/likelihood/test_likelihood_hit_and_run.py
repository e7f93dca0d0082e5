"""A walk along lines through a normal that is cut to the passive set."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import truncnorm

from tissueid.likelihood.bernstein import is_passive, to_powers
from tissueid.likelihood.hit_and_run import cut_normal, stretch, walk

#: One quadratic and one line.
BLOCKS = np.array([3, 2])


@pytest.mark.parametrize(
    ("low", "high"), [(-1.0, 2.0), (3.0, np.inf), (-np.inf, -9.0), (40.0, 41.0), (-0.5, np.inf)]
)
def test_quantiles_of_a_cut_normal_are_those_of_scipy(low, high):
    share = np.array([0.001, 0.2, 0.5, 0.9, 0.999])
    found = [cut_normal(low, high, u) for u in share]
    # scipy loses digits far out in the tail: 1e-8 is what it is good for at 40 sd
    assert found == pytest.approx(truncnorm.ppf(share, low, high), rel=1e-8)


def test_a_stretch_ends_where_the_polynomial_leaves_the_passive_set():
    rng = np.random.default_rng(1)
    touched = 0
    for _ in range(300):
        c = np.concatenate([rng.uniform(0.1, 1.0, 3), rng.uniform(0.1, 1.0, 2)])
        c[1] = rng.uniform(-0.95, 1.0) * np.sqrt(c[0] * c[2])
        e = rng.standard_normal(5)
        low, high = stretch(c, e, BLOCKS)
        assert low < 0.0 < high
        for end in (low, high):
            if not np.isfinite(end):
                assert is_passive(to_powers(c + np.sign(end) * 1e6 * e, BLOCKS), BLOCKS)
                continue
            assert is_passive(to_powers(c + (1.0 - 1e-9) * end * e, BLOCKS), BLOCKS)
            assert not is_passive(to_powers(c + (1.0 + 1e-6) * end * e, BLOCKS), BLOCKS)
            touched += 1
    assert touched > 300


@pytest.mark.needs_jit
def test_a_walk_from_a_corner_ends_up_as_plain_rejection_does():
    rng = np.random.default_rng(2)
    a = rng.standard_normal((5, 7))
    low = np.linalg.cholesky(a @ a.T / 7.0)
    mean = np.array([0.1, -0.3, 0.2, -0.4, 0.5])
    plain = mean + rng.standard_normal((400_000, 5)) @ low.T
    c0, c1, c2 = plain[:, 0], plain[:, 1], plain[:, 2]
    inside = (c0 >= 0.0) & (c2 >= 0.0) & (plain[:, 3:] >= 0.0).all(axis=1)
    inside &= c1 >= -np.sqrt(np.maximum(c0 * c2, 0.0))
    expected = plain[inside]
    start = np.linalg.solve(low, np.array([3.0, 4.0, 5.0, 2.0, 0.1]) - mean)
    found = np.array([walk(start, mean, low, BLOCKS, 125, rng) for _ in range(8_000)])
    # four standard errors of 8,000 independent draws
    error = expected.std(axis=0) / np.sqrt(len(found))
    assert (np.abs(found.mean(axis=0) - expected.mean(axis=0)) < 4.0 * error).all()
    for share in (0.05, 0.5, 0.95):
        below = (found < np.quantile(expected, share, axis=0)).mean(axis=0)
        assert below == pytest.approx(share, abs=4.0 * np.sqrt(share * (1.0 - share) / len(found)))
