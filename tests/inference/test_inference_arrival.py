"""Records that begin under a force: at a trigger while the tool moves, or behind a relaxed preload."""

import numpy as np
import pytest

from tissueid.inference.posterior import PosteriorOptions
from tissueid.inference.window import fitted_log
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.segment import SegmentOptions, segment
from tissueid.trial import Trial

STATIC, STIFFNESS, TAU_S = (2.0, 0.3, 0.05), 3.0, 0.5
SPEED_MM_S, DEPTH_MM, HOLD_S = 2.0, 4.0, 10.0
TRUTH = {
    "static_1_N_per_mm": STATIC[0],
    "static_2_N_per_mm2": STATIC[1],
    "static_3_N_per_mm3": STATIC[2],
    "stiffness_0_N_per_mm": STIFFNESS,
    "viscosity_N_s_per_mm": STIFFNESS * TAU_S,
    "relaxation_time_s": TAU_S,
}


def push(begins_mm: float, *, stood: bool = False, rate_Hz: float = 100.0, seed: int = 1) -> Trial:
    """Ramp and hold whose record begins ``begins_mm`` deep, in closed form; travel counts from there."""
    ramp_s = (DEPTH_MM - begins_mm) / SPEED_MM_S
    time = np.arange(0.0, ramp_s + HOLD_S, 1.0 / rate_Hz)
    depth = np.minimum(begins_mm + SPEED_MM_S * time, DEPTH_MM)
    moved_s = np.minimum(time, ramp_s) + (0.0 if stood else begins_mm / SPEED_MM_S)
    state = TAU_S * SPEED_MM_S * -np.expm1(-moved_s / TAU_S) * np.exp(-np.maximum(time - ramp_s, 0.0) / TAU_S)
    force = sum(a * depth**k for k, a in enumerate(STATIC, 1)) + STIFFNESS * state
    noise = 0.01 * np.random.default_rng(seed).standard_normal(time.size)
    return Trial("push", time, depth - begins_mm, force + noise)


def fitted(trial: Trial, *, draws: int = 0, **more):
    posterior = PosteriorOptions(sampler="emcee", draws=draws) if draws else PosteriorOptions(sampler="none")
    return identify([trial], options=IdentifyOptions(posterior=posterior, **more)).specimens[0]


@pytest.mark.parametrize("begins_mm", [0.1, 0.45])
def test_a_trigger_in_passing_gives_back_the_tissue(begins_mm):
    found = fitted(push(begins_mm))
    assert (found.model.branches, found.model.stiffness_degree) == (1, 0)
    for name, value in TRUTH.items():
        assert found.parameter(name).value == pytest.approx(value, rel=0.07), name
    (said,) = [flag for flag in found.flags if flag.code == "begins_moving"]
    assert said.values == {"recordings": 1, "decided": True}
    assert not {"form_dependent", "model_undecided"} & {flag.code for flag in found.flags}


def test_a_stated_contact_is_kept_where_the_tool_came_in_motion():
    trial, options = push(0.45), SegmentOptions(contact_displacement_mm=-0.45, contact_sd_mm=0.001)
    found = fitted(trial, segment=options)
    for name, value in TRUTH.items():
        assert found.parameter(name).value == pytest.approx(value, rel=0.05), name
    assert abs(found.trials[0].contact_offset_mm) < 0.003
    assert [flag.values["decided"] for flag in found.flags if flag.code == "begins_moving"] == [True]


def test_a_preload_that_has_relaxed_stays_one():
    found = fitted(push(0.45, stood=True, seed=3))
    for name in ("static_1_N_per_mm", "stiffness_0_N_per_mm", "relaxation_time_s"):
        assert found.parameter(name).value == pytest.approx(TRUTH[name], rel=0.07), name
    assert "begins_moving" not in {flag.code for flag in found.flags}


@pytest.mark.parametrize("stood", [False, True])
def test_intervals_hold_both_starts_where_the_samples_do_not_tell_them(stood):
    found = fitted(push(0.1, stood=stood, rate_Hz=20.0, seed=4), draws=400)
    (said,) = [flag for flag in found.flags if flag.code == "begins_moving"]
    assert not said.values["decided"]
    assert "intervals hold both" in said.message
    for name, value in TRUTH.items():
        low, high = found.parameter(name).uncertainty.ci95_total
        assert low <= value <= high, name


@pytest.mark.parametrize(
    ("begins_mm", "standing_s", "moving"), [(0.3, 0.0, True), (0.3, 0.05, False), (0.0, 0.0, False)]
)
def test_a_start_in_motion_has_a_force_and_no_standstill(begins_mm, standing_s, moving):
    trial = push(begins_mm)
    still = np.arange(0.0, standing_s, 0.01)
    first = float(trial.force_N[0])
    trial = Trial(
        "push",
        np.concatenate([still, trial.time_s + still.size * 0.01]),
        np.concatenate([np.zeros(still.size), trial.displacement_mm]),
        np.concatenate([np.full(still.size, first), trial.force_N]),
    )
    log = fitted_log(trial, segment(trial))
    assert (log.arrives_mm > 0.0) is moving
    if moving:
        assert begins_mm / 2 < log.arrives_mm < 3 * begins_mm
