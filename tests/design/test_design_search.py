"""The search: deterministic, within what is allowed, as short as a brute one, better than paper A's."""

from dataclasses import replace
from functools import cache
from itertools import pairwise, product

import numpy as np
import pytest
from design_cases import ETA, PAPER_A, TAU, asked_for, better_than_paper_a, paper_a, silent

from tissueid.design.machine import PRESETS, Setting
from tissueid.design.plan import Plan, against, planned
from tissueid.design.precision import Asked, Indentation, Ledger, Precision
from tissueid.design.search import balanced, enumerated, learned_candidates, rounded
from tissueid.design.tissues import Tissues, of_draws
from tissueid.errors import UsageError

pytestmark = pytest.mark.needs_jit

MACHINE = replace(PRESETS["paper-a"], settings=(Setting(100.0, 1.0),))
ASKED = asked_for({TAU: 0.04, ETA: 0.01}, MACHINE)


@cache
def plain_plan() -> Plan:
    return planned(MACHINE, PAPER_A, ASKED, silent)


def ledger_of(setting: Setting = MACHINE.settings[0], asked: Asked = ASKED) -> Ledger:
    return Ledger(MACHINE, setting, PAPER_A, asked)


def uncertain(draws: int = 6) -> Tissues:
    """Paper A's tissue with relaxation times that are known to a factor."""
    theta = np.repeat(PAPER_A.theta, draws, axis=0)
    theta[:, -1] *= np.geomspace(0.5, 2.0, draws)
    return of_draws("guesses", "uncertain", PAPER_A.model, theta, count=draws, known_depth_mm=6.0)


def test_for_paper_a_s_precision_less_machine_time_is_needed():
    given, better = paper_a(), better_than_paper_a()
    wanted, reached = given.predicted(), better.predicted()
    assert reached[TAU] <= wanted[TAU]
    assert reached[ETA] <= wanted[ETA]
    shorter = better.ledger.duration(better.protocol) / given.ledger.duration(given.protocol)
    # rests and mounting are the same for every log: without them it is a sixth
    assert shorter < 0.75
    working = [
        sum(
            count * (case.ledger.seconds(test) - case.asked.recovery_s)
            for test, count in case.protocol.items()
        )
        for case in (better, given)
    ]
    assert working[0] < 0.25 * working[1]


def test_a_plan_is_the_same_every_time_its_numbers_hold_and_less_would_not_do():
    plan = plain_plan()
    again = planned(MACHINE, PAPER_A, ASKED, silent)
    assert [one.protocol for one in plan.ranked] == [one.protocol for one in again.ranked]
    assert plan.best.reached
    for one in plan.ranked:
        ledger = ledger_of(one.setting)
        assert ledger.precision(one.protocol).worst == pytest.approx(one.worst, rel=1e-9)
        assert ledger.duration(one.protocol) == pytest.approx(one.seconds, rel=1e-9)
        assert min(one.protocol.values()) >= ASKED.repeats
        assert one.logs <= ASKED.max_logs
        assert one.seconds <= ASKED.budget_s
    reached = [one.seconds for one in plan.ranked if one.reached]
    # times within a hundredth count as one
    assert all(later >= 0.99 * earlier for earlier, later in pairwise(reached))
    best = plain_plan().best
    ledger = ledger_of()
    spare = {test: count for test, count in best.protocol.items() if count > ASKED.repeats}
    assert spare
    for test, count in spare.items():
        assert ledger.precision({**best.protocol, test: count - 1}).worst > 1.0
    plan = plain_plan()
    factors = [factor for factor, _ in plan.front]
    seconds = [one.seconds for _, one in plan.front]
    assert factors == sorted(factors, reverse=True)
    assert seconds == sorted(seconds)
    assert len(seconds) >= 4


def test_no_protocol_of_a_brute_search_is_shorter():
    best = plain_plan().best
    ledger = ledger_of()
    tests = [test for test in learned_candidates(ledger) if test.hold_s in {0.0, 1.0, 3.1}]
    assert len(tests) > 20
    shortest = np.inf
    for i, j in product(range(len(tests)), repeat=2):
        if i >= j or (tests[i].hold_s < 0.1 and tests[j].hold_s < 0.1):
            continue
        for a, b in product(range(3, 20, 4), repeat=2):
            protocol = {tests[i]: a, tests[j]: b}
            seconds = ledger.duration(protocol)
            if seconds < shortest and ledger.precision(protocol).worst <= 1.0:
                shortest = seconds
    assert np.isfinite(shortest)
    assert best.seconds <= shortest * 1.001


def test_tissues_that_are_known_less_need_more():
    asked = replace(ASKED, assurance=1.0)
    sure = plain_plan().best
    unsure = planned(MACHINE, uncertain(), asked, silent).best
    assert unsure.reached
    assert unsure.seconds > 1.2 * sure.seconds
    # the half of the tissues does with less
    half = planned(MACHINE, uncertain(), replace(asked, assurance=0.5), silent).best
    assert half.seconds < unsure.seconds


def test_force_and_depth_stay_below_what_is_allowed():
    gentle = replace(ASKED, max_force_N=40.0, max_depth_mm=3.0)
    plan = planned(MACHINE, PAPER_A, gentle, silent)
    for one in plan.ranked:
        assert max(one.peak_N) <= 40.0
        assert max(test.depth_mm for test in one.protocol) <= 3.0
    assert plan.best.seconds > plain_plan().best.seconds


def test_ramps_of_one_speed_alone_are_not_proposed():
    # so precise a machine would do with three of them
    quiet = replace(MACHINE, settings=(Setting(1000.0, 0.01),))
    plan = planned(quiet, PAPER_A, ASKED, silent)
    for one in plan.ranked:
        speeds = [test.speed_mm_min for test in one.protocol]
        holds = [test.hold_s for test in one.protocol]
        assert max(speeds) >= 1.5 * min(speeds) or max(holds) >= 3.0 * 0.021


def test_where_none_can_the_nearest_and_its_limits_are_said():
    machine = PRESETS["slow-logger"]
    asked = asked_for({TAU: 0.05, ETA: 0.05}, machine)
    plan = planned(machine, PAPER_A, asked, silent)
    assert not plan.best.reached
    assert all(not one.reached for one in plan.ranked)
    assert plan.best.assured[0] > 0.3
    assert max(one.logs for one in plan.ranked) <= asked.max_logs
    named = [one.name for one in plan.limits]
    assert {"noise", "speed"} <= set(named)
    factors = [one.factor for one in plan.limits if not one.enough]
    assert factors == sorted(factors, reverse=True)
    # a tenth of the noise makes it ten times as precise at the most
    (noise,) = [one for one in plan.limits if one.name == "noise"]
    assert 5.0 < noise.factor <= 10.0


def test_an_unknown_instrument_sets_a_floor_that_no_time_passes():
    machine = replace(MACHINE, settings=(Setting(1000.0, 0.1),))
    asked = asked_for({ETA: 0.004}, machine, total=True, gain_sd=0.0, time_sd=0.0)
    plan = planned(machine, PAPER_A, asked, silent)
    # force and displacement gain are known to 1 % each
    assert not plan.best.reached
    assert plan.best.assured[0] > 0.01
    assert plan.limits[0].name == "gains"
    assert planned(machine, PAPER_A, replace(asked, total=False), silent).best.reached


def test_what_a_machine_cannot_run_and_a_budget_without_room_are_said():
    given = against("paper A", paper_a().protocol, PRESETS["slow-logger"], PAPER_A, ASKED)
    assert given.judged is None
    assert "50" in given.obstacle
    assert enumerated(ledger_of(asked=replace(ASKED, budget_s=650.0))) == ([], 0)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"budget_s": 700.0}, "allow a larger --budget"),
        ({"budget_s": 1.0}, "allow a larger --budget"),
        ({"max_force_N": 1e-4}, "raise --max-force"),
        ({"max_depth_mm": 0.02}, "raise --max-depth"),
        ({"repeats": 9, "max_logs": 8}, "--repeats 9 does not fit --max-logs 8"),
    ],
)
def test_what_leaves_no_protocol_is_refused(change, says):
    with pytest.raises(UsageError, match=says):
        planned(MACHINE, PAPER_A, replace(ASKED, **change), silent)


def test_a_number_that_stays_open_takes_no_further_logs(monkeypatch):
    open_ones = np.full((len(ASKED.wants), 1), np.inf)
    monkeypatch.setattr(Ledger, "precision", lambda self, _protocol: Precision(open_ones, self.asked))
    tests = (Indentation(500.0, 4.0), Indentation(100.0, 4.0, 2.0))
    assert balanced(ledger_of(), tests, {}).logs == 2 * ASKED.repeats


def test_numbers_of_a_sheet_are_short_and_never_above():
    assert [rounded(value) for value in (0.0, 0.1, 0.0419, 8.0, 4.799999999, 123.4, 0.299999999999999)] == [
        0.0, 0.1, 0.041, 8.0, 4.7, 120.0, 0.3,
    ]  # fmt: skip
