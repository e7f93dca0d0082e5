"""Sums on knots at any correlation, and the density of the noise alone."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from tissueid.likelihood.knots import KnotSums, knot_sums, packed
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.sums import LogData
from tissueid.posterior.loose_noise import LOOSE, LooseNoise, loose_noise
from tissueid.priors import Priors, SpreadPrior

STEP, N = 0.1, 120
OPTIMUM = Optimum(
    theta=np.array([1.0, 0.0, 0.5, 2.0]),
    log_tau=np.log([0.5]),
    gamma=np.zeros(2),
    delta=np.zeros(2),
    own=np.zeros((2, 4)),
    scale=3.0,
    degree=0,
)


def logs(*, jitter: float = 0.0) -> tuple[list[LogData], list[np.ndarray]]:
    """Two ramps with a hold, and residuals that follow each other."""
    rng = np.random.default_rng(20261201)
    data, residuals = [], []
    for speed in (0.5, 1.0):
        time = np.cumsum(np.full(N, STEP) * np.exp(jitter * rng.standard_normal(N)))
        depth = np.minimum(speed * time, 3.0)
        walk = np.cumsum(0.05 * rng.standard_normal(N))
        data.append(LogData(time, depth, walk, np.ones(N, bool), np.zeros(N, dtype=np.int64)))
        residuals.append(walk)
    return data, residuals


def sums(phi: float, *, jitter: float = 0.0) -> list[KnotSums]:
    return [
        knot_sums(one, left, phi=phi, reference_step_s=STEP)
        for one, left in zip(*logs(jitter=jitter), strict=True)
    ]


def known(arctanh_phi: float, sd: float, *, steps: int = 1, jitter: float = 0.0) -> LooseNoise:
    target = SimpleNamespace(
        data=SimpleNamespace(branches=1, has_phi=True),
        mode=np.array([math.log(0.5), math.log(0.1), arctanh_phi]),
        covariance=np.diag([0.01, sd**2, sd**2]),
    )
    links = (np.arange(1.0, steps + 1.0), np.full(steps, 2.0 * (N - 1) / steps))
    found = loose_noise(target, links, 2 * N, lambda phi: sums(phi, jitter=jitter))  # type: ignore[arg-type]
    assert found is not None
    return found


@pytest.mark.parametrize("arctanh_phi", [0.3, 1.5, 3.0, 4.5])
def test_sums_at_any_correlation_are_those_of_a_pass_over_the_samples(arctanh_phi: float) -> None:
    noise = known(2.0, 0.6)
    data = packed(sums(0.5), OPTIMUM, ())
    found = noise.at(data, np.array([0.0, arctanh_phi]))
    direct = packed(sums(math.tanh(arctanh_phi)), OPTIMUM, ())
    # 1 - phi^2 is 5e-4 at the largest: three digits fewer than rounding
    np.testing.assert_allclose(found.square, direct.square, rtol=1e-10)
    np.testing.assert_allclose(found.pull, direct.pull, rtol=1e-8, atol=1e-9 * np.abs(direct.pull).max())
    np.testing.assert_allclose(found.band, direct.band, rtol=1e-8, atol=1e-9 * np.abs(direct.band).max())


def test_sums_of_a_clock_that_trembles_are_nearly_those() -> None:
    noise = known(2.0, 0.3, steps=3, jitter=0.1)
    data = packed(sums(0.5, jitter=0.1), OPTIMUM, ())
    for arctanh_phi in (1.2, 2.0, 2.8):
        found = noise.at(data, np.array([0.0, arctanh_phi]))
        direct = packed(sums(math.tanh(arctanh_phi), jitter=0.1), OPTIMUM, ())
        # a hundredth of the change over one standard deviation of phi, which is a third
        np.testing.assert_allclose(found.square, direct.square, rtol=3e-3)


def test_density_of_noise_is_that_of_all_samples() -> None:
    noise = known(1.0, 0.4)
    data = packed(sums(0.5), OPTIMUM, ())
    priors = Priors(sigma_N=SpreadPrior(0.1, 0.5))
    _, residuals = logs()
    lag = np.abs(np.subtract.outer(np.arange(N), np.arange(N)))

    def here(point: np.ndarray) -> float:
        square = noise.at(data, point).square.sum()
        return noise.log_weight(point, priors) - 0.5 * float(square) * math.exp(-2.0 * point[0])

    def dense(point: np.ndarray) -> float:
        covariance = math.exp(2.0 * point[0]) * math.tanh(point[1]) ** lag
        value = sum(multivariate_normal.logpdf(one, cov=covariance) for one in residuals)
        # uniform in phi, normal in ln sigma
        return float(value) - 2.0 * math.log(math.cosh(point[1])) - 2.0 * (point[0] - math.log(0.1)) ** 2

    first, second = np.array([-2.0, 0.8]), np.array([-1.5, 1.6])
    assert here(second) - here(first) == pytest.approx(dense(second) - dense(first), rel=1e-8)


def test_noise_that_is_well_known_is_held() -> None:
    target = SimpleNamespace(
        data=SimpleNamespace(branches=1, has_phi=False),
        mode=np.zeros(2),
        covariance=np.diag([0.01, (0.9 * LOOSE) ** 2]),
    )
    assert loose_noise(target, (np.ones(1), np.ones(1)), N, sums) is None  # type: ignore[arg-type]


def test_coordinates_stay_where_sums_were_taken() -> None:
    noise = known(2.0, 0.6)
    low, high = noise.cuts(Priors())
    assert np.tanh(low[1]) == pytest.approx(noise.phi[0])
    assert np.tanh(high[1]) == pytest.approx(noise.phi[-1])
    # a stated range that is narrower is the range
    low, high = noise.cuts(Priors(phi=(0.5, 0.99)))
    assert (np.tanh(low[1]), np.tanh(high[1])) == pytest.approx((0.5, 0.99))
