"""Cycles and their verdict; ruptures, aborts, load limits and load control, where something tells them."""

import csv

import numpy as np
import pytest
from told import codes, divided, events, flag_of, kinds, normal

from tissueid.segment import SegmentOptions, segment, segmentation
from tissueid.trial import Event, Protocol, Segmentation, Trial


def drawn(knots_s: list[float], depths_mm: list[float], **protocol: float) -> Trial:
    """A polyline into an elastic tissue of 10 N/mm, 100 Hz, noise 0.02 N."""
    time = np.arange(0.0, knots_s[-1], 0.01)
    depth = np.interp(time, knots_s, depths_mm)
    force = 10.0 * np.maximum(depth, 0.0) + normal(0.02, time, 4)
    return Trial("drawn", time, depth, force, Protocol(**protocol))


@pytest.mark.parametrize(
    ("knots", "depths", "protocol", "time_s", "values"),
    [
        ([0, 5], [0, 5], {"depth_mm": 8.0}, 5.0, {"reached_mm": 5.0, "stated_mm": 8.0}),
        ([0, 5], [0, 5], {"hold_s": 30.0}, 5.0, {"stated_hold_s": 30.0}),
        ([0, 5, 8], [0, 5, 0], {"hold_s": 30.0}, 5.0, {"stated_hold_s": 30.0}),
        ([0, 2, 6, 8, 12, 12.8], [0, 2, 2, 4, 4, 4.8], {}, 12.8, {"reached_mm": 4.8, "earlier_mm": 2.0}),
        ([0, 3, 6, 9, 12, 13.5], [0, 3, 0, 3, 0, 1.5], {}, 13.5, {}),
        # pushes from 3 mm above the tissue, the last of 3 mm into it
        (
            [0, 8, 12, 16, 18, 26, 30, 34, 36, 42],
            [-3, 5, 5, -3, -3, 5, 5, -3, -3, 3],
            {},
            42.0,
            {"travel_mm": 3.0, "earlier_mm": 5.0},
        ),
    ],
    ids=[
        "short of its depth",
        "no hold",
        "back without a hold",
        "a short step",
        "a short loop",
        "a short push",
    ],
)
def test_a_test_that_ended_early_was_aborted(knots, depths, protocol, time_s, values) -> None:
    found = segment(drawn(knots, depths, **protocol))
    (event,) = events(found, "abort")
    assert event.time_s == pytest.approx(time_s, abs=0.03)
    assert {key: event.values[key] for key in values} == pytest.approx(values, abs=0.05)
    said = flag_of(found, "aborted_ramp").message
    assert "earlier_mm" not in values or f"after {event.values['travel_mm']:.4g} mm" in said


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


@pytest.mark.parametrize("creep_mm", [0.15, 0.5])
def test_creep_under_a_held_load_is_a_phase_and_no_hold(creep_mm: float) -> None:
    """40 N reached in 4 s and held for 30 s while the tool sinks in."""
    time = np.arange(0.0, 34.0, 0.01)
    depth = np.minimum(time, 4.0) + creep_mm * (1.0 - np.exp(-np.maximum(time - 4.0, 0.0) / 8.0))
    found = divided(time, depth, 10.0 * np.minimum(time, 4.0) + normal(0.05, time, 5))
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
    found = divided(time, depth, force + normal(0.01, time, 8))
    assert kinds(found) == ["ramp", "creep"] * steps
    starts = [one.start_s for one in found.of_kind("creep")]
    assert starts == pytest.approx(31.0 * np.arange(steps) + 1.0, abs=0.05)
    assert [one.speed_mm_s for one in found.of_kind("ramp")] == pytest.approx([1.0] * steps, rel=0.02)


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
    return Trial("loops", time, depth, force + normal(0.02, time, 6))


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
    limits = events(segment(drawn([0, 4, 8], [0, 4, 0], load_limit_N=limit_N)), "load_limit")
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
    return Trial("drawn", time, depth, force + normal(0.02, time, 4))


def test_tissue_that_pulls_as_the_tool_leaves_adheres() -> None:
    flag = flag_of(segment(retracted(2.0)), "adhesion")
    # what the tissue itself pushes with is not part of it
    assert flag.values["pull_N"] == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize(("pull_N", "end_N"), [(0.0, 0.0), (0.1, 0.0), (0.0, -1.5)])
def test_a_clean_retract_or_a_zero_that_drifted_is_no_adhesion(pull_N: float, end_N: float) -> None:
    assert "adhesion" not in codes(segment(retracted(pull_N, end_N)))


@pytest.mark.parametrize(("creep_mm", "tau_s"), [(0.2, 15.0), (0.3, 10.0)])
def test_a_held_load_is_told_though_the_tool_slows_down_before_it(creep_mm: float, tau_s: float) -> None:
    """Load at a constant rate to 10 N in 60 s, held for 20 s, and off again, under a spherical tip."""
    time, rng = np.arange(0.0, 140.0, 0.1), np.random.default_rng(6)
    load = np.interp(time, [0.0, 60.0, 80.0, 140.0], [0.0, 10.0, 10.0, 0.0])
    crept = creep_mm * (1.0 - np.exp(-np.clip(time - 60.0, 0.0, None) / tau_s))
    depth = load ** (2.0 / 3.0) + crept * (load > 0.0) + 1e-4 * rng.normal(size=time.size)
    found = divided(time, depth, load + 1e-3 * rng.normal(size=time.size))
    assert kinds(found)[:3] == ["ramp", "creep", "retract"]
    assert found.phases[1].start_s == pytest.approx(60.0, abs=2.5)


def creeping_all_along(creep: float, rate_Hz: float, *, held: str) -> Trial:
    """A tip that sinks in by a share of its depth with 8 s, in the ramp of 60 s too."""
    time = np.arange(0.0, 100.0, 1.0 / rate_Hz)
    load = np.interp(time, [0.0, 60.0, 90.0, 100.0], [0.0, 1.0, 1.0, 0.8])
    late = np.zeros(time.size)
    for k in range(1, time.size):
        late[k] = load[k] + (late[k - 1] - load[k]) * np.exp(-1.0 / rate_Hz / 8.0)
    depth = 2.0 * (load + creep * late) ** (2.0 / 3.0)
    force = load
    if held == "path":  # of an elastic tissue, whose scale drifts on
        depth = 2.0 * load ** (2.0 / 3.0) + 0.01 * np.clip((time - 60.0) / 30.0, 0.0, 1.0)
        force = 0.3 * depth**1.5
    rng = np.random.default_rng(8)
    depth, force = depth + 1e-4 * rng.normal(size=time.size), force + 3e-4 * rng.normal(size=time.size)
    return Trial(held, time, depth, force)


@pytest.mark.parametrize("rate_Hz", [1.0, 2.0, 20.0])
@pytest.mark.parametrize("creep", [0.05, 0.15, 0.3])
def test_a_held_load_is_told_behind_a_ramp_that_creeps(creep: float, rate_Hz: float) -> None:
    found = segment(creeping_all_along(creep, rate_Hz, held="load"))
    assert kinds(found)[:3] == ["ramp", "creep", "retract"]
    assert found.phases[1].start_s == pytest.approx(60.0, abs=4.0)


@pytest.mark.parametrize("rate_Hz", [1.0, 20.0])
def test_a_path_that_drifts_in_a_hold_holds_no_load(rate_Hz: float) -> None:
    assert "creep" not in kinds(segment(creeping_all_along(0.0, rate_Hz, held="path")))


@pytest.mark.parametrize("shape", ["even", "sine"])
def test_a_crosshead_that_slows_down_holds_no_load(shape: str) -> None:
    time = np.arange(0.0, 20.0, 0.01)
    u = np.clip((time - 1.0) / 3.0, 0.0, 1.0)
    even = u - np.sin(2.0 * np.pi * u) / (2.0 * np.pi)
    depth = 5.0 * (even if shape == "even" else np.sin(0.5 * np.pi * u))
    force = depth + np.gradient(depth, time) * 0.5
    force *= 0.7 + 0.3 * np.exp(-np.clip(time - 4.0, 0.0, None))
    assert "creep" not in kinds(divided(time, depth, force + normal(0.01, time, 7)))


SPEED = 2.0


def loops(peaks_N: list[float], *, then_hold: bool = False, eta: float = 2.0, sigma_N: float = 0.01) -> Trial:
    """Loops to 3 mm and back at 2 mm/s; a dashpot makes each loop lose 2 eta v d, softened with its peak."""
    count = len(peaks_N)
    knots = np.arange(2 * count + 1) * 3.0 / SPEED
    depths = np.where(np.arange(2 * count + 1) % 2, 3.0, 0.0)
    if then_hold:
        knots, depths = np.append(knots, knots[-1] + np.array([2.0, 8.0])), np.append(depths, [4.0, 4.0])
    time = np.arange(0.0, knots[-1], 0.01)
    depth = np.interp(time, knots, depths)
    loop = np.minimum((time / (6.0 / SPEED)).astype(int), count - 1)
    scale = np.array(peaks_N)[loop] / (30.0 + eta * SPEED)
    force = scale * (10.0 * depth + eta * np.gradient(depth, time))
    return Trial("loops", time, depth, force + normal(sigma_N, time, 7))


def verdict(found: Segmentation):
    (flag,) = (f for f in found.flags if f.code in ("preconditioned", "not_preconditioned"))
    return flag


def test_a_cycle_has_its_turn_and_its_loading_speed() -> None:
    found = segment(loops([34.0] * 3))
    assert kinds(found) == ["cycle"] * 3
    for k, phase in enumerate(found.phases):
        assert phase.start_s + (phase.peak - phase.start) * 0.01 == pytest.approx(1.5 + 3.0 * k, abs=0.03)
        assert phase.speed_mm_s == pytest.approx(SPEED, rel=0.02)


def test_loops_that_repeat_are_preconditioned() -> None:
    found = segment(loops([34.0, 32.0, 31.0, 30.9, 30.8], then_hold=True))
    assert (kinds(found), found.test) == (["cycle"] * 5 + ["ramp", "hold"], 5)
    flag = verdict(found)
    assert flag.code == "preconditioned"
    assert flag.values["before_test"] is True
    # 31.0 -> 30.9 -> 30.8 N: at most 0.33 %, told within the noise of 0.01 N
    assert flag.values["peak_force_change"] == pytest.approx(0.1 / 30.9, abs=1e-3)
    assert flag.values["work_change"] < 0.02


def test_loops_that_still_change_are_not() -> None:
    found = segment(loops([40.0, 36.0, 34.0]))
    assert found.test == 0
    flag = verdict(found)
    assert flag.code == "not_preconditioned"
    assert flag.values["before_test"] is False
    # 40 -> 36 N is the larger of the two changes; work goes with the peak
    assert flag.values["peak_force_change"] == pytest.approx(0.1, abs=0.01)
    assert flag.values["work_change"] == pytest.approx(0.1, abs=0.02)


def test_work_alone_may_still_change() -> None:
    trial = loops([34.0, 34.0, 34.0])
    depth, time = trial.displacement_mm, trial.time_s
    # the same peaks, but the last loop loses half as much
    force = np.array(trial.force_N)
    last = time >= 6.0
    force[last] = (34.0 / 32.0) * (10.0 * depth[last] + np.gradient(depth, time)[last])
    flag = verdict(divided(time, depth, force))
    assert flag.code == "not_preconditioned"
    assert flag.values["work_change"] == pytest.approx(0.5, abs=0.05)


def test_coarse_sampling_of_the_turn_is_no_change() -> None:
    trial = loops([34.0] * 4)
    # every 13th sample: the turns are missed by up to 0.13 mm, 1.3 N of 34
    coarse = divided(trial.time_s[::13], trial.displacement_mm[::13], trial.force_N[::13])
    assert verdict(coarse).values["peak_force_change"] < 0.02


def test_one_loop_is_no_cyclic_test() -> None:
    found = segment(loops([34.0]))
    assert kinds(found) == ["ramp", "retract"]
    assert not codes(found) & {"cyclic", "preconditioned", "not_preconditioned"}


def ruptures(found: Segmentation) -> list[Event]:
    return events(found, "rupture")


def ramp(force_of_depth, *, hold_s: float = 0.0, sigma_N: float = 0.05, seed: int = 2) -> Trial:
    """1 mm in air, then into the tissue at 1 mm/s to 6 mm."""
    time = np.arange(0.0, 7.0 + hold_s, 0.01)
    depth = np.minimum(time, 7.0) - 1.0
    force = force_of_depth(np.maximum(depth, 0.0)) + normal(sigma_N, time, seed)
    return Trial("ramp", time, depth, force)


def relaxing(time: np.ndarray, depth: np.ndarray, tau_s: float, gain: float) -> Trial:
    """A spring of 2 N/mm beside a branch that relaxes."""
    decay, state, branch = np.exp(-(time[1] - time[0]) / tau_s), 0.0, []
    for v in np.gradient(depth, time).tolist():
        state = decay * state + (1.0 - decay) * v
        branch.append(state)
    return Trial("relaxing", time, depth, 2.0 * depth + gain * np.array(branch))


def broken(x: np.ndarray) -> np.ndarray:
    """Force of 10 N/mm of which 60 % break away at 4 mm."""
    return np.where(x <= 4.0, 10.0 * x, 4.0 * x)


def test_a_rupture_has_its_force_drop_depth_and_work() -> None:
    found = segment(ramp(broken))
    (event,) = ruptures(found)
    assert event.time_s == pytest.approx(5.0, abs=0.01)
    values = event.values
    # noise 0.05 N, and the running median looks two samples of 0.1 N back
    assert values["force_before_N"] == pytest.approx(40.0, abs=0.3)
    assert values["drop_N"] == pytest.approx(24.0, abs=0.5)
    assert values["drop_fraction"] == pytest.approx(0.6, abs=0.01)
    assert values["depth_mm"] == pytest.approx(4.0, abs=0.03)
    # half of 4 mm times 40 N
    assert values["work_N_mm"] == pytest.approx(80.0, rel=0.01)
    said = flag_of(found, "rupture")
    assert (said.values["time_s"], said.values["count"]) == (event.time_s, 1)


def test_every_layer_that_breaks_is_found() -> None:
    trial = ramp(lambda x: 15.0 * x * np.where(x > 2.0, 0.5, 1.0) * np.where(x > 4.0, 0.4, 1.0))
    broke = ruptures(segment(trial))
    assert [event.values["depth_mm"] for event in broke] == pytest.approx([2.0, 4.0], abs=0.03)
    assert [event.values["drop_fraction"] for event in broke] == pytest.approx([0.5, 0.6], abs=0.03)


@pytest.mark.parametrize("samples", [1, 3, 10])
def test_a_fall_that_takes_a_few_samples_is_dated_at_its_onset(samples: int) -> None:
    trial = ramp(lambda x: 10.0 * x * (1.0 - 0.7 * np.clip((x - 3.0) * 100.0 / samples, 0.0, 1.0)))
    (event,) = ruptures(segment(trial))
    assert event.time_s == pytest.approx(4.0, abs=0.03)


def test_a_curve_pulled_to_failure_ruptures_at_its_peak() -> None:
    # force sinks to nothing over a millimetre, as in necking
    trial = ramp(lambda x: np.where(x < 4.5, 20.0 * x, np.maximum(90.0 - 85.0 * (x - 4.5), 3.0)))
    (event,) = ruptures(segment(trial))
    assert event.values["depth_mm"] == pytest.approx(4.5, abs=0.1)
    assert event.values["drop_fraction"] > 0.9


def test_single_outliers_are_no_rupture() -> None:
    trial = ramp(lambda x: 10.0 * x)
    force = np.array(trial.force_N)
    force[[300, 450, 451]] -= 25.0
    force[620] = 0.0
    assert ruptures(divided(trial.time_s, trial.displacement_mm, force)) == []


@pytest.mark.parametrize("rounding_s", [0.0, 0.2])
def test_relaxation_at_a_stop_is_no_rupture(rounding_s: float) -> None:
    time = np.arange(0.0, 12.0, 0.002)
    width = max(rounding_s, 1e-9)
    u = np.clip((time - 4.0) / width + 0.5, 0.0, 1.0)
    smooth = width * (0.5 * u - np.sin(np.pi * u) / (2.0 * np.pi)) + np.maximum(time - 4.0 - 0.5 * width, 0.0)
    depth = time - smooth
    # a branch of 30 ms that carries 80 % of the force while the tool moves
    assert ruptures(segment(relaxing(time, depth, 0.03, 40.0))) == []


def test_a_slower_second_ramp_is_no_rupture() -> None:
    time = np.arange(0.0, 20.0, 0.01)
    found = segment(relaxing(time, np.interp(time, [0, 2, 20], [0, 4, 6]), 0.2, 20.0))
    assert kinds(found) == ["ramp", "ramp"]
    assert ruptures(found) == []


def test_a_soft_middle_is_no_rupture() -> None:
    # a layered tissue: force sinks by a quarter over a third of the depth
    trial = ramp(lambda x: 30.0 * np.sin(np.minimum(x, 4.0) * np.pi / 5.0) + 20.0 * np.maximum(x - 4.0, 0.0))
    assert ruptures(segment(trial)) == []


def test_unloading_is_no_rupture() -> None:
    time = np.arange(0.0, 8.0, 0.01)
    depth = np.interp(time, [0, 4, 4.4, 8], [0, 4, 0, 0])
    assert ruptures(divided(time, depth, 10.0 * depth)) == []


def test_the_user_may_say_it_is_none() -> None:
    found = segment(ramp(broken), options=SegmentOptions(rupture=False))
    assert found.events == ()
    assert "rupture" not in codes(found)


def test_a_drop_that_is_no_rupture_does_not_end_the_move_that_shows_contact(monkeypatch) -> None:
    trial = ramp(lambda x: 10.0 * np.maximum(x - 1.0, 0.0))
    dropped = Event("rupture", 8, float(trial.time_s[8]), values={"drop_fraction": 0.4})
    # in air, and so only while it is not known where the contact lies
    monkeypatch.setattr(segmentation, "ruptures", lambda *given: [dropped] if given[2][0] < 0.0 else [])

    for options in (SegmentOptions(), SegmentOptions(rupture=False)):
        assert abs(segment(trial, options=options).contact.displacement_mm - 1.0) < 0.05


@pytest.mark.parametrize("seed", [0, 8, 22, 25])
def test_a_swing_of_correlated_noise_in_air_hides_no_contact(seed: int) -> None:
    # AR(1) of 0.9 and 0.25 N in 30 N: swings far beyond what differences of neighbours say of the noise
    trial = ramp(lambda x: 5.0 * x, sigma_N=0.0)
    rng, noise, noises = np.random.default_rng(seed), 0.0, []
    for fresh in rng.standard_normal(trial.time_s.size).tolist():
        noise = 0.9 * noise + 0.25 * np.sqrt(1.0 - 0.9**2) * fresh
        noises.append(noise)
    found = divided(trial.time_s, trial.displacement_mm, trial.force_N + noises)
    assert "no_contact" not in codes(found)
    assert "ramp" in kinds(found)


def test_cyclic_bluehill_file_is_cyclic_without_a_hold_and_not_preconditioned(shared_data):
    path = shared_data / "instron-bluehill-cyclic-cc0" / "Specimen_RawData_6.csv"
    rows = list(csv.reader(path.read_text("latin-1").splitlines()))[5:]
    data = np.array([[float(cell) for cell in row[:3]] for row in rows if row])
    found = divided(*data.T)
    assert (found.compression_sign, found.force_sign) == (-1, -1)
    assert kinds(found) == ["cycle"] * 3
    assert {"cyclic", "no_hold", "preload", "not_preconditioned"} <= codes(found)
    # -4.3 N of preload at some 5-8 N/mm: contact 0.5-0.9 mm before the start at -2.047 mm
    assert abs(found.contact.displacement_mm + 1.35) < 2.5 * found.contact.sd_mm
    assert found.contact.sd_mm < 1.0
    # 10 mm/min as its header says
    assert [phase.speed_mm_s for phase in found.phases] == pytest.approx([10.0 / 60.0] * 3, rel=0.01)
    assert [data[phase.peak, 0] for phase in found.phases] == pytest.approx([60.0, 180.0, 300.0], abs=0.2)


def test_an_invar_bar_pulled_to_failure_ruptures_after_its_peak(shared_data):
    lines = (shared_data / "zwick-tra-mit" / "Invar_LT_05_01.TRA").read_text("latin-1").splitlines()
    rows = [row for row in csv.reader(lines) if len(row) > 3]
    names = next(row for row in rows if "Standard force" in row)
    columns = [names.index(name) for name in ("Time", "Standard travel", "Standard force")]
    table = rows[rows.index(names) + 2 :]
    data = np.array([[float(row[k]) for k in columns] for row in table])
    (event,) = events(divided(*data.T), "rupture")
    # necking from the peak of 7.4 kN at 0.9 mm on; hardly anything is carried at the end
    assert 0.9 < event.values["depth_mm"] < 1.3
    assert event.values["drop_fraction"] > 0.9
