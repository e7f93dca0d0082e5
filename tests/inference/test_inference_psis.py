"""Pareto smoothing of weights: light tails pass, heavy ones are told by their shape."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.inference.sampling import smoothed


def test_equal_weights_are_worth_all_their_draws():
    found = smoothed(np.full(500, 3.0))
    np.testing.assert_allclose(found.weights, 1.0 / 500)
    assert found.worth == pytest.approx(500.0)
    assert found.pareto < 0.0


def test_a_proposal_that_is_wide_enough_gives_the_moments():
    rng = np.random.default_rng(1)
    z = 1.5 * rng.standard_normal(20_000)
    found = smoothed(-0.5 * z**2 + 0.5 * (z / 1.5) ** 2)
    # weights of a normal under one of sd s are bounded: E w^2 = s^2 / sqrt(2 s^2 - 1), worth 0.83
    assert found.worth / 20_000 == pytest.approx(np.sqrt(2.0 * 2.25 - 1.0) / 2.25, rel=0.02)
    assert found.pareto < 0.2
    assert found.weights.sum() == pytest.approx(1.0)
    assert float(found.weights @ z) == pytest.approx(0.0, abs=0.03)
    assert float(found.weights @ z**2) == pytest.approx(1.0, abs=0.04)


@pytest.mark.parametrize("shape", [0.3, 0.7, 1.2])
def test_the_shape_of_a_pareto_tail_is_found(shape):
    # weights u^-k have a generalised Pareto tail of shape k
    found = [smoothed(-shape * np.log(np.random.default_rng(s).random(20_000))).pareto for s in range(12)]
    # 420 points of the tail, drawn towards 0.5 by ten
    assert np.mean(found) == pytest.approx(shape, abs=0.06)
    assert np.std(found) < 0.12


def test_a_single_giant_is_cut_down_to_its_tail():
    rng = np.random.default_rng(3)
    log_weight = np.append(0.3 * rng.standard_normal(1_000), 12.0)
    found = smoothed(log_weight)
    raw = np.exp(log_weight - log_weight.max())
    assert 1.0 / ((raw / raw.sum()) ** 2).sum() < 1.5
    assert found.pareto > 0.7
    # weights keep their order
    order = np.argsort(log_weight)
    assert (np.diff(found.weights[order]) >= -1e-15).all()


def test_draws_outside_weigh_nothing_and_too_few_inside_are_none():
    log_weight = np.zeros(400)
    log_weight[::2] = -np.inf
    found = smoothed(log_weight)
    assert (found.weights[::2] == 0.0).all()
    assert found.worth == pytest.approx(200.0)
    log_weight[40:] = -np.inf
    none = smoothed(log_weight)
    assert none.worth == 0.0
    assert none.pareto == np.inf
