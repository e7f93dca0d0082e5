"""Peaks, forces in the hold and their refusals, against recordings whose truth is written down."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from pushed import pushed

from tissueid.documents.measured import Measured
from tissueid.measured import measure, spread
from tissueid.measured.geometry import Geometry, TipOf
from tissueid.measured.relaxation import relaxation_rows
from tissueid.measured.spread import Pushed, measured_pairs, programs, ramp_reason
from tissueid.model.moduli import Indenter
from tissueid.segment import segment
from tissueid.trial import Axes, Contact, Corner, Event, Phase, Protocol, Segmentation, Trial

STEP = 0.01
REST, CORNER, STOP, END = 1.0, 3.0, 3.2, 18.2


def relaxed(time):
    """Share of the force left so long after the stop."""
    return 0.5 + 0.3 * np.exp(-time / 0.5) + 0.2 * np.exp(-time / 8.0)


def recording(
    *, noise: float = 0.0, sign: int = 1, zero: float = 0.0, stretch: float = 1.0, step: float = STEP
) -> tuple[Trial, Segmentation]:
    """Rest in air, 4 mm in 2 s with 0.2 s of braking, 15 s of hold; the force peaks at the corner."""
    corner, stop, end = (REST + stretch * (at - REST) for at in (CORNER, STOP, END))
    time = np.arange(round(end / step) + 1) * step
    depth = np.interp(time, [0.0, REST, corner, stop, end], [0.0, 0.0, 3.95, 4.0, 4.0])
    force = np.interp(time, [0.0, REST, corner, stop], [0.0, 0.0, 10.5, 10.0])
    force = np.where(time > stop, 10.0 * relaxed(np.maximum(time - stop, 0.0)), force)
    force = force + noise * np.random.default_rng(0).normal(size=time.size)
    at = [round(one / step) for one in (REST, corner, stop)]
    phases = (
        Phase("rest", 0, at[0] + 1, 0.0, REST, 0.0),
        Phase("ramp", at[0], at[2] + 1, REST, float(time[at[2]]), 2.0 / stretch),
        Phase("hold", at[2], time.size, float(time[at[2]]), float(time[-1]), 0.0),
    )
    corners = (Corner(1, at[1], corner, 0.2, 0.0, 0, None),)
    contact = Contact(at[0], 0.0, 0.01, zero, in_record=True)
    trial = Trial("s", time, depth, zero + sign * force, Protocol())
    return trial, Segmentation(1, sign, contact, phases, noise, corners=corners)


def test_the_peak_of_a_standstill_shorter_than_its_search_lies_in_it():
    trial, divided = recording()
    rest, ramp, hold = divided.phases
    stop = hold.start + 5
    # the tool goes on after 0.04 s, and the force rises beyond that of the stop
    force = np.where(np.arange(trial.time_s.size) >= stop, 20.0, trial.force_N)
    short = replace(hold, stop=stop, end_s=float(trial.time_s[stop - 1]))
    again = Phase("ramp", stop - 1, trial.time_s.size, short.end_s, END, 2.0)
    found = measure(replace(trial, force_N=force), replace(divided, phases=(rest, ramp, short, again)))
    assert found.holds[0].end_s <= STOP + 0.05
    assert all(one.after_peak_N is None or one.after_peak_N < 11.0 for one in found.holds[0].forces)


def test_forces_of_a_hold_are_the_same_at_another_time_of_day():
    # samples lie at the edges of the windows, where the rounding of their times would decide
    trial, divided = recording(noise=0.05)
    (hold,) = measure(trial, divided).holds
    for later in (0.3, 64.0, 5000.1):
        (again,) = measure(replace(trial, time_s=trial.time_s + later), divided).holds
        for one, other in zip(hold.forces[:3], again.forces[:3], strict=True):
            numbers = (one.after_stop_N, one.sd_N, one.after_peak_N)
            assert (other.after_stop_N, other.sd_N, other.after_peak_N) == pytest.approx(numbers, rel=1e-9)


@pytest.mark.parametrize(("sign", "zero"), [(1, 0.0), (-1, 3.0)])
def test_numbers_of_a_hold_are_those_of_its_truth(sign, zero):
    found = measure(*recording(sign=sign, zero=zero))
    (hold,) = found.holds
    push = hold.push
    assert (found.base.recorded_N, found.base.source) == (zero, "air")
    assert (push.ramp_time_s, push.depth_mm, push.travel_mm) == pytest.approx((2.2, 4.0, 4.0))
    assert push.braking_s == pytest.approx(0.2)
    # the crosshead brakes for 0.2 s, in which the force falls already
    assert (push.peak.time_s, push.peak.force_N) == pytest.approx((CORNER, 10.5))
    assert push.peak.recorded_N == pytest.approx(zero + sign * 10.5)
    for time in (0.1, 1.0, 10.0):
        one = hold.at(time)
        assert one.after_stop_N == pytest.approx(10.0 * relaxed(time), rel=2e-3)
        assert one.after_peak_N == pytest.approx(10.0 * relaxed(max(time - 0.2, 0.0)), rel=0.03)
        assert one.over_10s == pytest.approx(relaxed(time) / relaxed(10.0), rel=3e-3)
        assert one.over_peak == pytest.approx(one.after_peak_N / 10.5)
        assert not one.beyond_ramp
    assert hold.forces[3].reason == "the hold lasts 15 s"
    assert hold.at(100.0) is None
    # the window begins with the stop: 0.2 s of braking before it are no relaxation at rest
    assert hold.tau.double_s == pytest.approx((0.5, 8.0), rel=0.01)
    assert hold.tau.window_s == pytest.approx((STOP, END))


def test_the_end_of_a_hold_is_the_last_sample_before_the_next_move():
    trial, segmentation = recording()
    trial = replace(trial, force_N=np.append(trial.force_N[:-1], -2.0))
    assert measure(trial, segmentation).holds[0].end_N == -2.0
    last = trial.time_s.size - 1
    away = Phase("retract", last, last + 1, trial.time_s[-1], trial.time_s[-1], -2.0)
    hold = measure(trial, replace(segmentation, phases=(*segmentation.phases, away))).holds[0]
    assert hold.end_N == pytest.approx(10.0 * relaxed(END - STOP), rel=1e-3)


def test_forces_of_a_loading_stand_at_round_depths_and_predict_the_next():
    logs = [measure(*recording(noise=noise, stretch=1.0)) for noise in (0.0, 0.02, 0.05)]
    own = {one.depth_mm: one.force_N for one in logs[0].push.forces}
    # 4 mm are passed in braking: the last three of 1, 2, 5 before them; the ramp is a line to the corner
    assert own == pytest.approx({depth: 10.5 * depth / 3.95 for depth in (0.5, 1.0, 2.0)}, rel=1e-3)
    rows = {row.depth_mm: row for row in spread(logs) if row.name == "force_at_depth"}
    assert list(rows) == [0.5, 1.0, 2.0]
    for depth, row in rows.items():
        low, high = row.prediction95
        assert low < 10.5 * depth / 3.95 < high
    # at one depth forces are compared however deep the pushes went on
    (pair,) = measured_pairs([("one", spread(logs[:1])), ("other", spread(logs[1:]))])
    ratios = [row["ratio"] for row in pair["numbers"] if row["name"] == "force_at_depth"]
    assert ratios == pytest.approx([1.0, 1.0, 1.0], rel=0.05)


@pytest.mark.parametrize("rate", [200.0, 50.0, 20.0])
@pytest.mark.parametrize("brake", [0.2, 0.4])
def test_a_stop_is_where_a_thousandth_of_the_step_is_left(rate, brake):
    trial = pushed(brake_s=brake, rate_Hz=rate)
    (hold,) = measure(trial, segment(trial)).holds
    # even braking from 2 mm/s leaves 5 um of 5 mm this long before it ends
    reached = 3.5 + 0.5 * brake - np.sqrt(0.005 * brake)
    assert reached - 1e-9 <= hold.start_s <= reached + 1.5 / rate


@pytest.mark.parametrize(("brake", "tau"), [(0.05, 0.5), (0.2, 0.5), (0.2, 2.0), (0.5, 0.5)])
def test_braking_does_not_lengthen_relaxation(brake, tau):
    trial = pushed(brake_s=brake, tau_s=tau)
    divided = segment(trial)
    (hold,) = measure(trial, divided).holds
    # from the peak, 0.5 s would be 0.52 s where the crosshead brakes for 0.2 s, and 0.57 s for 0.5 s
    assert hold.tau.single_s == pytest.approx(tau, rel=0.01)
    (row,) = relaxation_rows(trial, divided)
    assert (row.tau_single_s, row.window_s[0]) == (hold.tau.single_s, hold.start_s)
    assert row.peak_force_N == pytest.approx(hold.push.peak.force_N, abs=0.05)


def test_noise_moves_a_force_by_its_stated_sd():
    errors = []
    trial, divided = recording()
    for seed in range(40):
        noise = 0.2 * np.random.default_rng(seed).normal(size=trial.time_s.size)
        noisy = replace(trial, force_N=trial.force_N + noise)
        (hold,) = measure(noisy, replace(divided, force_noise_N=0.2)).holds
        one = hold.at(10.0)
        assert one.sd_N < 0.05
        errors.append((one.after_stop_N - 10.0 * relaxed(10.0)) / one.sd_N)
        # the largest of many samples would be 0.6 N high
        assert hold.push.peak.force_N == pytest.approx(10.5, abs=0.4)
    assert 0.6 < float(np.std(errors)) < 1.5


def test_a_single_sample_far_off_does_not_move_a_force():
    trial, divided = recording()
    force = trial.force_N.copy()
    force[round((STOP + 10.0) / STEP)] += 5.0
    (hold,) = measure(replace(trial, force_N=force), divided).holds
    assert hold.at(10.0).after_stop_N == pytest.approx(10.0 * relaxed(10.0), rel=2e-3)


def test_sampling_too_slow_for_a_time_says_so():
    (hold,) = measure(*recording(step=0.2)).holds
    assert hold.forces[0].after_stop_N is None
    assert "samples are 0.2 s apart" in hold.forces[0].reason
    assert hold.at(1.0) is not None


def test_a_hold_under_a_held_load_has_no_forces():
    trial, divided = recording()
    phases = (*divided.phases[:2], replace(divided.phases[2], kind="creep"))
    (hold,) = measure(trial, replace(divided, phases=phases)).holds
    assert (hold.control, hold.forces, hold.tau) == ("force", (), None)


def test_forces_count_from_rest_where_there_is_no_air():
    trial, divided = recording(zero=0.5)
    touching = replace(divided, contact=replace(divided.contact, in_record=False, baseline_N=0.0))
    found = measure(trial, touching)
    assert (found.base.recorded_N, found.base.source) == (pytest.approx(0.5), "rest")
    assert found.push.peak.force_N == pytest.approx(10.5)
    assert measure(trial, replace(divided, contact=None)).push.depth_mm is None


def test_two_rows_at_rest_under_a_pull_are_the_load_cells_zero():
    time = 0.05 * np.arange(45)
    depth = np.clip(time - 0.05, 0.0, None) * 30.0
    trial = Trial("a", time, depth, -14.3 + 0.15 * depth + 0.01 * np.cos(7e3 * time))
    found = measure(trial, segment(trial))
    assert (found.base.recorded_N, found.base.source) == (pytest.approx(-14.3, abs=0.02), "rest")
    assert found.push.peak.force_N == pytest.approx(0.15 * depth[-1], abs=0.1)


@pytest.mark.parametrize(("left", "ends_there"), [(0.2, True), (0.7, False)])
@pytest.mark.parametrize("punctured", [False, True])
def test_a_push_ends_at_the_rupture_after_which_no_force_is_as_large(punctured, left, ends_there):
    time_s = np.arange(0.0, 4.0, 0.01)
    depth = np.minimum(2.0 * np.clip(time_s - 1.0, 0.0, None), 5.0)
    force = 2.0 * depth + 0.8 * depth**2
    first, broke = 200, 283
    if punctured:  # a first layer, which gave way at a lesser force
        force[first + 1 :] -= 0.5 * force[first]
    peak, force[broke + 1 :] = float(force[broke]), left * force[broke + 1 :]
    noisy = force + 0.01 * peak * np.random.default_rng(0).standard_normal(force.size)
    trial = Trial("a", time_s, depth, noisy)
    divided = segment(trial)
    found = [event.index for event in divided.events if event.kind == "rupture"]
    assert found == ([first, broke] if punctured else [broke])
    push = measure(trial, divided, geometry=Geometry(Indenter("flat", 10.0))).push
    # what broken tissue holds is no modulus of the whole one
    assert (push.modulus.held_kPa is None) == ends_there
    expected = (peak, depth[broke]) if ends_there else (force.max(), 5.0)
    assert (push.peak.force_N, push.travel_mm) == pytest.approx(expected, rel=0.02)


def test_a_hold_that_a_rupture_cut_is_kept_and_marked():
    trial, divided = recording()
    (hold,) = measure(trial, replace(divided, events=(Event("rupture", 150, 1.5),))).holds
    assert hold.after_rupture
    # no number of several tests is of broken tissue
    assert {row.hold for row in spread([measure(trial, divided)])} == {1}
    broken = measure(trial, replace(divided, events=(Event("rupture", 150, 1.5),)))
    assert {row.hold for row in spread([broken])} == {0}
    assert hold.at(1.0) is not None


def test_logs_of_several_programs_are_not_pooled():
    quick, slow = (measure(*recording(stretch=stretch)) for stretch in (0.5, 4.0))
    rows = spread([quick, slow, quick])
    speeds = {row.program: (row.mean, row.count) for row in rows if row.name == "speed"}
    (slower, once), (faster, twice) = sorted(speeds.values())
    assert faster == pytest.approx(8.0 * slower)
    assert (once, twice) == (1, 2)
    assert {row.count for row in rows if row.name == "force_over_peak"} == {1, 2}
    assert not any(row.reason for row in rows)


def test_speeds_that_differ_by_rounding_have_no_spread():
    one = measure(*recording())
    (hold,) = one.holds
    off = structs.replace(hold.push, speed_mm_s=float(np.nextafter(hold.push.speed_mm_s, 9.0)))
    other = structs.replace(one, holds=(structs.replace(hold, push=off),))
    (speed,) = (row for row in spread([one, other]) if row.name == "speed")
    assert speed.sd == 0.0


def test_a_program_is_a_speed_and_depths_that_contact_makes_differ():
    made = [(4.0, 8.0), (0.5, 8.0), (4.1, 7.0), (4.0, 2.0), (4.0, 2.1)]
    assert sorted(sorted(one) for one in programs([Pushed(*one) for one in made])) == [[0, 2], [1], [3, 4]]


def test_a_load_that_ends_pushes_is_a_program_at_whatever_depth():
    """A lab that holds at 1.2 N holds soft places deep and stiff ones shallow: one program, with a spread."""
    held = [(1.5, 2.3, 1.17, 2.2), (1.0, 3.6, 1.16, 3.7), (1.2, 2.9, 1.17, 3.0)]
    other = [(1.3, 3.0, 0.86, 1.5), (1.5, 3.0, 1.16, 30.0)]
    found = programs([Pushed(*one) for one in (*held, *other)])
    assert sorted(sorted(one) for one in found) == [[0, 1, 2], [3], [4]]
    # one depth at three speeds is three programs, however alike the forces; two logs may be an accident
    speeds = [(v, 8.0, 40.0 + v, 8.0 / v) for v in (4.0, 4.6, 5.4)]
    assert len(programs([Pushed(*one) for one in speeds])) == 3
    assert len(programs([Pushed(*one) for one in held[:2]])) == 2


def test_programs_of_two_sides_are_paired_where_they_ran_alike():
    quick, slow = (measure(*recording(stretch=stretch)) for stretch in (0.5, 4.0))
    both, one = spread([quick, slow]), spread([slow])
    (pair,) = measured_pairs([("both", both), ("one", one)])
    (peak,) = [row for row in pair["numbers"] if row["name"] == "peak"]
    assert peak["ratio"] == pytest.approx(1.0)
    # one program each: what knows the ramp is refused with the reason
    (pair,) = measured_pairs([("quick", spread([quick])), ("slow", one)])
    rows = {(row["name"], row["time_s"]): row for row in pair["numbers"]}
    reason = "depends on the ramp, and there are ramps of 1.1 to 8.8 s"
    assert reason in rows["force_over_peak", 1.0]["reason"]
    assert rows["force", 1.0]["ratio"] is None


def test_ramps_are_told_apart_before_ten_ramp_times():
    quick = measure(*recording(stretch=0.5))
    # one program pools
    same = {(row.name, row.time_s): row for row in spread([quick, quick])}
    assert same["force_over_peak", 1.0].sd == pytest.approx(0.0)
    assert ramp_reason(100.0, [0.1, 10.0]) == ""
    assert ramp_reason(100.0, [0.1, 10.0], peak=True) != ""


def test_a_modulus_is_that_of_the_formula_or_refused_with_its_number():
    trial, divided = recording()
    stiffness = trial.displacement_mm * 2.0 * 3.0 * 0.01 / 0.75
    flat = replace(trial, force_N=stiffness)
    modulus = measure(flat, divided, geometry=Geometry(Indenter("flat", 10.0))).push.modulus
    assert modulus.refused is None
    # F = 2 a E d / (1 - nu^2)
    assert modulus.loading_kPa == pytest.approx(1000.0 * 0.75 * 0.08 / 20.0, rel=1e-6)
    assert modulus.held_kPa == pytest.approx(modulus.loading_kPa, rel=1e-6)
    ball = measure(trial, divided, geometry=Geometry(Indenter("sphere", 5.0))).push.modulus
    assert ball.loading_kPa is None
    assert "a/R = 0.89 (at most 0.4)" in ball.refused
    buried = measure(trial, divided, geometry=Geometry(Indenter("flat", 2.0))).push.modulus
    assert "depth 4 mm beyond the radius of 2 mm" in buried.refused
    assert measure(trial, divided).push.modulus is None
    strain = replace(trial, axes=Axes("1", "MPa"))
    assert measure(strain, divided, geometry=Geometry(Indenter("flat", 10.0))).push.modulus is None


def test_a_header_states_a_sphere_unless_something_else_is_stated():
    trial = replace(recording()[0], protocol=Protocol(tip_radius_mm=0.05))
    assert TipOf().of(trial) == Geometry(Indenter("sphere", 0.05))
    assert TipOf(header=False).of(trial) is None
    stated = Geometry(Indenter("flat", 1.0))
    assert TipOf(stated).of(trial) == stated


def test_a_recording_without_phases_has_a_base_alone():
    trial, divided = recording()
    found = measure(trial, replace(divided, phases=(), corners=(), contact=None))
    assert found == Measured(found.base, None, (), ())
