"""The censored hierarchical likelihood, its evidence and interval, against brute force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from rupture_cohorts import known_cohort, typical_threshold
from scipy.integrate import quad
from scipy.stats import norm

from tissueid.rupture.evidence import Outcomes, log_likelihood, specimen_means, standardised, threshold_of
from tissueid.rupture.failures import Failure

MU, S, B = 0.3, 0.08, 0.12
Z = np.array([0.25, 0.31, 0.36, 0.45, 0.2])
VARIANCE = np.array([0.0, 1e-3, 0.0, 4e-4, 2e-3])
WHO = np.array([0, 0, 0, 1, 1])


def integrand(m: float, own: np.ndarray, ruptured: np.ndarray) -> float:
    sd = np.sqrt(S**2 + VARIANCE[own])
    terms = np.where(ruptured[own], norm.pdf(Z[own], m, sd), norm.sf(Z[own], m, sd))
    return float(terms.prod() * norm.pdf(m, MU, B))


@pytest.mark.parametrize("ruptured", [[1, 1, 1, 1, 1], [1, 0, 1, 1, 0], [1, 1, 1, 0, 0]])
def test_likelihood_is_the_integral_over_what_each_specimen_is(ruptured: list[int]) -> None:
    broken = np.array(ruptured, dtype=bool)
    expected = sum(
        np.log(quad(integrand, MU - 2.0, MU + 2.0, args=(np.flatnonzero(k == WHO), broken), points=[MU])[0])
        for k in (0, 1)
    )
    tests = Outcomes(Z, VARIANCE, broken, WHO)
    found = log_likelihood(tests, np.array(MU), np.array(S), np.array(B))
    assert float(found) == pytest.approx(expected, abs=2e-4)


def test_mean_of_a_specimen_knows_its_censored_tests() -> None:
    broken = np.array([True, False, True, True, False])
    tests = Outcomes(Z, VARIANCE, broken, WHO)
    for k, found in enumerate(specimen_means(tests, MU, S, B)):
        own = np.flatnonzero(k == WHO)
        mass = quad(integrand, MU - 2.0, MU + 2.0, args=(own, broken), points=[MU])[0]
        first = quad(lambda m, own=own: m * integrand(m, own, broken), MU - 2.0, MU + 2.0, points=[MU])[0]
        assert found == pytest.approx(first / mass, abs=2e-4)


@pytest.fixture(scope="module")
def cohort() -> list[Failure]:
    return known_cohort("work", 0.1, [9], threshold=typical_threshold("work"))


def in_other_units(failures: list[Failure], power: float) -> list[Failure]:
    """The same tests with the depth raised to a power: another measure of the same thing."""
    return [
        replace(
            one,
            measures={
                "depth": replace(
                    one.measures["depth"], value=7.0 * one.measures["depth"].value ** power, growth=power
                )
            },
        )
        for one in failures
    ]


def test_evidence_and_interval_do_not_depend_on_the_unit_or_power_of_a_measure(cohort: list[Failure]) -> None:
    plain, fourth = threshold_of(cohort, "depth"), threshold_of(in_other_units(cohort, 4.0), "depth")
    assert fourth.ln_evidence == pytest.approx(plain.ln_evidence, abs=1e-6)
    assert fourth.median == pytest.approx(7.0 * plain.median**4.0, rel=1e-4)
    assert fourth.ci95 == pytest.approx([7.0 * end**4.0 for end in plain.ci95], rel=1e-6)
    assert fourth.trend_p == pytest.approx(plain.trend_p, rel=1e-2)


def test_threshold_of_one_test_a_specimen_each_ruptured_is_their_mean(cohort: list[Failure]) -> None:
    slow = cohort[::3]
    found = threshold_of(slow, "work")
    logs, growth, _ = standardised(slow, "work")
    assert found.median == pytest.approx(float(np.exp(growth * logs.z.mean())), rel=1e-3)
    # two spreads can't be told apart, their sum is the sample's
    assert np.hypot(found.sd_ln, found.specimen_sd_ln) == pytest.approx(growth * logs.z.std(), rel=0.01)
    assert found.trend_p is None


def test_tests_that_did_not_rupture_raise_the_threshold() -> None:
    truth = typical_threshold("work")
    failures = known_cohort("work", 0.1, [4], threshold=truth, stop_mm=4.8)
    broken = [one for one in failures if one.ruptured]
    assert 6 <= len(broken) < 18
    whole, naive = threshold_of(failures, "work"), threshold_of(broken, "work")
    assert naive.median < whole.median
    assert whole.ci95[0] < truth < whole.ci95[1]
