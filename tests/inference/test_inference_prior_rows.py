"""The prior density of draws against its definition, and the table of priors beside posteriors."""

from __future__ import annotations

import numpy as np
import pytest
from inference_cases import draw, handles_for, identified, small_recipe

from tissueid.inference.prior import bernstein
from tissueid.inference.reported import log_theta_prior, prior_table
from tissueid.inference.target import SpecimenTarget
from tissueid.model.channels import branch_states
from tissueid.model.grammar import candidates
from tissueid.priors import WEAK_FACTOR, Priors, SpreadPrior

RECIPE = small_recipe(logs=small_recipe().logs[-1:])
THETA = np.array([[20.0, -1.2, 0.35, 63.0, 0.2], [25.0, -2.0, 0.4, 10.0, 1.5], [15.0, 0.5, 0.1, 90.0, 0.04]])
STATED = Priors(
    linear={"static_1_N_per_mm": (20.0, 5.0), "stiffness_0_N_per_mm": (60.0, 20.0)},
    relaxation_time_s=(SpreadPrior(0.2, 0.5),),
)


def target(priors=None, **asked):
    (log,) = draw(RECIPE, 1)
    ours = identified(handles_for([log]), noise="white", priors=priors or Priors(), **asked)
    return log, SpecimenTarget(ours, machine=asked.get("machine", False))


def largest_state(log, tau):
    """Of a branch along the recording, over the depth."""
    return float(branch_states(log.time_s, log.displacement_mm, np.array([tau]))[0].max()) / 4.0


def weak(log, force, theta):
    """Bernstein coefficients of F_s/x by depth, and K at the largest state: normal around 0."""
    a1, a2, a3, k, tau = theta
    sd, state = WEAK_FACTOR * force, largest_state(log, tau)
    static = bernstein(3) @ np.array([a1 * 4.0, a2 * 16.0, a3 * 64.0])
    # uniform in ln tau is 1 / tau in tau
    return -0.5 * (static @ static) / sd**2 - 0.5 * (k * 4.0 * state / sd) ** 2 + np.log(state / tau)


def test_the_weak_prior_is_its_definition():
    log, at = target()
    expected = np.array([weak(log, at.force, theta) for theta in THETA])
    found = log_theta_prior(at, THETA)
    # the largest state is read off a table of 48 times
    assert found - found[0] == pytest.approx(expected - expected[0], abs=0.03)


def test_stated_priors_are_their_densities():
    _, plain = target()
    _, at = target(STATED)
    found = log_theta_prior(at, THETA) - log_theta_prior(plain, THETA)
    expected = -0.5 * ((THETA[:, 0] - 20.0) / 5.0) ** 2 - 0.5 * ((THETA[:, 3] - 60.0) / 20.0) ** 2
    expected -= 0.5 * (np.log(THETA[:, 4] / 0.2) / 0.5) ** 2
    assert found - found[0] == pytest.approx(expected - expected[0], abs=1e-9)


@pytest.mark.parametrize(
    "stated", [{}, {"static_N_per_mm_n": (12.0, 4.0), "stiffness_0_N_per_mm": (30.0, 9.0)}]
)
@pytest.mark.parametrize(
    "name",
    ["power * stretched", "exponential * linear * fung", "polynomial * tangent * prony:2", "power * prony:2"],
)
def test_the_prior_of_any_law_is_that_of_the_sampled_vectors(name: str, stated: dict) -> None:
    (log,) = draw(RECIPE, 1)
    priors = Priors(linear=stated)
    ours = identified(handles_for([log]), noise="white", candidates=candidates(name), priors=priors)
    at = SpecimenTarget(ours, machine=False)
    tissue = np.r_[np.arange(at.law.times), at.law.times + 3 + np.arange(at.law.linear)]

    def theta(x):
        point = at.point(x)
        return at.law.theta(point.log_times, point.linear, exact=True)[0]

    points = np.repeat(at.mode[None], 4, axis=0)
    low, high = at.law.bounds(-5.0, 5.0)
    points[:, : at.law.times] = np.clip(points[:, : at.law.times], low + 0.5, high - 0.5)
    points[1, tissue[: at.law.times]] += 0.05
    points[2, tissue[at.law.times :]] *= 1.2
    points[3, tissue] *= 1.03
    sampled = at._log_prior(points, at.shared(points))
    volume = []
    for x in points:
        steps = 1e-5 * np.maximum(np.abs(x[tissue]), 1.0)
        columns = [
            (theta(x + step * unit) - theta(x - step * unit)) / (2.0 * step)
            for step, unit in zip(steps, np.eye(x.size)[tissue], strict=True)
        ]
        volume.append(np.linalg.slogdet(columns)[1])

    found = log_theta_prior(at, np.array([theta(x) for x in points]))

    expected = sampled - np.array(volume)
    # the largest state is read off a table of 48 times
    assert found - found[0] == pytest.approx(expected - expected[0], abs=0.01)


def test_the_table_names_every_prior_and_what_the_data_added():
    _, at = target(STATED, machine=True)
    rng = np.random.default_rng(1)
    n = 400
    vectors = at.mode + 0.01 * rng.standard_normal((n, at.mode.size))
    theta = THETA[0] * (1.0 + 0.01 * rng.standard_normal((n, 5)))
    gains = 1.0 + 0.005 * rng.standard_normal((n, 2))
    rows = {row.name: row for row in prior_table(at, vectors, theta, gains)}
    assert set(rows) == {
        "static_1_N_per_mm", "static_2_N_per_mm2", "static_3_N_per_mm3", "stiffness_0_N_per_mm",
        "ln_relaxation_time_1", "ln_sigma", "force_gain", "displacement_gain", "frame_compliance_mm_per_N",
        "skew_s", "force_filter_s",
    }  # fmt: skip
    assert [name for name, row in rows.items() if row.stated] == [
        "static_1_N_per_mm", "stiffness_0_N_per_mm", "ln_relaxation_time_1",
    ]  # fmt: skip
    one = rows["static_1_N_per_mm"]
    assert "normal, 20" in one.prior
    assert one.posterior_sd == pytest.approx(0.2, rel=0.15)
    assert one.shrinkage == pytest.approx(1.0 - one.posterior_sd / 5.0)
    assert "weak" in rows["static_2_N_per_mm2"].prior
    assert "log-normal" in rows["ln_relaxation_time_1"].prior
    assert rows["force_gain"].shrinkage == pytest.approx(0.5, abs=0.1)
    assert {"force_gain", "skew_s"}.isdisjoint(
        row.name for row in prior_table(target()[1], vectors, theta, None)
    )
