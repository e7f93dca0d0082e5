"""Model choice on specimens whose second branch lies at 3 to 20 times its detection limit.

The detection limit is the Cramer-Rao standard error of the second branch's stiffness in the true model, all
other parameters free.  Every candidate (one to three branches, K of degree 0 to 2) may be chosen; right is
the true number of branches and the true degree.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np
import pytest
from protocol_designs import Designs
from scipy.stats import binomtest

from tissueid.fit.candidates import Candidate, Noise, objective_for
from tissueid.fit.selection import choose
from tissueid.synth import Branch, recipe
from tissueid.uncertainty import NoiseFit

needs_jit = pytest.mark.skipif(
    os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="too slow without compilation"
)

PAPER = recipe("paper-a-30")
#: Each ramp and hold of the protocol once.
PLAN = replace(PAPER, rate_Hz=100.0, logs=tuple(replace(log, repeats=1) for log in PAPER.logs))
FIRST = PLAN.branches[0]
SIGMA_N, GAIN_CV, OFFSET_SD_MM = 1.0, 0.02, 0.02
#: Multiples of the detection limit, and ratios of the relaxation times, both log-uniform.
MULTIPLES, RATIOS = (3.0, 20.0), (3.0, 300.0)
#: Rounds in which the stiffness and its own standard error settle.
ROUNDS = 6


@dataclass(frozen=True)
class Outcome:
    ratio: float
    multiple: float
    chosen: tuple[int, int]
    rivals: tuple[tuple[int, int], ...]
    smallest_residual: tuple[int, int]


def detection_limit(designs, branches):
    """Cramer-Rao standard error of the stiffness of the second of two branches [N/mm]."""
    sums = designs.sums(designs.clean(branches), offset_sd_mm=OFFSET_SD_MM)
    objective = objective_for(sums, Candidate(2, 0, "partial"), Noise(SIGMA_N**2, GAIN_CV))
    there = objective.evaluate(np.log([branch.tau_s for branch in branches]))
    return float(np.sqrt(np.linalg.inv(there.curvature)[4, 4])) * SIGMA_N


def second_branch(designs, ratio, multiple):
    tau, stiffness = FIRST.tau_s * ratio, 1.0
    for _ in range(ROUNDS):
        limit = detection_limit(designs, (FIRST, Branch((stiffness,), tau)))
        stiffness = min(multiple * limit, 10.0 * FIRST.stiffness[0])
    return Branch((stiffness,), tau)


def outcome(designs, rng, *, second=True):
    ratio, multiple = (float(np.exp(rng.uniform(*np.log(span)))) for span in (RATIOS, MULTIPLES))
    branches = (FIRST, second_branch(designs, ratio, multiple)) if second else (FIRST,)
    gains = np.exp(GAIN_CV * rng.standard_normal(designs.count.size))
    clean, noise = designs.clean(branches, gains=gains), designs.noise(rng, SIGMA_N)
    sums = designs.sums([a + b for a, b in zip(clean, noise, strict=True)], offset_sd_mm=OFFSET_SD_MM)
    known = NoiseFit("ar1" if designs.phi else "white", SIGMA_N, designs.phi, designs.step)
    choice = choose(sums, branches=(1, 2, 3), degrees=(0, 1, 2), pooling="partial", noise=known)
    least = min(choice.candidates, key=lambda one: one.noise.sigma2).candidate
    named = choice.solution.candidate
    return Outcome(
        ratio,
        multiple,
        (named.branches, named.degree),
        tuple((one.branches, one.degree) for one in choice.undecided),
        (least.branches, least.degree),
    )


def shares(found, truth):
    """Counts of right, right or undecided, and of what the smallest residual would have had right."""
    clear = sum(one.chosen == truth and not one.rivals for one in found)
    right = sum(one.chosen == truth for one in found)
    either = sum(one.chosen == truth or bool(one.rivals) for one in found)
    return clear, right, either, sum(one.smallest_residual == truth for one in found)


def lower_99(hits, n):
    return float(binomtest(hits, n, alternative="greater").proportion_ci(0.99, "exact").low)


@needs_jit
def test_a_clear_second_branch_is_chosen_and_none_is_made_up():
    designs = Designs(PLAN, degree=2, phi=0.9)
    rng = np.random.default_rng(3)
    found = [outcome(designs, rng) for _ in range(5)]
    none = [outcome(designs, rng, second=False) for _ in range(4)]
    _, right, either, _ = shares(found, (2, 0))
    assert right >= 4
    assert either == 5
    _, right, _, _ = shares(none, (1, 0))
    assert right == 4


@pytest.mark.slow
@needs_jit
def test_second_branches_at_3_to_20_times_their_detection_limit():
    found = []
    for k, phi in enumerate((0.0, 0.9)):
        designs, rng = Designs(PLAN, degree=2, phi=phi), np.random.default_rng(400 + k)
        found += [outcome(designs, rng) for _ in range(200)]
    clear, right, either, by_residual = shares(found, (2, 0))
    n = len(found)
    print(f"\n{n} specimens, half with white noise, half AR(1) 0.9; truth: 2 branches, K constant")  # noqa: T201
    print(f"right and clear {clear}, right {right} ({100 * right / n:.1f} %), right or undecided {either}")  # noqa: T201
    print(f"lower 99 % bounds: right {lower_99(right, n):.3f}, right or undecided {lower_99(either, n):.3f}")  # noqa: T201
    print(f"the smallest residual would have been right in {by_residual}")  # noqa: T201
    for one in found:
        if one.chosen != (2, 0) or one.rivals:
            print(f"  ratio {one.ratio:5.1f}, {one.multiple:4.1f}x: {one.chosen}, rivals {one.rivals}")  # noqa: T201
    assert either / n >= 0.97
    assert clear / n >= 0.85


@pytest.mark.slow
@needs_jit
@pytest.mark.parametrize("phi", [0.0, 0.9, 0.99])
def test_one_branch_stays_one(phi):
    designs, rng = Designs(PLAN, degree=2, phi=phi), np.random.default_rng(700)
    found = [outcome(designs, rng, second=False) for _ in range(60)]
    clear, right, either, by_residual = shares(found, (1, 0))
    print(  # noqa: T201
        f"\none branch, phi {phi}: right {right} of 60, clear {clear}, right or undecided {either}, "
        f"by the smallest residual {by_residual}"
    )
    assert either >= 57
    assert right >= 54
