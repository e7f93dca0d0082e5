"""Bias and coverage of the contact point's standard deviation over many simulated ramps, with fixed seeds.

A condition is a tissue, a way to start, a sampling rate and a force noise; its ramps are shared out evenly
over the six speeds.  Bias is the mean of error / sd, coverage the share of |error| <= 1.96 sd.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from tissueid.segment import segment
from tissueid.synth import Branch, Log, Move, Recipe, as_trials, simulate
from tissueid.trial import Trial

SPEEDS_MM_MIN = (10.0, 70.0, 100.0, 150.0, 250.0, 500.0)
DEPTH_MM = 8.0
#: Bars of the issue.
BIAS = 0.3
COVERAGE = (0.92, 0.98)
#: 1,000 and more ramps a condition in the slow run.
RUNS = 1020
CONSTANT = (Branch((63.62,), 0.021),)
TISSUES = {
    "seed": ((20.0, -1.2, 0.35), CONSTANT),
    "growing K": ((20.0, -1.2, 0.35), (Branch((63.62, 10.0), 0.021),)),
    "Table 1": ((47.42, -5.577, 0.3804), CONSTANT),
    "soft toe": ((0.5, 0.0, 0.43), CONSTANT),
    "slow branch": ((20.0, -1.2, 0.35), (Branch((5.0,), 5.0),)),
}


@dataclass(frozen=True)
class Condition:
    """What is the same for a set of ramps."""

    rate_Hz: float
    sigma_N: float
    tissue: str = "seed"
    start: str = "air"

    def __str__(self) -> str:
        return f"{self.tissue}, {self.start}, {self.rate_Hz:g} Hz, {self.sigma_N:g} N"


def one_score(condition: Condition, speed: float, rng: np.random.Generator) -> tuple[float, float]:
    """Error and stated sd of one ramp [mm]; a load cell that is off by up to 5 sigma in air."""
    static, branches = TISSUES[condition.tissue]
    offset = float(rng.uniform(0.6, 1.6) if condition.start == "air" else -rng.uniform(0.3, 0.8))
    settings = Recipe(
        "c",
        (Log("ramp", (Move(DEPTH_MM, speed),)),),
        rate_Hz=condition.rate_Hz,
        static=static,
        branches=branches,
        sigma_N=condition.sigma_N,
        contact_offset_mm=offset,
    )
    trial = as_trials(simulate(settings, rng=rng))[0]
    # at 10 samples/s a reading that is off can't be told from a preload: there the cell is tared
    zero = 5.0 * condition.sigma_N * float(rng.uniform(-1.0, 1.0))
    zero *= condition.start == "air" and condition.rate_Hz > 10.0
    contact = segment(Trial("c", trial.time_s, trial.displacement_mm - 2.0, trial.force_N + zero)).contact
    return contact.displacement_mm + 2.0 - offset, contact.sd_mm


def scores(condition: Condition, *, runs: int, seed: int) -> NDArray[np.float64]:
    """Errors and sds, shape (speeds, runs each, 2) [mm]."""
    rng = np.random.default_rng(seed)
    each = runs // len(SPEEDS_MM_MIN)
    return np.array([[one_score(condition, v, rng) for _ in range(each)] for v in SPEEDS_MM_MIN])


def bias(found: NDArray[np.float64]) -> float:
    return float((found[..., 0] / found[..., 1]).mean())


def coverage(found: NDArray[np.float64]) -> float:
    return float((np.abs(found[..., 0]) <= 1.959964 * found[..., 1]).mean())


@pytest.mark.parametrize("sigma_N", [0.02, 0.3, 3.0])
@pytest.mark.parametrize("rate_Hz", [100.0, 1000.0])
def test_the_interval_of_a_contact_in_the_record_covers_it(rate_Hz: float, sigma_N: float) -> None:
    found = scores(Condition(rate_Hz, sigma_N), runs=72, seed=31)
    # 72 scores of sd 1: the mean has sd 0.12, and 63 or more are inside with probability 0.99
    assert abs(np.median(found[..., 0] / found[..., 1])) <= BIAS + 2.6 * 0.12
    assert round(72 * coverage(found)) >= 63


MAIN = [Condition(rate, sigma) for rate in (10.0, 100.0, 1000.0) for sigma in (0.02, 0.3, 1.0, 3.0)]
OTHERS = [Condition(100.0, 0.3, tissue) for tissue in TISSUES if tissue != "seed"]
OTHERS += [Condition(100.0, sigma, start="preloaded") for sigma in (0.02, 0.3, 3.0)]
OTHERS += [Condition(100.0, 0.3, "growing K", "preloaded")]
#: Bars that are not reached, with the figure of 1,020 ramps and why.
NO_HOLD = "bias -1.2, coverage 100 %: without a hold nothing tells how much of the stiffness relaxes"
SHORT = {
    Condition(100.0, 0.02, start="preloaded"): NO_HOLD,
    Condition(100.0, 0.3, start="preloaded"): NO_HOLD,
    Condition(100.0, 3.0, start="preloaded"): "bias -0.6: as with less noise",
    Condition(100.0, 0.3, "growing K", "preloaded"): NO_HOLD,
}


def marked(condition: Condition) -> object:
    reason = SHORT.get(condition)
    marks = pytest.mark.xfail(reason=reason, strict=True) if reason else ()
    return pytest.param(condition, marks=marks, id=str(condition))


@pytest.mark.slow
@pytest.mark.parametrize("condition", [marked(one) for one in MAIN + OTHERS])
def test_bias_and_coverage_are_within_the_bars(condition: Condition) -> None:
    found = scores(condition, runs=RUNS, seed=47)
    # 12 + 8 conditions: a band of 99 % for all of them is 3.5 sd of one, 0.11 in the mean, 2.4 points here
    assert abs(bias(found)) <= BIAS + 3.5 / np.sqrt(RUNS)
    assert COVERAGE[0] - 0.024 <= coverage(found) <= COVERAGE[1] + 0.015
