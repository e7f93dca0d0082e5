"""The second choice, under known noise, and what is said where the data do not decide."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from protocol_designs import Designs

from tissueid.fit.candidates import Candidate, fit_candidate
from tissueid.fit.held_out import held_out_scores
from tissueid.fit.selection import Choice, choose
from tissueid.fit.settling import undecided_flags
from tissueid.flags import FLAG_CODES
from tissueid.synth import Branch, recipe
from tissueid.uncertainty import NoiseFit

needs_jit = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="too slow without compilation"
)

PAPER = recipe("paper-a-30")
PLAN = replace(PAPER, rate_Hz=100.0, logs=tuple(replace(log, repeats=1) for log in PAPER.logs))
TWO = (PLAN.branches[0], Branch((3.0,), 0.8))
WHITE = NoiseFit("white", 1.0, 0.0, 0.01)


def sums_of(branches, *, degree, seed):
    designs = Designs(PLAN, degree=degree)
    noise = designs.noise(np.random.default_rng(seed), 1.0)
    forces = [a + b for a, b in zip(designs.clean(branches), noise, strict=True)]
    return designs.sums(forces, offset_sd_mm=0.02)


@needs_jit
def test_a_second_choice_ends_where_the_first_did_when_nothing_new_is_known():
    sums = sums_of(TWO, degree=1, seed=1)
    options = {"branches": (1, 2, 3), "degrees": (0, 1), "pooling": "shared", "noise": WHITE}
    first = choose(sums, **options)
    again = choose(sums, **options, start=first.candidates)
    assert first.solution.candidate == Candidate(2, 0, "shared")
    assert again.solution.candidate == first.solution.candidate
    np.testing.assert_allclose(again.solution.evaluation.log_tau, np.log([0.021, 0.8]), atol=0.3)
    np.testing.assert_allclose(
        again.solution.evaluation.log_tau, first.solution.evaluation.log_tau, atol=1e-6
    )


@needs_jit
def test_one_log_of_known_noise_is_judged_without_held_out_stretches():
    plan = replace(PLAN, logs=PLAN.logs[-1:])
    designs = Designs(plan, degree=0)
    for branches, expected in ((TWO, 2), (TWO[:1], 1)):
        noise = designs.noise(np.random.default_rng(2), 0.3)
        forces = [a + b for a, b in zip(designs.clean(branches), noise, strict=True)]
        sums = designs.sums(forces, offset_sd_mm=0.02)
        choice = choose(sums, branches=(1, 2, 3), degrees=(0,), pooling="shared", noise=WHITE)
        assert choice.solution.candidate.branches == expected


@needs_jit
def test_logs_held_out_together_are_predicted_from_the_others():
    """The score of a group against a fit without it, sample by sample through its own Gram matrix."""
    sums = sums_of(TWO[:1], degree=0, seed=3)
    solution = fit_candidate(sums, Candidate(1, 0, "shared"))
    group = np.array([2, 5])
    (score,) = held_out_scores(sums, solution, [group])
    rest = fit_candidate(sums.without(group), Candidate(1, 0, "shared"))
    theta, sigma2 = rest.evaluation.theta, solution.noise.sigma2
    beta = np.concatenate([[0.0], theta[:3] / sums.depth_mm ** np.arange(1.0, 4.0)])
    weights = sums.basis.weights(rest.evaluation.log_tau)[0][:, 0] * theta[3]
    v = np.concatenate([beta, weights, [-1.0]])
    squares = sum(float(v @ sums.gram[unit] @ v) for unit in group)
    count = float(sums.count[group].sum())
    expected = -0.5 * (count * np.log(2 * np.pi * sigma2) + squares / sigma2)
    # ln tau moves by a fraction of its error, where the linearised model is right to a tenth of a unit
    assert score == pytest.approx(expected, abs=0.3)


@needs_jit
def test_candidates_of_the_same_sums_are_not_fitted_again():
    sums = sums_of(TWO[:1], degree=0, seed=2)
    options = {"branches": (1, 2), "degrees": (0,), "pooling": "shared", "noise": WHITE}
    first = choose(sums, **options)
    again = choose(sums, **options, ready=(*first.candidates, *first.idle))
    assert len(first.candidates) + len(first.idle) == 2
    assert again.solution is first.solution
    assert all(a is b for a, b in zip(again.candidates, first.candidates, strict=True))
    assert all(a is b for a, b in zip(again.idle, first.idle, strict=True))
    assert again.table == first.table


@needs_jit
def test_rivals_are_named_where_the_data_do_not_decide():
    sums = sums_of(TWO[:1], degree=0, seed=4)
    solution = fit_candidate(sums, Candidate(1, 0, "shared"))
    assert undecided_flags(Choice(solution, ())) == ()
    rival = Candidate(2, 0, "shared")
    (flag,) = undecided_flags(Choice(solution, (), (solution,), (rival,)))
    assert flag.code in FLAG_CODES
    assert "1 branch with K of degree 0 taken; 1 other" in flag.message
    assert flag.values["rivals"] == ["2 branches with K of degree 0"]
