"""Samples that one independent sample stands for: one under white noise, the run of a smooth miss else."""

from __future__ import annotations

import numpy as np
from scipy import stats

from tissueid.fit.discrepancy import NORMAL_975, samples_per_independent
from tissueid.fit.residual_blocks import ResidualBlocks


def blocks(shared: np.ndarray, residual: np.ndarray, own: np.ndarray | None = None) -> ResidualBlocks:
    count = residual.size
    return ResidualBlocks(
        phase=np.zeros(count, dtype=np.int64),
        hold=np.ones(count, dtype=np.bool_),
        place=np.arange(count),
        count=np.ones(count, dtype=np.int64),
        mean_N=residual,
        start_s=np.arange(float(count)),
        end_s=np.arange(float(count)),
        shared=shared,
        own=np.zeros((count, 0)) if own is None else own,
        speed_mm_s=1.0,
        depth_mm=1.0,
        step_s=1.0,
    )


def worth(shared: np.ndarray, noise: np.ndarray) -> float:
    return samples_per_independent([blocks(shared, fitted(shared, noise))], 1.0, own=0)


def fitted(shared: np.ndarray, noise: np.ndarray) -> np.ndarray:
    return noise - shared @ np.linalg.lstsq(shared, noise, rcond=None)[0]


def smooth_columns(count: int) -> np.ndarray:
    u = np.linspace(-1.0, 1.0, count)
    return np.polynomial.legendre.legvander(u, 2)


def test_white_noise_is_worth_its_samples_but_for_few_clusters() -> None:
    rng = np.random.default_rng(1)
    shared = smooth_columns(400)
    found = [worth(shared, rng.standard_normal(400)) for _ in range(200)]
    few = (stats.t.ppf(0.975, 7) / NORMAL_975) ** 2
    # what was fitted is taken out of the scores: somewhat less than all
    assert 0.6 * few < np.mean(found) < 1.15 * few


def test_a_slow_miss_counts_by_its_length() -> None:
    rng = np.random.default_rng(2)
    shared = smooth_columns(400)
    short = [rng.standard_normal(400) for _ in range(100)]
    long = [np.repeat(rng.standard_normal(40), 10) for _ in range(100)]
    ratio = np.mean([worth(shared, one) for one in long]) / np.mean([worth(shared, one) for one in short])
    # what is fitted is as slow as the miss, and takes a part of it out of the scores
    assert 5.0 < ratio < 12.0


def test_logs_are_the_clusters_from_four_on_and_their_own_effects_count_for_nothing() -> None:
    rng = np.random.default_rng(3)
    shared = smooth_columns(60)
    own = rng.standard_normal((60, 2))
    logs = []
    for _ in range(8):
        slow = shared @ rng.standard_normal(3)
        logs.append(blocks(shared, slow + 0.01 * rng.standard_normal(60), own))
    sigma = float(np.sqrt(np.mean(np.concatenate([one.mean_N for one in logs]) ** 2)))
    assert samples_per_independent(logs, sigma, own=0) > 10.0
    explained = [blocks(shared, own @ rng.standard_normal(2), own) for _ in range(8)]
    assert samples_per_independent(explained, 1.0, own=2) == 1.0


def test_nothing_to_look_at_is_worth_its_samples() -> None:
    assert samples_per_independent([], 1.0, own=0) == 1.0
    assert samples_per_independent([blocks(smooth_columns(20), np.zeros(20))], 0.0, own=0) == 1.0
