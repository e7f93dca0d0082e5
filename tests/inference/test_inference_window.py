"""Samples that are fitted, of any history, their folds and chains of noise; blocks of a log."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from closed_forms import branch_state
from inference_cases import blocks_from, divided_handle, log_data, point_of, ramp_hold, system_of

from tissueid.inference.blocks import SAMPLED, _digits, log_blocks
from tissueid.inference.channel_law import kelvin_voigt_law
from tissueid.inference.logs import blocks_of
from tissueid.inference.rounds import LawSurface
from tissueid.inference.system import Effects, Point, System
from tissueid.inference.window import FOLDS, GUARD_SD, STRETCHES, LogData, assign_folds, fitted_log
from tissueid.measured.relaxation import relaxation_rows
from tissueid.model.base import ContactPath
from tissueid.pipeline import identify
from tissueid.segment import SegmentOptions, segment
from tissueid.signal_noise import chain_breaks, steadied
from tissueid.trial import Contact, Phase, Segmentation, Trial

STEP = 0.01


def phase(kind, start, stop, time, speed=0.0):
    return Phase(kind, start, stop, float(time[start]), float(time[stop - 1]), speed)


def in_air_trial(speed=2.0, contact_mm=0.505, n=400):
    """Approach through air, ramp to a depth of 4 mm below contact, then hold."""
    time = np.arange(n) * STEP
    displacement = np.minimum(speed * time, 4.0 + contact_mm)
    return Trial("s", time, displacement, 10.0 * np.maximum(displacement - contact_mm, 0.0))


def segmented(trial, *, contact_mm=0.505, sd=0.05):
    index = int(np.searchsorted(trial.displacement_mm, contact_mm))
    corner = int(np.argmax(trial.displacement_mm))
    time = trial.time_s
    phases = (
        phase("approach", 0, index + 1, time, 2.0),
        phase("ramp", index, corner + 1, time, 2.0),
        phase("hold", corner, time.size, time),
    )
    return Segmentation(1, 1, Contact(index, contact_mm, sd, in_record=True), phases, 0.1)


def test_fit_starts_at_a_contact_inserted_between_two_samples():
    trial = in_air_trial()
    log = fitted_log(trial, segmented(trial))
    assert log.inserted
    assert log.data.depth_mm[0] == 0.0
    assert log.data.time_s[0] == pytest.approx(0.505 / 2.0)
    assert log.data.force_N[0] == 0.0
    assert not log.data.include[0]
    assert log.data.depth_mm[1] == pytest.approx(trial.displacement_mm[log.first] - 0.505)
    assert log.data.time_s.size == trial.time_s.size - log.first + 1
    assert (log.depth_mm, log.step_s) == pytest.approx((4.0, STEP))
    assert log.has_hold
    assert log.speeds_mm_s == (2.0,)


@pytest.mark.parametrize("kind", ["hold", "creep"])
def test_what_is_held_is_a_hold_of_depth_or_of_load(kind):
    trial = in_air_trial()
    found = segmented(trial)
    phases = tuple(replace(one, kind=kind) if one.kind == "hold" else one for one in found.phases)
    assert fitted_log(trial, replace(found, phases=phases)).has_hold


def test_signs_and_baseline_are_taken_out():
    plain = in_air_trial()
    normal, phases = fitted_log(plain, segmented(plain)), segmented(plain).phases
    flipped = Trial("s", plain.time_s, -plain.displacement_mm, 2.0 - plain.force_N)
    contact = Contact(normal.first, -0.505, 0.05, baseline_N=2.0, in_record=True)
    other = fitted_log(flipped, Segmentation(-1, -1, contact, phases, 0.1))
    np.testing.assert_allclose(other.data.depth_mm, normal.data.depth_mm, atol=1e-12)
    np.testing.assert_allclose(other.data.force_N, normal.data.force_N, atol=1e-12)


def test_contact_on_a_sample_needs_no_insertion_and_its_error_leaves_samples_out():
    trial = in_air_trial(contact_mm=0.5)
    log = fitted_log(trial, segmented(trial, contact_mm=trial.displacement_mm[25]))
    assert not log.inserted
    assert log.data.depth_mm[0] == 0.0
    trial = in_air_trial()
    data = fitted_log(trial, segmented(trial, sd=0.1)).data
    np.testing.assert_array_equal(data.include[1:], data.depth_mm[1:] >= GUARD_SD * 0.1)
    assert (~data.include).sum() > 10


def test_a_record_that_starts_in_contact_loses_nothing_unless_guarded():
    time = np.arange(300) * STEP
    trial = Trial("s", time, 2.0 * time, 20.0 * time)
    segmentation = Segmentation(1, 1, Contact(0, 0.0, 0.1), (phase("ramp", 0, 300, time, 2.0),), 0.1)
    log = fitted_log(trial, segmentation)
    assert log.data.include.all()
    assert not log.inserted
    assert log.first == 0
    guarded = fitted_log(trial, segmentation, guard=True)
    np.testing.assert_array_equal(guarded.data.include, guarded.data.depth_mm >= GUARD_SD * 0.1)


def test_fit_ends_where_the_tool_turns_back_and_of_cycles_with_the_first_rise():
    time = np.arange(600) * STEP
    displacement = np.concatenate([np.linspace(0, 4, 201), np.full(199, 4.0), np.linspace(4, 0, 200)])
    phases = (
        phase("ramp", 0, 201, time, 2.0),
        phase("hold", 200, 400, time),
        phase("retract", 399, 600, time, -2.0),
    )
    contact = Contact(0, 0.0, 0.01)
    trial = Trial("s", time, displacement, 10.0 * displacement)
    log = fitted_log(trial, Segmentation(1, 1, contact, phases, 0.1))
    assert log.data.time_s.size == 400
    assert log.data.depth_mm[-1] == pytest.approx(4.0)
    time = time[:401]
    displacement = 2.0 * (1.0 - np.cos(2 * np.pi * time / 2.0))
    phases = (phase("cycle", 0, 201, time), phase("cycle", 200, 401, time))
    trial = Trial("s", time, displacement, 10.0 * displacement)
    log = fitted_log(trial, Segmentation(1, 1, contact, phases, 0.1))
    assert (log.data.time_s[-1], log.depth_mm, log.has_hold) == pytest.approx((1.0, 4.0, False))
    assert log.speeds_mm_s[0] == pytest.approx(4.0, rel=0.02)  # mean speed up to the peak


@pytest.mark.parametrize(
    ("contact", "moving"),
    [(None, True), (Contact(398, 0.5, 0.01, in_record=True), True), (Contact(0, 0.0, 0.01), False)],
)
def test_no_contact_or_too_few_samples_or_no_travel_give_nothing(contact, moving):
    trial = in_air_trial()
    phases = segmented(trial).phases if moving else ()
    trial = replace(trial, displacement_mm=trial.displacement_mm * moving)
    assert fitted_log(trial, Segmentation(1, 1, contact, phases, 0.1)) is None


def test_every_fold_holds_a_part_of_ramp_and_hold():
    trial = in_air_trial(n=1500)
    segmentation = segmented(trial)
    log = fitted_log(trial, segmentation)
    folded = assign_folds(log, segmentation.of_kind("hold"))
    # equal ln(time) may pass over a stretch where a hold begins
    assert len(set(folded.fold)) >= STRETCHES - 2
    assert folded.fold.max() == STRETCHES - 1
    group = folded.fold % FOLDS
    corner = int(np.argmax(folded.depth_mm >= folded.depth_mm.max()))
    assert set(group[:corner]) == set(range(FOLDS))
    assert set(group[corner:]) == set(range(FOLDS))
    np.testing.assert_array_equal(folded.force_N, log.data.force_N)
    # stretches, not single samples: neighbours mostly share a fold
    assert (np.diff(folded.fold) != 0).sum() <= 60
    depths = [np.ptp(folded.depth_mm[:corner][group[:corner] == k]) for k in range(FOLDS)]
    assert min(depths) >= 0.5 * folded.depth_mm.max()  # spread over the ramp


def test_early_hold_is_cut_finer_than_late_hold():
    trial = in_air_trial(n=3000)
    segmentation = segmented(trial)
    log = fitted_log(trial, segmentation)
    fold = assign_folds(log, segmentation.of_kind("hold")).fold
    corner = int(np.argmax(log.data.depth_mm >= log.data.depth_mm.max()))
    changes = np.flatnonzero(np.diff(fold[corner:])) * STEP
    lengths = np.diff(changes)
    assert lengths[-1] > 10 * lengths[2]


def changed(steps, **at):
    """Steps with some of them replaced, by their place behind an underscore."""
    out = np.array(steps)
    for place, value in at.items():
        out[int(place[1:])] = value
    return out


RATES = np.concatenate([np.full(300, 1e-3), np.full(300, 0.1), np.full(200, 1.0)])
EVEN = np.full(400, 0.01)


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        (np.full(500, 1e-3), [0]),
        (np.diff([float(f"{k / 30.0:.3f}") for k in range(600)]), [0]),  # printed with rounding
        (RATES, [0]),
        (RATES[::-1], [0]),
        (changed(EVEN, _100=0.03, _250=5.0), [0, 101, 251]),  # gaps
        # an event row and the sample after it, within a clock and where its rate changes
        *((changed(np.insert(EVEN, 200, s * 0.01), _201=(1 - s) * 0.01), [0, 201, 202]) for s in (0.02, 0.5)),
        (np.concatenate([np.full(300, 1e-3), [4e-4, 6e-4], np.full(300, 0.1)]), [0, 301, 302]),
        # an irregular clock is broken by real gaps only
        (changed(np.random.default_rng(1).uniform(0.01, 0.05, size=800), _400=3.0), [0, 401]),
        ([], [0]),
        ([1.0], [0]),
        ([1.0] * 4, [0]),
    ],
)
def test_chains_of_noise_break_at_gaps_and_event_rows(steps, expected):
    time = np.concatenate([[0.0], np.cumsum(steps)])
    assert np.flatnonzero(chain_breaks(time)).tolist() == expected


def test_repeated_times_start_chains_and_no_samples_none():
    assert 51 in np.flatnonzero(chain_breaks(np.cumsum(np.append(0.0, changed(EVEN, _50=0.0)))))
    assert chain_breaks(np.zeros(0)).size == 0


RATE_HZ = 50.0
STIFFNESS, TAU_S = 20.0, 2.0
STATIC = (8.0, 0.0, 0.6)
SIGMA_N = 0.02


def recording(knots_s: list[float], depths_mm: list[float]) -> Trial:
    """A tissue of one branch along a polyline, by the exact recursion."""
    time = np.arange(0.0, knots_s[-1], 1.0 / RATE_HZ)
    depth = np.interp(time, knots_s, depths_mm)
    x = np.maximum(depth, 0.0)
    force = sum(a * x**k for k, a in enumerate(STATIC, 1)) + STIFFNESS * branch_state(time, x, TAU_S)
    noise = SIGMA_N * np.random.default_rng(1).standard_normal(time.size)
    return Trial("tissue", time, depth, force + noise)


def kept_contact() -> Trial:
    """Three cycles between 2 and 1 mm, then 4 mm held for 10 s."""
    return recording([0, 2, 3, 4, 5, 6, 7, 10, 20], [0, 2, 1, 2, 1, 2, 1, 4, 4])


def test_cycles_in_contact_stay_out_of_the_likelihood_and_in_the_state() -> None:
    trial = kept_contact()
    divided = segment(trial)
    assert [phase.kind for phase in divided.phases] == ["cycle"] * 3 + ["ramp", "hold"]
    log = fitted_log(trial, divided)
    assert (log.data.time_s[0], log.data.depth_mm.size) == (0.0, trial.time_s.size)
    first = int(np.argmax(log.data.include))
    # the third cycle ends at 7 s
    assert log.data.time_s[first] == pytest.approx(7.0, abs=3.0 / RATE_HZ)
    assert log.data.include[first:].all()
    assert log.has_hold
    assert (*log.speeds_mm_s, log.depth_mm) == pytest.approx((1.0, 4.0), rel=0.01)


def test_cycles_without_a_test_are_fitted_on_their_first_rise() -> None:
    trial = recording([0, 2, 4, 6, 8], [0, 2, 0.5, 2, 0.5])
    divided = segment(trial)
    log = fitted_log(trial, divided)
    assert divided.test == 0
    assert log.data.time_s[-1] == pytest.approx(2.0, abs=3.0 / RATE_HZ)


def assert_given_back(trial: Trial, truth: dict[str, float], rel: float) -> None:
    """A test behind three cycles gives the tissue, and says what was left out."""
    found = identify([trial]).specimens[0]
    for name, value in truth.items():
        assert found.parameter(name).value == pytest.approx(value, rel=rel), name
    (said,) = [flag.message for flag in found.trials[0].flags if flag.code == "unloading_left_out"]
    assert "3 cycles before the test (their state is carried on)" in said


def test_a_test_after_cycles_gives_back_the_tissue() -> None:
    # the branch state at the test's start is some -1 mm: without its history tau is off by tens of per cent
    assert_given_back(kept_contact(), {"relaxation_time_s": TAU_S}, 0.03)


def let_go(rest_s: float, *, back_mm: float = 0.0, set_mm: float = 0.0, seed: int = 1) -> Trial:
    """Three loops to 3 mm under which tool and tissue part, rest, and 3 mm held for 20 s; contact at 1 mm.

    F = 0.4 x + q, q' = 0.5 x' - q / 2 s.  A free surface comes back as exp(-t / 4.5 s); ``set_mm``: it
    stays so much deeper from the second loop on.
    """
    knots = [0.0, 1.0, *np.cumsum([2.0, 1.5, 1.5, 1.5, 1.5, 1.5, rest_s, 1.5, 20.0]) + 1.0]
    depths = [0.0, 0.0, 4.0, back_mm, 4.0, back_mm, 4.0, back_mm, back_mm, 4.0, 4.0]
    time = np.arange(0.0, knots[-1], 0.01)
    tool = np.interp(time, knots, depths)
    force = closed_form(tool - 1.0 - set_mm * (time > 3.5))
    return Trial("loops", time, tool, force + noise_of(time.size, seed))


def closed_form(depth: np.ndarray) -> np.ndarray:
    """Force at 100 Hz of F = 0.4 x + q, q' = 0.5 x' - q / 2 s, whose free surface is exponential."""
    elastic, viscous, tau = 0.4, 0.5, 2.0
    force, surface, state = np.zeros(depth.size), 0.0, 0.0
    away, free = np.exp(-0.01 / tau), np.exp(-0.01 / (tau * (1.0 + viscous / elastic)))
    for n in range(1, depth.size):
        moved = away * state + viscous * tau * 100.0 * (1.0 - away) * (depth[n] - surface)
        if elastic * depth[n] + moved >= 0.0 and depth[n] >= 0.0:
            surface, state = depth[n], moved
            force[n] = elastic * surface + state
        else:
            surface *= free
            state = -elastic * surface
    return force


def loadings(speeds, depths, *, hold_s=0.0, back_mm=0.0, rest_s=4.0, seed=1) -> Trial:
    """Pushes of the same tissue, each back to ``back_mm`` where the tool rests; contact at 1 mm."""
    times, knots = [0.0, 1.0], [0.0, 0.0]
    for speed, depth in zip(speeds, depths, strict=True):
        for to in (1.0 + depth, back_mm):
            times += [times[-1] + abs(to - knots[-1]) / speed]
            times += [times[-1] + (hold_s if to > back_mm else rest_s)]
            knots += [to, to]
    time = np.arange(0.0, times[-1], 0.01)
    tool = np.interp(time, times, knots)
    return Trial("loadings", time, tool, closed_form(tool - 1.0) + noise_of(time.size, seed))


def noise_of(samples: int, seed: int) -> np.ndarray:
    return 0.004 * np.random.default_rng(seed).standard_normal(samples)


def test_cycles_that_let_go_are_carried_on_by_the_surface_that_comes_back() -> None:
    trial = let_go(2.0)
    divided = segment(trial)
    kinds = [phase.kind for phase in divided.phases]
    assert kinds[-4:] == ["rest", "approach", "ramp", "hold"]
    assert kinds.count("cycle") == 3
    assert trial.time_s[divided.contact.index] == pytest.approx(1.5, abs=0.02)
    log = fitted_log(trial, divided)
    assert log.data.time_s[0] == pytest.approx(1.5, abs=0.02)
    # what is fitted begins where the tool meets the surface again
    ramp = divided.phases[-2]
    assert log.data.time_s[np.argmax(log.data.include)] == pytest.approx(ramp.start_s, abs=0.1)
    assert log.tool_mm.min() < 0.0 < log.data.depth_mm[log.data.time_s > 3.0].min()


@pytest.mark.parametrize(
    "how",
    [{"rest_s": 2.0}, {"rest_s": 6.0}, {"rest_s": 4.0, "back_mm": 1.4}, {"rest_s": 20.0, "set_mm": 0.3}],
)
def test_a_test_after_cycles_that_let_go_gives_back_the_tissue(how) -> None:
    truth = {"static_1_N_per_mm": 0.4, "stiffness_0_N_per_mm": 0.5, "relaxation_time_s": 2.0}
    assert_given_back(let_go(**how), truth, 0.07)


@pytest.mark.parametrize("at", [150, 155, 170])
@pytest.mark.parametrize("how", [{"rest_s": 2.0}, {"rest_s": 4.0, "back_mm": 1.4}])
def test_a_surface_that_is_not_back_is_no_contact_where_the_record_begins_without_air(how, at) -> None:
    trial = let_go(**how)
    names = ("time_s", "displacement_mm", "force_N")
    contact = segment(replace(trial, **{name: getattr(trial, name)[at:] for name in names})).contact
    assert contact.index == 0
    assert abs(contact.displacement_mm - 1.0) < 2.0 * contact.sd_mm


@pytest.mark.parametrize("back_mm", [0.0, 2.0])
def test_of_loadings_without_a_test_the_first_is_fitted(back_mm) -> None:
    trial = loadings((0.5, 2.0, 5.0), (3.0,) * 3, back_mm=back_mm)
    divided = segment(trial)
    # a standstill where a loop ended is no test, and speeds make loops unlike
    assert divided.test == 0
    assert not {"preconditioned", "not_preconditioned"} & {flag.code for flag in divided.flags}
    assert fitted_log(trial, divided).data.time_s[-1] == pytest.approx(9.0, abs=0.03)


def test_forces_know_how_a_surface_moves_with_the_law() -> None:
    handle = divided_handle(let_go(20.0, back_mm=1.4))
    law = kelvin_voigt_law(1, 0, 3.0)
    times, linear = np.log([2.0]), np.array([1.2, 0.0, 0.0, 1.5])

    def system(times, linear, offset):
        held = replace(handle, surface=LawSurface(law, times, linear, offset))
        log = held.fitted()[1]
        # which samples touch moves with the law, too
        data = replace(log.data, include=include if include.size else log.data.include)
        return System([blocks_of(held, replace(log, data=data), whole=True)], law, 3.0, Effects())

    include = np.empty(0, dtype=bool)
    at = Point(times, np.zeros(3), linear, np.array([[0.01]]))
    here = system(times, linear, 0.01)
    include = replace(handle, surface=LawSurface(law, times, linear, 0.01)).fitted()[1].data.include
    parts = here.derivatives(at, machine=False)
    for moved, by in (
        (replace(at, log_times=times + 1e-4), parts.shared[:, 0]),
        (replace(at, linear=linear + 1e-4 * np.eye(4)[0]), parts.shared[:, 4]),
        (replace(at, linear=linear + 1e-4 * np.eye(4)[3]), parts.shared[:, 7]),
        (replace(at, own=at.own + 1e-4), parts.own[:, 0]),
    ):
        there = system(moved.log_times, moved.linear, float(moved.own[0, 0]))
        there.remembered = None
        change = there.predict(moved) - parts.force
        assert np.abs(change - 1e-4 * by).max() < 0.03 * np.abs(change).max()
    # what is carried through air is no small part of that
    assert (np.abs(here.remembered.by[:, [0, 1, 4]]).max(axis=0) > 0.09).all()
    # another law of as many parameters has another surface
    assert here.under(replace(law, depth_mm=2.0)).remembered is None
    # a log without loops beside it carries nothing, and takes nothing away
    time, depth = ramp_hold(100.0, 2.0, 3.0, 5.0)
    plain = blocks_from(log_data(time, depth, depth), whole=True)
    both = System([*here.logs, plain], law, 3.0, Effects())
    assert both.remembered.by[: here.force.size] == pytest.approx(here.remembered.by)
    assert not both.remembered.by[here.force.size :].any()


def ruptured() -> Trial:
    """A ramp to 4 mm in 4 s that loses 60 % of its force at 3 mm, and a hold."""
    trial = recording([0, 4, 14], [0, 4, 4])
    return replace(trial, force_N=np.where(trial.time_s > 3.0, 0.4, 1.0) * trial.force_N)


def test_samples_from_the_first_rupture_on_take_no_part_unless_the_user_denies_it() -> None:
    trial = ruptured()
    divided, denied = segment(trial), segment(trial, options=SegmentOptions(rupture=False))
    assert [[event.kind for event in one.events] for one in (divided, denied)] == [["rupture"], []]
    log = fitted_log(trial, divided)
    assert log.data.time_s[-1] == pytest.approx(3.0, abs=3.0 / RATE_HZ)
    assert not log.has_hold
    assert relaxation_rows(trial, divided) == ()
    flags = {flag.code: flag.message for flag in identify([trial]).specimens[0].trials[0].flags}
    assert {"rupture", "unloading_left_out"} <= set(flags)
    assert "the first rupture" in flags["unloading_left_out"]
    assert fitted_log(trial, denied).data.time_s[-1] == trial.time_s[-1]


def test_a_cut_without_samples_is_said() -> None:
    divided = segment(ruptured(), options=SegmentOptions(start_s=100.0))
    assert (divided.phases, divided.contact) == ((), None)
    assert "too_few_samples" in {flag.code for flag in divided.flags}


def test_the_user_may_cut_a_recording() -> None:
    trial = recording([0, 2, 3, 5, 15, 17], [0, 2, 0, 4, 4, 0])
    divided = segment(trial, options=SegmentOptions(start_s=3.0, end_s=12.0))
    assert [phase.kind for phase in divided.phases] == ["ramp", "hold"]
    assert (divided.phases[0].start_s, divided.phases[-1].end_s) == (3.0, 12.0)
    log = fitted_log(trial, divided)
    assert (log.data.time_s[0], log.data.time_s[-1]) == (3.0, 12.0)


LAW = kelvin_voigt_law(1, 1, 4.0)
THETA = np.array([20.0, -1.2, 0.35, 60.0, 8.0, 0.02])


def direct(time, depth, theta=THETA, law=LAW):
    return law.model().force(np.asarray(theta), ContactPath(time, depth))


def between(log, blocks):
    """Mean over the samples of each block: blocks are neighbours, and cover the log."""
    edges = np.concatenate([[0], np.cumsum(blocks.count)])
    assert edges[-1] == log.time_s.size
    return np.add.reduceat(log.force_N, edges[:-1]) / blocks.count


@pytest.mark.parametrize("tau", [0.02, 2.0])
@pytest.mark.parametrize("rate", [50.0, 1000.0])
def test_means_through_blocks_are_those_of_the_samples(tau, rate):
    # the corner lies on a sample, which belongs to both lines
    time, depth = ramp_hold(rate, 4.0, 4.0, 10.0)
    theta = np.append(THETA[:-1], max(tau, 20.0 / rate))
    log = log_data(time, depth, direct(time, depth, theta))
    system = system_of([log], LAW)
    assert system.force.size < 0.4 * time.size
    np.testing.assert_allclose(system.force, between(log, system.logs[0]), rtol=1e-12)
    error = system.predict(point_of(LAW, theta)) - system.force
    assert np.abs(error).max() <= 1e-4 * np.ptp(log.force_N)


def test_a_constant_speed_between_holds_is_no_digit():
    # most travel repeats and all steps are alike: corners stay sharp all the same
    time = np.arange(1001) / 50.0
    depth = np.interp(time, [0.0, 2.0, 3.0, 4.0, 7.0, 20.0], [0.0, 2.0, 1.0, 2.0, 4.0, 4.0])
    theta = np.append(THETA[:-1], 2.0)
    log = log_data(time, depth, direct(time, depth, theta))
    error = system_of([log], LAW).predict(point_of(LAW, theta)) - system_of([log], LAW).force
    assert np.abs(error).max() <= 2e-4 * np.ptp(log.force_N)


def test_noise_of_the_travel_is_averaged_and_not_followed():
    rng = np.random.default_rng(1)
    time, depth = ramp_hold(1000.0, 4.0, 4.0, 10.0)
    noisy = depth + 0.002 * rng.standard_normal(time.size)
    quiet, found = (blocks_from(log_data(time, x, 0.0 * x)) for x in (depth, noisy))
    assert found.force_N.size < 3 * quiet.force_N.size
    off = np.abs(found.depth_mm - np.interp(found.time_s, time, depth))
    # single samples near corners keep their noise, most points lie on lines through many
    assert np.median(off) < 0.5 * 0.002
    assert off.max() < 4.0 * 0.002


def test_a_short_log_is_kept_sample_by_sample_and_a_long_one_where_asked():
    time, depth = ramp_hold(1000.0, 4.0, 4.0, 10.0)
    found = blocks_from(log_data(time, depth, direct(time, depth)), whole=True)
    assert found.force_N.size == time.size
    time, depth = ramp_hold(100.0, 4.0, 4.0, 2.0)
    assert time.size <= SAMPLED
    include = np.arange(time.size) >= 5
    found = blocks_from(log_data(time, depth, direct(time, depth), include=include))
    np.testing.assert_array_equal(found.force_N, direct(time, depth)[5:])
    np.testing.assert_array_equal(found.mid_s, time[5:])
    assert (found.count == 1).all()
    assert (found.within_freedom, found.chain.sum()) == (0, 1)


def held_log(hold_s, *, noise=0.0, **given):
    """A second of ramp at 1 kHz and a hold."""
    time, depth = ramp_hold(1000.0, 4.0, 4.0, hold_s)
    more = noise * np.random.default_rng(2).standard_normal(time.size)
    return log_data(time, depth, direct(time, depth) + more, **given)


def test_blocks_grow_behind_the_corner():
    found = blocks_from(held_log(30.0))
    since = found.mid_s - 1.0
    held = found.count[since > 0.0]
    assert held[0] <= 2
    assert held.max() >= 400
    # evenly in ln time: a block is no longer than 0.4 of the time since the corner
    late = since > 0.02
    assert (found.count[late] * 1e-3 <= 0.4 * since[late]).all()


def test_what_is_left_within_blocks_is_the_noise():
    found = blocks_from(held_log(10.0, noise=0.5))
    # some ten thousand degrees of freedom know a standard deviation to 0.7 %
    assert found.within_freedom > 8_000
    assert np.sqrt(found.within_N2 / found.within_freedom) == pytest.approx(0.5, rel=0.03)


def test_samples_that_take_no_part_start_chains_and_folds_are_not_mixed():
    at = np.arange(2001)
    include = (at < 600) | (at >= 700)
    found = blocks_from(held_log(1.0, include=include))
    assert found.count.sum() == include.sum()
    assert found.chain.sum() == 2
    assert found.mid_s[np.flatnonzero(found.chain)[1]] >= 0.7
    # a corner's own block starts none
    assert (found.count == 1).any()
    fold = at // 477
    found = blocks_from(held_log(1.0, fold=fold))
    edges = np.concatenate([[0], np.cumsum(found.count)])
    for number, (a, b) in enumerate(pairwise(edges)):
        assert set(fold[a:b]) == {int(found.fold[number])}


def test_a_path_that_leads_begins_in_air():
    time, depth = ramp_hold(1000.0, 4.0, 4.0, 5.0)
    log = log_data(time, depth, direct(time, depth))
    found, plain = (log_blocks(log, step_s=1e-3, contact_sd_mm=0.02, leads=leads) for leads in (True, False))
    # on the line of the first samples, at 4 mm/s
    assert (found.depth_mm[0], found.time_s[0]) == pytest.approx((-0.1, -0.025))
    np.testing.assert_array_equal(found.at, plain.at + 1)


@pytest.mark.parametrize("whole", [True, False])
def test_a_corner_between_two_samples_is_a_point_of_the_path(whole):
    time = np.arange(801) / 100.0
    depth = np.round(np.minimum(3.7 * time, 4.0), 5)
    blocks = blocks_from(log_data(time, depth, depth), whole=whole)
    corner = 4.0 / 3.7
    nearest = int(np.argmin(np.abs(blocks.time_s - corner)))
    assert blocks.time_s[nearest] == pytest.approx(corner, abs=1e-5)
    assert blocks.depth_mm[nearest] == pytest.approx(4.0, abs=2e-5)
    # observations are where they were
    middle = blocks.at[:, 1]
    one = blocks.count == 1
    np.testing.assert_allclose(blocks.time_s[middle[one]], blocks.mid_s[one], atol=1e-12)


def test_a_stop_that_brakes_or_lies_on_a_sample_gets_no_corner():
    time = np.arange(801) / 100.0
    sharp = np.minimum(4.0 * np.pad(time, 10, mode="edge"), 4.0)
    braked = np.convolve(sharp, np.ones(11) / 11.0, mode="same")[10:-10]
    for depth in (braked, np.minimum(4.0 * time, 4.0)):
        assert blocks_from(log_data(time, depth, depth), whole=True).time_s.size == time.size


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05])
@pytest.mark.parametrize("slope", [1e-3, 1.0])
def test_rounding_that_samples_share_is_not_averaged(noise, slope):
    """Means of 200 samples of a slow force keep its rounding; quick ones and much noise do not."""
    rng, step = np.random.default_rng(4), 0.1
    time = np.arange(40_000.0) * 0.01
    level = slope * time
    force = np.round((level + noise * rng.standard_normal(time.size)) / step) * step
    off = (force - level).reshape(-1, 200)
    found = float(np.median(_digits(force, force.reshape(-1, 200).mean(axis=1))))
    # variance of the means, less the part that averages
    left = (off.mean(axis=1).var() - off.var() / 200) / off.var()
    assert left - 0.02 <= found <= 2.7 * left + 0.02


@pytest.mark.parametrize("share", [0.05, 0.4, 0.9])
def test_samples_beside_a_contact_between_samples_are_compared_where_they_are(share):
    """Contact a part of a step before the first sample: nothing of a noise-free log is missed."""
    time = np.concatenate([[0.0], (share + np.arange(1_000.0)) * 0.01])
    depth = np.minimum(4.0 * time, 6.0)
    include = np.arange(time.size) > 0
    data = LogData(time, depth, 50.0 * depth, include, np.zeros(time.size, dtype=np.int64))
    blocks = log_blocks(data, step_s=0.01, contact_sd_mm=0.004, leads=True)
    assert blocks.count.max() > 1
    x = blocks.depth_mm[blocks.at]
    mean = (x[:, 0] + 4.0 * x[:, 1] + x[:, 2]) / 6.0
    np.testing.assert_allclose(blocks.force_N, 50.0 * mean, atol=1e-9)


def test_rows_that_share_one_instant_are_no_straight_line():
    """A logger that stood still for twelve rows: no slope is taken over no time."""
    time = np.arange(2_000) * 0.01
    for at in (300, 600, 1_500):
        time[at : at + 12] = time[at]
    depth = np.minimum(np.arange(2_000) * 0.01, 6.0)
    data = LogData(time, depth, 5.0 * depth, np.ones(2_000, dtype=bool), np.zeros(2_000, dtype=np.int64))
    with np.errstate(all="raise"):
        blocks = log_blocks(data, step_s=0.01, contact_sd_mm=0.004, leads=False)
    assert np.isfinite(blocks.time_s).all()
    assert np.isfinite(blocks.depth_mm).all()


def read_with_noise(sd_mm, *, followed, seed=0):
    """Times, true and read depths of a ramp and hold, and a force of either, 2 N/mm, with 0.02 N of noise."""
    rng, time = np.random.default_rng(seed), np.arange(0.0, 12.0, 0.01)
    true = np.clip(2.0 * (time - 1.0), -0.4, 4.0)
    read = true + sd_mm * rng.standard_normal(time.size)
    force = 2.0 * np.maximum(read if followed else true, 0.0) + 0.02 * rng.standard_normal(time.size)
    return time, true, read, force


@pytest.mark.parametrize("sd_mm", [0.01, 0.03])
def test_travel_that_is_read_with_noise_is_steadied_and_its_corner_kept(sd_mm):
    time, true, read, force = read_with_noise(sd_mm, followed=False)
    off = steadied(time, read, force, noise_N=0.02) - true
    assert np.std(off) < 0.3 * sd_mm
    corner = np.abs(time - 3.0) < 0.1
    assert abs(off[corner].mean()) < 0.5 * sd_mm


@pytest.mark.parametrize(("sd_mm", "followed"), [(0.001, False), (0.03, True), (0.0, False)])
def test_travel_that_is_read_well_and_jitter_that_the_force_follows_are_left(sd_mm, followed):
    time, _, read, force = read_with_noise(sd_mm, followed=followed)
    assert steadied(time, read, force, noise_N=0.02) is read
