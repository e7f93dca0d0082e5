"""Tissue that breaks, against closed forms and its own recipe."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tissueid.synth import Branch, Log, Move, Rupture, recipe, simulate
from tissueid.synth.response import crosshead_path, rupture_of

STATIC = (6.0, 0.0, 0.4)
BRANCH = Branch((60.0, 5.0), 0.02)
SPEED_MM_S = 10.0


def broken(criterion: str, threshold: float):
    path = crosshead_path(Log("ramp", (Move(9.0, 60.0 * SPEED_MM_S),)))
    rupture = Rupture(criterion, threshold)
    return rupture_of(rupture, threshold, path, offset_mm=1.0, static=STATIC, branches=(BRANCH,))


def measures(x: float) -> dict[str, float]:
    """By 200,000 small steps of the ramp."""
    depth = np.linspace(0.0, x, 200_001)
    length = SPEED_MM_S * BRANCH.tau_s
    state = -length * np.expm1(-depth / length)
    static = 6.0 * depth + 0.4 * depth**3
    stiffness = 60.0 + 5.0 * depth
    force = static + stiffness * state
    # work less what the damper turned into heat, (s/tau) int K
    heat = state / length * (60.0 * state + 2.5 * (depth**2 - (depth - state) ** 2))
    return {
        "work": float(np.trapezoid(force, depth)),
        "weighted-force": float(static[-1] + 1.5 * stiffness[-1] * state[-1]),
        "stored-energy": float(np.trapezoid(force - heat, depth)),
        "depth": x,
        "force": float(force[-1]),
    }


@pytest.mark.parametrize("criterion", ["work", "weighted-force", "stored-energy", "depth"])
def test_it_breaks_where_the_measure_of_a_ramp_is_the_threshold(criterion):
    expected = measures(4.0)
    found = broken(criterion, expected[criterion])
    assert found.ruptured
    # a grid of 20,001 times
    assert found.depth_mm == pytest.approx(4.0, abs=1e-5)
    assert found.time_s == pytest.approx((1.0 + 4.0) / SPEED_MM_S, abs=1e-6)
    assert found.force_N == pytest.approx(expected["force"], rel=1e-5)
    assert found.work_N_mm == pytest.approx(expected["work"], rel=1e-5)


def test_a_threshold_that_is_not_reached_leaves_the_tissue_whole():
    found = broken("depth", 8.5)
    assert not found.ruptured
    assert found.depth_mm == pytest.approx(8.0)


def test_the_force_falls_to_its_share_at_the_rupture_and_not_before():
    plan = replace(recipe("rupture-18"), sigma_N=0.0, specimens=1)
    whole = simulate(
        replace(plan, rupture=replace(plan.rupture, threshold=1e9)), rng=np.random.default_rng(3)
    )
    torn = simulate(plan, rng=np.random.default_rng(3))
    for before, after in zip(whole, torn, strict=True):
        late = after.time_s > after.truth["rupture_time_s"]
        assert late.any()
        assert (after.force_N[~late] == before.force_N[~late]).all()
        assert after.force_N[late] == pytest.approx(0.2 * before.force_N[late], rel=1e-12)
        assert (before.truth["ruptured"], after.truth["ruptured"]) == (0.0, 1.0)


def test_a_recipe_without_rupture_draws_the_same_numbers_as_ever():
    plan = replace(recipe("paper-a-hold-100Hz"), cv_both=0.1)
    (one,) = simulate(plan, rng=np.random.default_rng(5))
    rng = np.random.default_rng(5)
    gain = np.exp(np.sqrt(np.log1p(0.01)) * rng.standard_normal())
    assert one.truth["gain"] == pytest.approx(gain, rel=1e-12)
    noise = one.force_N - one.force_clean_N
    assert noise == pytest.approx(rng.standard_normal(noise.size), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"criterion": "torque", "threshold": 1.0}, "must be one of work"),
        ({"criterion": "work", "threshold": 0.0}, "threshold must be > 0"),
        ({"criterion": "work", "threshold": 1.0, "residual": 1.5}, "within 0 to 1"),
    ],
)
def test_a_rupture_that_makes_no_sense_is_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        Rupture(**wrong)
