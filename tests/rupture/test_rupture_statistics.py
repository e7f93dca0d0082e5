"""How often the criterion is found, how often the interval holds the threshold, what censoring does."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from rupture_cohorts import known_cohort, recorded_cohort, typical_threshold
from scipy.stats import binom

from tissueid.rupture.evidence import threshold_of
from tissueid.rupture.run import run_rupture
from tissueid.rupture.study import KINDS, Decision, decide
from tissueid.rupture_law import CRITERIA

TRUTHS = ("work", "weighted-force", "depth")
COHORTS = 400
RECORDED = 30
CENSORED = 60
#: Least share of right decisions, and most of wrong ones, by CV of the threshold from test to test.
RIGHT = {0.05: 0.85, 0.1: 0.7}
WRONG = 0.03
SEED = 20_808


def judged(decision: Decision, truth: str) -> str:
    if decision.kind is None:
        return "undecided"
    return "right" if truth in KINDS[decision.kind] else "wrong"


def band(cohorts: int, cells: int) -> tuple[float, float]:
    """Family-wise 99 % band of a coverage of 95 %."""
    tail = 0.01 / cells / 2.0
    return float(binom.ppf(tail, cohorts, 0.95)) / cohorts, float(
        binom.ppf(1.0 - tail, cohorts, 0.95)
    ) / cohorts


def test_each_criterion_is_found_in_a_few_cohorts() -> None:
    found = []
    for k, truth in enumerate(TRUTHS):
        failures = known_cohort(truth, 0.05, [SEED, 1, k], threshold=typical_threshold(truth))
        found.append(judged(decide([threshold_of(failures, name) for name in CRITERIA]), truth))

    assert found == ["right"] * 3


@pytest.mark.slow
@pytest.mark.parametrize("cv", [0.05, 0.1])
def test_the_criterion_is_found_and_its_threshold_covered(cv: float) -> None:
    said: Counter[tuple[str, str]] = Counter()
    covered: Counter[str] = Counter()
    count = Counter(TRUTHS[k % 3] for k in range(COHORTS))
    thresholds = {truth: typical_threshold(truth) for truth in TRUTHS}
    for k in range(COHORTS):
        truth = TRUTHS[k % 3]
        failures = known_cohort(truth, cv, [SEED, round(1000 * cv), k], threshold=thresholds[truth])
        fitted = {name: threshold_of(failures, name) for name in CRITERIA}
        said[truth, judged(decide(list(fitted.values())), truth)] += 1
        low, high = fitted[truth].ci95
        covered[truth] += low <= thresholds[truth] <= high
    total = {
        word: sum(said[truth, word] for truth in TRUTHS) / COHORTS for word in ("right", "wrong", "undecided")
    }
    shares = {truth: covered[truth] / count[truth] for truth in TRUTHS}
    print(  # noqa: T201
        f"\nCV {cv}: {total}, by truth {dict(said)}, coverage {shares}, band {band(min(count.values()), 6)}"
    )

    assert total["wrong"] <= WRONG
    assert total["right"] >= RIGHT[cv]
    for truth in TRUTHS:
        low, high = band(count[truth], 6)
        assert low <= shares[truth] <= high, truth


@pytest.mark.slow
@pytest.mark.parametrize("cv", [0.05, 0.1])
def test_the_criterion_is_found_from_recordings(cv: float) -> None:
    said: Counter[tuple[str, str]] = Counter()
    covered = 0
    ratios = []
    thresholds = {truth: typical_threshold(truth) for truth in TRUTHS}
    for k in range(RECORDED):
        truth = TRUTHS[k % 3]
        trials = recorded_cohort(truth, cv, [SEED, 7, round(1000 * cv), k], threshold=thresholds[truth])
        study = run_rupture(trials).study
        said[truth, judged(study.decision, truth)] += 1
        fitted = next(one for one in study.thresholds if one.criterion == truth)
        covered += fitted.ci95[0] <= thresholds[truth] <= fitted.ci95[1]
        ratios.append(fitted.median / thresholds[truth])
    total = {
        word: sum(said[truth, word] for truth in TRUTHS) / RECORDED
        for word in ("right", "wrong", "undecided")
    }
    low, high = band(RECORDED, 2)
    print(  # noqa: T201
        f"\nrecordings, CV {cv}: {total}, by truth {dict(said)}, coverage {covered / RECORDED:.3f} "
        f"(band {low:.3f} to {high:.3f}), median of the ratio {np.median(ratios):.4f}"
    )

    assert total["wrong"] <= WRONG
    assert total["right"] >= RIGHT[cv]
    assert low <= covered / RECORDED <= high


def censored_ratios(cohorts: int, stop_mm: float, cv: float) -> tuple[list[float], list[float], float]:
    """Estimate over truth with and without the censored tests, and the share of censored tests."""
    truth = typical_threshold("work")
    kept, dropped, censored = [], [], []
    for k in range(cohorts):
        failures = known_cohort("work", cv, [SEED, 3, k], threshold=truth, stop_mm=stop_mm)
        censored.append(np.mean([not one.ruptured for one in failures]))
        kept.append(threshold_of(failures, "work").median / truth)
        dropped.append(threshold_of([one for one in failures if one.ruptured], "work").median / truth)
    return kept, dropped, float(np.mean(censored))


@pytest.mark.slow
@pytest.mark.parametrize("stop_mm", [5.3, 4.8])
def test_tests_that_stopped_too_early_bias_the_threshold_by_less_than_three_percent(stop_mm: float) -> None:
    kept, dropped, censored = censored_ratios(CENSORED, stop_mm, 0.1)
    bias, naive = float(np.mean(np.log(kept))), float(np.mean(np.log(dropped)))
    error = float(np.std(np.log(kept))) / len(kept) ** 0.5
    print(  # noqa: T201
        f"\ncensored {100 * censored:.0f} %: bias {100 * bias:.2f} +- {100 * error:.2f} %, "
        f"{100 * naive:.2f} % where they are left out"
    )

    assert abs(bias) <= 0.03
    # left out, the same cohorts show less: selection by stiffness as well as by threshold blurs it
    assert naive < bias - 0.01


@pytest.mark.slow
def test_the_fastest_speed_decides_whether_18_tests_can_tell() -> None:
    thresholds = {truth: typical_threshold(truth) for truth in TRUTHS}
    right = {}
    for fastest in (500.0, 1000.0, 2000.0, 3000.0):
        said: Counter[str] = Counter()
        for k in range(60):
            truth = TRUTHS[k % 3]
            seed = [SEED, 5, round(fastest), k]
            speeds = (120.0, (120.0 * fastest) ** 0.5, fastest)
            failures = known_cohort(truth, 0.1, seed, threshold=thresholds[truth], speeds=speeds)
            said[judged(decide([threshold_of(failures, name) for name in CRITERIA]), truth)] += 1
        right[fastest] = said["right"] / 60
        print(f"\nfastest {fastest:.0f} mm/min, CV 0.1: {dict(said)} of 60")  # noqa: T201
        assert said["wrong"] / 60 <= WRONG + 3.0 * (WRONG / 60) ** 0.5

    assert right[500.0] < 0.5 < right[3000.0]
