"""Model choice by held-out prediction."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from fit_cases import draw, log_data, small_recipe, specimen_sums, sums_of

from tissueid.fit.candidates import Candidate, fit_candidate
from tissueid.fit.held_out import held_out_scores
from tissueid.fit.selection import choose
from tissueid.model import ContactPath, KelvinVoigt
from tissueid.synth import Branch

JIT_OFF = os.environ.get("NUMBA_DISABLE_JIT") == "1"
needs_jit = pytest.mark.skipif(JIT_OFF, reason="too slow without compilation")

MANY = tuple(replace(log, repeats=2) for log in small_recipe().logs)
ONE = Branch((60.0,), 0.1)
GROWING = Branch((20.0, 20.0), 0.1)
SLOW = Branch((8.0,), 1.5)


def chosen(recipe, seed, pooling, *, branches=(1, 2, 3), degrees=(0, 1, 2)):
    sums = specimen_sums(draw(recipe, seed), degree=max(degrees), offset_sd_mm=1e-3)
    return choose(sums, branches=branches, degrees=degrees, pooling=pooling)


@needs_jit
@pytest.mark.parametrize("pooling", ["shared", "partial"])
def test_a_second_branch_and_a_growing_stiffness_are_not_made_up(pooling):
    right = 0
    for seed in range(3):
        candidate = chosen(small_recipe(logs=MANY, branches=(ONE,)), seed, pooling).solution.candidate
        right += (candidate.branches, candidate.degree) == (1, 0)
    assert right >= 2


@needs_jit
@pytest.mark.parametrize("pooling", ["shared", "partial"])
def test_a_second_branch_is_found_where_there_is_one(pooling):
    counts = []
    for seed in range(4):
        recipe = small_recipe(logs=MANY, branches=(ONE, SLOW))
        choice = chosen(recipe, seed, pooling, degrees=(0,))
        counts.append(choice.solution.candidate.branches)
        slowest = np.exp(choice.solution.evaluation.log_tau[-1])
        assert slowest == pytest.approx(1.5, rel=0.15)
    # one standard error decides: now and then a third branch is let in, the second never missed
    assert min(counts) == 2
    assert counts.count(2) >= 3


@needs_jit
def test_a_branch_without_stiffness_is_not_a_branch():
    # seed 1 draws noise in which a third branch ends at zero stiffness and yet predicts a little better
    for seed in range(4):
        solution = chosen(
            small_recipe(logs=MANY, branches=(ONE, SLOW)), seed, "shared", degrees=(0,)
        ).solution
        assert (solution.evaluation.theta[3:] > 1e-3).all()


@needs_jit
@pytest.mark.parametrize("pooling", ["shared", "partial", "per-log"])
def test_growing_stiffness_is_found_where_it_grows(pooling):
    for seed in range(3):
        choice = chosen(small_recipe(logs=MANY, branches=(GROWING,)), seed, pooling, branches=(1,))
        assert choice.solution.candidate.degree == 1


@needs_jit
def test_table_has_a_row_for_every_candidate_and_one_choice():
    choice = chosen(small_recipe(logs=MANY, branches=(ONE, SLOW)), 0, "shared")
    assert {frozenset(row) for row in choice.table} == {
        frozenset({"branches", "stiffness_degree", "score", "stderr", "chosen"})
    }
    rows = [row for row in choice.table if row["chosen"]]
    assert len(rows) == 1
    candidate = choice.solution.candidate
    assert (rows[0]["branches"], rows[0]["stiffness_degree"]) == (candidate.branches, candidate.degree)
    scores = np.array([row["score"] for row in choice.table])
    assert scores.max() == 0.0  # scores are differences from the best
    best = choice.table[int(np.argmax(scores))]
    assert best["stderr"] == 0.0
    assert rows[0]["score"] >= -max(rows[0]["stderr"], 4.0)
    assert len({(row["branches"], row["stiffness_degree"]) for row in choice.table}) == len(choice.table)


def test_a_single_candidate_is_not_compared_with_itself():
    choice = chosen(small_recipe(rate_Hz=20.0), 0, "shared", branches=(1,), degrees=(0,))
    assert choice.table == ()
    assert choice.solution.candidate == Candidate(1, 0, "shared")


def test_progress_names_every_candidate():
    said = []
    sums = specimen_sums(draw(small_recipe(rate_Hz=20.0), 0), degree=1)
    choose(sums, branches=(1,), degrees=(0, 1), pooling="shared", progress=said.append)
    assert len(said) == 2
    assert "degree 1" in said[1]


def test_score_is_the_log_density_of_the_held_out_log():
    """Refit by hand without one log, and predict it sample by sample."""
    recipe = small_recipe(rate_Hz=20.0, branches=(ONE,))
    logs = draw(recipe, 4)
    data = [log_data(log.time_s, log.displacement_mm, log.force_N) for log in logs]
    sums = sums_of(data, degree=0)
    solution = fit_candidate(sums, Candidate(1, 0, "shared"))
    scores = held_out_scores(sums, solution)
    sigma2 = solution.noise.sigma2
    model = KelvinVoigt(branches=1, stiffness_degree=0, depth_mm=sums.depth_mm)
    for held in range(len(data)):
        rest = sums.without(np.array([held]))
        again = fit_candidate(rest, Candidate(1, 0, "shared")).evaluation
        static = again.theta[:3] / sums.depth_mm ** np.arange(1.0, 4.0)
        theta = model.join(static, again.theta[3:].reshape(1, 1), np.exp(again.log_tau))
        out = data[held]
        residual = out.force_N - model.force(theta, ContactPath(out.time_s, out.depth_mm))
        expected = -0.5 * (residual.size * np.log(2 * np.pi * sigma2) + residual @ residual / sigma2)
        # tau follows by one Gauss-Newton step only: the rest of its way costs a fraction of a unit
        assert scores[held] == pytest.approx(expected, abs=0.3)


@needs_jit
def test_one_log_is_judged_by_its_held_out_stretches():
    recipe = small_recipe(branches=(ONE, SLOW), logs=small_recipe().logs[-1:])
    (log,) = draw(recipe, 1)
    fold = np.floor(np.linspace(0.0, 24.0, log.time_s.size, endpoint=False)).astype(np.int64) % 6
    sums = sums_of([log_data(log.time_s, log.displacement_mm, log.force_N, fold=fold)], degree=0)
    assert sums.single
    choice = choose(sums, branches=(1, 2), degrees=(0,), pooling="shared")
    assert choice.solution.candidate.branches == 2
