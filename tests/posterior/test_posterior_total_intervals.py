"""Total intervals of a machine that may have no filter: closed forms, and what they cover."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import norm

from tissueid.posterior.total_intervals import plausible_edges, total_intervals
from tissueid.priors import CalibrationPrior

FILTER = CalibrationPrior(0.0, 5.0, 0.0)
STATED = CalibrationPrior(3.0, 0.6, 0.0)
N = 40_000
TWO_SIDED_95 = 1.959964


def half_normal(scale: float, seed: int) -> np.ndarray:
    return np.abs(scale * np.random.default_rng(seed).standard_normal(N))


def test_a_nuisance_at_its_edge_adds_the_interval_without_it() -> None:
    nuisance = half_normal(1.0, 1)
    noise = np.random.default_rng(2).standard_normal(N)
    draws = {"tau": 10.0 + noise - 2.0 * nuisance}
    low, high = total_intervals(draws, {"f": nuisance}, {"f": FILTER})["tau"]
    # without the nuisance the draws are normal around 10; their ends from 40,000 draws are good to 0.013
    assert high == pytest.approx(10.0 + TWO_SIDED_95, abs=0.06)
    # the other end is drawn in: with the nuisance 95 % are held in all
    assert np.quantile(draws["tau"], 0.025) < low < np.quantile(draws["tau"], 0.05)
    assert ((low <= draws["tau"]) & (draws["tau"] <= high)).mean() == pytest.approx(0.95, abs=1e-4)


def test_an_end_is_not_drawn_in_past_what_absence_says() -> None:
    # absence leaves a parameter three times as wide as the nuisance moves it: both ends are its own
    nuisance = half_normal(1.0, 14)
    noise = np.random.default_rng(15).standard_normal(N)
    tau = 10.0 + 3.0 * noise * (nuisance < 1.0) + 0.1 * nuisance
    low, high = total_intervals({"tau": tau}, {"f": nuisance}, {"f": FILTER})["tau"]
    ends = np.quantile(tau, [0.025, 0.975])
    assert low < ends[0] + 0.1
    assert high > ends[1] - 0.1
    assert ((low <= tau) & (tau <= high)).mean() >= 0.95 - 1e-4


def test_a_nuisance_that_the_data_have_found_leaves_the_central_interval() -> None:
    rng = np.random.default_rng(3)
    nuisance = 4.0 + 0.5 * rng.standard_normal(N)
    draws = {"tau": 10.0 - 2.0 * nuisance + rng.standard_normal(N)}
    found = total_intervals(draws, {"f": nuisance}, {"f": FILTER})
    assert plausible_edges({"f": nuisance}, {"f": FILTER}) == ()
    assert found["tau"] == pytest.approx(tuple(np.quantile(draws["tau"], [0.025, 0.975])), abs=1e-12)


@pytest.mark.parametrize("sd_of_draws", [0.5, 2.0, 4.9])
def test_a_prior_that_nobody_learnt_from_keeps_its_edge(sd_of_draws: float) -> None:
    # odds of one or more: the posterior's density at the edge is the prior's, or higher
    assert plausible_edges({"f": half_normal(sd_of_draws, 4)}, {"f": FILTER}) == ("f",)


def test_edges_are_those_of_unknown_nuisances_only() -> None:
    draws = np.abs(half_normal(0.5, 5))
    known = CalibrationPrior(0.0, 0.0)
    both_sides = CalibrationPrior(0.0, 2.0)
    for prior in (STATED, known, both_sides):
        assert plausible_edges({"f": draws}, {"f": prior}) == ()


def test_odds_are_those_of_the_densities_at_the_edge() -> None:
    # a normal around m, cut at 0, against half a normal of sd 5: density ratio in closed form
    for centre, plausible in ((1.0, True), (2.6, False)):
        draws = centre + np.random.default_rng(6).standard_normal(4 * N)
        draws = draws[draws > 0.0]
        mass = 0.5 * math.erfc(-centre / math.sqrt(2.0))
        at_edge = math.exp(-0.5 * centre**2) / math.sqrt(2.0 * math.pi) / mass
        odds = at_edge / (2.0 / (5.0 * math.sqrt(2.0 * math.pi)))
        assert (odds / (1.0 + odds) >= 0.25) is plausible
        assert plausible_edges({"f": draws}, {"f": FILTER}) == (("f",) if plausible else ())


def end_moved_by(draws: np.ndarray, nuisance: np.ndarray, cluster: np.ndarray) -> float:
    """How far the upper end without a nuisance is moved out."""
    priors = {"f": CalibrationPrior(0.0, 1.0, 0.0)}
    still = total_intervals({"tau": draws}, {"f": nuisance}, priors)["tau"][1]
    return total_intervals({"tau": draws}, {"f": nuisance}, priors, cluster=cluster)["tau"][1] - still


def moved_by_two_errors(points: int) -> float:
    """That of a standard normal moved along its regression on half of one, in closed form."""
    density = math.exp(-0.5 * TWO_SIDED_95**2) / math.sqrt(2.0 * math.pi)
    # squared mean over variance of half a standard normal: the slope's error, as a share beyond the end
    slope = (2.0 / math.pi) / (1.0 - 2.0 / math.pi)
    error = math.sqrt((0.025 * 0.975 + density**2 * slope) / points)
    return float(norm.isf(0.025 - 2.0 * error)) - TWO_SIDED_95


def test_ends_without_a_nuisance_are_moved_out_by_two_standard_errors() -> None:
    points, times = 1_000, 40
    cluster = np.repeat(np.arange(points), times)
    nuisance = np.repeat(half_normal(1.0, 16)[:points], times)
    rng = np.random.default_rng(12)
    apart = rng.standard_normal(points * times) - nuisance
    same = np.repeat(rng.standard_normal(points), times) - nuisance
    # 40 draws of one value tell as much as one of them, 40 of their own as much as 40
    assert end_moved_by(same, nuisance, cluster) == pytest.approx(moved_by_two_errors(points), rel=0.5)
    assert end_moved_by(apart, nuisance, cluster) == pytest.approx(
        moved_by_two_errors(points * times), rel=0.3
    )
    # and what draws of a point share in part lies between
    partly = math.sqrt(0.5) * (same + apart + 2.0 * nuisance) - nuisance
    moved = end_moved_by(partly, nuisance, cluster)
    assert moved_by_two_errors(points * times) < moved < 0.9 * moved_by_two_errors(points)


def test_ends_of_the_draws_themselves_are_not_moved() -> None:
    draws = np.random.default_rng(17).standard_normal(1_000)
    found = total_intervals({"tau": draws}, {}, {}, cluster=np.arange(1_000))["tau"]
    assert found == pytest.approx(tuple(np.quantile(draws, [0.025, 0.975])), abs=1e-12)


def test_ends_without_a_nuisance_from_very_few_points_reach_as_far_as_there_are_any() -> None:
    rng = np.random.default_rng(13)
    draws = rng.standard_normal(20)
    # quantiles of half a standard normal
    nuisance = rng.permutation(norm.isf((np.arange(20) + 0.5) / 40.0))
    priors = {"f": CalibrationPrior(0.0, 1.0, 0.0)}
    found = total_intervals({"tau": draws}, {"f": nuisance}, priors, cluster=np.arange(20))["tau"]
    away = nuisance - nuisance.mean()
    without = draws - (away @ draws) / (away @ away) * nuisance
    assert found[0] <= max(without.min(), draws.min())
    assert found[1] >= min(without.max(), draws.max())


def test_no_end_lies_beyond_the_draws() -> None:
    nuisance = half_normal(1.0, 7)
    stiffness = np.abs(0.1 * np.random.default_rng(8).standard_normal(N)) + nuisance
    low, _ = total_intervals({"k": stiffness}, {"f": nuisance}, {"f": FILTER})["k"]
    assert low >= stiffness.min() >= 0.0


def test_the_truth_without_a_nuisance_is_covered_as_often_as_said() -> None:
    # one datum y = t - f + noise, t flat, f known to a half-normal of the noise's size and truly none:
    # the posterior of t is y + f + noise, and its central interval misses the truth too often
    rng = np.random.default_rng(9)
    noise, nuisance = rng.standard_normal(4_000), half_normal(1.5, 10)[:4_000]
    prior = {"f": CalibrationPrior(0.0, 1.5, 0.0)}
    central = hull = 0
    for y in np.random.default_rng(11).standard_normal(2_000):
        draws = y + nuisance + noise
        low, high = np.quantile(draws, [0.025, 0.975])
        central += low <= 0.0 <= high
        low, high = total_intervals({"t": draws}, {"f": nuisance}, prior)["t"]
        hull += low <= 0.0 <= high
    # three binomial standard deviations of 95 % are 1.5 %
    assert central / 2_000 < 0.95 - 0.015
    assert hull / 2_000 >= 0.95 - 0.015
