"""Which samples are fitted, and how one log is divided for held-out prediction."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.inference.window import FOLDS, GUARD_SD, STRETCHES, assign_folds, fitted_log
from tissueid.trial import Contact, Phase, Segmentation, Trial

STEP = 0.01


def phase(kind, start, stop, time, speed=0.0):
    return Phase(kind, start, stop, float(time[start]), float(time[stop - 1]), speed)


def in_air_trial(speed=2.0, contact_mm=0.505, n=400):
    """Approach through air, ramp to a depth of 4 mm below contact, then hold."""
    time = np.arange(n) * STEP
    displacement = np.minimum(speed * time, 4.0 + contact_mm)
    depth = np.maximum(displacement - contact_mm, 0.0)
    return Trial("s", time, displacement, 10.0 * depth)


def segmented(trial, *, contact_mm=0.505, sd=0.05, extra=(), sign=1):
    index = int(np.searchsorted(trial.displacement_mm, contact_mm))
    corner = int(np.argmax(trial.displacement_mm))
    time = trial.time_s
    phases = (
        phase("approach", 0, index + 1, time, 2.0),
        phase("ramp", index, corner + 1, time, 2.0),
        phase("hold", corner, time.size, time),
        *extra,
    )
    contact = Contact(index, contact_mm, sd, in_record=True)
    return Segmentation(sign, sign, contact, phases, 0.1)


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
    assert log.depth_mm == pytest.approx(4.0)
    assert log.step_s == pytest.approx(STEP)
    assert log.has_hold
    assert log.speeds_mm_s == (2.0,)


def test_contact_on_a_sample_needs_no_insertion():
    trial = in_air_trial(contact_mm=0.5)
    log = fitted_log(trial, segmented(trial, contact_mm=trial.displacement_mm[25]))
    assert not log.inserted
    assert log.data.depth_mm[0] == 0.0


def test_guard_zone_leaves_out_what_the_contact_error_reaches():
    trial = in_air_trial()
    log = fitted_log(trial, segmented(trial, sd=0.1))
    recorded = slice(1, None)
    np.testing.assert_array_equal(log.data.include[recorded], log.data.depth_mm[recorded] >= GUARD_SD * 0.1)
    assert (~log.data.include).sum() > 10


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


def test_signs_and_baseline_are_taken_out():
    plain = in_air_trial()
    flipped = Trial("s", plain.time_s, -plain.displacement_mm, 2.0 - plain.force_N)
    normal = fitted_log(plain, segmented(plain))
    index = normal.first
    phases = segmented(plain).phases
    contact = Contact(index, -0.505, 0.05, baseline_N=2.0, in_record=True)
    other = fitted_log(flipped, Segmentation(-1, -1, contact, phases, 0.1))
    np.testing.assert_allclose(other.data.depth_mm, normal.data.depth_mm, atol=1e-12)
    np.testing.assert_allclose(other.data.force_N, normal.data.force_N, atol=1e-12)


def test_fit_ends_where_the_tool_turns_back():
    time = np.arange(600) * STEP
    displacement = np.concatenate([np.linspace(0, 4, 201), np.full(199, 4.0), np.linspace(4, 0, 200)])
    trial = Trial("s", time, displacement, 10.0 * displacement)
    phases = (
        phase("ramp", 0, 201, time, 2.0),
        phase("hold", 200, 400, time),
        phase("retract", 399, 600, time, -2.0),
    )
    log = fitted_log(trial, Segmentation(1, 1, Contact(0, 0.0, 0.01), phases, 0.1))
    assert log.data.time_s.size == 400
    assert log.data.depth_mm[-1] == pytest.approx(4.0)


def test_of_a_cycle_only_the_first_rise_is_fitted():
    time = np.arange(401) * STEP
    displacement = 2.0 * (1.0 - np.cos(2 * np.pi * time / 2.0))
    trial = Trial("s", time, displacement, 10.0 * displacement)
    phases = (phase("cycle", 0, 201, time), phase("cycle", 200, 401, time))
    log = fitted_log(trial, Segmentation(1, 1, Contact(0, 0.0, 0.01), phases, 0.1))
    assert log.data.time_s[-1] == pytest.approx(1.0)
    assert log.depth_mm == pytest.approx(4.0)
    assert not log.has_hold
    assert log.speeds_mm_s[0] == pytest.approx(4.0, rel=0.02)  # mean speed up to the peak


def test_no_contact_or_too_few_samples_give_nothing():
    trial = in_air_trial()
    without = segmented(trial)
    assert fitted_log(trial, Segmentation(1, 1, None, without.phases, 0.1)) is None
    late = Segmentation(1, 1, Contact(398, 0.5, 0.01, in_record=True), without.phases, 0.1)
    assert fitted_log(trial, late) is None
    still = Trial("s", trial.time_s, np.zeros(400), trial.force_N)
    assert fitted_log(still, Segmentation(1, 1, Contact(0, 0.0, 0.01), (), 0.1)) is None


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
