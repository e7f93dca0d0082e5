"""Intervals hold what they claim: rank statistics and coverage over specimens, from recordings on."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from coverage_cases import CASES, FRAMES, Case
from scipy.stats import beta, binom

from tissueid.selfcheck.records import Checkpoint, run_simulations
from tissueid.selfcheck.verdicts import Verdict, verdict_of

pytestmark = [pytest.mark.slow, pytest.mark.needs_jit]

MANY = 200
#: Share of 95 % intervals that may hold the truth: family-wise 99 % over the rows of one case.
ROWS = 13
LOW, HIGH = (float(binom.ppf(p, MANY, 0.95)) / MANY for p in (0.005 / ROWS, 1.0 - 0.005 / ROWS))
#: Specimens behind an unknown frame, and what the lower 99 % bound of the coverage must reach.
FRAMED, FLOOR = 300, 0.92
TISSUE = ("static", "stiffness", "relaxation", "viscosity", "force_N at")


def verdict_on(case: Case, simulations: int, folder: Path, *, workers: int = 1) -> Verdict:
    with Checkpoint(folder / "records.jsonl", case.name) as checkpoint:
        records = run_simulations(
            case.check(), checkpoint, simulations=simulations, seed=case.seed, workers=workers
        )
    return verdict_of(records)


def table(case: Case, verdict: Verdict) -> str:
    lines = [f"\n{case.name}: {verdict.simulations} specimens, {len(verdict.failed)} without a posterior"]
    lines.append(f"{'coverage [%] of':<34}   50     80     90     95   mean z  spread  contraction  ranks")
    for one in verdict.parameters:
        shares = "  ".join(f"{100 * row.fraction:5.1f}" for row in one.coverage)
        kept = {"95 %": one.inside.percent_95, "99 %": one.inside.percent_99, "family": one.inside.family}
        ranks = next((name for name, holds in kept.items() if holds), "OUT")
        lines.append(
            f"{one.name:<34}{shares}  {one.mean_z:6.3f}  {one.spread_ratio:6.3f}  "
            f"{one.contraction:8.4f}     {ranks}"
        )
    return "\n".join(lines)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_intervals_cover_over_many_specimens(case, tmp_path):
    verdict = verdict_on(case, MANY, tmp_path)
    sys.stdout.write(table(case, verdict) + "\n")
    outside = {
        one.name: one.coverage[-1].fraction
        for one in verdict.parameters
        if not LOW <= one.coverage[-1].fraction <= HIGH
    }
    assert outside == {}
    assert [one.name for one in verdict.parameters if not one.inside.family] == []
    assert len(verdict.failed) <= MANY // 100


@pytest.mark.parametrize("case", FRAMES, ids=lambda case: case.name)
def test_total_intervals_cover_behind_a_frame_that_nobody_knows_of(case, tmp_path):
    verdict = verdict_on(case, FRAMED, tmp_path, workers=2)
    sys.stdout.write(table(case, verdict) + "\n")
    tissue = [one for one in verdict.parameters if one.name.startswith(TISSUE)]
    bounds = {}
    for one in tissue:
        covered = round(one.coverage[-1].fraction * verdict.simulations)
        # one-sided Clopper-Pearson
        bounds[one.name] = float(beta.ppf(0.01, covered, verdict.simulations - covered + 1))
    assert {name: bound for name, bound in bounds.items() if bound < FLOOR} == {}
    assert len(verdict.failed) <= FRAMED // 100
