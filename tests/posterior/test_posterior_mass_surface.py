"""The smooth passive mass against the mass worked out at every point, at a bound that is active."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tissueid.likelihood.basis import kernel_basis
from tissueid.likelihood.lag_sums import lag_sums
from tissueid.likelihood.linearise import Optimum, centre
from tissueid.likelihood.sums import LogData
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior.building import specimen_target
from tissueid.posterior.linear_priors import Facts
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.posterior.surface import Surface, cubic_terms
from tissueid.priors import Priors

STEP, DEPTH, TAU, SIGMA = 0.01, 5.0, 0.2, 0.4
SPEEDS = (1.0, 4.0, 12.0)


def target_of(static: tuple[float, float, float], stiffness: tuple[float, float]) -> SpecimenTarget:
    """Three ramps on one tissue, its optimum taken at the truth."""
    model = KelvinVoigt(branches=1, stiffness_degree=1, depth_mm=DEPTH)
    theta = np.array([*static, *stiffness, TAU])
    rng = np.random.default_rng(20261121)
    basis = kernel_basis(step_s=STEP, length_s=6.0)
    optimum = Optimum(
        theta=np.concatenate(
            [np.array(static) * DEPTH ** np.arange(1.0, 4.0), np.array(stiffness) * [1.0, DEPTH]]
        ),
        log_tau=np.array([np.log(TAU)]),
        gamma=np.zeros(3),
        delta=np.zeros(3),
        own=np.zeros((3, 4)),
        scale=DEPTH,
        degree=1,
    )
    sums = []
    for i, speed in enumerate(SPEEDS):
        time = np.arange(0.0, min(DEPTH / speed + 0.6, 2.0), STEP)
        depth = np.minimum(speed * time, DEPTH)
        force = model.force(theta, ContactPath(time, depth)) + SIGMA * rng.standard_normal(time.size)
        data = LogData(time, depth, force, np.ones(time.size, bool), np.zeros(time.size, dtype=np.int64))
        sums.append(
            lag_sums(data, basis, degree=1, reference_step_s=STEP, center=centre(basis, 1, optimum, i))
        )
    facts = Facts(
        force_N=120.0,
        speed_mm_s=np.array(SPEEDS),
        depth_mm=np.full(3, DEPTH),
        log_tau_bounds=(np.log(STEP / 5.0), np.log(60.0)),
        offset_sd_mm=np.zeros(3),
        offset_mean_mm=np.zeros(3),
    )
    return specimen_target(
        sums,
        basis,
        optimum,
        centred=optimum,
        facts=facts,
        priors=Priors(),
        pooling="shared",
        correlated=False,
        start=np.array([np.log(TAU), np.log(SIGMA)]),
        start_sd=np.array([0.05, 0.03]),
    )


def test_no_surface_is_made_where_no_bound_is_near() -> None:
    assert target_of((20.0, -1.2, 0.35), (30.0, 4.0)).surface is None


@pytest.mark.needs_jit
def test_surface_agrees_with_the_mass_of_every_point_at_an_active_bound() -> None:
    # F_s / x and K both start at zero: two bounds
    target = target_of((0.0, 0.5, 0.35), (0.0, 8.0))
    assert target.surface is not None
    root = np.linalg.cholesky(target.covariance)
    points = target.mode + np.random.default_rng(3).standard_normal((200, 2)) @ root.T
    direct = replace(target, surface=None).log_density(points)
    difference = target.log_density(points) - direct
    assert np.isfinite(direct).all()
    # the error it states of itself, and what a mass of a few bounds is known to
    assert difference.std() <= 3.0 * target.surface.error + 0.05
    assert abs(difference.mean()) <= 0.1


def test_surface_is_its_cubic_inside_and_constant_along_rays_outside() -> None:
    rng = np.random.default_rng(4)
    z = rng.standard_normal((50, 3))
    terms = cubic_terms(z)
    assert terms.shape == (50, 20)
    surface = Surface(np.zeros(3), np.eye(3), rng.standard_normal(20), radius=2.0, error=0.0)
    inside = 0.5 * z / np.linalg.norm(z, axis=1)[:, None]
    np.testing.assert_allclose(surface(inside), cubic_terms(inside) @ surface.coefficients, rtol=1e-12)
    np.testing.assert_allclose(surface(20.0 * inside), surface(4.0 * inside), rtol=1e-12)
