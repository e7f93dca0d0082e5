"""The contact point against the truth: bias and coverage of its sd, preload, air and its drift, overrides.

A condition of the statistics is a tissue, a way to start, a sampling rate and a force noise; its ramps are
shared out evenly over the six speeds.  Bias is the mean of error over sd, coverage the share within 1.96 sd.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from told import codes, divided, flag_of, kinds, normal, simulated

from tissueid.segment import SegmentOptions, segment
from tissueid.segment.hinge import fit_contact
from tissueid.signal_noise import quantum, white_noise_sd
from tissueid.synth import Branch, Hold, Move
from tissueid.trial import Trial, contact_frame


@pytest.mark.parametrize("preload_mm", [0.3, 0.8])
def test_preloaded_start_is_extrapolated_back(preload_mm):
    scores, rng = [], np.random.default_rng(4)
    settings = {"rate_Hz": 1000.0, "sigma_N": 0.3, "contact_offset_mm": -preload_mm}
    for _ in range(12):
        found = segment(simulated(Move(6.0, 250.0), Hold(2.0), seed=rng, **settings))
        assert "preload" in codes(found)
        scores.append((found.contact.displacement_mm + preload_mm) / found.contact.sd_mm)
    # extrapolation of a curve by 5-13 % of its length: within three of its own sd
    assert np.abs(scores).max() < 3.0


def ramp_in_air(sigma_N: float = 0.3, *, seed: int = 12, **changes) -> Trial:
    """8 mm at 250 mm/min, contact at 1 mm, 100 samples/s."""
    settings = {"rate_Hz": 100.0, "sigma_N": sigma_N, "contact_offset_mm": 1.0, **changes}
    return simulated(Move(8.0, 250.0), seed=seed, **settings)


def test_contact_frame_is_zero_at_contact():
    trial = ramp_in_air(0.05, seed=5, compression_sign=-1, rate_Hz=1000.0)
    # a load cell that is off by 5 N
    trial = replace(trial, force_N=trial.force_N + 5.0)
    found = segment(trial)
    assert found.contact.in_record
    assert found.contact.baseline_N == pytest.approx(5.0, abs=5.0 * 0.05)
    depth, force = contact_frame(trial, found)
    assert [phase.kind for phase in found.phases] == ["approach", "ramp"]
    assert found.phases[1].start == found.contact.index
    assert abs(depth[found.contact.index]) < 0.02
    assert np.abs(force[: found.contact.index].mean()) < 0.01
    assert force[-1] > 100.0


def fitted(depth_mm, force_N, noise_N):
    """The contact in a record that begins in air."""
    return fit_contact(
        depth_mm, force_N, noise_N=noise_N, noise_samples=depth_mm.size, baseline=True, reach_back_mm=0.0
    )


@pytest.mark.parametrize("factor", [1.0, 0.999, 1.7])
@pytest.mark.parametrize("seed", range(6))
def test_contact_of_a_specimen_that_slips_and_stiffens(seed, factor):
    depth_mm = np.arange(2200) * 8.3e-4
    beyond = np.maximum(depth_mm - 0.142, 0.0)
    # force falls by 1.5 N every 0.055 mm, and the stiffness is fourfold from 0.39 mm on
    slips = (beyond > 0.0) * 1.5 * np.mod(beyond / 0.055 + 0.3 * np.sin(9.0 * beyond), 1.0)
    force_N = 75.0 * beyond + 225.0 * np.maximum(beyond - 0.39, 0.0) - slips + normal(0.01, depth_mm, seed)
    found = fitted(depth_mm, factor * force_N, 0.003 * factor)
    assert found.sd_mm < 0.015
    assert abs(found.contact_mm - 0.142) < 2.0 * found.sd_mm


@pytest.mark.parametrize("contact_mm", [0.3, 0.0, -0.4])
def test_contact_of_a_coarse_record_is_the_same_in_other_units(contact_mm):
    # a scale of a power of two changes no digit: only logarithms of lengths are rounded otherwise
    for seed, speed in ((1, 250.0), (2, 30.0), (3, 250.0)):
        settings = {"rate_Hz": 10.0, "sigma_N": 1.0, "contact_offset_mm": contact_mm, "seed": seed}
        trial = simulated(Move(6.0, speed), Hold(2.0), **settings)
        contact = segment(trial).contact
        for scale in (2.0**-10, 8.0):
            scaled = segment(replace(trial, displacement_mm=scale * trial.displacement_mm)).contact
            assert scaled.sd_mm == pytest.approx(scale * contact.sd_mm, rel=1e-9)
            off = abs(scaled.displacement_mm - scale * contact.displacement_mm)
            assert off < 1e-9 * scaled.sd_mm


def test_force_that_never_rises_is_no_contact():
    time_s = np.arange(0.0, 4.0, 0.01)
    found = divided(time_s, 2.0 * time_s, normal(0.3, time_s, 6))
    assert found.contact is None
    assert "no_contact" in codes(found)
    assert kinds(found) == ["approach"]


@pytest.mark.parametrize(("speed", "sets_off_s"), [(100.0, 0.02), (100.0, 0.01), (50.0, 0.03)])
def test_a_mass_that_sets_off_is_no_specimen_that_breaks(speed, sets_off_s):
    """A tip of 0.15 kg behind the load cell gains its speed evenly, 8 mm above a tissue; then 5 mm of it."""
    stop_s = 1.0 + 13.0 / speed
    time_s = np.arange(0.0, stop_s + 10.0, 1e-3)
    rate = np.interp(time_s, [1.0, 1.0 + sets_off_s, stop_s, stop_s + sets_off_s], [0.0, speed, speed, 0.0])
    travel = np.cumsum(rate) * 1e-3 - 8.0
    depth = np.maximum(travel, 0.0)
    force = depth + 0.1 * depth**2 + 0.05 * depth**3 + 1.5e-4 * np.gradient(rate, time_s)
    found = divided(time_s, travel, force + normal(0.01, time_s, 4))
    assert "rupture" not in codes(found)
    assert kinds(found)[-2:] == ["ramp", "hold"]
    assert abs(found.contact.displacement_mm) < 3.0 * found.contact.sd_mm < 0.5


@pytest.mark.parametrize("swing_mm", [0.05, 0.3])
@pytest.mark.parametrize("rest_s", [20.0, 60.0])
def test_an_organ_that_breathes_is_met_and_held(swing_mm, rest_s):
    """The surface swings about 0 at 0.2 Hz under a stiffening tissue; the tool ends 5 mm deep, at 7 s."""
    time_s = np.arange(0.0, 7.0 + rest_s, 0.01)
    travel = np.clip(time_s - 2.0, 0.0, 5.0) * 2.0 - 5.0
    depth = np.maximum(travel + swing_mm * np.sin(0.4 * np.pi * time_s), 0.0)
    force = depth + 0.1 * depth**2 + 0.05 * depth**3
    found = divided(time_s, travel, force + normal(0.01, time_s, 2))
    assert abs(found.contact.displacement_mm) < 3.0 * found.contact.sd_mm + swing_mm
    hold = found.phases[-1]
    assert (hold.kind, time_s[hold.start]) == ("hold", pytest.approx(7.0, abs=0.02))


def test_a_reading_that_wanders_in_air_is_no_contact():
    time_s = np.arange(0.0, 60.0, 0.01)
    wandering = lfilter([1.0], [1.0, -0.99], normal(0.02, time_s, 9))
    assert "no_contact" in codes(divided(time_s, np.minimum(time_s, 10.0), wandering))


@pytest.mark.parametrize(
    ("stated_mm", "in_record", "said"), [(1.25, True, None), (-0.5, False, "before the first sample")]
)
def test_a_stated_contact_is_taken_where_it_lies(stated_mm, in_record, said):
    trial = ramp_in_air(seed=7)
    options = SegmentOptions(contact_displacement_mm=stated_mm, contact_sd_mm=0.01)
    found = segment(trial, options=options)
    contact = found.contact
    assert (contact.displacement_mm, contact.sd_mm, contact.in_record) == (stated_mm, 0.01, in_record)
    assert contact.index == int(np.searchsorted(trial.displacement_mm, stated_mm))
    assert said is None or said in flag_of(found, "starts_in_contact").message


@pytest.mark.parametrize("air_mm", [0.0, 2.0])
def test_a_soft_start_is_no_evidence_for_air_and_says_that_it_may_lie_there(air_mm):
    time, said = np.arange(0.0, 12.0, 0.01), 0
    travel = np.clip(15.0 * (time - 1.0), 0.0, 17.0)
    depth = np.maximum(travel - air_mm, 0.0)
    force = 0.02 * depth + 0.01 * depth**2 + 0.002 * depth**3
    for seed in range(4):
        found = divided(time, travel, force + normal(0.03, time, seed))
        assert abs(found.contact.displacement_mm - air_mm) <= 1.96 * found.contact.sd_mm
        said += "in air; the start is taken" in flag_of(found, "starts_in_contact").message
    assert air_mm == 0.0 or said >= 3


@pytest.mark.parametrize("n", [30, 500, 20_000])
def test_white_noise_is_measured_on_a_curved_ramp_and_a_hold(n):
    rng = np.random.default_rng(9)
    time_s = np.linspace(0.0, 10.0, n)
    clean = np.where(time_s < 5.0, 3.0 * time_s**2, 75.0)
    sd = [white_noise_sd(time_s, clean + 0.7 * rng.standard_normal(n)) for _ in range(40)]
    # the smaller of two estimates leans low where samples are few
    assert np.mean(sd) == pytest.approx(0.7, rel=0.05 + 1.5 / np.sqrt(n))


def test_quantised_force_has_at_least_the_noise_of_its_step():
    time_s = np.linspace(0.0, 10.0, 2000)
    coarse = np.round(4.0 * np.minimum(time_s, 5.0) / 0.5) * 0.5
    assert quantum(coarse) == pytest.approx(0.5)
    assert white_noise_sd(time_s, coarse) == pytest.approx(0.5 / np.sqrt(12.0))
    assert quantum(np.random.default_rng(1).standard_normal(100)) == 0.0
    # a crosshead that brakes and then stands still is not quantised
    assert quantum(np.concatenate([-(np.linspace(-1.0, 0.0, 60) ** 2), np.zeros(60)])) == 0.0


@pytest.mark.parametrize("slope", [0.05, 0.3, 0.9, 0.99, 1.1, 1.9])
def test_steps_of_a_reading_are_told_from_those_of_a_speed(slope):
    ramp = np.clip(np.arange(1200.0) - 400.0, 0.0, 400.0)
    assert quantum(np.round(slope * ramp) * 0.01, fewest=8) == pytest.approx(0.01)
    # eight pushes without noise, their corners on samples: steps of 0.2 mm are the crosshead's, at 10 Hz
    one = np.interp(np.arange(160.0), [10.0, 30.0, 130.0, 150.0], [0.0, 4.0, 4.0, 0.0])
    assert quantum(np.tile(one, 8), fewest=8) == 0.0
    assert [quantum(np.ones(n)) for n in range(4)] == [0.0] * 4


@pytest.mark.parametrize("rate_Hz", [5.0, 10.0, 50.0])
@pytest.mark.parametrize("air_s", [1.0, 2.0])
def test_a_ramp_of_few_equal_steps_is_whole(rate_Hz, air_s):
    time_s = np.arange(0.0, 14.0, 1.0 / rate_Hz)
    travel = np.clip(2.0 * (time_s - air_s), 0.0, 4.0)
    (ramp,) = divided(time_s, travel, travel + 0.2 * travel**2 + normal(0.02, time_s, 3)).of_kind("ramp")
    assert (ramp.start_s, ramp.end_s) == pytest.approx((air_s, air_s + 2.0))


@pytest.mark.parametrize("which", ["force_N", "displacement_mm"])
@pytest.mark.parametrize("at", [5, 60])
def test_one_wild_sample_does_not_move_the_contact(which, at):
    trial = ramp_in_air()
    plain = segment(trial).contact
    values = getattr(trial, which).copy()
    values[at] += 500.0 if which == "force_N" else 30.0
    hit = segment(replace(trial, **{which: values})).contact
    assert hit.in_record
    # the wild sample becomes the mean of its neighbours; a ramp that it cuts in two shows less of the shape
    assert hit.displacement_mm == pytest.approx(plain.displacement_mm, abs=2.0 * plain.sd_mm)


def test_a_load_cell_that_drifts_in_air_does_not_move_the_contact():
    trial = ramp_in_air()
    contact = segment(replace(trial, force_N=trial.force_N + 0.5 * trial.time_s)).contact
    assert contact.displacement_mm == pytest.approx(1.0, abs=3.0 * contact.sd_mm)


SOFT = {"static": (0.3, 0.05, 0.02), "branches": (Branch((0.5,), 3.0),), "contact_offset_mm": 1.3}


def soft_tissue(*moves: Move | Hold, seed: int = 0, sigma_N: float = 0.027, **changes) -> Trial:
    """Contact at 1.3 mm, 9 N at 7 mm, noise 0.3 % of it, 50 samples/s; speeds in mm/min."""
    return simulated(*moves, seed=seed, **{"rate_Hz": 50.0, "sigma_N": sigma_N, **SOFT, **changes})


def test_a_light_touch_that_is_held_places_the_contact_and_is_a_hold():
    pushes = (Hold(1.0), Move(1.6, 30.0), Hold(60.0), Move(7.0, 180.0), Hold(60.0))
    found = [segment(soft_tissue(*pushes, seed=seed, sigma_N=0.01)) for seed in range(12)]
    assert all(one.contact.in_record for one in found)
    assert all(kinds(one) == ["approach", "approach", "ramp", "hold", "ramp", "hold"] for one in found)
    errors = np.array([(one.contact.displacement_mm - 1.3) / one.contact.sd_mm for one in found])
    assert (np.abs(errors) > 2.0).sum() <= 2


@pytest.mark.parametrize("preload_mm", [1.6, 1.9])
def test_a_record_that_begins_in_the_rest_after_a_preload_has_its_contact_behind_it(preload_mm):
    errors, moves = [], (Move(preload_mm, 30.0), Hold(60.0), Move(7.0, 180.0), Hold(60.0))
    for seed in range(12):
        trial = soft_tissue(*moves, seed=seed, sigma_N=0.01)
        rest = trial.time_s > 55.0
        channels = (trial.time_s, trial.displacement_mm, trial.force_N)
        contact = divided(*(values[rest] for values in channels)).contact
        errors.append((contact.displacement_mm - 1.3) / contact.sd_mm)
    assert (np.abs(errors) > 2.0).sum() <= 2


@pytest.mark.parametrize("drift_N_per_s", [0.02, -0.02])
def test_a_drift_at_rest_hides_no_contact(drift_N_per_s):
    trial = soft_tissue(Hold(10.0), Move(7.0, 180.0), Hold(60.0))
    found = segment(replace(trial, force_N=trial.force_N + drift_N_per_s * trial.time_s))
    assert found.contact.in_record
    assert abs(found.contact.displacement_mm - 1.3) <= 3.0 * found.contact.sd_mm <= 0.5
    assert found.contact.baseline_N == pytest.approx(drift_N_per_s * 10.4, abs=0.02)


@pytest.mark.parametrize("power", [1.0, 1.5])
@pytest.mark.parametrize("peak_sd", [12.0, 20.0, 40.0])
def test_no_kink_of_the_noise_is_a_contact(peak_sd, power):
    rng = np.random.default_rng(int(10 * peak_sd + power))
    errors = []
    for _ in range(60):
        # 50 samples at rest, 60 in air, 20 in tissue
        travel = np.concatenate([np.zeros(50), np.arange(1, 81) / 80.0])
        force = peak_sd * np.maximum((travel - 0.75) / 0.25, 0.0) ** power + rng.normal(size=travel.size)
        contact = divided(np.arange(travel.size) * 0.02, travel, force).contact
        errors.append((contact.displacement_mm - 0.75) / contact.sd_mm)
    # 60 intervals of 95 %, and what a start without a slope hides in noise
    assert (np.abs(errors) > 2.0).sum() <= (8 if power == 1.0 else 16)
    assert np.sqrt(np.mean(np.square(errors))) < 1.8


@pytest.mark.parametrize("moved_mm", [0.0, 0.5])
def test_a_contact_after_loops_that_let_go_knows_of_the_first_one(moved_mm):
    time = np.arange(0.0, 60.0, 0.02)
    travel = np.interp(time, [0, 1, 3, 5, 7, 9, 11, 13, 15, 18, 60], [0, 0, 4, 0, 4, 0, 4, 0, 0, 6, 6])
    surface = 1.0 + moved_mm * (time > 5.0)
    found = divided(time, travel, np.maximum(travel - surface, 0.0) + normal(0.005, time, 3))
    assert kinds(found)[-4:] == ["rest", "approach", "ramp", "hold"]
    # the first one is the tissue's, the other's distance its sd: nobody knows whether it comes back
    assert found.contact.displacement_mm == pytest.approx(1.0, abs=0.03)
    assert abs(found.contact.displacement_mm - 1.0 - moved_mm) < 2.0 * found.contact.sd_mm
    told = "contact_uncertain" in codes(found)
    assert told is (found.contact.sd_mm > 0.2) is (moved_mm > 0.0)


@pytest.mark.parametrize("scale", [(1.0, 1.0, 1.0), (1e-3, 1e-4, 1e-6), (1e2, 1e3, 1e4)])
def test_a_recording_without_noise_has_its_contact_at_any_scale(scale):
    seconds, mm, newtons = scale
    trial = ramp_in_air(sigma_N=0.0)
    found = divided(trial.time_s * seconds, trial.displacement_mm * mm, trial.force_N * newtons).contact
    assert found.in_record
    assert 0.0 < found.sd_mm < 0.02 * mm
    # the branch's first rise lies between two samples 0.04 mm apart
    assert found.displacement_mm == pytest.approx(mm, abs=0.02 * mm)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_stated_contact_that_is_never_reached_is_none_and_says_the_range(sign):
    trial = ramp_in_air(compression_sign=sign)
    found = segment(trial, options=SegmentOptions(contact_displacement_mm=sign * 12.0))
    assert found.contact is None
    flag = flag_of(found, "no_contact")
    ends = (trial.displacement_mm.min(), trial.displacement_mm.max())
    assert (flag.values["from_mm"], flag.values["to_mm"]) == pytest.approx(ends)
    assert "never reached" in flag.message


@pytest.mark.parametrize(
    "kind", ["flat", "spiked force", "spiked travel", "Cauchy force", "Cauchy travel", "steep"]
)
def test_wild_recordings_are_divided_without_a_warning(kind):
    """Warnings are errors here: no overflow, no singular matrix, whatever the numbers."""
    rng = np.random.default_rng(13)
    for n in (3, 7, 40, 300):
        time_s = 0.01 * np.arange(n)
        depth = np.linspace(0.0, float(rng.choice([1e-6, 8.0, 1e3])), n)
        force = np.maximum(depth - 0.3 * depth[-1], 0.0) * float(rng.choice([1e-9, 1.0, 1e6]))
        wild = {
            "flat": (depth, np.ones(n)),
            "spiked force": (depth, force + 1e12 * (rng.random(n) < 0.02)),
            "spiked travel": (depth + 1e6 * (rng.random(n) < 0.02), force),
            "Cauchy force": (depth, rng.standard_cauchy(n)),
            "Cauchy travel": (np.cumsum(rng.standard_cauchy(n)), force),
            "steep": (depth, np.exp(np.linspace(0.0, 200.0, n))),
        }[kind]
        contact = divided(time_s, *wild).contact
        assert contact is None or (np.isfinite(contact.displacement_mm) and contact.sd_mm >= 0.0)


def test_a_curved_tip_after_clear_air_is_not_in_contact_from_the_start():
    """A force that begins without a slope (Hertz): 0.6 s in air, noise of a fortieth to a four hundredth."""
    rng, scores = np.random.default_rng(11), []
    time = np.arange(0.0, 6.0, 0.01)
    for depth in (2.0, 4.0, 6.0, 9.0):
        for _ in range(5):
            at = 1.2 * depth + float(rng.normal(0.0, 0.02))
            travel = np.interp(time, [0.0, 1.1], [0.0, 2.2 * depth])
            force = 8.0 * np.maximum(travel - at, 0.0) ** 1.5 + 0.5 * rng.standard_normal(time.size)
            found = divided(time, travel, force)
            assert found.contact.in_record
            assert "starts_in_contact" not in codes(found)
            scores.append((found.contact.displacement_mm - at) / found.contact.sd_mm)
    # the form at contact is no polynomial: within three of its errors, not two
    assert (np.abs(scores) < 3.5).all()


@pytest.mark.parametrize("noise_N", [2e-4, 1e-3, 1e-2])
def test_a_contact_that_no_shape_describes_is_as_uncertain_as_the_misfit_whatever_the_noise(noise_N):
    # stiffness that is lost within 20 um: far from a cubic with one branch, next to no noise
    depth = np.linspace(-0.5, 6.0, 2000)
    x = np.maximum(depth, 0.0)
    found = fitted(depth, 60.0 * np.expm1(0.2 * x) - 8.0 * np.expm1(-x / 0.02) + 20.0 * np.sqrt(x), noise_N)
    assert not found.adequate
    assert abs(found.contact_mm) <= 2.0 * found.sd_mm
    assert found.sd_mm <= 0.002


@pytest.mark.parametrize("sign", [1, -1])
def test_a_tool_that_is_dragged_through_air_meets_the_tissue_where_the_force_grows(sign: int) -> None:
    time = np.arange(0.0, 12.0, 0.01)
    depth = np.clip(time - 2.0, 0.0, 6.5)
    deep = np.maximum(depth - 1.5, 0.0)
    force = 0.5 * deep + 0.1 * deep**2 + 0.1 * ((time > 2.0) & (time < 8.5)) + normal(0.005, time, 3)
    found = divided(time, sign * depth, sign * force)
    assert found.contact.in_record
    assert abs(sign * found.contact.displacement_mm - 1.5) < 3.0 * found.contact.sd_mm < 0.1
    assert sign * found.contact.baseline_N == pytest.approx(0.1, abs=0.005)
    assert flag_of(found, "drag").values["drag_N"] == pytest.approx(0.1, abs=0.01)


def test_a_force_that_goes_on_as_it_leapt_is_tissue_and_no_drag() -> None:
    time = np.arange(0.0, 12.0, 0.01)
    deep = np.clip(time - 2.0, 0.0, 6.5)
    # a fast branch leaps as a drag does; the static curve behind it rises
    force = 0.02 * deep + 0.1 * deep**2 + 0.1 * ((time > 2.0) & (time < 8.5)) + normal(0.005, time, 4)
    assert "drag" not in codes(divided(time, deep, force))


def test_logs_that_start_in_contact_are_seldom_cut():
    # a stiffness that grows from nothing; 14 where air is believed at 2 sd
    rng = np.random.default_rng(3)
    settings = {"rate_Hz": 1000.0, "sigma_N": 1.0, "branches": (Branch((0.0, 63.62), 0.021),)}
    trials = (simulated(Move(8.0, 250.0), seed=rng, **settings) for _ in range(100))
    assert sum(segment(one).contact.in_record for one in trials) <= 11


@pytest.mark.parametrize(("zero_N", "baseline_N", "preloaded"), [(-5.0, -5.0, False), (5.0, 0.0, True)])
def test_a_force_at_rest_is_the_zero_of_the_load_cell_where_negative_and_a_preload_where_positive(
    zero_N, baseline_N, preloaded
):
    # 1 s at rest on the surface, a ramp of 2 mm in 1 s, 10 s hold; 100 Hz, 10 N/mm, noise 0.01 N
    time = np.arange(1200) * 0.01
    depth = 2.0 * np.clip(time - 1.0, 0.0, 1.0)
    found = divided(time, depth, 10.0 * depth + zero_N + normal(0.01, time, 3))
    # mean of 100 samples of noise 0.01 N: sd 0.001 N
    assert found.contact.baseline_N == pytest.approx(baseline_N, abs=0.005)
    assert preloaded or abs(found.contact.displacement_mm) <= 4.0 * found.contact.sd_mm
    assert ("preload" in codes(found)) is preloaded


def test_a_force_that_relaxes_below_its_zero_before_the_ramp_was_zeroed_in_contact() -> None:
    # 30 s at rest 1 mm deep, where the force was zeroed, a ramp of 4 mm, a hold
    time = np.arange(0.0, 60.0, 0.01)
    pushed = np.clip(time - 30.0, 0.0, 4.0)
    relaxed = 0.05 * np.expm1(-time / 15.0)
    force = 0.4 * pushed + 0.1 * pushed**2 + relaxed + normal(0.005, time, 5)
    found = divided(time, pushed, force)
    assert "zeroed in contact" in flag_of(found, "contact_uncertain").message
    # a load cell that holds its zero there says nothing of the kind
    assert "contact_uncertain" not in codes(divided(time, pushed, force - relaxed - 0.02))


def in_air(
    seed: int, *, drift: float = 0.0, noise: str = "white", softness: float = 1.0, rate: float = 100.0
) -> Trial:
    """6 s in air, 4 s of ramp at 1 mm/s, 10 s of hold; drift in N/s, noise of 0.05 N."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 20.0, 1.0 / rate)
    x = np.minimum(time, 10.0)
    depth = np.maximum(x - 6.0, 0.0)
    off = rng.normal(0.0, 0.05, time.size)
    if noise == "correlated":
        for i in range(1, off.size):
            off[i] += 0.7 * off[i - 1]
    elif noise == "hum":
        off += 0.1 * np.sin(2.0 * np.pi * 50.0 * time + rng.uniform(0.0, 6.0))
    force = (10.0 if softness == 1.0 else 0.0) * depth + 2.0 * depth**2 + drift * time + off
    return Trial("s", time, x, force)


@pytest.mark.parametrize("noise", ["white", "correlated", "hum"])
@pytest.mark.parametrize("softness", [1.0, 2.0])
@pytest.mark.parametrize("rate", [20.0, 100.0])
def test_steady_zeros_are_no_drift(noise: str, softness: float, rate: float) -> None:
    found = [segment(in_air(seed, noise=noise, softness=softness, rate=rate)) for seed in range(8)]
    # 0.03 N/s: half a newton by the end, of 72
    found.append(segment(in_air(2, drift=0.03)))
    assert not any("baseline_drift" in codes(one) for one in found)


@pytest.mark.parametrize("drift", [-0.5, 0.2, 1.0])
def test_a_drift_is_told_with_its_slope(drift: float) -> None:
    flag = flag_of(segment(in_air(1, drift=drift)), "baseline_drift")
    assert flag.values["slope_N_per_s"] == pytest.approx(drift, abs=5 * flag.values["slope_sd_N_per_s"])
    # from the middle of what was looked at, 2.4 s, to the end at 20 s
    assert flag.values["by_the_end_N"] == pytest.approx(drift * 17.6, rel=0.15)


def test_a_specimen_that_pulls_from_the_start_is_no_drift() -> None:
    # a stiff specimen with a weak toe: half the stiffness over the first third of the travel
    time = np.arange(0.0, 30.0, 0.02)
    x = 0.02 * np.minimum(time, 20.0)
    force = 1000.0 * x + 1000.0 * np.maximum(x - 0.12, 0.0) + normal(0.5, time, 3)
    assert "baseline_drift" not in codes(divided(time, x, force))


@pytest.mark.parametrize("step_N", [0.05, 0.2, 0.5])
def test_digits_without_noise_are_no_noise_and_part_of_the_contact_s_sd(step_N):
    time_s = np.arange(0.0, 30.0, 0.01)
    travel = np.interp(time_s, [0.0, 5.0], [-1.0, 4.0])
    depth = np.maximum(travel, 0.0)
    force = (1.0 * depth + 0.1 * depth**2) * (0.7 + 0.3 * np.exp(-np.maximum(time_s - 5.0, 0.0) / 2.0))
    contact = divided(time_s, travel, np.round(force / step_N) * step_N).contact
    assert contact.in_record
    assert abs(contact.displacement_mm) < 2.5 * contact.sd_mm
    assert contact.sd_mm < 0.3 * step_N + 0.02


SPEEDS_MM_MIN = (10.0, 70.0, 100.0, 150.0, 250.0, 500.0)
DEPTH_MM = 8.0
#: Bars of the issue.
BIAS = 0.3
COVERAGE = (0.92, 0.98)
#: 1,000 and more ramps a condition in the slow run.
RUNS = 1020
CONSTANT = (Branch((63.62,), 0.021),)
TISSUES = {
    "seed": ((20.0, -1.2, 0.35), CONSTANT),
    "growing K": ((20.0, -1.2, 0.35), (Branch((63.62, 10.0), 0.021),)),
    "Table 1": ((47.42, -5.577, 0.3804), CONSTANT),
    "soft toe": ((0.5, 0.0, 0.43), CONSTANT),
    "slow branch": ((20.0, -1.2, 0.35), (Branch((5.0,), 5.0),)),
}


@dataclass(frozen=True)
class Condition:
    rate_Hz: float
    sigma_N: float
    tissue: str = "seed"
    start: str = "air"

    def __str__(self) -> str:
        return f"{self.tissue}, {self.start}, {self.rate_Hz:g} Hz, {self.sigma_N:g} N"


def one_score(condition: Condition, speed: float, rng: np.random.Generator) -> tuple[float, float]:
    """Error and stated sd of one ramp [mm]; a load cell that is off by up to 5 sigma in air."""
    static, branches = TISSUES[condition.tissue]
    offset = float(rng.uniform(0.6, 1.6) if condition.start == "air" else -rng.uniform(0.3, 0.8))
    trial = simulated(
        Move(DEPTH_MM, speed), seed=rng, rate_Hz=condition.rate_Hz, static=static, branches=branches,
        sigma_N=condition.sigma_N, contact_offset_mm=offset,
    )  # fmt: skip
    # at 10 samples/s a reading that is off can't be told from a preload: there the cell is tared
    zero = 5.0 * condition.sigma_N * float(rng.uniform(-1.0, 1.0))
    zero *= condition.start == "air" and condition.rate_Hz > 10.0
    contact = divided(trial.time_s, trial.displacement_mm - 2.0, trial.force_N + zero).contact
    return contact.displacement_mm + 2.0 - offset, contact.sd_mm


def scores(condition: Condition, *, runs: int, seed: int) -> NDArray[np.float64]:
    """Errors and sds, shape (speeds, runs each, 2) [mm]."""
    rng = np.random.default_rng(seed)
    each = runs // len(SPEEDS_MM_MIN)
    return np.array([[one_score(condition, v, rng) for _ in range(each)] for v in SPEEDS_MM_MIN])


def bias(found: NDArray[np.float64]) -> float:
    return float((found[..., 0] / found[..., 1]).mean())


def coverage(found: NDArray[np.float64]) -> float:
    return float((np.abs(found[..., 0]) <= 1.959964 * found[..., 1]).mean())


@pytest.mark.parametrize(("rate_Hz", "sigma_N"), [(100.0, 0.02), (100.0, 0.3), (100.0, 3.0), (1000.0, 0.3)])
def test_the_interval_of_a_contact_in_the_record_covers_it(rate_Hz: float, sigma_N: float) -> None:
    found = scores(Condition(rate_Hz, sigma_N), runs=72, seed=31)
    # 72 scores of sd 1: the mean has sd 0.12, and 63 or more are inside with probability 0.99
    assert abs(np.median(found[..., 0] / found[..., 1])) <= BIAS + 2.6 * 0.12
    assert round(72 * coverage(found)) >= 63


MAIN = [Condition(rate, sigma) for rate in (10.0, 100.0, 1000.0) for sigma in (0.02, 0.3, 1.0, 3.0)]
OTHERS = [Condition(100.0, 0.3, tissue) for tissue in TISSUES if tissue != "seed"]
OTHERS += [Condition(100.0, sigma, start="preloaded") for sigma in (0.02, 0.3, 3.0)]
OTHERS += [Condition(100.0, 0.3, "growing K", "preloaded")]
#: Bars that are not reached, with the figure of 1,020 ramps and why.
NO_HOLD = "bias -1.2, coverage 100 %: without a hold nothing tells how much of the stiffness relaxes"
FEW = "coverage 99.8 %: in one ramp of six the first sample is quoted, with an sd of its distance to the air"
SHORT = {
    Condition(10.0, 0.3): FEW,
    Condition(10.0, 1.0): FEW,
    Condition(10.0, 3.0): "bias -0.47: as with less noise",
    Condition(100.0, 0.02, start="preloaded"): NO_HOLD,
    Condition(100.0, 0.3, start="preloaded"): NO_HOLD,
    Condition(100.0, 3.0, start="preloaded"): "bias -0.6: as with less noise",
    Condition(100.0, 0.3, "growing K", "preloaded"): NO_HOLD,
}


def marked(condition: Condition) -> object:
    reason = SHORT.get(condition)
    marks = pytest.mark.xfail(reason=reason, strict=True) if reason else ()
    return pytest.param(condition, marks=marks, id=str(condition))


@pytest.mark.slow
@pytest.mark.parametrize("condition", [marked(one) for one in MAIN + OTHERS])
def test_bias_and_coverage_are_within_the_bars(condition: Condition) -> None:
    found = scores(condition, runs=RUNS, seed=47)
    # 12 + 8 conditions: a band of 99 % for all of them is 3.5 sd of one, 0.11 in the mean, 2.4 points here
    assert abs(bias(found)) <= BIAS + 3.5 / np.sqrt(RUNS)
    assert COVERAGE[0] - 0.024 <= coverage(found) <= COVERAGE[1] + 0.015
