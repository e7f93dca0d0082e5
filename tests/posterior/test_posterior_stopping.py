"""The rule that says when a chain is long enough."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from emcee.autocorr import integrated_time
from scipy.signal import lfilter

from tissueid.posterior.diagnostics import diagnose
from tissueid.posterior.stopping import Memory, memory_of, next_look, shortfalls


def _autoregressive(phi: float, steps: int, walkers: int, seed: int) -> np.ndarray:
    """Stationary chains of one coordinate, shape (steps, walkers, 1)."""
    rng = np.random.default_rng(seed)
    shocks = np.sqrt(1.0 - phi**2) * rng.standard_normal((steps, walkers))
    shocks[0] /= np.sqrt(1.0 - phi**2)
    return np.asarray(lfilter([1.0], [1.0, -phi], shocks, axis=0))[:, :, None]


def _lacking(chain: np.ndarray, draws: int) -> tuple[str, ...]:
    memory = memory_of(chain)
    kept = chain[memory.burn_in :: memory.thin]
    names = [f"x{k}" for k in range(chain.shape[2])]
    found = diagnose(dict(zip(names, kept.transpose(2, 1, 0), strict=True)))
    return shortfalls(memory, len(chain) - memory.burn_in, chain.shape[1], draws, found, names)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9, 0.98])
def test_the_autocorrelation_time_is_the_closed_form(phi: float) -> None:
    tau = (1.0 + phi) / (1.0 - phi)
    steps = int(400 * tau)
    found = memory_of(_autoregressive(phi, steps, 32, seed=21))
    # 12,800 tau of samples, window 5 tau: Sokal's standard error is sqrt(20 / 12,800) = 4 %
    assert found.tau[0] == pytest.approx(tau, rel=0.12)
    assert found.thin == max(1, int(0.5 * found.tau[0]))
    assert found.burn_in == int(np.ceil(10.0 * found.tau_half[0]))


def test_the_autocorrelation_time_of_short_chains_is_not_too_small() -> None:
    chains = [_autoregressive(0.9, 380, 64, seed) for seed in range(40)]
    found = np.mean([memory_of(chain).tau_half[0] for chain in chains])
    around_each_mean = np.mean([integrated_time(chain[190:], quiet=True)[0] for chain in chains])
    # halves of ten tau, 640 tau in all: a standard error of 18 %, of the mean of 40 some 3 %
    assert found == pytest.approx(19.0, rel=0.1)
    assert around_each_mean < 0.9 * 19.0


@pytest.mark.parametrize("phi", [0.3, 0.8])
def test_noise_of_the_estimates_alone_rarely_keeps_a_good_chain_running(phi: float) -> None:
    tau = (1.0 + phi) / (1.0 - phi)
    steps = int(1.3 * 10_000 * tau / 32)
    running = sum(bool(_lacking(_autoregressive(phi, steps, 32, seed), 8_000)) for seed in range(60))
    assert running <= 3


def test_a_chain_whose_memory_grows_is_not_stable() -> None:
    early, late = _autoregressive(0.5, 2000, 32, seed=22), _autoregressive(0.97, 1000, 32, seed=23)
    chain = np.concatenate([early, late])
    lacking = _lacking(chain, 100)
    assert any("has not settled" in sentence for sentence in lacking)


def test_walkers_that_sit_apart_are_told() -> None:
    chain = _autoregressive(0.2, 1500, 32, seed=24)
    chain[:, :16] += 6.0
    assert any("R-hat of x0" in sentence for sentence in _lacking(chain, 100))


def test_a_short_chain_says_how_short_it_is() -> None:
    lacking = _lacking(_autoregressive(0.95, 1200, 32, seed=25), 10_000)
    assert any(sentence.startswith("x0 has ") and "of 10000 asked for" in sentence for sentence in lacking)
    assert any("autocorrelation times of x0" in sentence for sentence in lacking)


def test_the_cheap_answer_counts_effective_draws_by_the_autocorrelation_time() -> None:
    memory = Memory(np.array([4.0]), np.array([4.0]), np.array([0.1]), 40, 2)
    assert shortfalls(memory, 1000, 32, 8000, None, ["x0"]) == ()
    assert shortfalls(memory, 1000, 32, 8001, None, ["x0"]) == ("8000 of 8001 effective draws",)


def test_a_coordinate_that_never_moved_is_remembered_throughout() -> None:
    chain = np.concatenate([_autoregressive(0.2, 800, 32, seed=26), np.ones((800, 32, 1))], axis=2)
    found = memory_of(chain)
    assert found.tau[1] > 400.0
    assert found.tau[0] == pytest.approx(1.5, rel=0.1)
    assert len(chain[found.burn_in :: found.thin]) >= 16


def test_looks_grow_up_to_the_last_step() -> None:
    seen = [0]
    while seen[-1] < 1000:
        seen.append(next_look(seen[-1], 312, 1000))
    assert seen[1] == 312
    assert seen[-1] == 1000
    assert all(1.1 < late / early < 1.2 for early, late in itertools.pairwise(seen[1:-1]))
    assert next_look(0, 10, 5000) == 64
    assert next_look(0, 312, 100) == 100
