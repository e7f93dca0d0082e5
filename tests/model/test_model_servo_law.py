"""The servo's law of any model, and the yardstick: ticks against the force, passivity, projections."""

from __future__ import annotations

import numpy as np
import pytest
from passive_tissues import (
    DEPTH_MM,
    TICK,
    assert_no_energy,
    assert_stiffer_has_all_forces_times_that,
    of_law,
    walked,
)

from tissueid.documents import typed
from tissueid.documents.identification import Model
from tissueid.model.base import ContactPath
from tissueid.model.grammar import ModelNameError, candidates, described, known_laws, parsed, rebuilt
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.kernels import LAW_SIZE, pack_law
from tissueid.model.servo_law import servo_law
from tissueid.model.yardstick import INSIDE, OUTSIDE, presents, yardstick_of
from tissueid.result import ModelChoice


def of_kind(kind):
    return [key for key, law in known_laws().items() if law.about.kind == kind]


NAMES = [
    *(f"{static} * linear * fractional" for static in of_kind("static")),
    *(f"power * quadratic * {relaxation}" for relaxation in of_kind("relaxation")),
    *(f"exponential * tangent * {one}" for one in of_kind("relaxation") if one != "spectrum"),
    "polynomial * tangent * prony:3",
    "flat * prony:2",
]
DAMPED = [f"power * {one}" for one in of_kind("damping")]


@pytest.mark.parametrize("name", NAMES)
def test_ticks_follow_the_force_of_the_model(name):
    """A ramp, a hold and a slow return to half depth, in lasting contact: within 0.01 % of the most."""
    model, theta = of_law(name)
    time = np.arange(0.0, 3.0, TICK)
    depth = np.interp(time, [0.0, 1.0, 2.0, 3.0], [0.0, DEPTH_MM, DEPTH_MM, 0.7 * DEPTH_MM])
    expected = model.force(theta, ContactPath(time, depth))
    assert expected.min() >= 0.0
    error = np.abs(walked(model, theta, time, depth) - expected).max()
    assert error < 1e-4 * expected.max()


@pytest.mark.parametrize("name", NAMES)
def test_a_projection_says_what_it_misses(name):
    model, theta = of_law(name)
    law = servo_law(model, theta)
    assert law.tau_s.size <= 12
    assert (law.stiffness[:, 0] > 0.0).all()
    # on a fixed grid of as many times the springpot is 7e-4 off, with times and weights fitted at once 1e-4
    assert law.error < 6e-5
    if model.relaxation.branches or model.fixed_s.size:
        assert law.error == 0.0


@pytest.mark.parametrize("name", [*NAMES, *DAMPED])
def test_loops_put_out_no_energy(name):
    """Random closed loops: the work done on the tissue is never negative."""
    rng = np.random.default_rng([7, *name.encode()])
    model, theta = of_law(name)
    for _ in range(6):
        assert_no_energy(model, theta, rng, turns=7)


def test_a_kelvin_voigt_law_is_packed_as_it_is():
    model, theta = kelvin_voigt(2, 1, DEPTH_MM), np.array([20.0, -1.2, 0.35, 30.0, 4.0, 0.1, 12.0, 0.5, 2.0])
    expected = np.zeros(LAW_SIZE)
    static, stiffness, tau = model.split(theta)
    pack_law(np.array([0.0, *static]), stiffness, tau, DEPTH_MM, expected, 0)
    np.testing.assert_array_equal(servo_law(model, theta).packed(), expected)


@pytest.mark.parametrize("name", ["power * linear * fractional", "polynomial * tangent * prony"])
def test_a_tissue_made_stiffer_has_all_its_forces_times_that(name):
    model, theta = of_law(name)
    assert_stiffer_has_all_forces_times_that(model, theta, 6.0 * np.arange(0.0, 1.0, TICK))


INSIDE_S, OUTSIDE_S = (0.05, 1.2), (0.02, 0.7)


def drawn(seed=0):
    """A yardstick with weights of which some are nothing."""
    model, rng = yardstick_of(DEPTH_MM, INSIDE_S, OUTSIDE_S), np.random.default_rng(seed)
    theta = rng.exponential(20.0, len(model.parameters)) * (rng.random(len(model.parameters)) < 0.6)
    theta[0] = 15.0
    return model, theta


def test_curves_grow_and_presents_add_up_to_one():
    model, x = yardstick_of(DEPTH_MM, INSIDE_S, OUTSIDE_S), np.linspace(0.0, DEPTH_MM, 200)
    parts = model.static.basis(x)
    assert parts.shape == (INSIDE, 200)
    assert (np.diff(parts, axis=1) >= -1e-12).all()
    np.testing.assert_allclose(parts[:, [0, -1]], [[0.0, 1.0]] * INSIDE, atol=1e-12)
    by_hand = np.gradient(parts, x, axis=1)[:, 2:-2]
    np.testing.assert_allclose(model.static.slope(x)[:, 2:-2], by_hand, atol=2e-3)
    shares = presents(x / DEPTH_MM)
    assert shares.min() >= 0.0
    np.testing.assert_allclose(shares.sum(axis=0), 1.0)


def test_force_is_that_of_the_integral():
    """Convolution by quadrature on a fine grid, written here."""
    model, theta = drawn()
    fine = np.linspace(0.0, 2.0, 40_001)
    x = np.interp(fine, [0.0, 1.0, 2.0], [0.0, DEPTH_MM, 0.8 * DEPTH_MM])
    force = model.static_force(theta, x)
    middle, step = 0.5 * (fine[1:] + fine[:-1]), np.diff
    for j, tau in enumerate((*INSIDE_S, *OUTSIDE_S)):
        part = theta[model.parts[j].stiffness]
        inside = j < len(INSIDE_S)
        curve = part @ model.static.basis(x) if inside else x
        left = np.exp(-(fine[-1] - middle) / tau) @ step(curve)
        force[-1] += left * (1.0 if inside else part @ presents(np.array([x[-1] / DEPTH_MM]))[:, 0])
    coarse = np.linspace(0.0, 2.0, 8001)
    found = model.force(theta, ContactPath(coarse, np.interp(coarse, fine, x)))
    assert found[-1] == pytest.approx(force[-1], rel=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_ticks_follow_the_force_of_the_yardstick(seed):
    model, theta = drawn(seed)
    time = np.arange(0.0, 2.0, TICK)
    depth = np.interp(time, [0.0, 1.0, 2.0], [0.0, DEPTH_MM, DEPTH_MM])
    expected = model.force(theta, ContactPath(time, depth))
    assert np.abs(walked(model, theta, time, depth) - expected).max() < 0.01 * expected.max()
    assert_stiffer_has_all_forces_times_that(model, theta, depth[:50])


@pytest.mark.parametrize("seed", range(6))
def test_loops_of_the_yardstick_put_out_no_energy(seed):
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
    again = rebuilt(ModelChoice.of(typed(choice.as_json(), Model)), DEPTH_MM)
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
