"""Moves of an ensemble of walkers: each leaves the posterior as it is."""

from __future__ import annotations

import numpy as np
import pytest
from closed_form_targets import Normal
from emcee import EnsembleSampler, State
from scipy import stats

from tissueid.posterior.moves import DifferentialEvolution, Independence, Sampler, Snooker, StudentProposal
from tissueid.posterior.stopping import memory_of

WALKERS = 40


def _walked(move: object, target: Normal, steps: int, seed: int) -> np.ndarray:
    size = len(target.mode)
    random = np.random.RandomState(seed)
    starts = target.mode + random.standard_normal((WALKERS, size)) @ np.linalg.cholesky(target.covariance).T
    sampler = Sampler(WALKERS, size, target.log_density, vectorize=True, moves=[move])
    sampler.random_state = random.get_state()
    path = np.empty((steps, WALKERS, size))
    start = State(starts, log_prob=target.log_density(starts))
    for step, state in enumerate(sampler.sample(start, iterations=steps, store=False)):
        path[step] = state.coords
    return path


@pytest.mark.parametrize("size", [1, 3])
@pytest.mark.parametrize("kind", ["evolution", "snooker", "independence"])
def test_a_move_alone_keeps_the_moments_of_a_normal(kind: str, size: int) -> None:
    target = Normal(size, correlation=0.5)
    root = np.linalg.cholesky(target.covariance)
    move = {
        "evolution": DifferentialEvolution(),
        "snooker": Snooker(),
        # shifted and turned against the target: the importance weights must make up for it
        "independence": Independence(StudentProposal(target.mode + 0.3 * root[:, 0], 1.2 * root, 5.0)),
    }[kind]
    path = _walked(move, target, 3000, seed=11)
    whitened = np.linalg.solve(root, (path - target.mode).reshape(-1, size).T)
    tau = max(memory_of(path).tau.max(), memory_of((path - target.mode) ** 2).tau.max())
    effective = path.shape[0] * WALKERS / tau
    # standard errors of the mean and the variance of a unit normal from so many effective draws
    assert np.abs(whitened.mean(axis=1)).max() < 4.0 / np.sqrt(effective)
    assert np.abs(whitened.var(axis=1) - 1.0).max() < 4.0 * np.sqrt(2.0 / effective)


def test_the_student_proposal_draws_what_its_density_says() -> None:
    root = np.array([[2.0, 0.0], [-1.0, 0.5]])
    proposal = StudentProposal(np.array([1.0, -3.0]), root, 5.0)
    oracle = stats.multivariate_t(loc=[1.0, -3.0], shape=root @ root.T, df=5.0)
    points = proposal.draw(4000, np.random.RandomState(12))
    whitened = np.linalg.solve(root, (points - proposal.centre).T)
    assert stats.kstest(whitened[0], stats.t(5.0).cdf).pvalue > 1e-3
    assert stats.kstest(whitened[1], stats.t(5.0).cdf).pvalue > 1e-3
    # squared radius over d follows F(d, dof): the two coordinates share one scale
    assert stats.kstest((whitened**2).sum(axis=0) / 2.0, stats.f(2.0, 5.0).cdf).pvalue > 1e-3
    offset = oracle.logpdf(points) - proposal.log_density(points)
    assert np.ptp(offset) == pytest.approx(0.0, abs=1e-10)


def test_walkers_on_one_point_can_be_moved_apart_from_it() -> None:
    target = Normal(2)
    together = np.repeat(target.mode[None], WALKERS, axis=0)
    together[0] += 1e-3
    sampler = Sampler(WALKERS, 2, target.log_density, vectorize=True, moves=[Snooker()])
    state = State(together, log_prob=target.log_density(together))
    last = next(sampler.sample(state, iterations=1, store=False, skip_initial_state_check=True))
    assert np.isfinite(last.coords).all()
    assert np.array_equal(last.log_prob, target.log_density(last.coords))


def test_the_sampler_goes_on_from_its_random_numbers() -> None:
    target = Normal(3)
    whole = _walked(DifferentialEvolution(), target, 20, seed=13)
    sampler = Sampler(WALKERS, 3, target.log_density, vectorize=True, moves=[DifferentialEvolution()])
    random = np.random.RandomState(13)
    random.standard_normal((WALKERS, 3))
    sampler.random_state = random.get_state()
    starts = (
        target.mode
        + np.random.RandomState(13).standard_normal((WALKERS, 3)) @ np.linalg.cholesky(target.covariance).T
    )
    for state in sampler.sample(State(starts), iterations=10, store=False):
        halfway = state
    other = Sampler(WALKERS, 3, target.log_density, vectorize=True, moves=[DifferentialEvolution()])
    other.random_state = sampler.random_numbers()
    for state in other.sample(halfway, iterations=10, store=False):
        last = state
    assert np.array_equal(last.coords, whole[-1])
    assert isinstance(sampler, EnsembleSampler)
