"""Whitening of block means against a dense covariance that is summed sample by sample."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from tissueid.inference.noise import Memory, whitener

STEP = 0.01


def dense(count, first_s, step_s, chain, memory):
    """Covariance of block means of an AR(1) and white noise of unit variance together."""
    times = [t + h * np.arange(n) for t, h, n in zip(first_s, step_s, count, strict=True)]
    of = np.cumsum(chain)
    out = np.zeros((count.size, count.size))
    for i, one in enumerate(times):
        for j, other in enumerate(times):
            if of[i] != of[j]:
                continue
            apart = np.abs(one[:, None] - other)
            both = (1.0 - memory.white) * (
                np.exp(-apart / memory.time_s) if memory.time_s > 0.0 else apart == 0
            )
            out[i, j] = (both + memory.white * (apart == 0.0)).mean()
    return out


def laid_out(count, step_s, gap_s):
    """Time of the first sample of each block."""
    first = [0.0]
    for n, h, gap in zip(count[:-1], step_s[:-1], gap_s[1:], strict=True):
        first.append(first[-1] + (n - 1) * h + gap)
    return np.array(first)


CASES = {
    "samples": (np.ones(40, dtype=int), None, None),
    "alike": (np.full(12, 5), None, None),
    "growing": (np.array([1, 1, 2, 3, 1, 5, 8, 13, 40, 7, 1]), None, None),
    "gap": (np.array([3, 1, 4, 1, 5, 9, 2]), [3], None),
    "late": (np.array([3, 1, 4, 1, 5, 9, 2]), None, 4),
}


@pytest.mark.parametrize("case", list(CASES))
@pytest.mark.parametrize(
    "memory", [Memory(), Memory(0.005), Memory(0.1), Memory(1.0), Memory(0.1, 0.3), Memory(1.0, 0.9)]
)
def test_determinant_and_quadratic_form_are_those_of_the_dense_covariance(case, memory):
    count, starts, late = CASES[case]
    chain = np.arange(count.size) == 0
    if starts is not None:
        chain[starts] = True
    step = np.full(count.size, STEP)
    gap = np.full(count.size, STEP)
    if late is not None:
        gap[late] = 7.3 * STEP
    covariance = dense(count, laid_out(count, step, gap), step, chain, memory)
    columns = np.random.default_rng(1).standard_normal((count.size, 3))
    white = whitener(count.astype(float), step, gap, chain, memory)
    whitened = white(columns)
    assert white.log_det == pytest.approx(float(np.linalg.slogdet(covariance)[1]), abs=1e-9)
    np.testing.assert_allclose(
        whitened.T @ whitened, columns.T @ np.linalg.solve(covariance, columns), rtol=1e-9, atol=1e-9
    )
    np.testing.assert_array_equal(white(columns[:, 0]), whitened[:, 0])


def test_blocks_of_different_steps_are_whitened_exactly():
    rng = np.random.default_rng(2)
    count, step = rng.integers(1, 9, 15), STEP * rng.uniform(0.3, 3.0, 15)
    gap = step * rng.uniform(1.0, 4.0, 15)
    chain = np.arange(15) == 0
    memory = Memory(0.07, 0.2)
    covariance = dense(count, laid_out(count, step, gap), step, chain, memory)
    e = rng.standard_normal(15)
    white = whitener(count.astype(float), step, gap, chain, memory)
    assert white(e) @ white(e) == pytest.approx(float(e @ np.linalg.solve(covariance, e)), rel=1e-9)
    assert white.log_det == pytest.approx(float(np.linalg.slogdet(covariance)[1]), abs=1e-9)


def test_a_long_series_becomes_white():
    rng = np.random.default_rng(3)
    phi, n = 0.9, 20_000
    noise = lfilter([np.sqrt(1.0 - phi**2)], [1.0, -phi], rng.standard_normal(n))
    ones = np.ones(n)
    white = whitener(ones, STEP * ones, STEP * ones, np.arange(n) == 0, Memory(-STEP / np.log(phi)))
    left = white(noise)
    # 20,000 samples: a correlation is known to 0.007, a variance to 1 %
    assert left.var() == pytest.approx(1.0, abs=0.04)
    assert abs(np.corrcoef(left[1:], left[:-1])[0, 1]) < 0.03
    assert np.corrcoef(noise[1:], noise[:-1])[0, 1] > 0.87


def test_noise_that_lasts_for_ever_divides_by_nothing() -> None:
    count, step = np.ones(6), np.full(6, 0.01)
    chain = np.array([True, False, False, False, False, False])

    white = whitener(count, step, step, chain, Memory(time_s=1e18, white=0.0))

    assert np.isfinite(white(np.arange(6.0)[:, None])).all()
    assert np.isfinite(white.log_det)
