"""Aborts, load limits and load control: told where something in the recording tells them."""

from __future__ import annotations

import numpy as np
import pytest
from told import codes, events, flag_of, kinds

from tissueid.segment import segment
from tissueid.trial import Protocol, Trial


def drawn(knots_s: list[float], depths_mm: list[float], **protocol: float) -> Trial:
    """A polyline into an elastic tissue of 10 N/mm, 100 Hz, noise 0.02 N."""
    time = np.arange(0.0, knots_s[-1], 0.01)
    depth = np.interp(time, knots_s, depths_mm)
    noise = 0.02 * np.random.default_rng(4).standard_normal(time.size)
    return Trial("drawn", time, depth, 10.0 * depth + noise, Protocol(**protocol))


def test_a_ramp_short_of_its_stated_depth_was_aborted() -> None:
    found = segment(drawn([0, 5], [0, 5], depth_mm=8.0))
    (event,) = events(found, "abort")
    assert event.values["reached_mm"] == pytest.approx(5.0, abs=0.02)
    assert event.values["stated_mm"] == 8.0
    assert event.time_s == pytest.approx(5.0, abs=0.02)
    assert "aborted_ramp" in codes(found)


@pytest.mark.parametrize("after", [[], [8.0]])
def test_a_ramp_without_its_stated_hold_was_aborted(after: list[float]) -> None:
    found = segment(drawn([0, 5, *after], [0, 5, *([0] if after else [])], hold_s=30.0))
    (event,) = events(found, "abort")
    assert event.values["stated_hold_s"] == 30.0
    assert event.time_s == pytest.approx(5.0, abs=0.03)


def test_a_last_step_that_ends_early_was_aborted() -> None:
    found = segment(drawn([0, 2, 6, 8, 12, 12.8], [0, 2, 2, 4, 4, 4.8]))
    (event,) = events(found, "abort")
    assert event.values["reached_mm"] == pytest.approx(4.8, abs=0.05)
    assert event.values["earlier_mm"] == pytest.approx(2.0, abs=0.02)


def test_a_last_loop_that_ends_early_was_aborted() -> None:
    found = segment(drawn([0, 3, 6, 9, 12, 13.5], [0, 3, 0, 3, 0, 1.5]))
    assert len(events(found, "abort")) == 1


@pytest.mark.parametrize(
    ("knots", "depths", "protocol"),
    [
        ([0, 8], [0, 8], {"depth_mm": 8.0}),
        ([0, 5], [0, 5], {}),
        ([0, 4, 14], [0, 4, 4], {"depth_mm": 4.0, "hold_s": 10.0}),
        ([0, 2, 6, 8, 12, 14], [0, 2, 2, 4, 4, 6], {}),
        ([0, 3, 6, 9, 12], [0, 3, 0, 3, 0], {}),
    ],
)
def test_a_test_that_reached_its_end_was_not_aborted(knots, depths, protocol) -> None:
    found = segment(drawn(knots, depths, **protocol))
    assert events(found, "abort") == []
    assert "aborted_ramp" not in codes(found)


def creeping(creep_mm: float) -> Trial:
    """40 N reached in 4 s and held for 30 s while the tool sinks in."""
    time = np.arange(0.0, 34.0, 0.01)
    since = np.maximum(time - 4.0, 0.0)
    depth = np.minimum(time, 4.0) + creep_mm * (1.0 - np.exp(-since / 8.0))
    noise = 0.05 * np.random.default_rng(5).standard_normal(time.size)
    return Trial("creep", time, depth, 10.0 * np.minimum(time, 4.0) + noise)


@pytest.mark.parametrize("creep_mm", [0.15, 0.5])
def test_creep_under_a_held_load_is_a_phase_and_no_hold(creep_mm: float) -> None:
    found = segment(creeping(creep_mm))
    assert kinds(found) == ["ramp", "creep"]
    assert found.phases[1].start_s == pytest.approx(4.0, abs=0.03)
    (event,) = events(found, "load_limit")
    assert event.values["force_N"] == pytest.approx(40.0, abs=0.1)
    # 30 s are 3.75 time constants
    assert event.values["creep_mm"] == pytest.approx(creep_mm * (1.0 - np.exp(-3.75)), abs=0.02)
    assert {"load_limit_stop", "no_hold"} <= codes(found)


@pytest.mark.parametrize("steps", [1, 3])
def test_creep_that_begins_fast_is_told_from_the_ramp_at_every_load(steps: int) -> None:
    time, depth, force = np.arange(0.0, 31.0 * steps, 0.02), 0.0, 0.0
    for start in 31.0 * np.arange(steps):
        ramp = np.clip(time - start, 0.0, 1.0)
        depth = depth + ramp - 0.7 * np.expm1(-np.maximum(time - start - 1.0, 0.0) / 2.0)
        force = force + 2.0 * ramp
    noise = 0.01 * np.random.default_rng(8).standard_normal(time.size)
    found = segment(Trial("creep", time, depth, force + noise))
    assert kinds(found) == ["ramp", "creep"] * steps
    assert [one.start_s for one in found.phases if one.kind == "creep"] == pytest.approx(
        31.0 * np.arange(steps) + 1.0, abs=0.05
    )
    assert [one.speed_mm_s for one in found.phases if one.kind == "ramp"] == pytest.approx(
        [1.0] * steps, rel=0.02
    )


def test_an_elastic_tissue_at_a_held_depth_is_a_hold() -> None:
    found = segment(drawn([0, 4, 30], [0, 4, 4]))
    assert kinds(found) == ["ramp", "hold"]
    assert events(found, "load_limit") == []


def softening_loops(depth_mm: list[float], peak_N: list[float]) -> Trial:
    """Loops to the given depths at 1 mm/s, each elastic up to its own peak force."""
    knots, depths = [0.0], [0.0]
    for depth in depth_mm:
        knots += [knots[-1] + depth, knots[-1] + 2.0 * depth]
        depths += [depth, 0.0]
    time = np.arange(0.0, knots[-1], 0.01)
    depth = np.interp(time, knots, depths)
    loop = np.minimum(np.searchsorted(knots[2::2], time, side="right"), len(depth_mm) - 1)
    force = depth * (np.array(peak_N) / np.array(depth_mm))[loop]
    return Trial("loops", time, depth, force + 0.02 * np.random.default_rng(6).standard_normal(time.size))


def test_loops_that_turn_at_one_force_show_a_load_limit() -> None:
    found = segment(softening_loops([3.0, 3.3, 3.5, 3.6], [30.0] * 4))
    (event,) = events(found, "load_limit")
    assert event.values["force_N"] == pytest.approx(30.0, abs=0.1)
    assert event.values["turns"] == 4
    assert "load_limit_stop" in codes(found)


@pytest.mark.parametrize(
    ("depths", "peaks"),
    [([3.0] * 4, [30.0, 28.0, 27.5, 27.2]), ([3.0] * 4, [30.0] * 4), ([2.0, 3.0, 4.0], [20.0, 30.0, 40.0])],
)
def test_loops_that_turn_at_a_depth_show_none(depths: list[float], peaks: list[float]) -> None:
    assert events(segment(softening_loops(depths, peaks)), "load_limit") == []


@pytest.mark.parametrize(("limit_N", "stops"), [(40.0, 1), (60.0, 0), (25.0, 0)])
def test_a_ramp_that_ends_at_the_stated_force_was_stopped_by_it(limit_N: float, stops: int) -> None:
    # 4 mm at 10 N/mm
    found = segment(drawn([0, 4, 8], [0, 4, 0], load_limit_N=limit_N))
    limits = events(found, "load_limit")
    assert len(limits) == stops
    for event in limits:
        assert event.values["limit_N"] == limit_N
        assert event.values["force_N"] == pytest.approx(40.0, abs=0.2)
        assert event.time_s == pytest.approx(4.0, abs=0.03)


def retracted(pull_N: float, end_N: float = 0.0) -> Trial:
    """In, hold, out of the tissue: it pulls as the tool leaves; the cell reads ``end_N`` at last."""
    time = np.arange(0.0, 8.0, 0.01)
    depth = np.interp(time, [0.0, 0.5, 2.0, 4.0, 6.0, 8.0], [-1.0, 0.0, 3.0, 3.0, -1.0, -1.0])
    force = 10.0 * np.maximum(depth, 0.0)
    leaving = (time > 4.0) & (depth < 0.5) & (depth > -0.5)
    force[leaving] -= pull_N
    force[time > 4.0] += end_N
    return Trial("drawn", time, depth, force + 0.02 * np.random.default_rng(4).standard_normal(time.size))


def test_tissue_that_pulls_as_the_tool_leaves_adheres() -> None:
    flag = flag_of(segment(retracted(2.0)), "adhesion")
    # what the tissue itself pushes with is not part of it
    assert flag.values["pull_N"] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize(("pull_N", "end_N"), [(0.0, 0.0), (0.1, 0.0), (0.0, -1.5)])
def test_a_clean_retract_or_a_zero_that_drifted_is_no_adhesion(pull_N: float, end_N: float) -> None:
    assert "adhesion" not in codes(segment(retracted(pull_N, end_N)))


def load_controlled(creep_mm: float, tau_s: float) -> Trial:
    """Load at a constant rate to 10 N in 60 s, held for 20 s, and off again, under a spherical tip."""
    time = np.arange(0.0, 140.0, 0.1)
    load = np.interp(time, [0.0, 60.0, 80.0, 140.0], [0.0, 10.0, 10.0, 0.0])
    crept = creep_mm * (1.0 - np.exp(-np.clip(time - 60.0, 0.0, None) / tau_s))
    rng = np.random.default_rng(6)
    depth = load ** (2.0 / 3.0) + crept * (load > 0.0)
    return Trial(
        "load", time, depth + 1e-4 * rng.normal(size=time.size), load + 1e-3 * rng.normal(size=time.size)
    )


@pytest.mark.parametrize(("creep_mm", "tau_s"), [(0.2, 15.0), (0.3, 10.0)])
def test_a_held_load_is_told_though_the_tool_slows_down_before_it(creep_mm: float, tau_s: float) -> None:
    found = segment(load_controlled(creep_mm, tau_s))
    assert kinds(found)[:3] == ["ramp", "creep", "retract"]
    assert found.phases[1].start_s == pytest.approx(60.0, abs=2.5)


@pytest.mark.parametrize("shape", ["even", "sine"])
def test_a_crosshead_that_slows_down_holds_no_load(shape: str) -> None:
    time = np.arange(0.0, 20.0, 0.01)
    u = np.clip((time - 1.0) / 3.0, 0.0, 1.0)
    even = u - np.sin(2.0 * np.pi * u) / (2.0 * np.pi)
    depth = 5.0 * (even if shape == "even" else np.sin(0.5 * np.pi * u))
    force = depth + np.gradient(depth, time) * 0.5
    force *= 0.7 + 0.3 * np.exp(-np.clip(time - 4.0, 0.0, None))
    noise = 0.01 * np.random.default_rng(7).normal(size=time.size)
    assert "creep" not in kinds(segment(Trial(shape, time, depth, force + noise)))
