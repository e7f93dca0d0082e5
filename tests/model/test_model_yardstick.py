"""The yardstick: its curves, its force against quadrature, the servo's force, and what loops put out."""

from __future__ import annotations

import numpy as np
import pytest
from passive_tissues import assert_no_energy, assert_stiffer_has_all_forces_times_that, walked

from tissueid.model.base import ContactPath
from tissueid.model.grammar import ModelNameError, candidates, described, parsed, rebuilt
from tissueid.model.yardstick import INSIDE, OUTSIDE, presents, yardstick_of
from tissueid.result import ModelChoice

DEPTH, TICK = 8.0, 1e-3
INSIDE_S, OUTSIDE_S = (0.05, 1.2), (0.02, 0.7)


def drawn(seed=0):
    """A yardstick with weights of which some are nothing."""
    model, rng = yardstick_of(DEPTH, INSIDE_S, OUTSIDE_S), np.random.default_rng(seed)
    theta = rng.exponential(20.0, len(model.parameters)) * (rng.random(len(model.parameters)) < 0.6)
    theta[0] = 15.0
    return model, theta


def test_curves_grow_and_presents_add_up_to_one():
    model, x = yardstick_of(DEPTH, INSIDE_S, OUTSIDE_S), np.linspace(0.0, DEPTH, 200)
    parts = model.static.basis(x)
    assert parts.shape == (INSIDE, 200)
    assert (np.diff(parts, axis=1) >= -1e-12).all()
    np.testing.assert_allclose(parts[:, [0, -1]], [[0.0, 1.0]] * INSIDE, atol=1e-12)
    by_hand = np.gradient(parts, x, axis=1)[:, 2:-2]
    np.testing.assert_allclose(model.static.slope(x)[:, 2:-2], by_hand, atol=2e-3)
    shares = presents(x / DEPTH)
    assert shares.min() >= 0.0
    np.testing.assert_allclose(shares.sum(axis=0), 1.0)


def test_force_is_that_of_the_integral():
    """Convolution by quadrature on a fine grid, written here."""
    model, theta = drawn()
    fine = np.linspace(0.0, 2.0, 40_001)
    x = np.interp(fine, [0.0, 1.0, 2.0], [0.0, DEPTH, 0.8 * DEPTH])
    force = model.static_force(theta, x)
    middle, step = 0.5 * (fine[1:] + fine[:-1]), np.diff
    for j, tau in enumerate((*INSIDE_S, *OUTSIDE_S)):
        part = theta[model.parts[j].stiffness]
        inside = j < len(INSIDE_S)
        curve = part @ model.static.basis(x) if inside else x
        left = np.exp(-(fine[-1] - middle) / tau) @ step(curve)
        force[-1] += left * (1.0 if inside else part @ presents(np.array([x[-1] / DEPTH]))[:, 0])
    coarse = np.linspace(0.0, 2.0, 8001)
    found = model.force(theta, ContactPath(coarse, np.interp(coarse, fine, x)))
    assert found[-1] == pytest.approx(force[-1], rel=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_ticks_follow_the_force_of_the_model(seed):
    model, theta = drawn(seed)
    time = np.arange(0.0, 2.0, TICK)
    depth = np.interp(time, [0.0, 1.0, 2.0], [0.0, DEPTH, DEPTH])
    expected = model.force(theta, ContactPath(time, depth))
    assert np.abs(walked(model, theta, time, depth) - expected).max() < 0.01 * expected.max()
    assert_stiffer_has_all_forces_times_that(model, theta, depth[:50])


@pytest.mark.parametrize("seed", range(6))
def test_loops_put_out_no_energy(seed):
    model, theta = drawn(seed)
    assert_no_energy(model, theta, np.random.default_rng(seed), turns=9)


def test_stiffness_is_the_slope_of_a_small_sudden_move():
    model, theta = drawn(2)
    at, step = 5.0, 1e-5
    time = np.concatenate([np.linspace(0.0, 1.0, 500), np.linspace(1.0, 300.0, 3000)[1:]])
    depth = np.concatenate([np.linspace(0.0, at, 500), np.full(2999, at)])
    before = model.force(theta, ContactPath(time, depth))[-1]
    moved = ContactPath(np.append(time, time[-1] + 1e-9), np.append(depth, at + step))
    rise = (model.force(theta, moved)[-1] - before) / step
    expected = model.static_slope(theta, np.array([at]))[0] + model.stiffness(theta, np.array([at])).sum()
    assert rise == pytest.approx(expected, rel=1e-3)


def test_it_is_built_again_from_its_nodes_and_refuses_negative_weights():
    choice = ModelChoice("yardstick", 4, 3, 2, "shared", "yardstick", (0.02, 1.2), INSIDE_S, OUTSIDE_S)
    model, theta = drawn()
    again = rebuilt(ModelChoice.from_json(choice.as_json()), DEPTH)
    assert again.parameter_names == model.parameter_names
    assert len(model.parameters) == INSIDE * (1 + len(INSIDE_S)) + OUTSIDE * len(OUTSIDE_S)
    assert again.is_passive(theta)
    assert not again.is_passive(np.where(np.arange(theta.size) == 3, -1.0, theta))


def test_names_of_choices():
    assert parsed("yardstick").mark
    auto = candidates("auto")
    assert auto.choose
    assert auto.paper is not None
    assert [one.mark for one in auto.laws] == [False, False, True]
    assert not candidates("kelvin-voigt").choose
    several = candidates("power * fung | polynomial * prony:2|flat*stretched")
    assert several.choose
    assert several.paper.branches == 2
    assert [one.name for one in several.laws] == ["power * fung", "flat*stretched"]
    with pytest.raises(ModelNameError, match="are one law"):
        candidates("kelvin-voigt | polynomial * prony:1")
    with pytest.raises(ModelNameError, match="'auto' is no model"):
        candidates("auto | power * fung")
    assert len(described()) == len({row["key"] for row in described()})
