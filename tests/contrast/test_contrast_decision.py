"""Are two tissues one?  Against normal theory, and over tissues that were recorded twice."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from rendered_tissues import PAPER_A, TWO_BRANCHES
from scipy.stats import beta, kstest

from tissueid.contrast.decision import (
    LIMITS,
    Compared,
    common_range,
    contrast_document,
    difference,
    draws_of_numbers,
    hand_words,
    noticed,
    rows,
)
from tissueid.documents.contrast import Common
from tissueid.errors import UsageError
from tissueid.model.channels import loading_force
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.rendering.tissue_block import Tissue
from tissueid.selfcheck.protocol import Centre, of_program
from tissueid.selfcheck.tissue import TissueCheck, tissue_check
from tissueid.selfcheck.truth import Widths
from tissueid.synth.recipe import Hold, Log, Move


def compared(tissue: Tissue, *, share: float = 0.01, scale: float = 1.0, seed: int = 1) -> Compared:
    """A tissue of which everything is known to a share."""
    chance = np.random.default_rng(seed)
    center = tissue.theta.copy()
    center[:4] *= scale
    draws = center * np.exp(share * chance.standard_normal((400, center.size)))
    return Compared(tissue.name, tissue.model, draws, tissue.speeds_mm_s, total=False)


def test_forces_are_those_of_the_model_at_common_depths_and_speeds() -> None:
    tissue = compared(PAPER_A)
    common = Common(8.0, (1.0, 5.0))
    found = draws_of_numbers(tissue, common)
    for speed in (1.0, 5.0):
        values = found[f"force at 4 mm, {speed:.3g} mm/s [N]"]
        expected = loading_force(PAPER_A.model, tissue.draws[17], np.array([4.0]), speed_mm_s=speed)[0]
        assert values[17] == pytest.approx(expected, rel=1e-12)
    k, tau = tissue.draws[17, 3:5]
    assert found["viscosity at 4 mm [N s/mm]"][17] == pytest.approx(k * tau)


def test_what_is_common_is_the_shallower_depth_and_the_narrower_speeds() -> None:
    one = compared(PAPER_A)
    other = replace(compared(TWO_BRANCHES), speeds_mm_s=(1.0, 20.0))
    assert common_range([one, other]) == Common(8.0, (1.0, 500.0 / 60.0))
    with pytest.raises(UsageError, match="no speed is common"):
        common_range([one, replace(other, speeds_mm_s=(10.0, 20.0))])
    # one program, as two recordings of it have its speed
    held = [replace(one, speeds_mm_s=(speed, speed)) for speed in (4.16666658, 4.1666667)]
    assert common_range(held).speeds_mm_s == pytest.approx((4.1666667, 4.1666667))
    with pytest.raises(UsageError, match="too few"):
        replace(one, draws=one.draws[:10])


def test_the_test_has_its_level_where_posteriors_are_normal() -> None:
    chance = np.random.default_rng(20_261_122)
    spread = np.array([[1.0, 0.9, 0.2], [0.9, 1.0, 0.3], [0.2, 0.3, 1.0]]) * 1e-4
    probabilities = []
    for _ in range(400):
        truth = chance.normal(3.0, 1.0, 3)
        draws = [
            np.exp(chance.multivariate_normal(chance.multivariate_normal(truth, spread), spread, 800))
            for _ in range(2)
        ]
        named = [{f"force {k}": values[:, k] for k in range(3)} for values in draws]
        probabilities.append(difference(*named).probability)
    # uniform where it is right: 400 of them leave that with 1 %, this seed does not
    assert kstest(probabilities, "uniform").pvalue > 0.01


def test_the_test_has_its_level_where_draws_have_far_tails() -> None:
    chance = np.random.default_rng(20_261_129)
    called = 0
    for _ in range(400):
        named = []
        for _ in range(2):
            # few logs leave the scale of what is known open
            values = 3.0 + 0.02 * chance.standard_t(3, 4)[0] + 0.02 * chance.standard_t(3, 2000)
            named.append({"force": np.exp(values)})
        called += difference(*named).different
    # 2 % of 400 are 8; more than 17 are one in a thousand
    assert called <= 17


def test_what_the_intervals_do_not_know_is_said() -> None:
    once, often = (replace(compared(PAPER_A, seed=seed), logs=seed, total=True) for seed in (1, 2))
    assert contrast_document([often, often], clamp_N=5.0)["remarks"] == []
    (found,) = contrast_document([often, once], clamp_N=5.0)["remarks"]
    assert found.startswith(f"1 of 2 tissues (first {once.name}) have one log")
    (found,) = contrast_document([often, replace(often, total=False)], clamp_N=5.0)["remarks"]
    assert found.startswith("statistical intervals hold the machine at each fit's own estimate")


def test_a_tissue_beside_itself_and_beside_a_stiffer_one() -> None:
    document = contrast_document(
        [compared(PAPER_A), compared(PAPER_A, seed=2), compared(PAPER_A, scale=1.3, seed=3)], clamp_N=5.0
    )
    same, stiffer, _ = document["pairs"]
    assert same["difference"]["different"] is False
    assert stiffer["difference"]["different"] is True
    row = next(one for one in stiffer["numbers"] if one["name"].startswith("static stiffness"))
    assert row["ratio"][0] <= 1.3 <= row["ratio"][2]
    assert row["larger"] > 0.99


def test_probability_of_being_larger_is_that_of_independent_draws() -> None:
    chance = np.random.default_rng(4)
    a, b = chance.normal(10.0, 1.0, 2000), chance.normal(11.0, 1.0, 2000)
    (row,) = rows({"x": a}, {"x": b})
    # P(N(1, sqrt 2) > 0) = 0.760; 2,000 draws each: 0.011
    assert row.larger == pytest.approx(0.760, abs=0.035)
    assert row.one[1] == pytest.approx(10.0, abs=0.1)


@pytest.mark.parametrize(
    ("ratio", "scale", "felt"), [(1.03, 0.1, False), (1.15, 0.1, True), (1.15, 1e-3, False)]
)
def test_a_force_that_is_not_faint_is_noticed_by_a_hand_beyond_seven_percent(ratio, scale, felt) -> None:
    force = np.full(200, 40.0)
    (one,) = noticed({"force at 4 mm [N]": force}, {"force at 4 mm [N]": ratio * force}, force_scale=scale)
    assert one.limit is LIMITS[0]
    assert (one.times > 1.0, one.probability) == (felt, float(felt))


@pytest.mark.parametrize(
    ("ratio", "spread", "different", "said"),
    [
        (1.04, 0.17, False, "it is not known whether a hand could tell: force, 0.49 (0 to 7.3)"),
        (1.30, 0.02, True, "a hand could tell: force, 3.7"),
        (1.30, 0.02, False, "it is not known"),
        (1.01, 0.01, True, "a hand would hardly tell"),
    ],
)
def test_scatter_is_no_difference_that_a_hand_could_tell(ratio, spread, different, said) -> None:
    chance = np.random.default_rng(5)
    one, other = ({"force": 40.0 * of * np.exp(spread * chance.standard_normal(4000))} for of in (1.0, ratio))
    found = noticed(one, other, force_scale=1.0)
    assert hand_words(found, different=different).startswith(said)
    low, high = found[0].interval
    assert low <= found[0].times <= high
    assert (found[0].probability >= 0.975) is (low > 1.0)


PAIRS, FEW = 400, 3
SEED_SAME, SEED_STIFFER = 20_261_141, 20_261_142
#: One tissue is called different at most so often, one 30 % stiffer at least so often (99 % bounds).
MOST_FALSE, LEAST_RIGHT = 0.09, 0.90
LOGS = (
    Log("ramp-60", (Move(4.0, 60.0),)),
    Log("ramp-500", (Move(8.0, 500.0),), repeats=2),
    Log("hold-8", (Move(8.0, 250.0), Hold(3.0)), repeats=2),
)


def check_of_one_tissue() -> TissueCheck:
    protocol = of_program(LOGS, rate_Hz=100.0, contact_sd_mm=0.01, words="five logs")
    model = kelvin_voigt(branches=1, stiffness_degree=0, depth_mm=protocol.depth_mm)
    theta = np.array([20.0, -1.2, 0.35, 63.62, 0.021])
    return tissue_check(protocol, Centre(model, theta, sigma_N=1.0), widths=Widths(gain_sd=0.005))


def recorded_twice(check: TissueCheck, scale: float, seed: int) -> bool:
    """True where two recordings, the second of a tissue stiffer by a factor, are called different."""
    rng = np.random.default_rng(seed)
    truths = [check.truth(rng) for _ in range(2)]
    # the tissue is the same, gains and contact of the second recording are its own
    stiffer = truths[0].theta * np.array([scale, scale, scale, scale, 1.0])
    tissues = []
    for truth in (truths[0], replace(truths[1], theta=stiffer)):
        fit = check.identified(check.trials(truth, rng), seed=int(rng.integers(2**31)))
        draws = check.drawn(fit)
        tissues.append(Compared("tissue", check.model, draws, (1.0, 500.0 / 60.0), total=False))
    common = common_range(tissues)
    return difference(*(draws_of_numbers(tissue, common) for tissue in tissues)).different


@pytest.mark.needs_jit
def test_a_tissue_that_was_recorded_twice_is_one_and_a_stiffer_one_is_not() -> None:
    check = check_of_one_tissue()
    assert sum(recorded_twice(check, 1.0, SEED_SAME + k) for k in range(FEW)) == 0
    assert sum(recorded_twice(check, 1.3, SEED_STIFFER + k) for k in range(FEW)) == FEW


@pytest.mark.slow
def test_rates_of_calling_tissues_different_over_400_pairs() -> None:
    check = check_of_one_tissue()
    false = sum(recorded_twice(check, 1.0, SEED_SAME + k) for k in range(PAIRS))
    right = sum(recorded_twice(check, 1.3, SEED_STIFFER + k) for k in range(PAIRS))
    most = float(beta.ppf(0.99, false + 1, PAIRS - false))
    least = float(beta.ppf(0.01, right, PAIRS - right + 1))
    sys.stdout.write(
        f"\none tissue called different: {false} of {PAIRS}, upper 99 % bound {most:.3f}\n"
        f"30 % stiffer called different: {right} of {PAIRS}, lower 99 % bound {least:.3f}\n"
    )
    assert most <= MOST_FALSE
    assert least >= LEAST_RIGHT
