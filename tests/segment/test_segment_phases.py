"""Phases of known programs: every one found, at its corner, and none invented."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from tissueid.segment import SegmentOptions, segment
from tissueid.synth import Hold, Log, Move, Recipe, as_trials, recipe, simulate
from tissueid.trial import Trial

EDGE_SAMPLES = 3


def trial_of(log: Log, seed: int = 0, **changes) -> Trial:
    settings = Recipe("test", (log,), **{"rate_Hz": 100.0, "sigma_N": 0.5, **changes})
    return as_trials(simulate(settings, rng=np.random.default_rng(seed)))[0]


def kinds(segmentation) -> list[str]:
    return [phase.kind for phase in segmentation.phases]


def codes(segmentation) -> set[str]:
    return {flag.code for flag in segmentation.flags}


@pytest.mark.parametrize("rate_Hz", [10.0, 100.0, 1000.0])
def test_each_log_of_the_named_protocol_is_divided_at_its_corner(rate_Hz):
    logs = simulate(replace(recipe("paper-a-30"), rate_Hz=rate_Hz), rng=np.random.default_rng(2))
    for log, trial in zip(logs[:10], as_trials(logs)[:10], strict=True):
        found = segment(trial)
        held = log.truth["hold_s"] > 0.0
        assert kinds(found) == (["ramp", "hold"] if held else ["ramp"]), log.name
        assert ("no_hold" in codes(found)) is not held
        if held:
            corner = log.truth["depth_mm"] / log.truth["speed_mm_s"]
            assert found.phases[1].start_s == pytest.approx(corner, abs=1.0 / rate_Hz)
            # chord of a ramp whose corner lies between samples
            assert found.phases[0].speed_mm_s == pytest.approx(
                log.truth["speed_mm_s"], rel=1.5 / (corner * rate_Hz)
            )
        assert found.compression_sign == found.force_sign == 1


def test_phases_share_their_corner_sample_and_cover_the_record():
    found = segment(trial_of(Log("p", (Move(4.0, 250.0), Hold(3.0), Move(0.5, 250.0)))))
    assert kinds(found) == ["ramp", "hold", "retract"]
    assert found.phases[0].start == 0
    assert all(a.stop - 1 == b.start for a, b in pairwise(found.phases))
    assert found.phases[-1].speed_mm_s < 0.0


def random_program(rng: np.random.Generator) -> tuple[list[Move | Hold], list[str]]:
    """Moves of 15-100 % of the depth with holds between, and the phases they must give."""
    scale = 10.0 ** rng.uniform(-3.0, 1.0)
    slow = 10.0 ** rng.uniform(-2.0, 2.0)
    moves: list[Move | Hold] = []
    expected: list[str] = []
    depth, direction = 0.0, 1
    for _ in range(rng.integers(1, 6)):
        step = rng.uniform(0.15, 1.0)
        step = min(step, depth) if direction < 0 else step
        depth += direction * step
        duration = slow * rng.uniform(0.3, 1.0)
        moves.append(Move(depth * scale, 60.0 * step * scale / duration))
        expected.append("ramp" if direction > 0 else "retract")
        if rng.random() < 0.6:
            moves.append(Hold(slow * rng.uniform(0.5, 3.0)))
            # back at the surface nothing is held
            expected.append("hold" if depth > 0.0 else "rest")
            direction = -1 if depth > 0.4 and rng.random() < 0.3 else 1
        else:
            direction = -direction
    return moves, expected


def test_random_programs_give_their_phases_at_their_corners():
    rng = np.random.default_rng(11)
    failures = []
    for case in range(100):  # two thousand with all that machines do: test_segment_programs
        moves, expected = random_program(rng)
        total = sum(m.hold_s if isinstance(m, Hold) else 0.0 for m in moves)
        moved = [m for m in moves if isinstance(m, Move)]
        travels = np.diff([0.0, *(m.to_mm for m in moved)])
        times = [abs(d) / m.speed_mm_s for d, m in zip(travels, moved, strict=True)]
        rate = rng.uniform(400, 4000) / (total + sum(times))
        span = max(m.to_mm for m in moved)
        noise = span * rng.choice([0.0, 1e-5, 1e-4])
        sign = int(rng.choice([-1, 1]))
        settings = Recipe(
            "random",
            (Log("r", tuple(moves)),),
            rate_Hz=rate,
            static=(100.0 / span,),
            branches=(),
            sigma_N=0.3,
            sigma_mm=noise,
            compression_sign=sign,
        )
        trial = as_trials(simulate(settings, rng=rng))[0]
        if rng.random() < 0.3:  # quantised displacement
            quantised = np.round(trial.displacement_mm / (span * 5e-4)) * span * 5e-4
            trial = Trial("q", trial.time_s, quantised, trial.force_N)
        found = segment(trial)
        loops = sum(a == "ramp" and b == "retract" for a, b in pairwise(expected))
        if loops >= 2:
            continue  # may be cyclic: tested on its own
        corners = np.cumsum([m.hold_s if isinstance(m, Hold) else times.pop(0) for m in moves])[:-1]
        starts = [phase.start_s for phase in found.phases[1:]]
        good = kinds(found) == expected and found.compression_sign == sign
        if good:
            good = bool(np.abs(np.array(starts) - corners).max(initial=0.0) <= EDGE_SAMPLES / rate)
        if not good:
            edges = np.round(rate * np.array(starts), 1), np.round(rate * corners, 1)
            failures.append((case, expected, kinds(found), *edges, noise / span))
        assert sum(kind == "hold" for kind in kinds(found)) <= expected.count("hold"), (
            f"hold invented in {case}"
        )
    assert len(failures) <= 1, failures


@pytest.mark.parametrize("dwell_s", [0.0, 0.1])
def test_cyclic_test_gives_cycles_and_no_hold(dwell_s):
    loop = [Move(4.0, 100.0), Hold(dwell_s), Move(0.5, 100.0), Hold(dwell_s)]
    moves = tuple(move for move in loop * 4 if not (isinstance(move, Hold) and dwell_s == 0.0))
    found = segment(trial_of(Log("c", moves)))
    assert kinds(found) == ["cycle"] * 4
    assert {"cyclic", "no_hold"} <= codes(found)
    starts = [phase.start_s for phase in found.phases]
    first = 4.0 / (100.0 / 60.0)
    loop_s = 2 * 3.5 / (100.0 / 60.0) + 2 * dwell_s
    assert starts == pytest.approx(
        [0.0] + [first + 3.5 / (100 / 60) + 2 * dwell_s + k * loop_s for k in range(3)], abs=0.15
    )


LOOP = (Move(2.0, 200.0), Move(0.2, 200.0))
STEPS = tuple(step for k in range(1, 5) for step in (Move(float(k), 100.0), Hold(2.0)))


@pytest.mark.parametrize(
    ("moves", "expected", "said"),
    [
        ((*LOOP * 3, Move(4.0, 200.0), Hold(5.0)), ["cycle"] * 3 + ["ramp", "hold"], set()),
        (STEPS, ["ramp", "hold"] * 4, {"several_steps"}),
        ((Move(8.0, 10.0), Hold(0.3)), ["ramp"], {"no_hold"}),
    ],
    ids=["preconditioning before a test", "several steps", "dwell of a stop after a long ramp"],
)
def test_programs_have_their_phases(moves, expected, said):
    found = segment(trial_of(Log("p", moves)))
    assert kinds(found) == expected
    assert codes(found) & {"several_steps", "no_hold"} == said


def test_creep_under_load_control_is_not_a_hold():
    time_s = np.arange(0.0, 30.0, 0.01)
    depth = np.where(time_s < 2.0, 2.0 * time_s, 4.0 + 0.3 * (1.0 - np.exp(-(time_s - 2.0) / 10.0)))
    force = np.where(time_s < 2.0, 40.0 * time_s, 80.0) + 0.1 * np.random.default_rng(1).standard_normal(
        time_s.size
    )
    found = segment(Trial("creep", time_s, depth, force))
    assert "hold" not in kinds(found)
    assert "no_hold" in codes(found)


def test_user_may_ask_for_short_holds():
    trial = trial_of(Log("d", (Move(8.0, 10.0), Hold(0.3))))
    assert kinds(segment(trial, options=SegmentOptions(minimum_hold_s=0.2))) == ["ramp", "hold"]


def test_overshoot_and_ringing_belong_to_the_ramp_and_are_said():
    time_s = np.arange(0.0, 10.0, 0.005)
    ring = 0.12 * np.exp(-(time_s - 1.0) / 0.05) * np.sin((time_s - 1.0) * 60.0)
    depth = np.where(time_s < 1.0, 4.0 * time_s, 4.0 + ring)
    force = 20.0 * depth + 0.1 * np.random.default_rng(2).standard_normal(time_s.size)
    found = segment(Trial("ring", time_s, depth, force))
    assert kinds(found) == ["ramp", "hold"]
    said = next(flag for flag in found.flags if flag.code == "corner_overshoot")
    assert said.values["overshoot_mm"] == pytest.approx(depth.max() - 4.0, rel=0.1)
    # the ringing has decayed below the tolerance (0.05 % of 4 mm) within 5 time constants
    assert 1.0 <= found.phases[1].start_s <= 1.3


def test_rounded_stop_puts_the_hold_where_the_plateau_begins():
    found = segment(
        trial_of(Log("r", (Move(4.0, 250.0), Hold(5.0))), rate_Hz=1000.0, crosshead_rounding_s=0.2)
    )
    assert kinds(found) == ["ramp", "hold"]
    # half the rounding after the nominal corner; the last 5e-4 of the travel is below the tolerance
    assert 0.96 <= found.phases[1].start_s <= 0.96 + 0.1 + 0.003


def test_event_rows_gaps_and_equal_times_do_not_make_phases():
    trial = trial_of(Log("e", (Move(4.0, 250.0), Hold(5.0))))
    time_s = np.array(trial.time_s)
    corner = int(np.searchsorted(time_s, 0.96))
    keep = (time_s < 2.0) | (time_s > 4.0)
    order = np.sort(np.concatenate([np.flatnonzero(keep), [0, corner, time_s.size - 1]]))
    time_s = time_s[order]
    time_s[np.flatnonzero(np.diff(order) == 0) + 1] += np.array([0.0, 0.001, 0.001])
    found = segment(Trial("e", time_s, trial.displacement_mm[order], trial.force_N[order]))
    assert kinds(found) == ["ramp", "hold"]
    assert found.phases[1].start_s == pytest.approx(0.96, abs=0.03)


def test_different_sampling_in_ramp_and_hold():
    trial = trial_of(Log("m", (Move(4.0, 250.0), Hold(30.0))), rate_Hz=1000.0)
    order = np.concatenate([np.arange(0, 1000), np.arange(1000, trial.time_s.size, 100)])
    found = segment(Trial("m", trial.time_s[order], trial.displacement_mm[order], trial.force_N[order]))
    assert kinds(found) == ["ramp", "hold"]
    assert found.phases[1].start_s == pytest.approx(0.96, abs=0.003)


def test_aborted_ramp_is_told_from_its_stated_depth():
    trial = trial_of(Log("a", (Move(3.0, 100.0),)))
    stopped = Trial(
        "a", trial.time_s, trial.displacement_mm, trial.force_N, replace(trial.protocol, depth_mm=8.0)
    )
    assert "aborted_ramp" in codes(segment(stopped))
    assert "aborted_ramp" not in codes(segment(trial))


@pytest.mark.parametrize("sign", [1, -1])
def test_signs_follow_the_dominant_excursion_and_the_user_wins(sign):
    trial = trial_of(Log("s", (Move(4.0, 250.0), Hold(2.0))), compression_sign=sign)
    found = segment(trial)
    assert (found.compression_sign, found.force_sign) == (sign, sign)
    forced = segment(trial, options=SegmentOptions(compression_sign=-sign, force_sign=-sign))
    assert (forced.compression_sign, forced.force_sign) == (-sign, -sign)


def test_force_against_the_travel_is_said():
    trial = trial_of(Log("s", (Move(4.0, 250.0), Hold(2.0))))
    found = segment(Trial("t", trial.time_s, -trial.displacement_mm, trial.force_N))
    assert (found.compression_sign, found.force_sign) == (-1, 1)
    assert "tension" in codes(found)


def test_a_standing_record_has_no_phases_and_no_contact():
    still = Trial("still", np.arange(10.0), np.full(10, 2.0), np.zeros(10))
    found = segment(still)
    assert found.phases == ()
    assert found.contact is None
    assert {"too_few_samples", "no_hold"} <= codes(found)


@pytest.mark.parametrize(
    ("field", "value"), [("compression_sign", 0), ("force_sign", 2), ("contact_sd_mm", -1.0)]
)
def test_senseless_options_are_refused(field, value):
    with pytest.raises(ValueError, match=field):
        SegmentOptions(**{field: value})


def test_a_long_slow_noisy_recording_keeps_its_phases():
    # 200,000 samples: noise of 5 sd is in it, and 15 samples pass before the tool has moved by one sd
    n = 200_000
    time_s = np.arange(n) * 1e-3
    corners = np.array([0.0, 40.0, 100.0, 140.0, 180.0, n * 1e-3])
    depth = np.interp(time_s, corners, [0.0, 4.0, 4.0, 2.0, 6.0, 6.0])
    rng = np.random.default_rng(12)
    noisy = depth + 1.5e-3 * rng.standard_normal(n)
    found = segment(Trial("long", time_s, noisy, 10.0 * depth + 0.2 * rng.standard_normal(n)))
    assert kinds(found) == ["ramp", "hold", "retract", "ramp", "hold"]
    starts = [phase.start_s for phase in found.phases[1:]]
    # lines through 200 samples meet within 1.5e-3 mm sqrt(8/200) / 0.05 mm/s: 6 samples, 2 sd
    assert starts == pytest.approx(corners[1:-1].tolist(), abs=0.015)
