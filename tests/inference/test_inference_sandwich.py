"""The clustered sandwich: about the plain covariance where residuals are white, wider where they follow."""

from __future__ import annotations

import numpy as np
import pytest
from inference_cases import draw, handles_for, identified, small_recipe

from tissueid.inference.optimum import covariance_of
from tissueid.inference.residual_blocks import LOGS_AS_CLUSTERS, TOGETHER, _clusters, sandwich_covariance
from tissueid.inference.target import SpecimenTarget
from tissueid.synth import Hold, Log, Move

MANY = tuple(Log(f"a-{k}", (Move(4.0, v), Hold(3.0))) for k, v in enumerate((60.0, 120.0, 240.0, 480.0) * 3))


def target(seed=1, logs=MANY, pooling="shared", **noise):
    ours = identified(
        handles_for(draw(small_recipe(logs=logs, **noise), seed)), noise="white", pooling=pooling
    )
    return SpecimenTarget(ours, machine=False)


def inflation(seed, pooling, **noise):
    """Standard deviations of tau and coefficients over those of independent samples; and the worth."""
    at = target(seed, pooling=pooling, **noise)
    found, worth = sandwich_covariance(at)
    plain = covariance_of(at.precision)
    kept = at.n_shared - 3
    return np.sqrt(np.diag(found) / np.diag(plain))[:kept], worth


@pytest.mark.parametrize("pooling", ["shared", "partial"])
def test_white_residuals_give_about_the_plain_covariance(pooling):
    ratios, worth = zip(*(inflation(seed, pooling, sigma_N=0.3) for seed in range(3)), strict=True)
    # never less than of independent samples; Student's t of 12 clusters and the scatter of their scores add
    assert np.min(ratios) >= 0.999
    assert np.mean(ratios) < 1.35
    assert np.mean(worth) < 1.5


@pytest.mark.parametrize("pooling", ["shared", "partial"])
def test_residuals_that_follow_each_other_give_a_larger_one(pooling):
    noise = {"sigma_N": 0.0, "ar1_sigma_N": 0.3, "ar1_phi": 0.95}
    ratios, worth = zip(*(inflation(seed, pooling, **noise) for seed in range(3)), strict=True)
    # a sample in (1 + 0.95) / (1 - 0.95) = 39 counts for slow columns, more of them for fast ones
    assert 1.8 < np.mean(ratios) < 8.0
    assert 4.0 < np.mean(worth) < 50.0


@pytest.mark.slow
def test_intervals_of_correlated_noise_hold_the_truth():
    noise = {"sigma_N": 0.0, "ar1_sigma_N": 0.3, "ar1_phi": 0.95}
    inside, plain = 0, 0
    for seed in range(100):
        at = target(seed, **noise)
        off = abs(at.mode[0] - np.log(0.021))
        inside += off <= 1.96 * np.sqrt(sandwich_covariance(at)[0][0, 0])
        plain += off <= 1.96 * np.sqrt(covariance_of(at.precision)[0, 0])
    # three binomial standard deviations
    assert inside >= 88
    assert plain < 80


def test_clusters_are_logs_or_stretches():
    many = target()
    assert len(many.system.logs) >= LOGS_AS_CLUSTERS
    np.testing.assert_array_equal(_clusters(many), many.system.log)
    few = target(logs=MANY[:2])
    np.testing.assert_array_equal(_clusters(few) % 1000, few.system.fold // TOGETHER)
    np.testing.assert_array_equal(_clusters(few) // 1000, few.system.log)


def test_directions_of_the_prior_keep_it():
    """Where data say nothing, clusters don't either."""
    at = target(sigma_N=0.3)
    found, _ = sandwich_covariance(at)
    plain = covariance_of(at.precision)
    inverse = np.linalg.inv(np.linalg.cholesky(plain))
    assert np.linalg.eigvalsh(inverse @ found @ inverse.T).min() >= 0.99
    # ln sigma has no score: its variance stays
    k = int(np.flatnonzero(np.array(at.names)[at.free] == "ln_sigma")[0])
    assert found[k, k] == pytest.approx(plain[k, k], rel=1e-6)
