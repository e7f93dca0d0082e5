"""Fit of one candidate: pooling, variances, recovery of the truth."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from fit_cases import draw, small_recipe, specimen_sums

from tissueid.fit.candidates import Candidate, Noise, fit_candidate, objective_for, sum_of_logs
from tissueid.likelihood.objective import PartialObjective, PooledObjective

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"
needs_jit = pytest.mark.skipif(JIT_OFF, reason="too slow without compilation")

#: Ten logs: a spread is known to a quarter from them.
MANY = tuple(replace(log, repeats=2) for log in small_recipe().logs)
RATE = 10.0 if JIT_OFF else 100.0


def fit(recipe, seed, pooling, *, branches=1, degree=0, offset_sd_mm=0.05):
    sums = specimen_sums(draw(recipe, seed), degree=max(degree, 0), offset_sd_mm=offset_sd_mm)
    return sums, fit_candidate(sums, Candidate(branches, degree, pooling))


def test_parameters_are_counted():
    assert Candidate(1, 0, "shared").n_parameters == 5
    assert Candidate(2, 1, "shared").n_parameters == 9
    assert Candidate(3, 2, "shared").n_parameters == 15


@pytest.mark.needs_jit
@pytest.mark.parametrize("pooling", ["shared", "per-log", "partial"])
def test_noise_variance_is_that_of_the_recording(pooling):
    _, solution = fit(small_recipe(rate_Hz=RATE, sigma_N=0.4), 3, pooling)
    sums = specimen_sums(draw(small_recipe(rate_Hz=RATE, sigma_N=0.4), 3), degree=0)
    # sd of an estimated variance is sqrt(2 / N), relative
    assert solution.noise.sigma2 == pytest.approx(0.16, rel=5.0 * np.sqrt(2.0 / sums.n))


@needs_jit
@pytest.mark.parametrize("spread", [0.03, 0.15])
def test_spread_of_the_gains_is_recovered(spread):
    recipe = small_recipe(logs=MANY, cv_both=spread)
    found, scatter = [], []
    for seed in range(6):
        logs = draw(recipe, seed)
        sums = specimen_sums(logs, degree=0, offset_sd_mm=0.001)
        found.append(fit_candidate(sums, Candidate(1, 0, "partial")).noise.gain_sd)
        scatter.append(np.std([np.log(log.truth["gain"]) for log in logs], ddof=1))
    # against the spread that was drawn: what is left is the noise of a log's gain
    np.testing.assert_allclose(found, scatter, rtol=0.25)


@needs_jit
def test_no_spread_is_found_where_there_is_none():
    for seed in range(4):
        _, solution = fit(small_recipe(logs=MANY), seed, "partial", offset_sd_mm=0.001)
        assert solution.noise.gain_sd <= 0.01


@needs_jit
def test_gains_and_offsets_of_the_logs_are_recovered():
    recipe = small_recipe(logs=MANY, cv_both=0.1, sigma_N=0.05)
    for seed in range(3):
        logs = draw(recipe, seed)
        sums = specimen_sums(logs, degree=0, offset_sd_mm=0.02)
        solution = fit_candidate(sums, Candidate(1, 0, "partial"))
        truth = np.log([log.truth["gain"] for log in logs])
        ours = solution.evaluation.gamma
        # a gain common to all logs is the tissue's
        np.testing.assert_allclose(ours - ours.mean(), truth - truth.mean(), atol=0.01)
        assert np.abs(solution.evaluation.delta).max() <= 0.02


@needs_jit
def test_scatter_of_the_specimen_spoils_one_shared_curve_and_not_partial_pooling():
    recipe = small_recipe(logs=MANY, cv_both=0.15)
    errors = {"shared": [], "partial": []}
    for seed in range(6):
        for pooling, out in errors.items():
            _, solution = fit(recipe, seed, pooling, offset_sd_mm=0.001)
            out.append(abs(solution.evaluation.log_tau[0] - np.log(0.021)))
    assert np.median(errors["partial"]) <= 0.2
    assert np.median(errors["partial"]) < 0.5 * np.median(errors["shared"])


@needs_jit
@pytest.mark.parametrize("degree", [0, 1])
def test_small_noise_gives_the_truth_with_every_pooling(degree):
    stiffness = (30.0, 5.0)[: degree + 1]
    branch = replace(small_recipe().branches[0], stiffness=stiffness, tau_s=0.2)
    recipe = small_recipe(branches=(branch,), sigma_N=0.01)
    powers = 4.0 ** np.arange(degree + 1.0)
    for pooling in ("shared", "partial", "per-log"):
        _, solution = fit(recipe, 1, pooling, degree=degree, offset_sd_mm=1e-4)
        found = solution.evaluation
        assert np.exp(found.log_tau[0]) == pytest.approx(0.2, rel=1e-2)
        np.testing.assert_allclose(found.theta[-degree - 1 :] / powers, stiffness, rtol=3e-2)
        if pooling != "per-log":
            static = np.array([20.0, -1.2, 0.35]) * 4.0 ** np.arange(1.0, 4.0)
            np.testing.assert_allclose(found.theta[:3], static, rtol=2e-2)


def test_objective_follows_the_pooling():
    sums = specimen_sums(draw(small_recipe(rate_Hz=20.0), 0), degree=1)
    noise = Noise(0.04, 0.1)
    shared = objective_for(sums, Candidate(1, 1, "shared"), noise)
    per_log = objective_for(sums, Candidate(1, 1, "per-log"), noise)
    partial = objective_for(sums, Candidate(1, 1, "partial"), noise)
    assert isinstance(shared, PooledObjective)
    assert shared.static
    assert not per_log.static
    assert isinstance(partial, PartialObjective)
    assert partial.weight_gain == pytest.approx(4.0)
    np.testing.assert_allclose(partial.weight_offset, 0.04 / sums.offset_sd_mm**2)
    assert shared.blocks.tolist() == [3, 2]
    assert per_log.blocks.tolist() == [2]


def test_holding_out_logs_leaves_the_sums_of_the_others():
    sums = specimen_sums(draw(small_recipe(rate_Hz=20.0), 0), degree=0)
    rest = sums.without(np.array([0, 3]))
    assert rest.n == int(sums.count[[1, 2, 4]].sum())
    np.testing.assert_allclose(sum_of_logs(rest), sums.gram[[1, 2, 4]].sum(axis=0))
    groups = sums.held_out_groups()
    assert sorted(int(i) for group in groups for i in group) == [0, 1, 2, 3, 4]


def test_more_logs_than_thirty_are_held_out_in_thirty_groups():
    sums = specimen_sums(draw(small_recipe(rate_Hz=20.0), 0), degree=0)
    many = replace(
        sums,
        gram=np.repeat(sums.gram, 20, axis=0),
        count=np.repeat(sums.count, 20),
        offset_sd_mm=np.repeat(sums.offset_sd_mm, 20),
        logs=np.arange(100),
    )
    groups = many.held_out_groups()
    assert len(groups) == 30
    assert np.concatenate(groups).tolist() == list(range(100))
