"""Simulate a recipe, segment and fit it, and keep what a table of errors needs; workers import this."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from tissueid.inference.specimen import FitOptions
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.result import Estimate
from tissueid.synth import Recipe, as_trials, recipe, simulate

#: Truth of paper-a-30: K = 63.62 N/mm (+ 10 N/mm2 x at half depth 4 mm for -k1), tau = 21 ms.
TAU_S = 0.021
STIFFNESS_N_PER_MM = 63.62
STIFFNESS_K1_N_PER_MM2 = 10.0
DEPTH_MM = 8.0


@dataclass(frozen=True)
class Run:
    """One simulated specimen and its fit: (estimate, standard error, identified) of tau and eta."""

    seed: int
    branches: int
    degree: int
    tau: tuple[float, float, bool]
    eta: tuple[float, float, bool]


@dataclass(frozen=True)
class Job:
    """What to simulate and how to fit it."""

    plan: Recipe
    options: FitOptions
    seed: int


def _numbers(estimate: Estimate) -> tuple[float, float, bool]:
    value = estimate.detail["estimate"] if estimate.value is None else estimate.value
    stderr = np.nan if estimate.stderr is None else estimate.stderr
    return float(value), float(stderr), estimate.identified


def run_job(job: Job) -> Run:
    """Simulate, segment, fit."""
    trials = as_trials(simulate(job.plan, rng=np.random.default_rng(job.seed)))
    (fit,) = identify(trials, options=IdentifyOptions(fit=job.options)).specimens
    return Run(
        seed=job.seed,
        branches=fit.model.branches,
        degree=fit.model.stiffness_degree,
        tau=_numbers(fit.parameter("relaxation_time_s")),
        eta=_numbers(fit.parameter("viscosity_N_s_per_mm")),
    )


def jobs(name: str, seeds: range, options: FitOptions, *, rate_Hz: float, **scatter: float) -> list[Job]:
    """Jobs over a recipe at a rate, with scatter, one a seed."""
    plan = replace(recipe(name), rate_Hz=rate_Hz, **scatter)  # type: ignore[arg-type]
    return [Job(plan, options, seed) for seed in seeds]


def run_jobs(work: Sequence[Job], *, workers: int = 2) -> list[Run]:
    """All jobs, in spawned workers of one thread each."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")
    with get_context("spawn").Pool(workers) as pool:
        return pool.map(run_job, work, chunksize=1)


def column(runs: Sequence[Run], name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Estimates and standard errors of ``tau`` or ``eta``."""
    table = np.array([getattr(run, name)[:2] for run in runs])
    return table[:, 0], table[:, 1]


def table_row(title: str, runs: Sequence[Run], truth: dict[str, float]) -> str:
    """Mean error, spread and mean standard error of tau and eta [% of truth]."""
    cells = []
    for name, value in truth.items():
        estimate, stderr = column(runs, name)
        percent = 100.0 / value
        cells.append(
            f"{name}: error {percent * (estimate.mean() - value):+7.3f} %"
            f"  sd {percent * estimate.std(ddof=1):6.3f} %  stderr {percent * stderr.mean():6.3f} %"
        )
    chosen = sorted({(run.branches, run.degree) for run in runs})
    return f"\n{title} (n = {len(runs)}, branches and degree {chosen})\n  " + "\n  ".join(cells)
