"""How a ramp came to its stop: time, duration, overshoot and ringing against the path that was drawn."""

from __future__ import annotations

import numpy as np
import pytest
from told import codes, flag_of, kinds

from tissueid.segment import segment
from tissueid.segment.motion import Path, corner_near
from tissueid.segment.stop import corners_of
from tissueid.trial import Corner, Phase, Segmentation, Trial

RATE_HZ = 500.0
SPEED, DEPTH, CORNER_S = 2.0, 4.0, 3.0  # 1 s at rest, then 2 mm/s to 4 mm


def path(*, rounding_s: float = 0.0, ring_mm: float = 0.0, period_s: float = 0.1, decay_s: float = 0.1):
    """Times and depths; the stop takes a raised-cosine change of speed and a decaying sine after it."""
    time = np.arange(0.0, 10.0, 1.0 / RATE_HZ)
    depth = np.clip(SPEED * (time - 1.0), 0.0, DEPTH)
    if rounding_s:
        u = np.clip((time - CORNER_S) / rounding_s + 0.5, 0.0, 1.0)
        smooth = rounding_s * (0.5 * u - np.sin(np.pi * u) / (2.0 * np.pi))
        depth -= SPEED * (smooth - rounding_s * np.maximum(u - 0.5, 0.0))
    since = np.maximum(time - CORNER_S, 0.0)
    depth += ring_mm * np.exp(-since / decay_s) * np.sin(2.0 * np.pi * since / period_s)
    return time, depth


def divided(time: np.ndarray, depth: np.ndarray, noise_mm: float = 0.0) -> Segmentation:
    rng = np.random.default_rng(3)
    noisy = depth + noise_mm * rng.standard_normal(time.size)
    return segment(Trial("stop", time, noisy, 10.0 * depth + 0.02 * rng.standard_normal(time.size)))


def only(found: Segmentation) -> Corner:
    stops = [corner for corner in found.corners if found.phases[corner.phase + 1].kind == "hold"]
    assert len(stops) == 1
    return stops[0]


@pytest.mark.parametrize("noise_mm", [0.0, 1e-3])
def test_a_sharp_stop_takes_no_time(noise_mm: float) -> None:
    found = divided(*path(), noise_mm)
    corner = only(found)
    assert corner.time_s == pytest.approx(CORNER_S, abs=1.0 / RATE_HZ)
    assert found.phases[corner.phase].kind == "ramp"
    # the tolerance, 5.5 sd of the noise, is passed within 0.006 mm / 2 mm/s on either side
    assert corner.duration_s <= 2.0 / RATE_HZ + 12.0 * noise_mm / SPEED
    assert (corner.overshoot_mm, corner.ringing_swings, corner.ringing_period_s) == (0.0, 0, None)
    assert not codes(found) & {"corner_slow", "corner_overshoot"}


@pytest.mark.parametrize("rounding_s", [0.05, 0.15, 0.3])
def test_a_rounded_stop_takes_its_time(rounding_s: float) -> None:
    corner = only(divided(*path(rounding_s=rounding_s)))
    # the lines of ramp and plateau meet where the speed has fallen to a half
    assert corner.time_s == pytest.approx(CORNER_S, abs=2.0 / RATE_HZ)
    # a raised cosine r has the area of an even stop of r sqrt(24 (1/8 - 1/pi^2)) = 0.754 r; a tenth for what
    # of it lies outside the stretch that noise and resolution let be seen
    assert 0.68 * rounding_s <= corner.duration_s <= rounding_s + 2.0 / RATE_HZ
    assert corner.ringing_swings <= 1


def test_a_slow_stop_is_said_with_its_time() -> None:
    found = divided(*path(rounding_s=0.8))
    assert flag_of(found, "corner_slow").values["duration_s"] == only(found).duration_s
    assert 0.54 <= only(found).duration_s <= 0.81


def test_ringing_is_measured() -> None:
    period, decay, ring = 0.1, 0.1, 0.08
    time, depth = path(ring_mm=ring, period_s=period, decay_s=decay)
    found = divided(time, depth)
    corner = only(found)
    assert corner.overshoot_mm == pytest.approx(depth.max() - DEPTH, abs=1e-3)
    # maxima of exp(-t/d) sin(wt) lie half a period apart
    assert corner.ringing_period_s == pytest.approx(period, rel=0.05)
    # it falls to the tolerance of 2 um within d ln(0.08 / 0.002) = 0.37 s: seven half periods
    assert corner.ringing_swings == pytest.approx(7, abs=1)
    assert corner.duration_s == pytest.approx(decay * np.log(ring / 0.002), abs=period)
    assert "corner_overshoot" in codes(found)
    assert "corner_slow" not in codes(found)


def test_every_ramp_that_goes_on_has_its_corner() -> None:
    time = np.arange(0.0, 30.0, 0.01)
    depth = np.interp(time, [0, 2, 7, 9, 15, 19, 25], [0, 2, 2, 4, 4, 0, 0])
    found = divided(time, depth)
    assert kinds(found) == ["ramp", "hold", "ramp", "hold", "retract", "rest"]
    assert [corner.phase for corner in found.corners] == [0, 2]
    assert [corner.time_s for corner in found.corners] == pytest.approx([2.0, 9.0], abs=0.01)
    assert all(time[corner.index] == pytest.approx(corner.time_s, abs=0.01) for corner in found.corners)


@pytest.mark.parametrize("noise_mm", [3e-4, 2e-3])
def test_a_servo_that_rings_and_then_creeps_on_holds(noise_mm: float) -> None:
    # 7 mm at 20 mm/s, ringing by 5 % of them at 5 Hz, 0.03 mm of creep behind it
    rng, time = np.random.default_rng(5), np.arange(0.0, 60.0, 1.0 / RATE_HZ)
    since = np.maximum(time - 3.35, 0.0)
    depth = np.clip(20.0 * (time - 3.0), 0.0, 7.0) + 0.03 * -np.expm1(-since / 15.0)
    depth += 0.35 * np.exp(-since / 0.16) * np.sin(2.0 * np.pi * 5.0 * since)
    force = 1.5 * np.maximum(depth - 1.3, 0.0) * (0.8 + 0.2 * np.exp(-since / 3.0))
    noisy = (depth + noise_mm * rng.normal(size=time.size), force + 0.02 * rng.normal(size=time.size))
    found = segment(Trial("rings", time, *noisy))
    assert kinds(found) == ["approach", "approach", "ramp", "hold"]
    assert "rupture" not in codes(found)
    assert found.phases[-1].start_s == pytest.approx(3.6, abs=0.4)


def test_the_first_sample_of_the_next_move_is_no_overshoot_of_a_hold() -> None:
    # steps of 1 mm at 2 mm/s, 50 samples/s; a move begins between two samples, 0.018 mm before the next one
    time = np.arange(0.0, 12.0, 0.02)
    edges = [0.0, 0.009, 0.509, 3.509, 4.009, 7.509, 8.009, 12.0]
    found = divided(time, np.interp(time, edges, [0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0]))
    assert kinds(found) == ["ramp", "hold"] * 3
    assert [corner.overshoot_mm for corner in found.corners] == [0.0, 0.0, 0.0]
    assert "corner_overshoot" not in codes(found)


def test_braking_of_one_sampling_interval_is_no_slow_stop() -> None:
    # 10 samples/s; 2 mm/s end between two of them, and the line of the ramp is left one sample earlier
    time = np.arange(0.0, 100.0, 0.1)
    found = divided(time, np.clip(2.0 * (time - 0.501), 0.0, 5.3))
    assert only(found).duration_s <= 0.1
    assert "corner_slow" not in codes(found)


def stops(
    time: np.ndarray, depth: np.ndarray, phases: tuple[Phase, ...], tolerance_mm: float
) -> tuple[Corner, ...]:
    return corners_of(Path(time, depth, depth, 0.0, tolerance_mm, tolerance_mm), phases)


def phases_between(time: np.ndarray, edges: list[int], kinds: list[str]) -> tuple[Phase, ...]:
    return tuple(
        Phase(kind, first, last + 1, float(time[first]), float(time[last]), 1.0)
        for kind, first, last in zip(kinds, edges, edges[1:], strict=False)
    )


def test_a_slow_ramp_into_a_faster_one_is_no_stop() -> None:
    time = np.arange(0.0, 40.0, 0.1)
    depth = np.interp(time, [0, 10, 30, 40], [0, 0.1, 2.1, 0.0])
    phases = phases_between(time, [0, 100, 300, 399], ["ramp", "ramp", "retract"])
    corners = stops(time, depth, phases, 1e-3)
    assert [corner.phase for corner in corners] == [1]
    assert corners[0].time_s == pytest.approx(30.0, abs=0.1)


@pytest.mark.parametrize("bend", [0.2, 0.6, 0.95])
def test_no_stop_lasts_longer_than_its_ramp_or_what_follows(bend: float) -> None:
    # a ramp and a retract that are no straight lines: the area between path and lines is not a stop's
    time = np.arange(0.0, 30.0, 0.1)
    u, v = np.clip(time / 20.0, 0.0, 1.0), np.clip((time - 20.0) / 10.0, 0.0, 1.0)
    depth = (1.0 - bend) * u + bend * u**3 - 1e-3 * v - bend * 0.2 * v**3
    phases = phases_between(time, [0, 200, 299], ["ramp", "retract"])
    (corner,) = stops(time, depth, phases, 1e-4)
    assert 0.0 <= corner.duration_s <= 10.0


def test_a_stop_between_two_samples_takes_no_time() -> None:
    # the corner lies a thousandth of a sample off: an area that is no time
    time = np.arange(0.0, 6.0, 0.01)
    depth = np.clip(2.0 * time, 0.0, 4.0 + 2e-5)
    phases = phases_between(time, [0, 200, 599], ["ramp", "hold"])
    (corner,) = stops(time, depth, phases, 1e-3)
    assert corner.duration_s == 0.0


def test_two_samples_of_one_ramp_place_no_corner_far_along_it():
    # a line through the first two samples and one through the rest are the same, but for rounding, which
    # differs from ramp to ramp
    found = []
    for k in range(200):
        time_s = 0.01 * np.arange(k, k + 100)
        depth = time_s * 25.0 / 6.0
        path = Path(time_s, depth, depth, 0.0, 1e-3, 1e-3)
        found.append(corner_near(path, 0, (0, 99), stands=(False, False)))
    assert max(found) <= 1


def test_a_crosshead_that_creeps_on_in_its_hold_overshoots_nothing() -> None:
    time, depth = path()
    found = divided(time, depth + 0.003 * np.clip(time - CORNER_S, 0.0, None))
    assert "corner_overshoot" not in codes(found)
    assert only(found).overshoot_mm == 0.0
