"""Phases of known programs, decisions of the user, and recordings that are no test at all.

Every phase of a program is found, at its corner, and none is invented; stairs, noise, jumps, equal times,
jitter and nothing in the force are divided without an error.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from told import codes, divided, flag_of, kinds, normal, simulated

from tissueid.inference.window import fitted_log
from tissueid.segment import SegmentOptions, segment
from tissueid.segment.motion import _held_step, _moving, path_noise
from tissueid.synth import Hold, Move, as_trials, recipe, simulate
from tissueid.trial import Protocol, Source, Trial


def trial_of(*moves: Move | Hold, **changes) -> Trial:
    return simulated(*moves, **{"rate_Hz": 100.0, "sigma_N": 0.5, **changes})


@pytest.mark.parametrize("rate_Hz", [10.0, 100.0, 1000.0])
def test_each_log_of_the_named_protocol_is_divided_at_its_corner(rate_Hz):
    logs = simulate(replace(recipe("paper-a-30"), rate_Hz=rate_Hz), rng=np.random.default_rng(3))
    for log, trial in zip(logs[:10], as_trials(logs)[:10], strict=True):
        found = segment(trial)
        held = log.truth["hold_s"] > 0.0
        assert kinds(found) == (["ramp", "hold"] if held else ["ramp"]), log.name
        assert ("no_hold" in codes(found)) is not held
        if held:
            speed = log.truth["speed_mm_s"]
            corner = log.truth["depth_mm"] / speed
            assert found.phases[1].start_s == pytest.approx(corner, abs=1.0 / rate_Hz)
            # chord of a ramp whose corner lies between samples
            assert found.phases[0].speed_mm_s == pytest.approx(speed, rel=1.5 / (corner * rate_Hz))
        assert found.compression_sign == found.force_sign == 1
        contact = found.contact
        assert (contact.in_record, contact.index) == (False, 0), log.name
        assert (contact.baseline_N, contact.displacement_mm) == (0.0, 0.0)
        # what 1 N of noise hides, and what lies between two samples
        assert 0.0 < contact.sd_mm < 0.2 + log.truth["speed_mm_s"] / rate_Hz
        assert "starts_in_contact" in codes(found)
        assert "preload" not in codes(found)


LOOP = (Move(2.0, 200.0), Move(0.2, 200.0))
STEPS = tuple(step for k in range(1, 5) for step in (Move(float(k), 100.0), Hold(2.0)))


@pytest.mark.parametrize(
    ("moves", "expected", "said"),
    [
        ((*LOOP * 3, Move(4.0, 200.0), Hold(5.0)), ["cycle"] * 3 + ["ramp", "hold"], set()),
        (STEPS, ["ramp", "hold"] * 4, {"several_steps"}),
        ((Move(4.0, 250.0), Hold(3.0), Move(0.5, 250.0)), ["ramp", "hold", "retract"], set()),
        ((Move(8.0, 10.0), Hold(0.3)), ["ramp"], {"no_hold"}),
    ],
    ids=["preconditioning before a test", "several steps", "a retract", "dwell of a stop after a long ramp"],
)
def test_programs_have_their_phases(moves, expected, said):
    found = segment(trial_of(*moves))
    assert kinds(found) == expected
    assert codes(found) & {"several_steps", "no_hold"} == said


def test_user_may_ask_for_short_holds():
    trial = trial_of(Move(8.0, 10.0), Hold(0.3))
    assert kinds(segment(trial, options=SegmentOptions(minimum_hold_s=0.2))) == ["ramp", "hold"]


@pytest.mark.parametrize("sign", [1, -1])
def test_signs_follow_the_dominant_excursion_and_the_user_wins(sign):
    trial = trial_of(Move(4.0, 250.0), Hold(2.0), compression_sign=sign)
    found = segment(trial)
    assert (found.compression_sign, found.force_sign) == (sign, sign)
    forced = segment(trial, options=SegmentOptions(compression_sign=-sign, force_sign=-sign))
    assert (forced.compression_sign, forced.force_sign) == (-sign, -sign)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("pulls_N", [0.0, 0.8])
def test_a_crosshead_that_goes_home_through_air_leaves_the_push_where_it_was(sign, pulls_N):
    """A push of 8 mm, 5 of them in tissue, and 40 mm back, past the start; tissue may stick to the tool."""
    time_s = np.arange(0.0, 46.0, 0.01)
    travel = np.interp(time_s, [1.0, 9.0, 42.0, 42.8], [-3.0, 5.0, 5.0, -35.0])
    force = 4.0 * np.maximum(travel, 0.0) * (0.7 + 0.3 * np.exp(-np.maximum(time_s - 9.0, 0.0) / 5.0))
    force -= pulls_N * ((time_s > 42.0) & (travel < 0.0) & (travel > -6.0))
    found = divided(time_s, sign * travel, sign * (force + normal(0.01, time_s, 3)))
    assert (found.compression_sign, found.force_sign) == (sign, sign)
    assert kinds(found) == ["approach", "approach", "ramp", "hold", "retract", "rest"]
    assert "sign_assumed" not in codes(found)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_record_that_begins_deep_in_the_tissue_is_not_read_upside_down(sign):
    """3 s of a hold 5 mm deep that was not recorded from its start, out into air, and the push 40 s later."""
    time_s = np.arange(0.0, 95.0, 0.01)
    travel = np.interp(time_s, [3.0, 6.0, 46.0, 55.0], [5.0, -4.0, -4.0, 5.0])
    relaxed = 0.7 + 0.3 * np.exp(-np.maximum(time_s - 55.0, 0.0) / 5.0) * (time_s > 46.0)
    force = 4.0 * np.maximum(travel, 0.0) * relaxed + normal(0.01, time_s, 3)
    found = divided(time_s, sign * travel, sign * force)
    assert (found.compression_sign, found.force_sign) == (sign, sign)
    assert kinds(found)[-2:] == ["ramp", "hold"]
    assert sign * found.contact.displacement_mm == pytest.approx(0.0, abs=3.0 * found.contact.sd_mm)
    assert found.contact.in_record


def test_force_against_the_travel_is_said():
    trial = trial_of(Move(4.0, 250.0), Hold(2.0))
    found = divided(trial.time_s, -trial.displacement_mm, trial.force_N)
    assert (found.compression_sign, found.force_sign) == (-1, 1)
    assert "tension" in codes(found)


def test_a_gap_that_closes_under_the_force_is_no_tension():
    trial = trial_of(Move(4.0, 250.0), Hold(2.0))
    for name, said in (("Corrected Gap", False), ("Position", True)):
        source = Source("a.csv", columns={"displacement": name})
        gap = Trial("t", trial.time_s, 12.0 - trial.displacement_mm, trial.force_N, source=source)
        assert ("tension" in codes(segment(gap))) == said


def test_a_standing_record_has_no_phases_and_no_contact():
    found = divided(np.arange(10.0), np.full(10, 2.0), np.zeros(10))
    assert found.phases == ()
    assert found.contact is None
    assert {"too_few_samples", "no_hold"} <= codes(found)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"compression_sign": 0}, "compression_sign"),
        ({"force_sign": 2}, "force_sign"),
        ({"contact_sd_mm": -1.0}, "contact_sd_mm"),
        ({"hold_from_s": 5.0, "end_s": 4.0}, "must end after it starts"),
    ],
)
def test_senseless_options_are_refused(given, said):
    with pytest.raises(ValueError, match=said):
        SegmentOptions(**given)


def test_a_long_slow_noisy_recording_keeps_its_phases():
    # 200,000 samples: noise of 5 sd is in it, and 15 samples pass before the tool has moved by one sd
    n = 200_000
    time_s = np.arange(n) * 1e-3
    corners = np.array([0.0, 40.0, 100.0, 140.0, 180.0, n * 1e-3])
    depth = np.interp(time_s, corners, [0.0, 4.0, 4.0, 2.0, 6.0, 6.0])
    rng = np.random.default_rng(12)
    noisy = depth + 1.5e-3 * rng.standard_normal(n)
    found = divided(time_s, noisy, 10.0 * depth + 0.2 * rng.standard_normal(n))
    assert kinds(found) == ["ramp", "hold", "retract", "ramp", "hold"]
    starts = [phase.start_s for phase in found.phases[1:]]
    # lines through 200 samples meet within 1.5e-3 mm sqrt(8/200) / 0.05 mm/s: 6 samples, 2 sd
    assert starts == pytest.approx(corners[1:-1].tolist(), abs=0.015)


def log(*, specimen: str = "knee", path: str = "knee.csv") -> Trial:
    """A ramp of 1 mm/s to 4 mm at 50 Hz, and 10 s of hold whose force decays."""
    time = np.arange(0.0, 14.0, 0.02)
    depth = np.minimum(time, 4.0)
    force = 2.0 * depth + 3.0 * np.where(time < 4.0, depth, 4.0 * np.exp(-(time - 4.0) / 2.0))
    return Trial(specimen, time, depth, force, source=Source(path=path))


def test_a_hold_begins_and_ends_where_it_is_said() -> None:
    found = segment(log(), options=SegmentOptions(hold_from_s=4.5, end_s=9.0))
    ramp, hold = found.phases[-2:]
    assert (ramp.kind, hold.kind) == ("ramp", "hold")
    assert ramp.end_s == hold.start_s == pytest.approx(4.5)
    assert hold.end_s == pytest.approx(9.0)
    flag = flag_of(found, "decision_overridden")
    assert flag.values["keys"] == ["end_s", "hold_from_s"]
    assert "4.5" in flag.message
    assert "9.0" in flag.message


def test_a_hold_is_made_in_a_ramp_where_there_is_none() -> None:
    time = np.arange(0.0, 20.0, 0.02)
    assert "hold" not in kinds(divided(time, time, 2.0 * time))
    last = divided(time, time, 2.0 * time, hold_from_s=12.0).phases[-1]
    assert (last.kind, last.start_s) == ("hold", pytest.approx(12.0))


@pytest.mark.parametrize("pattern", ["knee*", "*/knee.csv", "knee.csv", "patient-7"])
def test_patterns_fit_path_file_or_specimen(pattern: str) -> None:
    options = SegmentOptions(exclude=(pattern,))
    assert options.excludes(log(specimen="patient-7", path="lab/knee.csv")) == pattern
    assert options.excludes(log(specimen="other", path="lab/hip.csv")) is None


def odd(rng: np.random.Generator) -> tuple[Trial, SegmentOptions]:
    """Any path with any force, few samples or many, some at one time."""
    n = int(rng.integers(2, 60)) if rng.random() < 0.5 else int(rng.integers(60, 400))
    steps = rng.choice([0.0, 0.01, 0.02, 1.0], n) * rng.random(n)
    time = np.arange(n) * 0.01 if rng.random() < 0.3 else np.cumsum(steps)
    depth = [
        lambda: rng.normal(0.0, 1.0, n),
        lambda: np.zeros(n),
        lambda: np.cumsum(rng.normal(0.0, 1.0, n)),
        lambda: np.repeat(rng.normal(0.0, 1.0, n // 5 + 1), 5)[:n],
        lambda: np.interp(np.arange(n), np.sort(rng.integers(0, n, 5)), rng.normal(0.0, 3.0, 5)),
        lambda: np.sin(np.arange(n) * rng.uniform(0.01, 1.0)),
        lambda: np.round(np.cumsum(rng.normal(0.1, 1.0, n))),
    ][int(rng.integers(7))]()
    force = [
        rng.normal(0.0, 1.0, n), 10.0 * depth, np.zeros(n), np.maximum(depth, 0.0) ** 2, 1e-9 * depth,
        1e6 * depth,
    ][int(rng.integers(6))]  # fmt: skip
    middle = float(time[n // 3])
    cut = rng.random() < 0.1 and middle < time[-1]
    options = SegmentOptions(
        contact_displacement_mm=float(rng.normal()) if rng.random() < 0.2 else None,
        minimum_hold_s=0.01 if rng.random() < 0.2 else None,
        start_s=middle if cut else None,
        end_s=float(time[-1]) if cut else None,
    )
    stated = Protocol(depth_mm=5.0, hold_s=1.0, load_limit_N=3.0) if rng.random() < 0.5 else Protocol()
    return Trial("odd", time, depth, force, stated), options


def test_anything_is_divided_without_an_error() -> None:
    rng = np.random.default_rng(99)
    for case in range(250):
        trial, options = odd(rng)
        with np.errstate(all="ignore"):
            found = segment(trial, options=options)
            fitted_log(trial, found)
        assert all(a.stop - 1 == b.start for a, b in pairwise(found.phases)), case
        assert all(phase.start <= phase.stop - 1 < trial.time_s.size for phase in found.phases), case
        numbers = [corner.duration_s for corner in found.corners]
        numbers += [value for event in found.events for value in event.values.values()]
        assert np.isfinite(numbers).all(), case


RAMP_S, HOLD_S, CONTACT_MM, SPEED_MM_S = 6.0, 60.0, 1.0, 1.0


def assert_one_ramp(found, *, stop_within_s: float = np.inf, contact_within_mm: float = 0.02) -> None:
    """Approach, ramp and hold, their stop and contact in place."""
    assert kinds(found) == ["approach", "ramp", "hold"]
    assert found.phases[2].start_s == pytest.approx(RAMP_S, abs=stop_within_s)
    assert found.contact.displacement_mm == pytest.approx(CONTACT_MM, abs=contact_within_mm)


def recording(rate_hz: float, *, noise_mm: float = 3e-4) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A ramp of 6 mm at 1 mm/s, contact after 1 mm, and its hold."""
    rng = np.random.default_rng(11)
    time = np.arange(0.0, RAMP_S + HOLD_S, 1.0 / rate_hz)
    travel = SPEED_MM_S * np.minimum(time, RAMP_S)
    depth = np.maximum(travel - CONTACT_MM, 0.0)
    kept = np.where(time > RAMP_S, 0.7 + 0.3 * np.exp(-np.maximum(time - RAMP_S, 0.0) / 5.0), 1.0)
    force = (2.0 * depth + 0.3 * depth**3) * kept
    return time, travel + rng.normal(0.0, noise_mm, time.size), force + rng.normal(0.0, 0.01, time.size)


@pytest.mark.parametrize(("rate_hz", "held"), [(100.0, 2), (100.0, 5), (100.0, 10), (50.0, 5), (500.0, 50)])
@pytest.mark.parametrize("noise_mm", [0.0, 3e-4])
def test_a_displacement_sampled_slower_than_the_force_is_one_ramp(rate_hz, held, noise_mm) -> None:
    time, travel, force = recording(rate_hz, noise_mm=noise_mm)
    found, period = divided(time, travel[np.arange(travel.size) // held * held], force), held / rate_hz
    # a held displacement lags by half of its period
    assert_one_ramp(found, stop_within_s=1.5 * period, contact_within_mm=SPEED_MM_S * period + 0.02)


@pytest.mark.parametrize("share", [0.3, 0.45])
def test_stamps_that_jitter_make_no_moves(share: float) -> None:
    time, travel, force = recording(100.0)
    stamps = time + np.random.default_rng(1).uniform(-share, share, time.size) * 0.01
    assert_one_ramp(divided(stamps, travel, force), stop_within_s=0.03)


def test_neither_a_fast_ramp_beside_a_long_hold_nor_a_bend_is_noise() -> None:
    time = np.arange(0.0, 60.0, 0.01)
    noise = normal(3e-4, time, 2)
    fast = np.minimum(20.0 * time, 4.0)
    assert path_noise(time, fast + noise) < 4e-3
    assert _held_step(np.round(fast, 2), _moving(np.round(fast, 2))) == 0.0
    sine = 2.0 * np.sin(2.0 * np.pi * 0.5 * time)
    assert path_noise(time, sine + noise) < 4e-3


@pytest.mark.parametrize(
    ("approach_mm_s", "ramp_mm_s", "air_mm"),
    [(1.0, 1.1, 10.0), (1.0, 1.5, 10.0), (1.0, 2.0, 3.0), (1.0, 2.0, 40.0), (3.0, 2.0, 20.0)],
)
def test_a_ramp_at_nearly_the_speed_of_its_approach_is_found_and_ends_at_its_stop(
    approach_mm_s: float, ramp_mm_s: float, air_mm: float
) -> None:
    turn_s = 1.0 + air_mm / approach_mm_s
    stop_s = turn_s + 3.0 / ramp_mm_s
    time = np.arange(0.0, stop_s + 30.0, 0.05)
    noise = np.random.default_rng(5).standard_normal((2, time.size))
    travel = np.interp(time, [0.0, 1.0, turn_s, stop_s], [0.0, 0.0, air_mm, air_mm + 3.0])
    depth = np.clip(travel - air_mm - 0.2, 0.0, None)
    kept = 0.7 + 0.3 * np.exp(-np.maximum(time - stop_s, 0.0) / 5.0)
    force = (2.0 * depth + 0.3 * depth**2) * kept
    found = divided(time, travel + 2e-4 * noise[0], force + 2e-3 * noise[1])
    ramp, hold = found.of_kind("ramp")[-1], found.of_kind("hold")[0]
    assert found.contact.displacement_mm == pytest.approx(air_mm + 0.2, abs=3.0 * found.contact.sd_mm)
    assert found.contact.sd_mm < 0.05
    assert ramp.speed_mm_s == pytest.approx(ramp_mm_s, rel=0.01)
    assert (ramp.end_s, hold.start_s) == pytest.approx((stop_s, stop_s), abs=0.051)


@pytest.mark.parametrize("value", [0.0, 50.0])
def test_a_single_sample_far_off_parts_no_ramp(value: float) -> None:
    time, travel, force = recording(100.0)
    travel[300] = value
    assert_one_ramp(divided(time, travel, force))


@pytest.mark.parametrize("samples", [1, 2, 3, 5])
def test_a_step_of_few_samples_and_its_hold_are_told(samples: int) -> None:
    time = np.arange(0.0, 12.0, 0.01)
    travel = np.interp(time, [1.0, 1.0 + 0.01 * samples], [-0.5, 4.0])
    force = 2.0 * np.maximum(travel, 0.0) * (0.6 + 0.4 * np.exp(-np.maximum(time - 1.0, 0.0) / 2.0))
    found = divided(time, travel, force + normal(0.01, time, 4))
    assert kinds(found) == ["approach", "ramp", "hold"]
    assert found.phases[-1].start_s == pytest.approx(1.0, abs=0.011 * samples + 0.011)
    assert abs(found.contact.displacement_mm) < 2.5 * found.contact.sd_mm
