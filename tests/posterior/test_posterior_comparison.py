"""Comparison of models: evidence against closed forms, verdicts on specimens with a known truth."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from scipy.integrate import quad

from tissueid.fit.logs import LogHandle
from tissueid.fit.specimen import FitOptions, fit_with_state
from tissueid.fit.window import fitted_log
from tissueid.likelihood.basis import kernel_basis
from tissueid.model.kernels import branch_state
from tissueid.posterior.alternatives import FAMILIES
from tissueid.posterior.comparison import compare_models, evidence, speed_groups
from tissueid.priors import Priors
from tissueid.synth import Branch, as_trials, recipe, simulate
from tissueid.trial import Contact, Phase, Segmentation

needs_jit = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="too slow without compilation"
)

PAPER = recipe("paper-a-30")
PLAN = replace(PAPER, rate_Hz=50.0, logs=tuple(replace(log, repeats=1) for log in PAPER.logs))


@dataclass(frozen=True)
class NormalTarget:
    """exp(height) times a normal density, cut at zero in the first coordinate where ``cut``."""

    mode: np.ndarray
    covariance: np.ndarray
    height: float
    cut: bool = False

    @property
    def names(self):
        return tuple(f"x{k}" for k in range(self.mode.size))

    def log_density(self, points):
        z = np.linalg.solve(np.linalg.cholesky(self.covariance), (points - self.mode).T)
        value = -0.5 * (z**2).sum(axis=0) - 0.5 * np.linalg.slogdet(2 * np.pi * self.covariance)[1]
        inside = (points[:, 0] >= 0.0) | (not self.cut)
        return np.where(inside, self.height + value, -np.inf)

    def redraw(self, points, rng):
        raise NotImplementedError


@pytest.mark.parametrize("d", [1, 3, 5])
def test_evidence_of_a_normal_is_its_height(d):
    root = np.tril(np.ones((d, d))) * 0.3
    target = NormalTarget(np.ones(d), root @ root.T, -1234.5)
    value, error = evidence(target, seed=1)
    assert error < 0.03
    assert abs(value + 1234.5) <= 4.0 * error


def test_evidence_counts_only_what_the_cut_leaves():
    # half of a normal is cut away at its mode
    target = NormalTarget(np.zeros(2), np.eye(2), 7.0, cut=True)
    value, error = evidence(target, seed=2)
    assert abs(value - (7.0 + np.log(0.5))) <= 4.0 * error


def test_speeds_within_five_per_cent_are_one():
    groups = speed_groups([4.0, 1.0, 4.1, 8.0, 1.02])
    assert [group.tolist() for group in groups] == [[1, 4], [0, 2], [3]]


def test_weights_of_an_exponential_are_those_of_its_relaxation_time():
    basis = kernel_basis(step_s=0.01, length_s=20.0)
    found, error = basis.weights_of(lambda t: np.exp(-t / 0.3))
    expected = basis.weights(np.log([0.3]))[0][:, 0]
    assert error < 1e-10
    # weights of neighbouring nodes trade against each other: what counts is the state they make
    time = np.arange(0.0, 20.0, 0.01)
    states = np.column_stack(
        [branch_state(time, np.minimum(time, 2.0), float(tau), 0.0) for tau in basis.tau_s]
    )
    np.testing.assert_allclose(states @ found, states @ expected, atol=1e-9)


@pytest.mark.parametrize(("family", "shape"), [(FAMILIES[0], 0.5), (FAMILIES[1], 0.4)])
def test_state_of_another_kernel_is_a_mixture_of_node_states(family, shape):
    basis = kernel_basis(step_s=0.01, length_s=20.0)
    weights, error = basis.weights_of(lambda t: family.kernel(t, np.log(0.2), shape))
    assert error < 1e-5
    time = np.arange(0.0, 20.0, 0.01)
    depth = np.minimum(time, 2.0)
    states = np.column_stack([branch_state(time, depth, float(tau), 0.0) for tau in basis.tau_s])
    for at in (50, 150, 300, 1900):
        until = min(time[at], 2.0)
        expected = quad(
            lambda u, t=time[at]: float(family.kernel(np.array(t - u), np.log(0.2), shape)), 0.0, until,
            limit=200,
        )[0]  # fmt: skip
        # 1e-5 of the state, and what quadrature and a kernel with an infinite slope at zero leave
        assert float(states[at] @ weights) == pytest.approx(expected, rel=1e-4)


def handle_of(trial):
    time, n = trial.time_s, trial.time_s.size
    speed, depth = trial.protocol.speed_mm_s, trial.protocol.depth_mm
    corner = min(int(np.searchsorted(time, depth / speed - 1e-9)), n - 2)
    phases = (
        Phase("ramp", 0, corner + 1, 0.0, float(time[corner]), speed),
        Phase("hold", corner, n, float(time[corner]), float(time[-1]), 0.0),
    )
    held = time[-1] - time[corner] > 1.0
    if not held:
        phases = (Phase("ramp", 0, n, 0.0, float(time[-1]), speed),)
    segmentation = Segmentation(1, 1, Contact(index=0, displacement_mm=0.0, sd_mm=0.001), phases, 0.0)
    facts = fitted_log(trial, segmentation)
    return LogHandle(partial(lambda one: one, trial), segmentation, facts.without_samples(), 0.001)


@needs_jit
@pytest.mark.slow
def test_the_truth_is_chosen_and_the_wrong_models_are_worse():
    plan = replace(PLAN, branches=(Branch((63.62,), 0.05), Branch((5.0,), 2.0)), sigma_N=0.5)
    trials = as_trials(simulate(plan, rng=np.random.default_rng(1)))
    fitted = fit_with_state("a", [handle_of(trial) for trial in trials], options=FitOptions())
    said = []
    rows = compare_models(fitted, Priors(), tick=said.append)
    named = {row.model: row for row in rows}
    for row in rows:
        print(row)  # noqa: T201
    assert rows[0].verdict == "chosen"
    assert rows[0].model == "2 branches, K of degree 0, partial static"
    assert max(row.log_evidence for row in rows) == 0.0
    assert named["static force only, partial static"].verdict == "worse"
    assert named["1 branch, K of degree 0, partial static"].verdict == "worse"
    assert named["static force and a dashpot of degree 0, partial static"].verdict == "worse"
    assert {row.verdict for row in rows if "kernel" in row.model} == {"beside"}
    assert rows[0].elpd_speed is not None
    assert rows[0].log_evidence_se < 0.2
