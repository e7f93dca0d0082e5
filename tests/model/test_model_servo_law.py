"""The servo's law of any model: ticks against the model's force, passivity, errors of a projection."""

from __future__ import annotations

import numpy as np
import pytest
from passive_tissues import assert_no_energy, assert_stiffer_has_all_forces_times_that, walked
from scipy.optimize import nnls

from tissueid.model.base import ContactPath
from tissueid.model.grammar import known_laws, parsed
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.kernels import LAW_SIZE, pack_law
from tissueid.model.servo_law import _nonnegative, servo_law

DEPTH, RESOLUTION, WINDOW = 8.0, 0.01, 20.0
TICK = 1e-3
#: Values of parameters by the beginning of their names.
VALUES = {
    "static_1": 20.0, "static_2": -1.2, "static_3": 0.35, "static_N_per_mm": 12.0, "static_exponent": 1.4,
    "static_stiffness": 12.0, "static_rate": 0.15, "stiffness_0": 30.0, "stiffness_1": 4.0,
    "stiffness_2": -0.2, "relaxation_time": 0.4, "relaxation_exponent": 0.5, "relaxation_span": 200.0,
    "relaxation_ratio": 1.2, "damping": 0.7,
}  # fmt: skip


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


def tissue(name: str):
    """A model and its theta; times of further branches are longer, other parameters less."""
    model, theta = parsed(name).model(DEPTH, RESOLUTION, WINDOW), []
    for one in model.parameters:
        value = next(v for start, v in VALUES.items() if one.name.startswith(start))
        branch = int(one.name.rpartition("_b")[2]) if "_b" in one.name else 1
        theta.append(value * 5.0 ** (branch - 1) if "time" in one.name else value / branch)
    return model, np.array(theta)


@pytest.mark.parametrize("name", NAMES)
def test_ticks_follow_the_force_of_the_model(name):
    """A ramp, a hold and a slow return to half depth, in lasting contact: within 0.05 % of the most."""
    model, theta = tissue(name)
    time = np.arange(0.0, 3.0, TICK)
    depth = np.interp(time, [0.0, 1.0, 2.0, 3.0], [0.0, DEPTH, DEPTH, 0.7 * DEPTH])
    expected = model.force(theta, ContactPath(time, depth))
    assert expected.min() >= 0.0
    error = np.abs(walked(model, theta, time, depth) - expected).max()
    assert error < 5e-4 * expected.max()


@pytest.mark.parametrize("name", NAMES)
def test_a_projection_says_what_it_misses(name):
    model, theta = tissue(name)
    law = servo_law(model, theta)
    assert law.tau_s.size <= 12
    assert (law.stiffness[:, 0] > 0.0).all()
    # exponentials whose times are fitted: on a fixed grid of as many, the springpot's error is 7e-4
    assert law.error < 2e-4
    if model.relaxation.branches or model.fixed_s.size:
        assert law.error == 0.0


@pytest.mark.parametrize("name", [*NAMES, *DAMPED])
def test_loops_put_out_no_energy(name):
    """Random closed loops: the work done on the tissue is never negative."""
    rng = np.random.default_rng([7, *name.encode()])
    model, theta = tissue(name)
    for _ in range(6):
        assert_no_energy(model, theta, rng, turns=7)


def test_a_kelvin_voigt_law_is_packed_as_it_is():
    model, theta = kelvin_voigt(2, 1, DEPTH), np.array([20.0, -1.2, 0.35, 30.0, 4.0, 0.1, 12.0, 0.5, 2.0])
    expected = np.zeros(LAW_SIZE)
    static, stiffness, tau = model.split(theta)
    pack_law(np.array([0.0, *static]), stiffness, tau, DEPTH, expected, 0)
    np.testing.assert_array_equal(servo_law(model, theta).packed(), expected)


@pytest.mark.parametrize("name", ["power * linear * fractional", "polynomial * tangent * prony"])
def test_a_tissue_made_stiffer_has_all_its_forces_times_that(name):
    model, theta = tissue(name)
    assert_stiffer_has_all_forces_times_that(model, theta, 6.0 * np.arange(0.0, 1.0, TICK))


def test_non_negative_least_squares_are_those_of_scipy():
    rng = np.random.default_rng(3)
    for _ in range(40):
        matrix = np.abs(rng.standard_normal((30, 9)))
        target = matrix @ rng.standard_normal(9) + 0.1 * rng.standard_normal(30)
        np.testing.assert_allclose(_nonnegative(matrix, target), nnls(matrix, target)[0], atol=1e-9)
