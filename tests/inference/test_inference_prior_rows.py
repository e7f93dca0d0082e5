"""The prior density of draws, against the definition written out for one branch."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest

from tissueid.likelihood.linearise import Optimum
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.inference.linear_priors import Facts
from tissueid.inference.theta_prior import log_theta_prior
from tissueid.priors import WEAK_FACTOR, Priors, SpreadPrior

DEPTH = 8.0
FACTS = Facts(
    force_N=150.0,
    speed_mm_s=np.array([0.2, 4.0]),
    depth_mm=np.array([8.0, 8.0]),
    log_tau_bounds=(math.log(1e-3), math.log(300.0)),
    offset_sd_mm=np.zeros(1),
    offset_mean_mm=np.zeros(1),
)
THETA = np.array(
    [[20.0, -1.2, 0.35, 63.0, 0.021], [25.0, -2.0, 0.4, 10.0, 1.5], [15.0, 0.5, 0.1, 90.0, 0.004]]
)


def target(priors: Priors, *, static: bool = True) -> SimpleNamespace:
    optimum = Optimum(
        theta=np.zeros(4 if static else 1), log_tau=np.zeros(1), gamma=np.zeros(1), delta=np.zeros(1),
        own=np.zeros((1, 4)), scale=DEPTH, degree=0,
    )  # fmt: skip
    return SimpleNamespace(optimum=optimum, priors=priors, facts=FACTS, model=KelvinVoigt(1, 0, DEPTH))


def weak(theta: np.ndarray) -> float:
    """Bernstein coefficients of F_s/x by depth, and K at the largest state: normal around 0."""
    a1, a2, a3, k, tau = theta
    u = np.array([a1 * DEPTH, a2 * DEPTH**2, a3 * DEPTH**3])
    bernstein = np.array([u[0], u[0] + u[1] / 2.0, u.sum()])
    sd = WEAK_FACTOR * FACTS.force_N
    state = 4.0 * tau * (1.0 - math.exp(-DEPTH / (4.0 * tau)))
    branch = -0.5 * (k * state / sd) ** 2 + math.log(state)
    # uniform in ln tau is 1 / tau in tau
    return float(-0.5 * (bernstein**2).sum() / sd**2 + branch - math.log(tau))


def test_the_weak_prior_is_its_definition() -> None:
    found = log_theta_prior(target(Priors()), THETA)  # type: ignore[arg-type]

    expected = np.array([weak(theta) for theta in THETA])
    assert found - found[0] == pytest.approx(expected - expected[0], abs=1e-10)


def test_stated_priors_are_their_densities() -> None:
    priors = Priors(
        linear={
            "static_1_N_per_mm": (20.0, 5.0),
            "static_2_N_per_mm2": (-1.0, 1.0),
            "static_3_N_per_mm3": (0.3, 0.1),
            "stiffness_0_N_per_mm": (60.0, 20.0),
        },
        relaxation_time_s=(SpreadPrior(0.02, 0.5),),
    )

    found = log_theta_prior(target(priors), THETA)  # type: ignore[arg-type]

    mean, sd = np.array([20.0, -1.0, 0.3, 60.0]), np.array([5.0, 1.0, 0.1, 20.0])
    expected = -0.5 * (((THETA[:, :4] - mean) / sd) ** 2).sum(axis=1)
    expected = expected - 0.5 * (np.log(THETA[:, 4] / 0.02) / 0.5) ** 2 - np.log(THETA[:, 4])
    assert found - found[0] == pytest.approx(expected - expected[0], abs=1e-9)


def test_a_curve_of_a_second_stage_has_a_flat_prior() -> None:
    moved = THETA.copy()
    moved[:, :3] *= 1.7

    found = log_theta_prior(target(Priors(), static=False), moved)  # type: ignore[arg-type]

    assert found == pytest.approx(log_theta_prior(target(Priors(), static=False), THETA))  # type: ignore[arg-type]
