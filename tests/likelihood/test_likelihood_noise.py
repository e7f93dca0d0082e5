"""Noise models estimated from residuals, against dense covariance matrices and known truths."""

from __future__ import annotations

import math
import os

import numpy as np
import pytest

from tissueid.likelihood.noise import NoiseChain, estimate_noise, moving_average, noise_chain
from tissueid.likelihood.sums import LogData

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"
SEEDS = 40
needs_jit = pytest.mark.skipif(JIT_OFF, reason="too slow without compilation")


def simulated(rng, ratio, starts, phi, white_sd, slow_sd):
    """Residuals of white noise plus AR(1), one sample after the other."""
    out = np.empty(ratio.size)
    slow = 0.0
    for n in range(ratio.size):
        rho = 0.0 if starts[n] else phi ** ratio[n]
        slow = rho * slow + math.sqrt(1.0 - rho**2) * slow_sd * rng.normal()
        out[n] = slow + white_sd * rng.normal()
    return out


def chain(rng, n, phi, *, white=0.0, slow=1.0, clock="uniform"):
    ratio = np.ones(n)
    starts = np.zeros(n, dtype=bool)
    starts[0] = True
    if clock == "irregular":
        ratio = rng.uniform(0.3, 3.0, size=n)
    if clock == "gaps":
        starts[rng.integers(1, n, size=max(n // 300, 2))] = True
    return NoiseChain(simulated(rng, ratio, starts, phi, white, slow), starts, ratio)


def covariance(chain_, phi, white_share, variance):
    """Dense covariance matrix of a chain."""
    time = np.cumsum(np.where(chain_.starts, 0.0, chain_.ratio))
    segment = np.cumsum(chain_.starts)
    apart = np.abs(time[:, None] - time[None, :])
    slow = (1.0 - white_share) * phi**apart * (segment[:, None] == segment[None, :])
    return variance * (slow + white_share * np.eye(time.size))


@pytest.mark.parametrize("clock", ["uniform", "irregular", "gaps"])
@pytest.mark.parametrize(("phi", "white", "slow"), [(0.9, 0.0, 1.0), (0.97, 1.0, 0.7)])
def test_log_likelihood_is_that_of_the_dense_normal(clock, phi, white, slow):
    rng = np.random.default_rng(5)
    logs = [chain(rng, 150, phi, white=white, slow=slow, clock=clock) for _ in range(2)]
    found = estimate_noise(logs)
    expected = 0.0
    for one in logs:
        matrix = covariance(one, found.phi, found.white_share, found.sigma_N**2)
        _, log_det = np.linalg.slogdet(2.0 * math.pi * matrix)
        expected -= 0.5 * (log_det + float(one.residual_N @ np.linalg.solve(matrix, one.residual_N)))
    assert found.log_likelihood == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("clock", ["uniform", "irregular", "gaps"])
@pytest.mark.parametrize("phi", [0.5, 0.9, 0.99, 0.999])
@needs_jit
def test_ar1_is_found_within_its_standard_error(clock, phi):
    rng = np.random.default_rng(11)
    logs = [chain(rng, 20_000, phi, slow=0.4, clock=clock) for _ in range(4)]
    found = estimate_noise(logs)
    # information of the correlation time L = -1/ln(phi): at worst 2 L samples count for one
    samples = 80_000 * (1.0 - phi)
    assert found.model == "ar1"
    assert math.log(math.log(found.phi) / math.log(phi)) == pytest.approx(0.0, abs=4.5 / math.sqrt(samples))
    assert found.sigma_N == pytest.approx(0.4, rel=4.5 / math.sqrt(samples))
    assert found.moving_average == 0.0


@pytest.mark.parametrize(("phi", "white", "slow"), [(0.99, 1.0, 0.5), (0.9, 0.5, 1.0), (0.999, 1.0, 1.0)])
@needs_jit
def test_white_plus_ar1_is_told_apart(phi, white, slow):
    rng = np.random.default_rng(12)
    logs = [chain(rng, 20_000, phi, white=white, slow=slow) for _ in range(4)]
    found = estimate_noise(logs)
    share = white**2 / (white**2 + slow**2)
    assert found.model == "white+ar1"
    assert math.log(math.log(found.phi) / math.log(phi)) == pytest.approx(0.0, abs=0.5)
    assert found.white_share * found.sigma_N**2 == pytest.approx(white**2, rel=0.05)
    assert found.moving_average == pytest.approx(moving_average(phi, share), abs=0.02)


@pytest.mark.parametrize("n", [200, 5_000 if not JIT_OFF else 300])
@pytest.mark.needs_jit
def test_white_noise_is_called_white(n):
    # a penalty of ln(N)/2 lets 0.1 to 1 % of white records pass as correlated
    rng = np.random.default_rng(13)
    models = [estimate_noise([chain(rng, n, 0.0, slow=2.0)]).model for _ in range(SEEDS)]
    assert models.count("white") >= 0.9 * SEEDS


@pytest.mark.parametrize("phi", [0.5, 0.9])
@pytest.mark.needs_jit
def test_one_short_log_is_enough(phi):
    rng = np.random.default_rng(14)
    found = [estimate_noise([chain(rng, 200, phi)]) for _ in range(SEEDS)]
    error = [one.phi - phi for one in found]
    assert all(one.model != "white" for one in found)
    assert np.std(error) <= 1.5 * math.sqrt((1.0 - phi**2) / 200)
    assert abs(np.mean(error)) <= 0.03


def residuals_of_a_fit(rng, phi, degree):
    n = 400
    one = chain(rng, n, phi)
    basis = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, n), degree)
    fitted = basis @ np.linalg.lstsq(basis, one.residual_N, rcond=None)[0]
    return NoiseChain(one.residual_N - fitted, one.starts, one.ratio)


@pytest.mark.parametrize("phi", [0.5, 0.9])
@needs_jit
def test_fitted_parameters_are_allowed_for(phi):
    # a polynomial of 8 coefficients takes low frequencies with it; what is left looks less correlated
    rng = np.random.default_rng(15)
    logs = [residuals_of_a_fit(rng, phi, 7) for _ in range(120)]
    freed = np.array([estimate_noise([one], parameters=8).phi for one in logs])
    raw = np.array([estimate_noise([one]).phi for one in logs])
    error_freed, error_raw = abs(freed.mean() - phi), abs(raw.mean() - phi)
    assert error_freed <= 0.5 * error_raw
    assert error_freed <= 0.012


def test_the_variance_of_white_residuals_is_divided_by_what_is_left():
    rng = np.random.default_rng(16)
    one = chain(rng, 60, 0.0)
    found = estimate_noise([one], parameters=10)
    assert found.model == "white"
    assert found.sigma_N**2 == pytest.approx(float(one.residual_N @ one.residual_N) / 50, rel=1e-12)


def test_without_links_the_noise_is_white():
    residual = np.sin(np.arange(50.0))
    found = estimate_noise([NoiseChain(residual, np.ones(50, dtype=bool), np.ones(50))])
    assert found.model == "white"
    assert found.sigma_N == pytest.approx(math.sqrt(float(residual @ residual) / 50), rel=1e-12)


def test_residuals_of_nothing_are_white_and_zero():
    found = estimate_noise([NoiseChain(np.zeros(20), np.arange(20) == 0, np.ones(20))])
    assert (found.model, found.sigma_N, found.phi) == ("white", 0.0, 0.0)


def test_too_few_residuals_are_refused():
    with pytest.raises(ValueError, match="8 residuals"):
        estimate_noise([NoiseChain(np.ones(8), np.arange(8) == 0, np.ones(8))], parameters=8)


@pytest.mark.parametrize(("phi", "white", "slow"), [(0.9, 0.5, 1.0), (0.99, 1.0, 0.5), (0.5, 1.0, 1.0)])
def test_theta_gives_the_autocovariance_of_white_plus_ar1(phi, white, slow):
    total = white**2 + slow**2
    theta = moving_average(phi, white**2 / total)
    # psi weights of (1 - theta L) / (1 - phi L)
    psi = (phi - theta) * phi ** np.arange(6000)
    psi = np.concatenate([[1.0], psi])
    lags = np.array([float(psi[: psi.size - k] @ psi[k:]) for k in range(4)])
    expected = np.array([total, *(slow**2 * phi ** np.arange(1.0, 4.0))])
    np.testing.assert_allclose(lags / lags[0], expected / expected[0], rtol=1e-10)


def test_the_pre_filter_leaves_ar1_noise_of_the_stated_variance():
    rng = np.random.default_rng(17)
    found = estimate_noise([chain(rng, 3000, 0.95, white=1.0, slow=1.0)])
    psi = np.concatenate([[1.0], (found.phi - found.moving_average) * found.phi ** np.arange(3000.0)])
    innovation = found.sigma_N**2 / float(psi @ psi)
    assert found.model == "white+ar1"
    assert found.sigma_filtered_N**2 == pytest.approx(innovation / (1.0 - found.phi**2), rel=1e-8)


def test_a_log_gives_its_links_and_steps():
    time = np.array(
        [0.0, 0.01, 0.02, 0.03, 0.04, 1.0, 1.01, 1.02, 1.03, 1.04] + [1.05 + 0.01 * k for k in range(40)]
    )
    include = np.ones(time.size, dtype=bool)
    include[:2] = False
    include[7] = False
    data = LogData(time, time, time, include, np.zeros(time.size, dtype=np.int64))
    made = noise_chain(data, np.arange(float(time.size)), reference_step_s=0.01)
    kept = np.flatnonzero(include)
    assert made.residual_N.tolist() == kept.tolist()
    assert kept[made.starts].tolist() == [2, 5, 8]
    np.testing.assert_allclose(made.ratio[~made.starts], 1.0, rtol=1e-9)
