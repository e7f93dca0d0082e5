"""Orders and laws by what was left out: the simplest that predicts as well as the best."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from inference_cases import draw, handles_for, handles_of, identified, small_recipe

from tissueid.flags import Flag
from tissueid.inference import choice
from tissueid.inference.channel_law import kelvin_voigt_law, law_of
from tissueid.inference.choice import Rival
from tissueid.inference.specimen import _one_form, rival_flags
from tissueid.inference.window import FOLDS
from tissueid.model.base import ContactPath
from tissueid.model.grammar import parsed
from tissueid.synth import Branch, Hold, Log, Move

ONE = (Branch((30.0,), 0.3),)
TWO = (Branch((30.0,), 0.05), Branch((25.0,), 1.5))
GROWING = (Branch((10.0, 12.0), 0.3),)
LOGS = tuple(
    Log(f"hold-{d:.0f}-{v:.0f}", (Move(d, v), Hold(4.0)))
    for d, v in ((4.0, 60.0), (4.0, 240.0), (4.0, 600.0), (2.0, 240.0))
)


def chosen(tissue, seed, **asked):
    recipe = small_recipe(branches=tissue, logs=LOGS, sigma_N=0.1)
    return identified(handles_of(recipe, seed), pooling="partial", **asked)


@pytest.mark.system
@pytest.mark.parametrize(("truth", "count"), [(ONE, 1), (TWO, 2)])
def test_the_number_of_branches_is_that_of_the_tissue(truth, count):
    seen = [chosen(truth, seed, branches=(1, 2, 3), degrees=(0,)) for seed in range(5)]
    # one standard error is one in six that a branch too many is kept, one too few never
    assert sum(found.law.branches == count for found in seen) >= 4
    assert all(found.law.branches >= count for found in seen)
    for found in seen:
        rows = [row for row in found.table if row["chosen"]]
        assert [row["branches"] for row in rows] == [found.law.branches]
        assert found.left_out == "speed"
        if found.law.branches == count:
            tau = np.sort(np.exp(found.optimum.point.log_times))
            np.testing.assert_allclose(tau, [one.tau_s for one in truth], rtol=0.1)


@pytest.mark.system
def test_a_growing_stiffness_is_found_where_it_grows():
    seeds = range(6)
    assert [chosen(GROWING, seed, branches=(1,), degrees=(0, 1)).law.degree for seed in seeds] == [1] * 6
    # one standard error is one in six that a bend too many is kept
    assert sum(chosen(ONE, seed, branches=(1,), degrees=(0, 1)).law.degree == 0 for seed in seeds) >= 5


def tried(branches, degree, errors, law=None, sigma_N=1.0, logs=3, badness=0.0):
    law = law or kelvin_voigt_law(branches, degree, 8.0)
    point = SimpleNamespace(log_times=np.log(np.arange(1.0, law.times + 1)), linear=np.ones(law.linear))
    noise = SimpleNamespace(sigma_N=sigma_N)
    optimum = SimpleNamespace(point=point, covariance=1e-4 * np.eye(law.times + law.linear), noise=noise)
    system = SimpleNamespace(law=law, logs=[None] * logs)
    return choice.Tried(optimum, system, np.array(errors), badness)


def named(name, errors, sigma_N=1.0):
    law = law_of(parsed(name).model(8.0, 0.01, 10.0), 1)
    return tried(law.branches, law.degree, errors, law, sigma_N)


NEAR, FAR = [1.0, 1.1, 0.9, 1.0], [2.0, 2.1, 2.0, 1.9]


def test_a_law_of_fewer_parameters_that_predicts_as_well_is_chosen():
    paper, simple = tried(2, 1, NEAR), named("power * power-law", [1.0, 1.2, 0.9, 1.0])
    found = choice.choice_of(paper, [simple], choose=True)
    assert found.chosen is simple
    (beside,) = found.rivals
    assert beside.name == "polynomial * linear * prony:2"
    row = {"branches": 2, "stiffness_degree": 1, "score": 0.0, "chosen": True}
    rows = choice.table_of([row], found, paper)
    assert [row["chosen"] for row in rows] == [False, True]
    assert rows[0]["score"] == pytest.approx(beside.gain)
    assert rows[1]["model"] == "power * power-law"


def test_what_misses_all_logs_is_no_candidate_though_it_predicts_alike():
    """Differences between logs drown in their prediction what a law misses in every one of them."""
    plain, right = tried(1, 2, NEAR, sigma_N=2.0), tried(2, 2, NEAR)
    assert choice.chosen_among([plain, right])[0] is plain
    assert choice.describing([plain, right]) == [right]
    # of one log the prediction itself tells
    alone = [tried(1, 2, NEAR, sigma_N=2.0, logs=1), tried(2, 2, NEAR, logs=1)]
    assert choice.describing(alone) == alone


def test_a_law_that_lacks_a_branch_in_all_logs_is_no_candidate_beside_another_kind():
    paper = tried(3, 2, FAR, sigma_N=1.0)
    fewer, more = (named(f"polynomial * tangent * prony:{n}", NEAR, s) for n, s in ((1, 1.8), (2, 1.0)))
    assert choice.choice_of(paper, [fewer, more], choose=True).chosen is more
    # a law of another kind may miss as much, and one branch is taken where it describes as well
    assert choice.choice_of(paper, [fewer], choose=True).chosen is fewer
    alike = named("polynomial * tangent * prony:1", NEAR, 1.1)
    assert choice.choice_of(paper, [alike, more], choose=True).chosen is alike


def test_a_branch_too_many_of_another_law_is_a_row_and_counts_for_nothing():
    names = [f"polynomial * tangent * prony:{n}" for n in (1, 2)]
    found = choice.choice_of(tried(1, 0, NEAR), [named(one, NEAR) for one in names], choose=False)
    assert [one.name for one in found.rivals] == names
    assert [one.name for one in found.simplest] == names[:1]
    # a gain that is sure, and short of a fifth, is as good
    assert rival(0.5 * choice.BEND, 0.0, stderr=1e-3).as_good


def test_of_as_many_parameters_the_papers_law_is_kept_and_unasked_always():
    paper, other = tried(1, 0, NEAR), named("polynomial * tangent * prony:1", [0.99, 1.09, 0.9, 1.0])
    assert choice.choice_of(paper, [other], choose=True).chosen is paper
    better = named("power * fung", [0.1, 0.1, 0.1, 0.1])
    assert choice.choice_of(paper, [better], choose=False).chosen is paper
    assert choice.choice_of(paper, [better], choose=True).chosen is better


def test_the_yardstick_is_a_row_and_never_chosen():
    paper, mark = tried(1, 0, FAR), named("power * fung", NEAR)
    law = replace(mark.law, model_of=replace(mark.law.model_of, name="yardstick"))
    found = choice.choice_of(paper, [tried(1, 0, NEAR, law)], choose=True)
    assert found.chosen is paper
    assert found.rivals == ()
    assert found.mark.gain > 0.5
    assert [row.get("model") for row in choice.table_of([], found, paper)] == ["yardstick"]


def test_the_simplest_within_one_standard_error_is_chosen():
    best, close, worse = tried(2, 1, NEAR), tried(1, 0, [1.0, 1.3, 0.9, 1.0]), tried(1, 1, FAR)
    found, table, as_good = choice.chosen_among([worse, close, best])
    assert found is close
    assert as_good == [close, best]
    assert [row["chosen"] for row in table] == [True, False, False]
    assert [row["score"] for row in table][2] == 0.0
    gain = np.log([1.0, 1.3, 0.9, 1.0]) - np.log(NEAR)
    assert table[0]["score"] == pytest.approx(-gain.mean())
    assert table[0]["stderr"] == pytest.approx(gain.std(ddof=1) / 2.0)
    # a clear gain is worth its parameters
    assert choice.chosen_among([worse, best])[0] is best
    # two groups alike: the gain of the third is its own standard error, whatever it is
    simple = tried(1, 1, [1.0, 5.0, 1.0])
    assert choice.chosen_among([simple, tried(1, 2, [1.0, 1.0, 1.0])])[0] is simple
    # but for one that is missed by far
    far = tried(1, 1, [1.0, 50.0, 1.0])
    assert choice.chosen_among([far, (better := tried(1, 2, [1.0, 1.0, 1.0]))])[0] is better


@pytest.mark.parametrize(
    ("rows", "kind", "of"),
    [
        (((1.0, 4.0), (1.05, 4.0), (2.0, 4.0), (5.0, 4.0)), "speed", [0, 0, 0, 1, 2]),
        (((1.0, 1.0), (1.0, 2.0), (1.0, 3.0), (1.0, 3.1)), "depth", [0, 0, 1, 2, 2]),
        (((1.0, 4.0), (1.0, 4.0), (1.0, 4.0), (2.0, 4.0)), "log", [0, 0, 1, 2, 3]),
        (((1.0, 4.0),), "stretch of the log", [0, 7 % FOLDS, 1, 2, 3]),
    ],
)
def test_what_is_left_out_is_a_speed_a_depth_a_log_or_a_stretch(rows, kind, of):
    facts = [SimpleNamespace(speeds_mm_s=(v,), depth_mm=d) for v, d in rows]
    system = SimpleNamespace(log=np.array([0, 0, 1, 2, 3]), fold=np.array([0, 7, 1, 2, 3]))
    found = choice.groups_of(system, facts)
    assert (found.kind, found.of.tolist()) == (kind, of)


def test_the_error_of_what_was_left_out_is_that_of_fits_without_it():
    """One step from the optimum, against fits to the other logs."""
    handles = handles_of(small_recipe(branches=ONE, logs=LOGS, sigma_N=0.3), 4)
    ours = identified(handles, pooling="shared", noise="white")
    groups = choice.groups_of(ours.system, [handle.facts for handle in handles])
    assert groups.kind == "speed"
    found = choice.held_out(ours.system, ours.optimum, groups)
    for number, error in enumerate(found):
        out = np.unique(ours.system.log[groups.of == number])
        rest = [one for k, one in enumerate(handles) if k not in out]
        other = identified(rest, pooling="shared", noise="white").optimum.point
        left = ours.system.force - ours.system.predict(ours.optimum.point.moved(other.shared))
        rows = groups.of == number
        # block means, weighed with their samples
        expected = float((left[rows] ** 2 * ours.system.count[rows]).mean())
        assert error == pytest.approx(expected, rel=0.02)


def test_a_branch_faster_than_the_sampling_or_below_the_noise_is_not_resolved():
    ours = identified(handles_of(small_recipe(branches=TWO, logs=LOGS), 1), branches=(2,))
    one = choice.Tried(ours.optimum, ours.system, np.ones(3))
    assert choice.resolved(one, 0.01)
    assert not choice.resolved(one, 0.1)


def test_a_third_branch_of_one_program_has_to_gain_a_fifth_and_be_shown_by_the_logs_themselves():
    base = np.array([1.0, 1.2, 0.9])
    plain, slight = tried(2, 1, base), tried(3, 1, 0.93 * base, badness=-20.0)
    assert choice.shown([plain, slight], one_program=True) == [plain]
    assert choice.shown([plain, slight], one_program=False) == [plain, slight]
    much, luck = (tried(3, 1, 0.7 * base, badness=-gain) for gain in (20.0, 10.0))
    assert choice.shown([plain, much], one_program=True) == [plain, much]
    # a second branch needs no such gain, but to be seen
    one, two = tried(1, 0, base), tried(2, 0, 0.97 * base, badness=0.6)
    assert choice.shown([one, replace(two, badness=-20.0)], one_program=True)[1].law.branches == 2
    for one_program in (True, False):
        assert choice.shown([plain, luck], one_program=one_program) == [plain]
        assert choice.shown([one, two], one_program=one_program) == [one]


PAPER = small_recipe(branches=(Branch((10.0, 12.0), 0.3),), logs=LOGS, sigma_N=0.1)


def quasi_linear(trials):
    """The same paths, felt by a quasi-linear tissue."""
    rng, theta = np.random.default_rng(8), np.array([20.0, -1.2, 0.35, 1.5, 0.5])
    model = parsed("polynomial * tangent * prony:1").model(8.0, 0.01, 10.0)
    out = []
    for one in trials:
        force = model.force(theta, ContactPath(one.time_s, np.maximum(one.displacement_mm, 0.0)))
        out.append(replace(one, force_N=force + 0.1 * rng.standard_normal(one.time_s.size)))
    return out


@pytest.mark.system
def test_a_quasi_linear_tissue_is_told_and_the_papers_is_not():
    asked = {"pooling": "partial", "branches": (1, 2), "degrees": (0, 1)}
    paper = identified(handles_of(PAPER, 1), **asked)
    assert not any(one.better or one.disagrees for one in paper.rivals)
    assert rival_flags(paper) == ()
    other = identified(handles_for(quasi_linear(draw(PAPER, 1))), **asked)
    assert any(one.better for one in other.rivals)
    (flag,) = rival_flags(other)
    assert flag.code == "form_dependent"
    assert flag.values["tau_s"] == pytest.approx(0.5, rel=0.05)


def rival(gain, apart, *, stderr=0.3):
    return Rival("polynomial * tangent * prony:1", gain, stderr, 1.84 * stderr, 0.5, apart, None, None)


@pytest.mark.parametrize(
    ("gain", "apart", "better", "disagrees"),
    [
        (1.0, 0.0, True, False),
        (1.0, 9.0, True, True),
        (0.29, 0.5, False, False),
        (0.29, -4.0, False, True),
        (-0.5, 4.0, False, True),
        (-1.0, 9.0, False, False),
    ],
)
def test_a_law_is_better_or_ties_and_disagrees(gain, apart, better, disagrees):
    one = rival(gain, apart)
    assert (one.better, one.disagrees) == (better, disagrees)
    # a gain that is sure but small is none
    assert not rival(0.9 * choice.BEND, 0.0, stderr=1e-3).better


def test_one_remark_on_the_form_is_enough():
    keys = ("gain", "slope", "depth_mm")
    by_law, window, program = (Flag("form_dependent", "", {key: 1.0}) for key in keys)
    other = Flag("bound_active", "else")
    assert _one_form((program, other, window, by_law)) == (other, by_law)
    assert _one_form((program, window, other)) == (window, other)
    assert _one_form((program, other)) == (program, other)
    assert _one_form((other,)) == (other,)


@pytest.mark.parametrize(("times", "rate_Hz"), [((0.3, 5.0, 80.0), 50.0), ((0.2, 4.0, 60.0), 20.0)])
def test_a_third_time_is_found_beside_two_that_lie_between_nodes(times, rate_Hz):
    """Noise of 0.05 of some 400 N: a pair between nodes misses more than a third branch gains from either."""
    three = tuple(Branch((stiffness,), tau) for stiffness, tau in zip((20.0, 10.0, 10.0), times, strict=True))
    hold = (Log("hold", (Move(8.0, 240.0), Hold(300.0))),)
    plan = small_recipe(branches=three, logs=hold, rate_Hz=rate_Hz, sigma_N=0.05)
    ours = identified(handles_of(plan, 1, sd_mm=0.02), branches=(1, 2, 3), degrees=(0, 1), machine=True)
    assert ours.law.branches == 3
    assert np.exp(np.sort(ours.optimum.point.log_times)) == pytest.approx(times, rel=0.01)
