"""The equations themselves: regressor, Lyapunov equality, and the loop against an independent solver."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tissueid.rendering.control import simulation
from tissueid.rendering.control.settings import ControlSettings, Gains, Mechanics, Signal
from tissueid.rendering.options import preset_tissue

PAPER_A = preset_tissue("paper-a")
#: Large gains and estimates from 0, so that the adaptation's share of V' is large.
LEARNING = Gains(adaptation=(1.0, 100.0, 1000.0), projection=False, sigma_start=2.0, sigma_floor=0.0)
HUM = Signal((0.0,), (1.0,), (7.0,))
#: A device and a hand of two axes whose matrices are not diagonal.
SKEWED = Mechanics([[1.2, 0.2], [0.2, 0.9]], [[20.0, 3.0], [3.0, 15.0]], [[30.0, -4.0], [-4.0, 20.0]])
HAND = Mechanics([[0.9, 0.1], [0.1, 0.6]], [[4.0, 0.0], [0.0, 3.0]], [[60.0, 5.0], [5.0, 40.0]])


def learning(variant: str, scale: float, sign: int = 1, **changes: Any) -> simulation.ControlRun:
    """A loop of which sampling and delay leave next to nothing."""
    gains = replace(LEARNING, adaptation_sign=sign)
    fast = {"rate_Hz": 2e5, "substeps": 1, "seconds": 0.5, "unchecked": True, **changes}
    settings = {"stiffness_scale": scale, "variant": variant, "gains": gains, "disturbance": HUM, **fast}
    settings = ControlSettings(PAPER_A, **settings)
    return simulation.simulate(replace(settings, start_estimates=np.zeros(settings.estimated_truth().size)))


def by_hand(run: simulation.ControlRun) -> tuple[np.ndarray, np.ndarray]:
    """V and the right side of (I-4) of one axis, from the recorded motion and nothing else of the package."""
    s, rho = run.settings, run.rho_m_s[:, 0]
    total = {"A": (1.158 + 1.25, 115.4 + 2.0, 31.46 + 30.0), "B": (1.158, 115.4, 31.46)}[s.variant]
    wrong = np.array(total) - run.estimates
    V = 0.5 * total[0] * rho**2 + 0.5 * (wrong**2 / np.array(s.gains.adaptation)).sum(axis=1)
    delta = {"A": 25.0, "B": 3.0}[s.variant]
    robust = delta**2 * rho / (delta * np.abs(rho) + 2.0 * np.exp(-0.5 * run.time_s))
    push = run.push_N[:, 0] if s.variant == "A" else 0.0
    unknown = push - np.sin(2.0 * np.pi * 7.0 * run.time_s)
    return V, -(100.0 + total[1]) * rho**2 - rho * unknown - rho * robust


def mismatch(run: simulation.ControlRun) -> float:
    """Largest difference of V' from what (I-4) says of it, as a share of the largest that is said."""
    rate = run.lyapunov_rate
    said = 0.5 * (rate[1:] + rate[:-1])
    return float(np.abs(np.diff(run.lyapunov) / np.diff(run.time_s) - said).max() / np.abs(said).max())


@pytest.mark.needs_jit
@pytest.mark.parametrize("variant", ["A", "B"])
@pytest.mark.parametrize("scale", [1.0, 100.0])
def test_the_equality_of_the_proof_holds_along_the_run_and_not_where_it_learns_wrongly(variant, scale):
    run = learning(variant, scale)
    V, rate = by_hand(run)
    np.testing.assert_allclose(run.lyapunov, V, rtol=1e-9)
    np.testing.assert_allclose(run.lyapunov_rate, rate, rtol=1e-6, atol=1e-9 * np.abs(rate).max())
    assert mismatch(run) <= 3e-4
    # without adaptation V' lacks all of the term, with the other sign it has it twice
    assert [round(mismatch(learning(variant, scale, sign))) for sign in (0, -1)] == [1, 2]


@pytest.mark.parametrize("environment", ["admittance", "impedance"])
def test_the_equality_holds_for_two_axes(environment):
    two = {
        "device": SKEWED, "operator": HAND, "push": Signal((10.0, 1.0), (8.0, 3.0), (1.0, 0.7)),
        "disturbance": Signal((0.0, 0.2), (0.5, 0.5), (7.0, 5.0)), "environment": environment,
        "rate_Hz": 1e4, "push_rise_s": 0.0, "seconds": 0.02,
    }  # fmt: skip
    # first order in steps of 0.1 ms
    assert mismatch(learning("B", 1.0, **two)) <= 0.06
    assert mismatch(learning("B", 1.0, -1, **two)) > 2.0


def test_matrices_of_several_axes_come_back_from_their_parameters():
    n = 3
    rng = np.random.default_rng(5)
    parts = [one @ one.T + np.eye(n) for one in rng.normal(size=(3, n, n))]
    theta = Mechanics(*parts).parameters()
    x, vr, ar = rng.normal(size=(3, n))

    force = simulation.generalised_force(theta, x, vr, ar)

    np.testing.assert_allclose(force, parts[0] @ ar + parts[1] @ vr + parts[2] @ x, rtol=1e-12)
    assert simulation.damping_form(theta, x) == pytest.approx(x @ parts[1] @ x, rel=1e-12)
    np.testing.assert_allclose(parts[0] @ simulation.solved(parts[0].copy(), force), force, rtol=1e-9)
    pivoted = simulation.solved(np.array([[0.0, 2.0], [3.0, 1.0]]), np.array([2.0, 5.0]))
    np.testing.assert_allclose(pivoted, [4.0 / 3.0, 1.0], rtol=1e-12)


def test_axes_that_know_nothing_of_each_other_move_as_one_axis_does():
    one = ControlSettings(PAPER_A, variant="B", seconds=0.06)
    two = replace(
        one,
        device=Mechanics(np.diag([1.158, 2.0]), np.diag([115.4, 20.0]), np.diag([31.46, 10.0])),
        operator=Mechanics(np.diag([1.25, 0.8]), np.diag([2.0, 1.0]), np.diag([30.0, 20.0])),
    )

    alone, first = simulation.simulate(one), simulation.simulate(two)

    assert alone.position_m[-1, 0] > 1e-6
    np.testing.assert_allclose(first.position_m[:, 0], alone.position_m[:, 0], atol=1e-15)
    np.testing.assert_array_equal(first.position_m[:, 1], 0.0)
    np.testing.assert_allclose(first.control_force_N[:, 0], alone.control_force_N[:, 0], atol=1e-9)


def radau(settings: ControlSettings, times: np.ndarray) -> np.ndarray:
    """x of one axis in lasting contact, from the differential equations of docs/control.md and scipy."""
    scale = settings.stiffness_scale
    a = scale * np.array([47.42e3, -5.577e6, 0.3804e9])
    K, tau = scale * 63.62e3, 0.021
    Md, Bd, Kd, Mh, Bh, Kh, Mt = 1.158, 115.4, 31.46, 1.25, 2.0, 30.0, 2.0
    B = settings.variant == "B"
    delta, floor, gamma = settings.disturbance_bound_N(), settings.sigma_floor(), (0.05, 5.0, 50.0)
    offset, amplitude = 8.0, 4.0

    def slope(t: float, z: np.ndarray) -> list[float]:
        x, v, xe, ve, s, *th = z
        push = min(t / 0.5, 1.0) * (offset + amplitude * np.sin(2.0 * np.pi * t))
        touched = a[0] * xe + a[1] * xe**2 + a[2] * xe**3 + K * s
        vr = ve + 50.0 * (xe - x)
        rho = vr - v
        robust = delta**2 * rho / (delta * abs(rho) + max(5.0 * np.exp(-0.5 * t), floor))

        def command(acceleration: float) -> tuple[float, float, float]:
            hand = push - Mh * acceleration - Bh * v - Kh * x
            ar = (hand - touched) / Mt + 50.0 * (ve - v)
            return th[0] * ar + th[1] * vr + th[2] * x + 100.0 * rho + robust - B * hand, hand, ar

        # what is left of Newton's law is linear in the acceleration: two points give its root
        def left(acceleration: float) -> float:
            u = command(acceleration)[0]
            return (Md + Mh) * acceleration + (Bd + Bh) * v + (Kd + Kh) * x - push - u

        acceleration = -left(0.0) / (left(1.0) - left(0.0))
        _u, hand, ar = command(acceleration)
        return [
            v, acceleration, ve, (hand - touched) / Mt, ve - s / tau,
            gamma[0] * ar * rho, gamma[1] * vr * rho, gamma[2] * x * rho,
        ]  # fmt: skip

    start = np.concatenate([np.zeros(5), 0.5 * settings.estimated_truth()])
    found = solve_ivp(slope, (0.0, times[-1]), start, "Radau", times, rtol=1e-9, atol=1e-13, max_step=2e-3)
    return np.asarray(found.y[0])


@pytest.mark.needs_jit
@pytest.mark.parametrize("variant", ["B", pytest.param("A", marks=pytest.mark.slow)])
def test_the_sampled_loop_tends_to_the_solution_of_the_differential_equations(variant):
    gains, push = Gains(projection=False, sigma_floor=0.4), Signal((8.0,), (4.0,), (1.0,))
    base = ControlSettings(PAPER_A, variant=variant, gains=gains, push=push, seconds=0.6)
    right = radau(base, np.arange(600) / 1000.0)
    size = np.sqrt(np.mean(right**2))

    def off(run: simulation.ControlRun) -> float:
        every = round(run.settings.rate_Hz / 1000.0)
        return float(np.sqrt(np.mean((run.position_m[::every, 0] - right) ** 2)) / size)

    rates = (1000.0, 2000.0, 4000.0, 8000.0, 16000.0)
    shares = [off(simulation.simulate(replace(base, rate_Hz=rate))) for rate in rates]

    assert all(later < 0.7 * earlier for earlier, later in pairwise(shares)), shares
    assert shares[-1] <= 0.01


def test_a_command_longer_than_the_device_gives_is_shortened_in_its_direction():
    most = 7.0
    settings = ControlSettings(PAPER_A, gains=Gains(saturation_N=most))
    block = simulation.loop_block(settings)
    for length, kept in ((0.5, 0.5), (1.0, 1.0), (3.0, 1.0)):
        u = simulation.saturated(block, length * most * np.array([0.6, -0.8]))
        np.testing.assert_allclose(u, kept * most * np.array([0.6, -0.8]), rtol=1e-12)
