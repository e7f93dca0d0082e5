"""A smooth likelihood stands for all draws of a specimen, not for one of them."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.population.mixture_kernels import log_mixture
from tissueid.population.surrogate import Mixture, mixture_of

LINEAR = np.array([True, True, False])
#: Forces to 5 and 10 %, a relaxation time to 60 %.
OWN = np.array([0.05, 0.1, 0.6])


def draws(count: int = 2000) -> np.ndarray:
    return np.array([4.0, 0.5, -4.0]) + OWN * np.random.default_rng(31).standard_normal((count, 3))


def level(found: Mixture, phi: np.ndarray) -> float:
    return log_mixture(phi, LINEAR, found.centre, found.log_weight, found.mean, found.unit)


# As a prior says that knows next to nothing of one place, or nothing at all.
@pytest.mark.parametrize("below", [60.0, 2000.0, np.inf])
def test_one_draw_far_out_in_the_prior_does_not_stand_for_all_others(below: float) -> None:
    phi, reference = draws(), np.zeros(2000)
    expected = mixture_of(phi, reference, LINEAR, np.random.default_rng(0))
    phi[77, :2] += np.log(15.0)
    reference[77] = -below
    found = mixture_of(phi, reference, LINEAR, np.random.default_rng(0))

    assert np.abs((found.middle - expected.middle) / OWN).max() < 0.2
    for place in phi[:40]:
        near, centre = place, expected.centre
        change = level(found, near) - level(found, centre)
        # a hundredth of all weight at five standard deviations: a quarter more variance, up to half of a
        # squared distance of some ten
        assert change == pytest.approx(level(expected, near) - level(expected, centre), abs=2.0)


def test_a_prior_that_varies_is_divided_out_of_the_likelihood() -> None:
    phi = draws(6000)
    # draws of likelihood x prior: with a normal prior around 4.05, of the first force alone
    prior = -0.5 * ((phi[:, 0] - 4.05) / 0.1) ** 2
    rng = np.random.default_rng(2)
    kept = phi[rng.random(len(phi)) < np.exp(prior)]

    found = mixture_of(kept, -0.5 * ((kept[:, 0] - 4.05) / 0.1) ** 2, LINEAR, rng)

    # the likelihood is a normal around 4 again: 3 errors of the mean of some thousand draws
    assert found.middle[0] == pytest.approx(4.0, abs=3.0 * 0.05 / np.sqrt(1000.0) + 0.002)
    assert 1.0 / np.sqrt(found.precision[0, 0]) == pytest.approx(0.05, rel=0.1)
