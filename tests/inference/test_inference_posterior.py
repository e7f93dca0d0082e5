"""A simulated log from its samples to its intervals: the truth in them, the same draws for a seed."""

from dataclasses import replace

import numpy as np
import pytest
from inference_cases import handles_of, small_recipe, state_of
from scipy.optimize import LinearConstraint, minimize

from tissueid.inference.channel_law import kelvin_voigt_law
from tissueid.inference.posterior import (
    PosteriorOptions,
    _at_mean_machine,
    _passive,
    with_posterior,
    without_faults,
)
from tissueid.inference.target import SpecimenTarget
from tissueid.model.base import scaled_theta
from tissueid.priors import CalibrationPrior, Priors
from tissueid.synth import Branch, Hold, Log, Move

TRUTH = {
    "static_1_N_per_mm": 20.0, "static_2_N_per_mm2": -1.2, "static_3_N_per_mm3": 0.35,
    "stiffness_0_N_per_mm": 30.0, "relaxation_time_s": 0.2, "viscosity_N_s_per_mm": 6.0,
}  # fmt: skip
ONE = small_recipe(branches=(Branch((30.0,), 0.2),), logs=(Log("hold", (Move(4.0, 240.0), Hold(5.0))),))
SEVERAL = small_recipe(branches=(Branch((30.0,), 0.2),))
#: A machine that was calibrated: what remains of its frame, of its skew and of its filter.
CALIBRATED = Priors(
    calibration={
        "frame_compliance_mm_per_N": CalibrationPrior(0.0, 2e-4, stated=True),
        "skew_s": CalibrationPrior(0.0, 3e-4, stated=True),
        "force_filter_s": CalibrationPrior(0.0, 3e-4, 0.0, stated=True),
    }
)


def fitted(recipe=ONE, seed=7, machine=True, priors=CALIBRATED, **options):
    return state_of(handles_of(recipe, seed, sd_mm=0.01), priors=priors, machine=machine, **options)


def sampled(state, *, instrument=True, seed=3, priors=CALIBRATED):
    options = PosteriorOptions(draws=600, seed=seed)
    return with_posterior(state, priors=priors, options=options, instrument=instrument)


@pytest.fixture(scope="module")
def fit():
    return sampled(fitted())


def test_draws_are_moved_to_a_machine_without_faults():
    rng = np.random.default_rng(5)
    machine = np.abs(rng.standard_normal((4000, 2)))
    noise = 0.001 * rng.standard_normal(4000)
    bent = {
        "tau": 2.0 * np.exp(0.02 * machine[:, 0] - 0.1 * machine[:, 1] + noise),
        "a2": 0.3 * machine[:, 0] - 1.0 + noise,
        "bound": np.maximum(0.2 * machine[:, 1] - 0.1, 0.0),
    }
    one, other, both = without_faults(machine, bent)
    assert np.quantile(both["tau"], [0.025, 0.975]) == pytest.approx([1.996, 2.004], abs=2e-3)
    assert one["a2"].mean() == pytest.approx(-1.0, abs=2e-3)
    np.testing.assert_allclose(other["a2"], bent["a2"], atol=0.02)
    assert min(moved["bound"].min() for moved in (one, other, both)) == 0.0
    # effects that are there are not taken away
    assert list(without_faults(3.0 + 0.1 * machine, bent)) == []


@pytest.mark.system
def test_the_truth_lies_in_its_intervals(fit):
    assert fit.posterior.sampler.converged
    for name, truth in TRUTH.items():
        own = fit.parameter(name).uncertainty
        low, high = own.ci95_total
        assert low < truth < high, name
        # the total interval holds the statistical one and the value
        assert low <= own.ci95[0] <= fit.parameter(name).value <= own.ci95[1] <= high, name
        assert fit.parameter(name).identified, name
    # and they are no wider than that machine makes them
    low, high = fit.parameter("relaxation_time_s").uncertainty.ci95_total
    assert np.log(high / low) < 0.5
    assert fit.posterior.noise.sigma_N == pytest.approx(0.2, rel=0.1)


@pytest.mark.system
def test_draws_are_passive_tissues_with_their_log_density(fit):
    posterior = fit.posterior
    model = kelvin_voigt_law(1, 0, fit.depth_mm).model()
    for theta in (*posterior.draws[::50], *posterior.draws_total[::50]):
        assert model.is_passive(theta)
    assert posterior.chain.shape[:2] == posterior.log_density.shape
    assert np.isfinite(posterior.log_density).all()
    assert len(posterior.chain_names) == posterior.chain.shape[2]
    assert posterior.log_prior.shape == (len(posterior.draws),)
    sources = {row.source for row in posterior.budget}
    assert sources >= {"noise", "frame", "time skew", "contact points", "total"}
    (band,) = posterior.bands.values()
    inside = (fit.trials[0].curve.force_N >= band[0]) & (fit.trials[0].curve.force_N <= band[2])
    # 500 samples: three binomial standard deviations
    assert inside.mean() == pytest.approx(0.95, abs=0.03)


@pytest.mark.system
def test_a_seed_repeats_its_draws_and_another_agrees(fit):
    state = fitted()
    same, other = sampled(state), sampled(state, seed=4)
    np.testing.assert_array_equal(same.posterior.draws, fit.posterior.draws)
    np.testing.assert_array_equal(same.posterior.draws_total, fit.posterior.draws_total)
    for name in TRUTH:
        a, b = fit.parameter(name).uncertainty, other.parameter(name).uncertainty
        assert abs(a.mean - b.mean) <= 0.4 * a.sd, name
        assert b.sd == pytest.approx(a.sd, rel=0.3), name


@pytest.mark.system
def test_a_known_machine_narrows_the_interval_to_that_of_the_noise(fit):
    alone = sampled(fitted(machine=False), instrument=False)
    assert alone.posterior.draws_total is None
    assert alone.posterior.budget == ()
    for name in ("relaxation_time_s", "viscosity_N_s_per_mm", "static_1_N_per_mm"):
        own = alone.parameter(name).uncertainty
        assert own.ci95_total is None
        assert own.ci95[0] < TRUTH[name] < own.ci95[1]
        low, high = fit.parameter(name).uncertainty.ci95_total
        assert own.ci95[1] - own.ci95[0] < high - low
    # a well determined time is as sharp as its standard error says
    bare = fitted(machine=False).fit.parameter("relaxation_time_s")
    assert alone.parameter("relaxation_time_s").uncertainty.sd == pytest.approx(bare.stderr, rel=0.25)


@pytest.mark.system
def test_several_logs_with_scatter_hold_the_truth_too():
    found = sampled(fitted(replace(SEVERAL, cv_both=0.05), seed=2))
    for name in ("relaxation_time_s", "viscosity_N_s_per_mm"):
        low, high = found.parameter(name).uncertainty.ci95_total
        assert low < TRUTH[name] < high, name
    assert "ln_gain_sd" in found.posterior.chain_names


@pytest.mark.system
def test_a_law_that_lacks_a_branch_has_the_generalised_posterior():
    state = fitted(replace(ONE, branches=(*ONE.branches, Branch((20.0,), 2.5)), sigma_N=0.05))
    assert state.identified.discrepant
    found, name = sampled(state), "static_1_N_per_mm"
    assert found.posterior.sampler.detail["density"] == "generalised"
    assert found.posterior.noise.samples_per_independent > 1.0
    plain = state.fit.parameter(name).detail["estimate_stderr"]
    assert found.parameter(name).uncertainty.sd > 1.5 * plain
    # without a sampler the fit stands
    assert with_posterior(state, priors=Priors(), options=PosteriorOptions(sampler="none")) is state.fit


def test_gains_of_the_channels_scale_the_tissue():
    law, (force, travel) = kelvin_voigt_law(1, 1, 4.0), (1.02, 0.97)
    theta, model = np.array([20.0, -1.2, 0.35, 30.0, 6.0, 0.2]), law.model()
    found = scaled_theta(model.parameters, theta[None], np.array([force]), np.array([travel]))[0]
    # F_shown = g_F F(x), x_shown = g_x x
    x = np.linspace(0.1, 3.0, 5)
    shown = model.static_force(theta, travel * x) / force
    np.testing.assert_allclose(model.static_force(found, x), shown, rtol=1e-12)
    shown = model.stiffness(theta, travel * x)[0] * travel / force
    np.testing.assert_allclose(model.stiffness(found, x)[0], shown)
    assert found[-1] == 0.2


def test_draws_are_brought_inside_no_further_than_needed():
    law = kelvin_voigt_law(1, 1, 1.0)
    rng = np.random.default_rng(2)
    spread = np.diag([0.1, 0.1, 0.1, 1.0, 1.0])
    spread[3, 4] = spread[4, 3] = -0.5
    linear = np.array([3.0, 0.0, 0.0, 0.5, 0.5]) + rng.multivariate_normal(np.zeros(5), spread, 400)
    found = _passive(law, linear, np.array([3.0, 0.0, 0.0, 0.5, 0.5]))
    # slopes, K at the surface and K at depth 1
    walls = law.cone @ linear.T
    inside = (walls >= 0.0).all(axis=0)
    assert 0.2 < inside.mean() < 0.8
    np.testing.assert_array_equal(found[inside], linear[inside])
    assert (law.cone @ found.T >= -1e-12).all()
    # the nearest in the metric of the draws, by another solver
    precision = np.linalg.inv(np.cov(linear.T))
    for one, moved in list(zip(linear[~inside], found[~inside], strict=True))[:20]:
        best = minimize(
            lambda x, one=one: (x - one) @ precision @ (x - one), np.array([3.0, 0.0, 0.0, 1.0, 0.0]),
            constraints=LinearConstraint(law.cone, 0.0), method="SLSQP", options={"ftol": 1e-12},
        )  # fmt: skip
        np.testing.assert_allclose(moved, best.x, atol=2e-3)


def test_draws_on_a_wall_keep_what_the_wall_does_not_hold():
    law = kelvin_voigt_law(1, 0, 4.0)
    rng = np.random.default_rng(3)
    linear = np.array([1.0, 0.1, 0.0, 0.0]) + rng.standard_normal((300, 4)) * [0.01, 0.001, 1e-5, 0.0]
    # all of them on the wall of K, half of them behind it by rounding
    linear[:, 3] = np.where(np.arange(300) % 2, -1e-9, 0.0)
    found = _passive(law, linear, np.array([1.0, 0.1, 0.0, 0.0]))
    np.testing.assert_allclose(found[:, 3], 0.0, atol=1e-12)
    assert found[:, 0].std() == pytest.approx(linear[:, 0].std(), rel=0.1)


@pytest.mark.system
def test_seeds_agree_on_a_generalised_posterior_at_its_walls():
    # two branches in a recording of three: the law lacks one, and a K that grows from nothing is on its wall
    branches = (Branch((0.0, 12.0), 0.2), Branch((0.0, 6.0), 2.5), Branch((8.0,), 0.02))
    recipe = replace(ONE, branches=branches, sigma_N=0.05)
    state = fitted(recipe, priors=Priors(), branches=2, stiffness_degree=1)
    assert state.identified.discrepant
    found = [sampled(state, seed=seed, priors=Priors()) for seed in (3, 4)]
    assert found[0].posterior.sampler.detail["density"] == "generalised"
    spread = found[0].posterior.parameters
    assert any(own.ci95[0] == 0.0 for own in spread.values())
    for one, other in zip(found[0].parameters, found[1].parameters, strict=True):
        if one.value is not None and spread[one.name].sd > 0.0:
            assert abs(one.value - other.value) <= 0.03 * spread[one.name].sd, one.name


def test_statistical_draws_have_the_machine_at_its_mean():
    at = SpecimenTarget(fitted().identified, machine=True)
    vectors = at.mode + np.random.default_rng(1).standard_normal((500, at.mode.size)) * 0.01
    k = at.law.times
    vectors[:, 0] += 5.0 * (vectors[:, k] - at.mode[k])
    found = _at_mean_machine(at, vectors)
    assert np.ptp(found[:, k : k + 3], axis=0) == pytest.approx(np.zeros(3))
    # what followed the machine is taken off, the rest and all means stay
    assert found[:, 0].std() == pytest.approx(0.01, rel=0.1)
    np.testing.assert_allclose(found.mean(axis=0), vectors.mean(axis=0), atol=1e-12)
    assert found[:, -1].std() == pytest.approx(vectors[:, -1].std(), rel=0.02)
