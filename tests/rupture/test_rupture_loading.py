"""A recording up to its end, against the synthetic truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.rupture.failures import SpecimenLaw, failures_of, loaded_test
from tissueid.segment import SegmentOptions, segment
from tissueid.synth import Hold, Log, Move, Recipe, as_trials, recipe, simulate
from tissueid.synth.simulate import SyntheticLog

RATE_HZ = 500.0
PLAN = replace(recipe("rupture-18"), specimens=1, rate_Hz=RATE_HZ, cv_specimen=0.0)


def up_to_end(plan: Recipe) -> list[tuple[SyntheticLog, object]]:
    logs = simulate(plan, rng=np.random.default_rng(3))
    trials = as_trials(logs)
    return [
        (log, loaded_test(trial, segment(trial, options=SegmentOptions())))
        for log, trial in zip(logs, trials, strict=True)
    ]


def test_the_end_of_a_test_is_where_the_synthetic_tissue_broke():
    for log, test in up_to_end(PLAN):
        assert test is not None
        assert test.ruptured
        assert test.speed_mm_s == pytest.approx(log.truth["speed_mm_s"], rel=1e-6)
        # half a step to either side, and 0.02 mm of contact
        assert test.depth_mm[-1] == pytest.approx(
            log.truth["rupture_depth_mm"], abs=0.5 * test.step_mm + 0.03
        )
        slope = 60.0  # N/mm at the rupture, at the most
        assert test.force_N == pytest.approx(
            log.truth["rupture_force_N"], abs=0.5 * test.step_mm * slope + 1.0
        )
        within = 0.5 * test.step_mm * log.truth["rupture_force_N"] + 1.0
        assert test.work_N_mm == pytest.approx(log.truth["rupture_work_N_mm"], abs=within)
        assert test.residual == pytest.approx(0.2, abs=0.02)


def test_the_middle_of_the_step_is_not_early_or_late():
    plan = replace(PLAN, logs=(replace(PLAN.logs[2], repeats=24),), rate_Hz=250.0)
    early = [test.depth_mm[-1] - log.truth["rupture_depth_mm"] for log, test in up_to_end(plan)]
    # uniform over 0.2 mm: sd 0.058 mm, of a mean of 24 0.012; the last sample itself is 0.1 mm early
    assert np.mean(early) == pytest.approx(0.0, abs=0.036)


def test_a_test_that_did_not_rupture_ends_at_its_deepest_sample():
    held = Log("held", (Move(4.0, 600.0), Hold(1.0)))
    ((log, test),) = up_to_end(replace(PLAN, logs=(held,)))
    assert test is not None
    assert (test.ruptured, test.step_mm, test.residual) == (False, 0.0, None)
    assert test.depth_mm[-1] == pytest.approx(4.0 - log.truth["contact_offset_mm"], abs=0.05)
    assert test.work_N_mm == pytest.approx(log.truth["rupture_work_N_mm"], rel=0.05)


def test_nothing_is_made_of_a_recording_in_air():
    air = Log("air", (Move(0.5, 60.0),))
    (trial,) = as_trials(simulate(replace(PLAN, logs=(air,)), rng=np.random.default_rng(1)))
    assert loaded_test(trial, segment(trial, options=SegmentOptions())) is None


def test_shares_of_the_law_multiply_what_was_measured_and_its_draws_make_the_spread():
    (_, test) = up_to_end(PLAN)[1]
    assert test is not None
    model = kelvin_voigt(1, 0, 9.0)
    theta = np.array([6.0, 0.0, 0.4, 63.62, 0.021])
    covariance = np.diag([0.0, 0.0, 0.0, (0.05 * 63.62) ** 2, 0.0])
    (sure,) = failures_of(SpecimenLaw("a", model, theta, np.zeros((5, 5))), [(test, 0.0)])
    (open_,) = failures_of(SpecimenLaw("a", model, theta, covariance), [(test, 0.0)])
    x, v = test.depth_mm[-1], test.speed_mm_s
    dynamic = 63.62 * v * 0.021
    share = dynamic / (6.0 * x + 0.4 * x**3 + dynamic)
    assert sure.dynamic_share == pytest.approx(share, rel=0.01)
    assert sure.measures["weighted-force"].value == pytest.approx(
        test.force_N * (1.0 + 0.5 * share), rel=0.005
    )
    assert sure.measures["work"].value == test.work_N_mm
    # 5 % of K is 5 % (1 - share) of the share; the sd of 40 draws is good to 11 %
    more = open_.measures["weighted-force"].sd_ln ** 2 - sure.measures["weighted-force"].sd_ln ** 2
    expected = 0.5 * share * (1.0 - share) * 0.05 / (1.0 + 0.5 * share)
    assert np.sqrt(more) == pytest.approx(expected, rel=0.4)
    assert open_.measures["work"].sd_ln == sure.measures["work"].sd_ln
    assert (sure.hardening_sd, open_.hardening_sd > 0.0) == (0.0, True)
