"""One reason with its number, on recordings made for it; near misses of each are kept."""

import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from pushed import pushed
from scipy.signal import lfilter

from tissueid.documents import plain, typed
from tissueid.documents.inspect import Verdict
from tissueid.documents.measured import MeasuredPush
from tissueid.ingest.quality import quality_flags
from tissueid.measured import measure
from tissueid.measured.verdict import verdict_of
from tissueid.segment import segment
from tissueid.trial import Trial


def judged(trial: Trial, earlier: tuple[MeasuredPush, ...] = ()) -> Verdict:
    """The verdict of a recording as it is read: with the flags of its samples."""
    read = replace(trial, flags=quality_flags(trial.time_s, trial.displacement_mm, trial.force_N))
    divided = segment(read)
    return verdict_of(read, divided, measure(read, divided), earlier)


@cache
def shown(**made: Any) -> MeasuredPush:
    trial = pushed(**made)
    push = measure(trial, segment(trial)).push
    assert typed(plain(push), MeasuredPush) == push
    return push


REASONS: dict[str, tuple[dict[str, Any], str, str]] = {
    "saturated cell": ({"stop_force_N": 22.0}, "repeat",
        r"the force stands at 22 N for \d+ samples.*Take a larger load cell, or less depth"),
    "no air": ({"air_mm": 0.0, "zero_N": 0.3}, "good",
        r"no air before contact: depth known to [\d.]+ % if the force was zeroed in air\. Start in air"),
    "overshoot": ({"overshoot_mm": 0.2}, "look",
        r"displacement overshoots its hold by 0\.2 mm .*Tune the controller, if it is large"),
    "short hold": ({"tau_s": 4.0, "hold_s": 6.0}, "look",
        r"hold too short: 6(\.0\d)? s for a relaxation time of (4|4\.\d|3\.9) s; hold 12 s or longer"),
    "few samples in the ramp": ({"rate_Hz": 4.0, "speed": 2.5, "brake_s": 0.0, "air_mm": 4.0}, "look",
        r"sampling too slow: [78] samples in a ramp of [\d.]+ s; take \d+ Hz"),
    "few samples in the relaxation": ({"rate_Hz": 10.0, "tau_s": 0.12, "brake_s": 0.0}, "look",
        r"sampling too slow: a relaxation time of 0\.1\d* s, samples 0\.1 s apart; take \d+ Hz"),
    "drift": ({"drift_N_per_s": 0.1, "air_mm": 6.0}, "look",
        r"force drifts by 0\.09\d+ N/s in air: .*then zero it"),
}  # fmt: skip


@pytest.mark.parametrize("case", REASONS)
def test_each_reason_is_said_with_its_number(case: str) -> None:
    made, level, words = REASONS[case]
    found = judged(pushed(**made))
    assert found.level == level, found
    assert re.fullmatch(words, found.reason), found.reason
    assert len(found.reason.split()) <= 25
    assert plain(found) == {"level": level, "reason": found.reason}


KEPT: dict[str, dict[str, Any]] = {
    "plain": {},
    "force below the cell's limit": {"stop_force_N": 100.0},
    "noisy": {"noise_N": 0.2},
    "overshoot of its noise": {"overshoot_mm": 0.002},
    "hold of three relaxation times": {"tau_s": 2.0, "hold_s": 6.0},
    "a ramp of twenty samples": {"rate_Hz": 10.0, "brake_s": 0.0},
    "slow drift": {"drift_N_per_s": 0.001, "air_mm": 6.0},
    "an offset zero": {"zero_N": -3.0},
    "a hold that does not relax": {"tau_s": 1e-4, "noise_N": 0.1, "hold_s": 30.0, "seed": 11},
}


@pytest.mark.parametrize("case", KEPT)
def test_what_is_sound_is_kept_without_a_reason(case: str) -> None:
    assert judged(pushed(**KEPT[case])) == Verdict("good", None)


@pytest.mark.parametrize(("rest_s", "level"), [(40.0, "good"), (6.0, "look")])
def test_a_pause_on_the_way_down_is_no_hold_that_is_too_short(rest_s: float, level: str) -> None:
    """A pause of 2 s at 2 of 4 mm, of a tissue whose branch relaxes in 4 s; then the hold."""
    time_s = np.arange(0.0, 7.0 + rest_s, 0.01)
    travel = np.interp(time_s, [1.0, 3.0, 5.0, 7.0], [-1.0, 2.0, 2.0, 4.0])
    depth = np.maximum(travel, 0.0)
    decay = float(np.exp(-0.01 / 4.0))
    branch = lfilter([10.0 * np.sqrt(decay)], [1.0, -decay], np.diff(depth, prepend=0.0))
    noise = np.random.default_rng(1).normal(0.0, 0.01, time_s.size)
    found = judged(Trial("liver", time_s, travel, 5.0 * depth + branch + noise))
    assert found.level == level
    assert found.reason is None or re.match(r"hold too short: (6|5\.99) s", found.reason)


@pytest.mark.parametrize(
    ("gains", "now", "said"),
    [
        ((), 0.5, None),
        ((1.0,), 0.95, None),
        ((1.0,), 0.8, "20 % softer than the last push: rest longer"),
        ((1.0, 1.05, 0.95, 1.0), 0.95, None),
        ((1.0, 1.01, 0.99, 1.0), 0.95, "5 % softer than the last push, spread 0.79 %: rest longer"),
        ((1.0, 1.01, 0.99, 1.0), 1.2, None),
    ],
)
def test_softer_than_the_last_push_by_more_than_they_spread(gains, now, said) -> None:
    earlier = tuple(shown(gain=gain, seed=number) for number, gain in enumerate(gains))
    found = judged(pushed(gain=now, seed=9), earlier)
    assert found.level == ("good" if said is None else "look"), found
    assert (found.reason or "").startswith(said or "")


def test_pushes_of_another_depth_or_speed_are_not_compared() -> None:
    earlier = (shown(depth_mm=2.0), shown(speed=8.0))
    assert judged(pushed(gain=0.5), earlier) == Verdict("good", None)
