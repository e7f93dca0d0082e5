"""Closed forms of quoted numbers against the running model, and their errors against Monte Carlo."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.model.base import ContactPath
from tissueid.model.functionals import (
    complex_stiffness,
    delta_method,
    dissipated_per_cycle,
    equilibrium_stiffness,
    force_after_ramp,
    force_after_step,
    instantaneous_stiffness,
)
from tissueid.model.grammar import parsed
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.states import branch_states

MODEL = kelvin_voigt(branches=2, stiffness_degree=2, depth_mm=4.0)
THETA = MODEL.join(
    np.array([5.0, 0.4, 0.1]), np.array([[8.0, 1.0, 0.3], [4.0, 0.5, 0.0]]), np.array([0.05, 1.2])
)


LINEAR = kelvin_voigt(1, 1, 4.0), np.array([5.0, 0.4, 0.1, 8.0, 1.0, 0.05])


@pytest.mark.parametrize("ramp_s", [0.0, 1.5])
@pytest.mark.parametrize("tissue", [(MODEL, THETA), LINEAR], ids=["quadratic", "linear"])
def test_force_after_a_step_or_a_ramp_is_that_of_the_recursion(tissue, ramp_s):
    model, theta = tissue
    time = np.array([0.0, ramp_s, ramp_s + 0.1, 5.0])
    force = model.force(theta, ContactPath(time, np.array([0.0, 3.0, 3.0, 3.0])))
    for k in (1, 2, 3):
        since = float(time[k] - ramp_s)
        ramp = (force_after_ramp, (model, theta, 3.0, 2.0, since))
        function, at = ramp if ramp_s else (force_after_step, (model, theta, 3.0, since))
        assert function(*at) == pytest.approx(force[k], rel=1e-13)


def last_cycle(frequency, amplitude, n):
    """Phase, travel and force of a late period of a sine about 2 mm."""
    settle = int(np.ceil(12.0 * 1.2 * frequency)) + 1
    angle = 2.0 * np.pi * np.arange(0.0, settle + 1.0, 1.0 / n)
    x = 2.0 + amplitude * np.sin(angle)
    # from rest at the mean depth: F_s alone, no branch
    states = branch_states(angle / (2.0 * np.pi * frequency), x, np.array([0.05, 1.2]))
    force = MODEL.static_force(THETA, x) + (MODEL.stiffness(THETA, x) * states).sum(axis=0)
    return angle[-n - 1 :], x[-n - 1 :], force[-n - 1 :]


@pytest.mark.needs_jit
@pytest.mark.parametrize("frequency", [0.05, 0.7, 6.0])
def test_storage_and_loss_are_those_of_a_small_sine(frequency):
    angle, _, force = (one[1:] for one in last_cycle(frequency, 1e-4, 2000))
    found = complex_stiffness(MODEL, THETA, 2.0, frequency)
    # chords of a sine of 2000 samples: 1e-6; the amplitude's second order: 1e-5
    for part, wave in zip(found, (np.sin(angle), np.cos(angle)), strict=True):
        assert part == pytest.approx(2.0 * np.mean(force * wave) / 1e-4, rel=1e-4)


def test_energy_of_a_large_cycle_is_the_area_of_its_loop():
    _, x, force = last_cycle(0.7, 1.5, 4000)
    # trapezoids over 4000 samples: 1e-6; what is left of the start after 12 periods: 1e-6
    area = np.trapezoid(force, x)
    assert dissipated_per_cycle(MODEL, THETA, 2.0, 1.5, 0.7) == pytest.approx(area, rel=1e-4)


def test_stiffness_is_the_slope_of_slow_and_of_sudden_motion():
    secant, tangent = equilibrium_stiffness(MODEL, THETA, 3.0)
    assert secant == pytest.approx(5.0 + 0.4 * 3.0 + 0.1 * 9.0)
    assert tangent == pytest.approx(5.0 + 0.8 * 3.0 + 0.3 * 9.0)
    sudden_secant, sudden_tangent = instantaneous_stiffness(MODEL, THETA, 3.0)
    assert sudden_secant == pytest.approx(force_after_step(MODEL, THETA, 3.0, 0.0) / 3.0)
    # the limit of high frequency
    assert sudden_tangent == pytest.approx(complex_stiffness(MODEL, THETA, 3.0, 1e5)[0], rel=1e-8)


def test_error_of_a_function_is_the_spread_over_draws():
    rng = np.random.default_rng(20261121)
    half = rng.standard_normal((THETA.size, THETA.size)) * (0.004 * THETA)[:, None]
    covariance = half @ half.T
    unknown = np.zeros(THETA.size, dtype=bool)

    def relaxed(theta):
        return 1.0 - force_after_step(MODEL, theta, 3.0, 0.5) / force_after_step(MODEL, theta, 3.0, 0.0)

    value, stderr = delta_method(relaxed, THETA, covariance, unknown)
    draws = [relaxed(theta) for theta in rng.multivariate_normal(THETA, covariance, size=4000)]
    assert value == relaxed(THETA)
    # 4000 draws know their spread to 1.1 %; the second order of a 1 % change is as large
    assert stderr == pytest.approx(float(np.std(draws)), rel=0.05)


def test_a_number_that_hangs_on_an_unknown_parameter_or_has_no_slope_has_no_finite_error():
    unknown, covariance = np.arange(THETA.size) == THETA.size - 1, np.diag((0.01 * THETA) ** 2)
    for function, finite in (
        (lambda theta: equilibrium_stiffness(MODEL, theta, 2.0)[0], True),
        (lambda theta: complex_stiffness(MODEL, theta, 2.0, 0.3)[1], False),
    ):
        assert np.isfinite(delta_method(function, THETA, covariance, unknown)[1]) == finite

    def beside_a_pole(theta):
        return float(theta[0]) if theta[0] <= 1.0 else float("inf")

    assert delta_method(beside_a_pole, np.ones(1), np.eye(1), np.zeros(1, bool)) == (1.0, np.inf)


def test_a_shape_that_nothing_determines_leaves_no_error_of_a_number() -> None:
    law = parsed("power * prony").model(4.0, 0.01, 8.0)
    theta, covariance = np.array([1e-3, 4.0, 1.0, 0.1]), np.diag([1.0, 1e40, 1.0, 1.0])

    def deepest(one: np.ndarray) -> float:
        return float(law.static_force(one, np.array([4.0]))[0])

    value, stderr = delta_method(deepest, theta, covariance, np.zeros(4, bool))

    assert value == pytest.approx(1e-3 * 4.0**4)
    assert np.isinf(stderr)


def test_a_depth_just_above_the_surface_has_no_force() -> None:
    law = parsed("power * stretched").model(4.0, 0.01, 8.0)

    force = law.static_force(np.array([2.0, 1.5, 1.0, 0.1, 0.5]), np.array([-1e-9, 0.0, 1.0]))

    assert force.tolist() == [0.0, 0.0, 2.0]
