"""Errors of tau and eta over many simulated specimens, through the segmenter, with fixed seeds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from tissue_runs import (
    DEPTH_MM,
    STIFFNESS_K1_N_PER_MM2,
    STIFFNESS_N_PER_MM,
    TAU_S,
    column,
    jobs,
    run_job,
    run_jobs,
    table_row,
)

from tissueid.inference.specimen import FitOptions

AUTO = FitOptions()
CONSTANT = FitOptions(branches=1, stiffness_degree=0)
GROWING = FitOptions(branches=1, stiffness_degree=1)
TRUTH = {"tau": TAU_S, "eta": STIFFNESS_N_PER_MM * TAU_S}
#: Viscosity is stated at half depth where K varies.
TRUTH_K1 = {"tau": TAU_S, "eta": (STIFFNESS_N_PER_MM + STIFFNESS_K1_N_PER_MM2 * DEPTH_MM / 2.0) * TAU_S}


@pytest.fixture
def show(capsys: pytest.CaptureFixture[str]) -> Callable[[str], None]:
    """Print a figure whether or not the test passes."""

    def printed(text: str) -> None:
        with capsys.disabled():
            print(text)  # noqa: T201

    return printed


@pytest.mark.parametrize(
    ("seed", "rate_Hz"),
    [(0, 100.0), (1, 100.0), (5, 1e3), *(pytest.param(k, 100.0, marks=pytest.mark.slow) for k in (2, 3, 4))],
)
def test_every_error_is_within_three_standard_errors(seed: int, rate_Hz: float) -> None:
    (job,) = jobs("paper-a-30", range(seed, seed + 1), CONSTANT, rate_Hz=rate_Hz)
    run = run_job(job)
    for name, truth in TRUTH.items():
        estimate, stderr, identified = getattr(run, name)
        assert identified, name
        assert abs(estimate - truth) <= 3.0 * stderr, name


@pytest.mark.slow
def test_default_options_are_unbiased_and_as_sharp_as_their_standard_errors(
    show: Callable[[str], None],
) -> None:
    runs = run_jobs(jobs("paper-a-30", range(20_100, 20_150), AUTO, rate_Hz=100.0))
    show(table_row("no scatter, 100 Hz, default options", runs, TRUTH))
    for name, truth in TRUTH.items():
        estimate, stderr = column(runs, name)
        assert abs(estimate.mean() - truth) <= 0.5 * stderr.mean(), name
        assert estimate.std(ddof=1) <= 1.3 * stderr.mean(), name


@pytest.mark.slow
def test_scatter_of_gain_and_contact_does_not_move_the_mean_relaxation_time(
    show: Callable[[str], None],
) -> None:
    work = jobs(
        "paper-a-30", range(20_200, 20_240), CONSTANT, rate_Hz=100.0, cv_both=0.15, contact_offset_sd_mm=0.1
    )
    runs = run_jobs(work)
    show(table_row("CV 15 % and contact offset 0.1 mm, 100 Hz", runs, TRUTH))
    estimate, _ = column(runs, "tau")
    assert abs(estimate.mean() - TAU_S) <= 0.05 * TAU_S
    assert abs(estimate.mean() - TAU_S) <= 3.0 * estimate.std(ddof=1) / np.sqrt(len(runs))


@pytest.mark.slow
def test_a_rounded_stop_of_the_crosshead_hardly_moves_the_relaxation_time(
    show: Callable[[str], None],
) -> None:
    runs = run_jobs(
        jobs("paper-a-30", range(20_300, 20_320), CONSTANT, rate_Hz=100.0, crosshead_rounding_s=0.03)
    )
    show(table_row("crosshead rounded over 30 ms, 100 Hz", runs, TRUTH))
    estimate, _ = column(runs, "tau")
    assert abs(estimate.mean() - TAU_S) <= 0.05 * TAU_S


@pytest.mark.slow
def test_at_10_hz_the_relaxation_time_is_never_called_identified(show: Callable[[str], None]) -> None:
    runs = run_jobs(jobs("paper-a-30", range(20_400, 20_410), AUTO, rate_Hz=10.0))
    show(f"\n10 Hz: tau identified in {sum(run.tau[2] for run in runs)} of {len(runs)}")
    assert not any(run.tau[2] for run in runs)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options", "truth", "percent"),
    [
        # standard deviations of partial pooling [%], docs of the estimator: K grows, 100 Hz
        ("paper-a-30-k1", GROWING, TRUTH_K1, {"tau": 3.33, "eta": 0.89}),
        # and K constant: stated at 1 kHz, ten times fewer samples at 100 Hz
        ("paper-a-30", CONSTANT, TRUTH, {"tau": 1.64 * np.sqrt(10.0), "eta": 0.19 * np.sqrt(10.0)}),
    ],
)
def test_pooling_costs_no_precision_on_data_without_scatter(
    show: Callable[[str], None],
    name: str,
    options: FitOptions,
    truth: dict[str, float],
    percent: dict[str, float],
) -> None:
    runs = run_jobs(jobs(name, range(20_500, 20_530), options, rate_Hz=100.0))
    show(table_row(f"{name}, no scatter, 100 Hz, limits 1.15 x {percent} %", runs, truth))
    for parameter, limit in percent.items():
        estimate, _ = column(runs, parameter)
        assert 100.0 * estimate.std(ddof=1) / truth[parameter] <= 1.15 * limit, parameter
