"""A smooth likelihood stands for all draws of a specimen, not for one of them."""

import numpy as np
import pytest
from cohort_factory import COORDINATES, TYPICAL, plain_design

from tissueid.population.members import Member, stage_one
from tissueid.population.sampler import SamplerOptions, sample_population
from tissueid.population.stage_one import Mixture, Mixtures, StageOne, mixture_of
from tissueid.result import ModelChoice

LINEAR = np.array([True, True, False])
#: Forces to 5 and 10 %, a relaxation time to 60 %.
OWN = np.array([0.05, 0.1, 0.6])


def draws(count: int = 2000) -> np.ndarray:
    return np.array([4.0, 0.5, -4.0]) + OWN * np.random.default_rng(31).standard_normal((count, 3))


def level(found: Mixture, phi: np.ndarray, linear: np.ndarray = LINEAR) -> float:
    stage = StageOne((), (), linear, np.zeros(0, np.int64))
    return float(Mixtures.of([found], stage).log_density(phi[None, None])[0, 0])


# As a prior says that knows next to nothing of one place, or nothing at all.
@pytest.mark.parametrize("below", [60.0, 2000.0, np.inf])
def test_one_draw_far_out_in_the_prior_does_not_stand_for_all_others(below):
    phi, reference = draws(), np.zeros(2000)
    expected = mixture_of(phi, reference, LINEAR)
    phi[77, :2] += np.log(15.0)
    reference[77] = -below
    found = mixture_of(phi, reference, LINEAR)
    assert np.abs((found.middle - expected.middle) / OWN).max() < 0.2
    for place in phi[:40]:
        change, right = (level(one, place) - level(one, expected.centre) for one in (found, expected))
        # a hundredth of all weight at five standard deviations: a quarter more variance, up to half of a
        # squared distance of some ten
        assert change == pytest.approx(right, abs=2.0)


def test_a_prior_that_varies_is_divided_out_of_the_likelihood():
    phi = draws(6000)
    # draws of likelihood x prior: with a normal prior around 4.05, of the first force alone
    prior = -0.5 * ((phi[:, 0] - 4.05) / 0.1) ** 2
    kept = phi[np.random.default_rng(2).random(len(phi)) < np.exp(prior)]
    found = mixture_of(kept, -0.5 * ((kept[:, 0] - 4.05) / 0.1) ** 2, LINEAR)
    # the likelihood is a normal around 4 again: 3 errors of the mean of some thousand draws
    assert found.middle[0] == pytest.approx(4.0, abs=3.0 * 0.05 / np.sqrt(1000.0) + 0.002)
    assert 1.0 / np.sqrt(found.precision[0, 0]) == pytest.approx(0.05, rel=0.1)


def test_forces_that_are_open_by_a_factor_do_not_draw_the_population_to_no_force():
    """Specimens whose forces are known but for a gain of each."""
    rng = np.random.default_rng(33)
    centre = COORDINATES.to_phi(TYPICAL)[0][0]
    gain = np.array([0.0, 0.0, 1.0, 0.0, 0.0])
    made, places = [], []
    while len(made) < 10:
        place = centre + 0.15 * rng.standard_normal(5)
        error = 0.3 * rng.standard_normal()
        # gains of two logs, whose own spread is open as well: longer tails than a normal
        scatter = error + 0.3 * rng.standard_t(5.0, size=(2000, 1))
        own = np.array([3e-4, 3e-4, 5e-4, 0.015, 0.05]) * rng.standard_normal((2000, 5))
        phi = place + gain * scatter + own
        theta = COORDINATES.to_theta(phi)
        if not COORDINATES.passive(theta).all():
            continue
        model = ModelChoice("kelvin-voigt", 1, 3, 0, "partial")
        made.append(Member(f"s{len(made)}", model, 8.0, theta, -COORDINATES.log_jacobian(phi)))
        places.append(place)
    stage, _ = stage_one(made, COORDINATES)
    assert not stage.linear[2]
    found = sample_population(stage, plain_design(10), None, SamplerOptions(chains=4))
    assert found.converged
    # ten specimens of a spread of 0.15, each open by 0.3: their mean is known to a tenth
    assert np.abs(np.median(found.mean, axis=0) - np.mean(places, axis=0)).max() < 0.3


def test_what_noise_leaves_open_is_even_in_the_quantity_and_what_a_gain_does_in_its_logarithm():
    rng = np.random.default_rng(34)
    theta = np.tile(TYPICAL, (4000, 1))
    theta[:, 3] *= np.clip(1.0 + 0.4 * rng.standard_normal(4000), 1e-3, None)
    theta[:, :4] *= np.exp(0.4 * rng.standard_normal((4000, 1)))
    model = ModelChoice("kelvin-voigt", 1, 3, 0, "partial")
    stage, _ = stage_one([Member("s", model, 8.0, theta, np.zeros(4000))], COORDINATES)
    assert stage.linear[2:].tolist() == [False, True, False]


def test_few_draws_are_one_normal():
    draws = np.random.default_rng(6).standard_normal((319, 3))
    logarithms = np.zeros(3, dtype=bool)
    few = mixture_of(draws[:-1], np.zeros(318), logarithms)
    enough = mixture_of(np.vstack([draws, draws[:1]]), np.zeros(320), logarithms)
    assert few.log_weight.size == 1
    assert enough.log_weight.size == 3
    # of one normal: the mean of its draws
    np.testing.assert_allclose(few.mean[0] + few.centre, draws[:-1].mean(axis=0), atol=1e-12)


def test_gains_that_are_small_or_seldom_large_leave_a_core_and_tails():
    rng = np.random.default_rng(5)
    # one factor of all forces: to 4 % where the logs' gains are small, to 40 % where they are large
    middle = np.array([4.0, 4.5, -4.0])
    phi = middle + 0.03 * rng.standard_normal((4000, 3))
    phi += np.where(rng.random(4000) < 0.7, 0.04, 0.4)[:, None] * rng.standard_normal((4000, 1)) * [1, 1, 0]
    logarithms = np.zeros(3, dtype=bool)
    found = mixture_of(phi, np.zeros(4000), logarithms)

    def density(shift: float) -> float:
        return level(found, middle + np.array([shift, shift, 0.0]), logarithms)

    def expected(shift: float) -> float:
        # sd of the mean of two forces, and weights over it
        wide = np.sqrt(np.array([0.04, 0.4]) ** 2 + 0.03**2 / 2)
        return float(np.log((np.array([0.7, 0.3]) / wide * np.exp(-0.5 * (shift / wide) ** 2)).sum()))

    for shift in (-0.6, -0.3, -0.1, -0.05, 0.05, 0.1, 0.3, 0.6):
        fall = density(shift) - density(0.0)
        # 1,200 draws in the tails; one normal of all draws falls by 0.1 at a shift of 0.1, where 2.1 is right
        assert fall == pytest.approx(expected(shift) - expected(0.0), abs=0.4), shift
