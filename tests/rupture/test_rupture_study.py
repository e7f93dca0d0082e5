"""Words on a cohort, refusals, and the contents of bundles."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from rupture_cohorts import known_cohort, typical_threshold

from tissueid.documents.rupture import Test as Failure
from tissueid.errors import NotIdentifiedError
from tissueid.model.frame import linear_frame
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.rupture.evidence import Threshold
from tissueid.rupture.failures import SpecimenLaw, failures_of, loaded_test
from tissueid.rupture.run import sentences
from tissueid.rupture.study import change_with_speed, decide, direction, hardening_of, rupture_study
from tissueid.rupture_law import CRITERIA
from tissueid.segment import SegmentOptions, segment
from tissueid.synth import Hold, Log, Move, Recipe, as_trials, recipe, simulate
from tissueid.synth.simulate import SyntheticLog


@pytest.fixture(scope="module")
def cohort():
    return known_cohort("work", 0.05, [12], threshold=typical_threshold("work"))


def threshold(criterion: str, ln_evidence: float, trend_p: float | None = 0.5) -> Threshold:
    return Threshold(criterion, "N", 1.0, (0.9, 1.1), 0.1, 0.1, ln_evidence, 1.0, 0.0, trend_p, {"a": 1.0})


def thresholds(evidence: tuple[float, ...], trend_p: float | None = 0.5) -> list[Threshold]:
    return [threshold(name, value, trend_p) for name, value in zip(CRITERIA, evidence, strict=True)]


def test_stored_energy_and_depth_are_one_kind_and_a_trend_that_is_left_says_none():
    # ln evidence of work, weighted force, stored energy, depth
    found = decide(thresholds((0.0, 0.0, 0.0, 0.0)))
    assert found.answer == "undecided"
    assert list(found.probability.values()) == pytest.approx([1 / 3, 1 / 3, 1 / 3])
    found = decide(thresholds((0.0, 0.0, 5.0, 6.0)))
    elastic = (np.exp(5.0) + np.exp(6.0)) / 2.0
    assert found.probability["elastic limit"] == pytest.approx(elastic / (elastic + 2.0))
    assert (found.answer, found.kind, found.criterion) == ("decided", "elastic limit", "depth")
    found = decide(thresholds((9.0, 0.0, 0.0, 0.0), trend_p=0.001))
    assert (found.answer, found.kind, found.criterion) == ("none", None, None)
    assert "none of the criteria" in found.reason


def test_auto_takes_what_the_evidence_decides_for_with_each_specimens_own_threshold(cohort):
    # one that is asked for is taken whatever the evidence says, and nothing unless it is asked for
    assert rupture_study(cohort, weight=1.5, asked="depth").taken == "depth"
    found = rupture_study(cohort, weight=1.5, asked="auto")
    assert (found.decision.answer, found.decision.criterion) == ("decided", "work")
    work = next(one for one in found.thresholds if one.criterion == "work")
    assert found.taken == "work"
    assert {name: law.threshold for name, law in found.laws.items()} == dict(work.specimens)
    for name, law in found.laws.items():
        own = np.mean([np.log(one.work_N_mm) for one in cohort if one.specimen == name])
        # drawn a little toward the others: 5 % from test to test, 15 % between specimens
        assert np.log(law.threshold) == pytest.approx(own, abs=0.05)
        assert (law.residual, law.population, law.population_ci95) == (0.2, work.median, work.ci95)


def only_own_speed(failures: list[Failure]) -> list[Failure]:
    """Each specimen at one speed of three: two specimens a speed, made three tests by repeats of names."""
    return [structs.replace(one, specimen=f"{one.speed_mm_s:.0f}-{k // 9}") for k, one in enumerate(failures)]


def test_speeds_of_different_specimens_are_confounded_with_them_and_no_effect_is_claimed(cohort):
    found = rupture_study(only_own_speed(cohort), weight=1.5, asked="auto")
    said = sentences(found)
    assert found.confounding.kind == "confounded"
    assert found.changes == ()
    assert (found.decision.answer, found.taken) == ("undecided", "none")
    assert "specimens of its own" in found.decision.reason
    assert "No effect of speed on rupture is claimed." in said
    assert not any("with speed: " in sentence for sentence in said)
    assert [flag.code for flag in found.flags] == ["speed_confounded"]
    one = rupture_study(cohort[::3], weight=1.5, asked="auto").decision
    assert (one.answer, "one speed" in one.reason) == ("undecided", True)


def test_without_a_wish_no_law_is_taken_and_the_work_criterion_is_qualified(cohort):
    found = rupture_study(cohort, weight=1.5)
    assert (found.taken, dict(found.laws)) == ("none", {})
    said = " ".join(sentences(found))
    assert "less energy is absorbed at higher speed" in said
    assert "contradicts its source on this point" in said
    assert "no fall of the force at rupture follows from it" in said


def test_change_inside_specimens_is_the_slope_of_tests_about_their_specimens_mean(cohort):
    # toughness of specimens, however large, is no effect of speed
    force = {name: 10.0 ** (k % 3) for k, name in enumerate(dict.fromkeys(one.specimen for one in cohort))}
    made = [
        structs.replace(one, force_N=force[one.specimen] * (one.speed_mm_s / 2.0) ** -0.1) for one in cohort
    ]
    found = {one.quantity: one for one in change_with_speed(made)}
    assert found["force_N"].ratio == pytest.approx(10.0**-0.1, rel=1e-9)
    assert found["force_N"].direction == "falls"


def test_the_sign_test_leaves_out_what_ruptured_too_fast_for_it(cohort):
    found = hardening_of(cohort)
    slow = [one for one in cohort if one.speed_mm_s < 30.0]
    assert found.ruptures == len(slow) == 12
    assert found.mean == pytest.approx(np.mean([one.hardening for one in slow]))
    assert found.direction == "falls"
    assert hardening_of([one for one in cohort if one.speed_mm_s > 30.0]) is None


@pytest.mark.parametrize(
    ("ends", "said"), [((1.1, 2.0), "falls"), ((0.5, 0.9), "rises"), ((0.9, 1.1), "undecided")]
)
def test_the_sign_is_told_only_where_the_interval_leaves_out_one(ends, said):
    assert direction(ends, below="rises", above="falls") == said


def test_too_few_ruptures_are_refused_with_their_number(cohort):
    with pytest.raises(NotIdentifiedError, match="3 of 3 tests end in a rupture, and 4 are needed"):
        rupture_study(cohort[:3], weight=1.5)


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


def test_what_a_known_frame_gives_way_is_none_of_the_depth_and_the_work():
    (trial,) = as_trials(simulate(replace(PLAN, logs=PLAN.logs[:1]), rng=np.random.default_rng(3)))
    divided = segment(trial, options=SegmentOptions())
    behind = replace(trial, displacement_mm=trial.displacement_mm + trial.force_N / 500.0)
    test, alone = loaded_test(behind, divided, linear_frame(500.0)), loaded_test(trial, divided)
    assert test.depth_mm == pytest.approx(alone.depth_mm, abs=1e-3)
    assert test.work_N_mm == pytest.approx(alone.work_N_mm, rel=1e-3)
    # the frame stores F^2 / 2k
    spring = 0.5 * alone.force_N**2 / 500.0
    assert loaded_test(behind, divided).work_N_mm - alone.work_N_mm == pytest.approx(spring, rel=0.05)
    assert spring > 0.05 * alone.work_N_mm


def test_the_middle_of_the_step_is_not_early_or_late():
    plan = replace(PLAN, logs=(replace(PLAN.logs[2], repeats=24),), rate_Hz=250.0)
    early = [test.depth_mm[-1] - log.truth["rupture_depth_mm"] for log, test in up_to_end(plan)]
    # uniform over 0.2 mm: sd 0.058 mm, of a mean of 24 0.012; the last sample itself is 0.1 mm early
    assert np.mean(early) == pytest.approx(0.0, abs=0.036)


def test_a_test_that_did_not_rupture_ends_at_its_deepest_sample_and_one_in_air_is_none():
    held = Log("held", (Move(4.0, 600.0), Hold(1.0)))
    ((log, test),) = up_to_end(replace(PLAN, logs=(held,)))
    assert (test.ruptured, test.step_mm, test.residual) == (False, 0.0, None)
    assert test.depth_mm[-1] == pytest.approx(4.0 - log.truth["contact_offset_mm"], abs=0.05)
    assert test.work_N_mm == pytest.approx(log.truth["rupture_work_N_mm"], rel=0.05)
    air = Log("air", (Move(0.5, 60.0),))
    (trial,) = as_trials(simulate(replace(PLAN, logs=(air,)), rng=np.random.default_rng(1)))
    assert loaded_test(trial, segment(trial, options=SegmentOptions())) is None


def test_shares_of_the_law_multiply_what_was_measured_and_its_draws_make_the_spread():
    (_, test) = up_to_end(PLAN)[1]
    model = kelvin_voigt(1, 0, 9.0)
    theta = np.array([6.0, 0.0, 0.4, 63.62, 0.021])
    covariance = np.diag([0.0, 0.0, 0.0, (0.05 * 63.62) ** 2, 0.0])
    (sure,) = failures_of(SpecimenLaw("a", model, theta, np.zeros((5, 5))), [(test, 0.0)])
    (open_,) = failures_of(SpecimenLaw("a", model, theta, covariance), [(test, 0.0)])
    x, v = test.depth_mm[-1], test.speed_mm_s
    dynamic = 63.62 * v * 0.021
    share = dynamic / (6.0 * x + 0.4 * x**3 + dynamic)
    assert sure.dynamic_share == pytest.approx(share, rel=0.01)
    assert sure.measures.weighted_force.value == pytest.approx(test.force_N * (1.0 + 0.5 * share), rel=0.005)
    assert sure.measures.work.value == test.work_N_mm
    # 5 % of K is 5 % (1 - share) of the share; the sd of 40 draws is good to 11 %
    more = open_.measures.weighted_force.sd_ln**2 - sure.measures.weighted_force.sd_ln**2
    expected = 0.5 * share * (1.0 - share) * 0.05 / (1.0 + 0.5 * share)
    assert np.sqrt(more) == pytest.approx(expected, rel=0.4)
    assert open_.measures.work.sd_ln == sure.measures.work.sd_ln
    assert (sure.hardening_sd, open_.hardening_sd > 0.0) == (0.0, True)
