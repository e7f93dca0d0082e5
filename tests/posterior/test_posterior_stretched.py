"""Draws stretched about a value: as far as asked, passive, and without what all gains have in common."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.likelihood.passive_normal import passive
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior.stretched import stretched

MODEL = KelvinVoigt(branches=1, stiffness_degree=1, depth_mm=4.0)
VALUE = np.array([2.0, 0.1, 0.02, 5.0, 0.4, 0.5])
SPEED = 1.0


def draws(spread: float) -> np.ndarray:
    rng = np.random.default_rng(4)
    return VALUE * np.exp(spread * rng.standard_normal((3000, VALUE.size)))


def test_small_spreads_grow_by_the_factor_but_for_what_is_common() -> None:
    theta = draws(0.002)
    out = stretched(MODEL, theta, VALUE, 5.0, SPEED)
    for column in (0, 1, 3, 5):
        before, after = np.log(theta[:, column] / VALUE[column]), np.log(out[:, column] / VALUE[column])
        if column == 5:
            assert after.std() == pytest.approx(5.0 * before.std(), rel=0.05)
        else:
            assert 2.0 * before.std() < after.std() < 7.0 * before.std()


def test_a_gain_that_all_logs_share_is_not_stretched() -> None:
    rng = np.random.default_rng(5)
    size = np.exp(0.1 * rng.standard_normal(2000))
    theta = np.tile(VALUE, (2000, 1))
    theta[:, :5] *= size[:, None]
    out = stretched(MODEL, theta, VALUE, 6.0, SPEED)
    assert out == pytest.approx(theta, rel=1e-9)


def test_every_draw_stays_passive_and_a_factor_of_one_changes_nothing() -> None:
    edge = np.array([0.0, 0.0, 0.05, 0.0, 1.0, 0.5])
    rng = np.random.default_rng(6)
    theta = edge * np.exp(0.3 * rng.standard_normal((500, 6))) + np.array([0.01, 0, 0, 0.01, 0, 0])
    out = stretched(MODEL, theta, edge, 4.0, SPEED)
    assert passive(
        np.ascontiguousarray(out[:, :5] * 4.0 ** np.array([1, 2, 3, 0, 1])), np.array([3, 2])
    ).all()
    assert (out[:, 5] > 0.0).all()
    assert stretched(MODEL, theta, edge, 1.0, SPEED) == pytest.approx(theta, rel=1e-9, abs=1e-12)
