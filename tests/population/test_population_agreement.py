"""Repeatability, order and speed of logs, against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from cohort_factory import members

from tissueid.population.agreement import (
    agreement,
    confounding_flags,
    confounding_of,
    order_effect,
    repeatability,
)
from tissueid.population.cohort import specimens_for_mean, specimens_for_sd
from tissueid.population.members import Member


def with_gains(*gains: tuple[float, ...]) -> tuple[Member, ...]:
    """Specimens, each with logs that differ in their gains."""
    made = []
    for one, own in zip(members(len(gains), repeats=1, draws=100), gains, strict=True):
        logs = ({"gain": gain, "run": k + 1, "path": f"{k}.csv"} for k, gain in enumerate(own))
        made.append(replace(one, trials=tuple(replace(one.trials[0], **log) for log in logs)))
    return tuple(made)


def test_intraclass_correlation_is_the_ratio_of_variances():
    # sums of squares in closed form: each specimen has ln gains -w, +w
    w, between = 0.04, 0.12
    cohort = with_gains(*[(math.exp(-w), math.exp(w))] * 40)
    found = repeatability(cohort, np.full(20_000, between), np.random.default_rng(0))
    within2 = 40 * 2.0 * w**2 / 40
    assert (found.logs, found.groups, found.freedom) == (80, 40, 40)
    assert found.within_cv == pytest.approx(math.sqrt(math.expm1(within2)), rel=1e-12)
    # median of D^2 / (D^2 + SS / chi2): the median of chi2 with 40 degrees of freedom is 39.34
    assert found.icc == pytest.approx(between**2 / (between**2 + 40 * within2 / 39.34), abs=0.003)
    assert found.icc_ci95[0] < found.icc < found.icc_ci95[1]


def test_limits_of_agreement_are_those_of_bland_and_altman():
    changes = np.array([0.02, -0.05, 0.01, 0.06, -0.01, 0.03, -0.04, 0.05])
    cohort = with_gains(*[(1.0 / math.exp(c / 2), math.exp(c / 2)) for c in changes])
    found = agreement(cohort, {one.specimen: 100.0 for one in cohort})
    sd = changes.std(ddof=1)
    # t of 7 degrees of freedom, from a table
    error, limit = 2.364624 * sd / math.sqrt(8), 2.364624 * sd * math.sqrt(1 / 8 + 1.959964**2 / 14)
    assert found.bias == pytest.approx(changes.mean(), abs=1e-12)
    assert found.bias_ci95 == pytest.approx((changes.mean() - error, changes.mean() + error), abs=1e-6)
    assert found.upper == pytest.approx(changes.mean() + 1.959964 * sd, abs=1e-6)
    assert found.upper_ci95 == pytest.approx((found.upper - limit, found.upper + limit), abs=1e-6)
    assert [pair.force_N for pair in found.pairs] == pytest.approx([100.0] * 8)


def test_a_slope_common_to_all_specimens_is_the_order_effect():
    rng = np.random.default_rng(1)
    gains = [
        tuple(np.exp(rng.normal(0.0, 0.2) - 0.03 * np.arange(5) + 0.005 * rng.standard_normal(5)))
        for _ in range(6)
    ]
    found = order_effect(with_gains(*gains))
    # 30 logs, sum of squares of the runs 6 * 10: an error of 0.005 / sqrt(60)
    assert found.per_run == pytest.approx(-0.03, abs=4 * 0.005 / math.sqrt(60))
    # t of 23 degrees of freedom, its error from residuals that scatter by 15 %
    assert 0.5 * (found.ci95[1] - found.ci95[0]) == pytest.approx(2.07 * 0.005 / math.sqrt(60), rel=0.45)
    assert found.p_value < 1e-6


def test_logs_without_gains_or_at_other_speeds_or_sites_are_no_repeats():
    cohort = with_gains((1.0, 1.0), (1.0, 1.0), (1.0, 1.0), (1.0, 1.0))
    assert repeatability(cohort, np.full(100, 0.1), np.random.default_rng(0)) is None
    assert agreement(cohort, {one.specimen: 1.0 for one in cohort}) is None
    assert order_effect(cohort) is None
    cohort = with_gains((0.9, 1.1))
    first, second = cohort[0].trials
    other_speed = replace(cohort[0], trials=(first, replace(second, speed_mm_s=2.0 * first.speed_mm_s)))
    other_site = replace(cohort[0], trials=(first, replace(second, site="left")))
    assert repeatability((other_speed, other_site), np.full(100, 0.1), np.random.default_rng(0)) is None


def test_cohort_size_gives_the_interval_it_promises():
    # simulated: means and spreads of as many normal specimens as the formula asks for
    between, own, precision = 0.2, 0.05, 0.05
    n = specimens_for_mean(between, own, precision)
    many = specimens_for_sd(between, own, 0.1)
    rng = np.random.default_rng(3)
    sd = math.hypot(between, own)
    means = np.exp((sd * rng.standard_normal((4000, n))).mean(axis=1))
    spreads = np.sqrt((sd * rng.standard_normal((1000, many))).var(axis=1, ddof=1) - own**2)
    # 95 % of 4000 with an error of 0.35 %, four of them; whole specimens add a little
    assert ((means > 1 / 1.05) & (means < 1.05)).mean() == pytest.approx(0.95, abs=0.015)
    # large-sample formula of a spread: 95 % within 2 %
    assert ((spreads > 0.18) & (spreads < 0.22)).mean() == pytest.approx(0.95, abs=0.03)


SLOW, MIDDLE, FAST = 10.0 / 60.0, 100.0 / 60.0, 500.0 / 60.0


@pytest.mark.parametrize(
    ("speeds", "kind", "says"),
    [
        (((SLOW, MIDDLE, FAST),) * 3, "none", "All 3 speeds meet in specimens"),
        # along a chain of specimens
        (((SLOW, MIDDLE), (MIDDLE, FAST), (FAST,)), "none", "All 3 speeds meet in specimens"),
        (((SLOW,), (SLOW,), (MIDDLE,), (FAST,)), "confounded", "no effect of speed can be claimed"),
        (((SLOW, MIDDLE), (SLOW, MIDDLE), (FAST,)), "partly", "different parts can't be compared"),
        # settings that differ by a machine's error are one speed
        (((SLOW,), (1.01 * SLOW,), (0.995 * SLOW,)), "single speed", "nothing is said of an effect of speed"),
    ],
)
def test_speeds_that_share_no_specimen_are_confounded_with_them(speeds, kind, says):
    found = confounding_of(speeds)
    assert found.kind == kind
    assert says in found.sentence
    # two specimens at one speed are one part
    assert "10, 10 " not in found.sentence
    told = {"confounded", "partly"}
    assert [flag.code for flag in confounding_flags(found)] == ["speed_confounded"] * (kind in told)
    if kind == "partly":
        assert found.parts == (pytest.approx((SLOW, MIDDLE)), pytest.approx((FAST,)))
