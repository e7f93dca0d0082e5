"""The simulated force against closed forms, the differential equation and energy."""

from dataclasses import replace

import numpy as np
import pytest

from tissueid.synth import Branch, Hold, Log, Move, Recipe, Rupture, recipe, simulate
from tissueid.synth.simulate import Body, branch_extension, crosshead_path, low_pass, rupture_of, tissue_force

TAU = 0.021
K = 63.62
RAMP_HOLD = Log("hold", (Move(4.0, 250.0), Hold(1.0)))


def quiet(log: Log, **changes) -> Recipe:
    return Recipe("test", (log,), sigma_N=0.0, **changes)


def one(recipe: Recipe):
    return simulate(recipe, rng=np.random.default_rng(1))[0]


def test_ramps_and_holds_follow_their_closed_forms_and_branches_add_up():
    log = one(quiet(Log("ramp", (Move(8.0, 500.0),))))
    v, x = 500.0 / 60.0, log.displacement_mm
    expected = 20.0 * x - 1.2 * x**2 + 0.35 * x**3 + K * v * TAU * (1.0 - np.exp(-x / (v * TAU)))
    # rounding of sums of terms up to 300 N
    np.testing.assert_allclose(log.force_N, expected, atol=1e-11)
    log = one(quiet(RAMP_HOLD))
    v, t_ramp = 250.0 / 60.0, 4.0 / (250.0 / 60.0)
    held = log.time_s >= t_ramp
    static = 20.0 * 4.0 - 1.2 * 16.0 + 0.35 * 64.0
    start = K * v * TAU * (1.0 - np.exp(-t_ramp / TAU))
    expected = static + start * np.exp(-(log.time_s[held] - t_ramp) / TAU)
    np.testing.assert_allclose(log.force_N[held], expected, atol=1e-11)
    assert log.displacement_mm.max() == 4.0
    branches = (Branch((10.0, 2.0), 0.05), Branch((3.0,), 4.0))
    both = one(quiet(RAMP_HOLD, branches=branches))
    first = one(quiet(RAMP_HOLD, branches=branches[:1]))
    second = one(quiet(RAMP_HOLD, branches=branches[1:]))
    none = one(quiet(RAMP_HOLD, branches=()))
    np.testing.assert_allclose(both.force_N, first.force_N + second.force_N - none.force_N, atol=1e-11)


def test_a_corner_between_samples_is_exact():
    # 100 Hz does not hit the corner at 0.96 s / 7 mm; the denser log must agree at common times
    program = Log("odd", (Move(3.337, 133.0), Hold(0.5), Move(5.0, 70.0)))
    coarse = one(quiet(program, rate_Hz=100.0))
    fine = one(quiet(program, rate_Hz=1000.0))
    np.testing.assert_allclose(coarse.force_N, fine.force_N[::10][: coarse.force_N.size], atol=1e-9)


def test_extension_solves_its_differential_equation_on_a_rounded_path():
    travel = crosshead_path(RAMP_HOLD, rounding_s=0.03)
    time_s = np.linspace(0.9, 1.1, 200_001)
    s = branch_extension(travel, TAU, time_s)
    x = travel.at(time_s)
    # midpoint form of tau s' + s = tau x'; h^2 error of the midpoint rule, relative to v tau = 0.0875 mm
    residual = TAU * np.diff(s) + 0.5 * (s[1:] + s[:-1]) * np.diff(time_s) - TAU * np.diff(x)
    assert np.abs(residual).max() < 1e-9 * np.abs(np.diff(time_s)).max() / 1e-6


@pytest.mark.parametrize("rounding", [0.005, 0.03, 0.2])
def test_rounded_stop_slows_down_smoothly_and_ends_at_the_nominal_travel(rounding):
    travel = crosshead_path(RAMP_HOLD, rounding_s=rounding)
    corner, v = 0.96, 250.0 / 60.0
    before, after = corner - rounding / 2.0, corner + rounding / 2.0
    assert travel.at(np.array([before]))[0] == pytest.approx(v * before, abs=1e-12)
    assert travel.at(np.array([after, after + 0.5])) == pytest.approx([4.0, 4.0], abs=1e-12)
    speed = np.diff(travel.value_mm) / np.diff(travel.time_s)
    assert speed.min() >= -1e-9
    assert speed.max() <= v * (1.0 + 1e-9)
    # a raised cosine passes half speed at the corner
    assert np.interp(corner, 0.5 * (travel.time_s[1:] + travel.time_s[:-1]), speed) == pytest.approx(
        v / 2.0, rel=1e-3
    )


def test_an_offset_starts_in_air_or_preloaded_and_shifts_the_curve():
    offset = 0.137
    late = one(quiet(RAMP_HOLD, contact_offset_mm=offset))
    air = late.displacement_mm < offset
    assert air.sum() > 10
    assert not late.force_N[air].any()
    v = 250.0 / 60.0
    ramp = ~air & (late.time_s < 0.96)
    x = late.displacement_mm[ramp] - offset
    expected = 20.0 * x - 1.2 * x**2 + 0.35 * x**3 + K * v * TAU * (1.0 - np.exp(-x / (v * TAU)))
    np.testing.assert_allclose(late.force_N[ramp], expected, atol=1e-10)
    log = one(quiet(RAMP_HOLD, contact_offset_mm=-0.5))
    assert log.displacement_mm[0] == 0.0
    assert log.force_N[0] == pytest.approx(20.0 * 0.5 - 1.2 * 0.25 + 0.35 * 0.125, abs=1e-12)


def test_the_force_filter_is_a_first_order_low_pass():
    time_s = np.linspace(0.0, 1.0, 5001)
    filtered = low_pass(time_s, 3.0 * time_s, 0.01)
    expected = 3.0 * (time_s - 0.01 * (1.0 - np.exp(-time_s / 0.01)))
    np.testing.assert_allclose(filtered, expected, atol=1e-12)
    plain = one(quiet(RAMP_HOLD, rate_Hz=20_000.0))
    filtered = one(quiet(RAMP_HOLD, rate_Hz=200.0, force_filter_s=0.01))
    dense = low_pass(plain.time_s, plain.force_N, 0.01)
    # the oversampled grid at 200 Hz is 0.3 ms: its chords are off by h^2 F''/8, F'' <= K v/tau
    np.testing.assert_allclose(filtered.force_N, dense[::100][: filtered.force_N.size], atol=2e-4)


def test_force_never_pulls_and_recovers_after_contact_loss():
    program = Log("cycle", (Move(4.0, 500.0), Move(0.0, 500.0), Hold(0.02), Move(4.0, 500.0)))
    log = one(quiet(program, branches=(Branch((60.0,), 0.2),)))
    assert log.force_N.min() == 0.0
    # while free, linear surface: y decays with tau (K + a1)/a1, so contact resumes above 0
    resumed = np.flatnonzero((log.force_N[1:] > 0.0) & (log.force_N[:-1] == 0.0))[-1]
    assert log.displacement_mm[resumed] > 0.05


@pytest.mark.parametrize("wait_s", [0.1, 0.4])
def test_free_surface_of_a_linear_tissue_recovers_with_its_closed_form_time_constant(wait_s):
    a1, k, tau, depth, held = 20.0, 60.0, 0.1, 2.0, 2.0
    program = (Move(depth, 600.0), Hold(held), Move(-0.02, 60_000.0), Hold(wait_s), Move(0.3, 6.0))
    travel = crosshead_path(Log("free", program))
    time_s = np.arange(0.0, travel.time_s[-1], 1e-3)
    force = tissue_force(travel, time_s, Body((a1,), (Branch((k,), tau),)))
    start = np.flatnonzero((time_s > travel.time_s[-2]) & (force > 0.0))[0]
    # relaxed at the depth d, a sudden retreat frees the surface at a1 y = k (d - y); then tau (k + a1)/a1
    freed = depth * k / (k + a1)
    expected = freed * np.exp(-(time_s[start] - travel.time_s[2]) / (tau * (k + a1) / a1))
    # 1 ms of sampling is 1e-4 mm at contact; the retreat takes 2 ms = 0.5 % of the time constant
    assert travel.at(time_s[start : start + 1])[0] == pytest.approx(expected, rel=0.01, abs=1e-4)


def test_energy_put_into_the_tissue_is_never_returned_in_full():
    rng = np.random.default_rng(3)
    moves = tuple(
        Move(float(d), float(v))
        for d, v in zip(rng.uniform(0.5, 6, 12), rng.uniform(50, 900, 12), strict=True)
    )
    log = one(quiet(Log("random", (*moves, Move(0.0, 300.0))), rate_Hz=2000.0))
    work = np.cumsum(0.5 * (log.force_N[1:] + log.force_N[:-1]) * np.diff(log.displacement_mm))
    assert work.min() > -1e-6
    assert work[-1] > 0.1


STATIC = (6.0, 0.0, 0.4)
BRANCH = Branch((60.0, 5.0), 0.02)
SPEED_MM_S = 10.0


def broken(criterion: str, threshold: float):
    path = crosshead_path(Log("ramp", (Move(9.0, 60.0 * SPEED_MM_S),)))
    return rupture_of(Rupture(criterion, threshold), path, Body(STATIC, (BRANCH,), offset_mm=1.0))


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
    assert found["ruptured"]
    # a grid of 20,001 times
    assert found["rupture_depth_mm"] == pytest.approx(4.0, abs=1e-5)
    assert found["rupture_time_s"] == pytest.approx((1.0 + 4.0) / SPEED_MM_S, abs=1e-6)
    assert found["rupture_force_N"] == pytest.approx(expected["force"], rel=1e-5)
    assert found["rupture_work_N_mm"] == pytest.approx(expected["work"], rel=1e-5)


def test_a_threshold_that_is_not_reached_leaves_the_tissue_whole():
    found = broken("depth", 8.5)
    assert not found["ruptured"]
    assert found["rupture_depth_mm"] == pytest.approx(8.0)


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
