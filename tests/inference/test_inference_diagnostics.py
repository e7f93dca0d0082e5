"""Effective sizes and R-hat of draws."""

from __future__ import annotations

import numpy as np
import pytest
from arviz_stats.base.array import array_stats

from tissueid.inference.diagnostics import WORST_R_HAT, diagnose


def _autoregressive(phi: float, chains: int, draws: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    out = np.empty((chains, draws))
    out[:, 0] = rng.standard_normal(chains)
    for k in range(1, draws):
        out[:, k] = phi * out[:, k - 1] + np.sqrt(1.0 - phi**2) * rng.standard_normal(chains)
    return out


@pytest.mark.parametrize("rounded", [False, True], ids=["continuous", "with ties"])
def test_diagnostics_are_those_of_arviz_stats(rounded: bool) -> None:
    draws = _autoregressive(0.7, 12, 400, seed=1) ** 3
    if rounded:
        draws = np.round(4.0 * draws)
    found = diagnose({"x": draws})["x"]
    # one table of normal scores instead of one a call: the same operations, to rounding
    assert found.ess_bulk == pytest.approx(float(array_stats.ess(draws, method="bulk")), rel=1e-9)
    tail = float(array_stats.ess(draws, method="tail", prob=(0.05, 0.95)))
    assert found.ess_tail == pytest.approx(tail, rel=1e-9)
    assert found.r_hat == pytest.approx(float(array_stats.rhat(draws, method="rank")), rel=1e-9)


@pytest.mark.parametrize("phi", [0.0, 0.5, 0.9])
def test_an_autoregressive_chain_has_its_closed_form_effective_size(phi: float) -> None:
    draws = _autoregressive(phi, 16, 4000, seed=2)
    expected = draws.size * (1.0 - phi) / (1.0 + phi)
    # the estimate sums a few noisy lags: 10 % at 3,400 to 64,000 effective draws
    assert diagnose({"x": draws})["x"].ess_bulk == pytest.approx(expected, rel=0.1)


def test_walkers_that_disagree_are_told_by_r_hat() -> None:
    draws = _autoregressive(0.0, 8, 500, seed=3)
    draws[0] += 1.0
    wider = _autoregressive(0.0, 8, 500, seed=3)
    wider[0] *= 3.0
    found = diagnose({"shifted": draws, "wider": wider, "same": _autoregressive(0.0, 8, 500, seed=4)})
    assert found["shifted"].r_hat > 1.03
    assert found["wider"].r_hat > 1.03
    assert found["same"].r_hat < 1.01


def test_independent_draws_in_one_chain_are_diagnosed() -> None:
    draws = np.random.default_rng(5).standard_normal(4002)
    found = diagnose({"flat": draws, "row": draws[None], "short": draws[:100]})
    assert found["flat"] == found["row"]
    assert found["short"] == diagnose({"short": draws[:100]})["short"]
    assert found["flat"].ess_bulk == pytest.approx(4000, rel=0.1)
    assert found["flat"].r_hat < 1.01


def test_draws_that_never_differ_are_known_exactly_and_chains_that_never_moved_not_at_all() -> None:
    found = diagnose(
        {"same": np.full((4, 100), 2.5), "apart": np.repeat(np.arange(6.0)[:, None], 50, axis=1)}
    )
    assert (found["same"].ess_bulk, found["same"].ess_tail, found["same"].r_hat) == (400.0, 400.0, 1.0)
    assert found["apart"].r_hat == WORST_R_HAT
    assert found["apart"].ess_bulk < 15


def test_draws_that_say_nothing_are_refused_by_name() -> None:
    draws = np.random.default_rng(8).standard_normal((4, 100))
    draws[2, 7] = np.nan
    with pytest.raises(ValueError, match="tau: 1 draws are not finite"):
        diagnose({"tau": draws})
    with pytest.raises(ValueError, match="tau: draws of shape"):
        diagnose({"tau": draws[:, :3]})
