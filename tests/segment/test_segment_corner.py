"""Stops at the end of ramps; and contacts behind a preload that has relaxed, or noise that lasts."""

import numpy as np
import pytest
from closed_forms import branch_state
from scipy.signal import lfilter
from told import codes, divided, flag_of, kinds, normal

from tissueid.segment import segment
from tissueid.segment.memory import long_run_ratio, without_slow
from tissueid.segment.motion import Path, Piece, corner_near
from tissueid.segment.preload import LARGEST_SHARE, relaxing_stiffness, with_relaxed
from tissueid.segment.stop import corners_of
from tissueid.signal_noise import white_noise_sd
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


def stopped(time: np.ndarray, depth: np.ndarray, noise_mm: float = 0.0) -> Segmentation:
    rng = np.random.default_rng(3)
    noisy = depth + noise_mm * rng.standard_normal(time.size)
    return divided(time, noisy, 10.0 * depth + 0.02 * rng.standard_normal(time.size))


def only(found: Segmentation) -> Corner:
    (stop,) = [corner for corner in found.corners if found.phases[corner.phase + 1].kind == "hold"]
    return stop


@pytest.mark.parametrize("noise_mm", [0.0, 1e-3])
def test_a_sharp_stop_takes_no_time(noise_mm: float) -> None:
    found = stopped(*path(), noise_mm)
    corner = only(found)
    assert corner.time_s == pytest.approx(CORNER_S, abs=1.0 / RATE_HZ)
    assert found.phases[corner.phase].kind == "ramp"
    # the tolerance, 5.5 sd of the noise, is passed within 0.006 mm / 2 mm/s on either side
    assert corner.duration_s <= 2.0 / RATE_HZ + 12.0 * noise_mm / SPEED
    assert (corner.overshoot_mm, corner.ringing_swings, corner.ringing_period_s) == (0.0, 0, None)
    assert not codes(found) & {"corner_slow", "corner_overshoot"}


@pytest.mark.parametrize("epoch_s", [1_234_567_890.123, 1.7e9])
def test_a_clock_from_an_epoch_moves_no_corner(epoch_s: float) -> None:
    """At 10 Hz the air before contact is seven samples: one that is lost hides it."""
    time = 0.1 * np.arange(350.0)
    travel = 20.0 - np.interp(time, [2.0, 6.0, 30.0, 33.0], [0.0, 4.8, 4.8, 0.0])  # a place, 20 mm up
    force = 4.0 * np.clip(19.2 - travel, 0.0, None) + 0.004 * np.random.default_rng(3).standard_normal(350)
    sound, found = divided(time, travel, force), divided(epoch_s + time, travel, force)
    assert [(one.kind, one.start, one.stop) for one in found.phases] == [
        (one.kind, one.start, one.stop) for one in sound.phases
    ]
    assert found.contact is not None
    assert found.contact.in_record
    assert found.contact.displacement_mm == pytest.approx(19.2, abs=0.01)


@pytest.mark.parametrize(("over_mm", "settles_s"), [(0.004, 1.0), (0.0065, 3.0), (0.01, 2.0)])
def test_a_stop_that_settles_for_longer_than_the_ramp_took_is_where_the_ramp_ends(over_mm, settles_s):
    time = np.arange(0.0, 15.0, 0.01)
    stop_s = 1.0 + (2.5 + over_mm) / 8.0
    depth = np.clip(8.0 * (time - 1.0), 0.0, 2.5 + over_mm)
    late = time > stop_s
    depth[late] = 2.5 + over_mm * np.exp(-(time[late] - stop_s) / settles_s)
    (hold,) = [one for one in stopped(time, depth, 2e-4).phases if one.kind == "hold"]
    assert hold.start_s == pytest.approx(stop_s, abs=0.02)


@pytest.mark.parametrize("rounding_s", [0.05, 0.15, 0.3])
def test_a_rounded_stop_takes_its_time(rounding_s: float) -> None:
    corner = only(stopped(*path(rounding_s=rounding_s)))
    # the lines of ramp and plateau meet where the speed has fallen to a half
    assert corner.time_s == pytest.approx(CORNER_S, abs=2.0 / RATE_HZ)
    # a raised cosine r has the area of an even stop of r sqrt(24 (1/8 - 1/pi^2)) = 0.754 r; a tenth for what
    # of it lies outside the stretch that noise and resolution let be seen
    assert 0.68 * rounding_s <= corner.duration_s <= rounding_s + 2.0 / RATE_HZ
    assert corner.ringing_swings <= 1


def test_a_slow_stop_is_said_with_its_time() -> None:
    found = stopped(*path(rounding_s=0.8))
    assert flag_of(found, "corner_slow").values["duration_s"] == only(found).duration_s
    assert 0.54 <= only(found).duration_s <= 0.81


def test_ringing_is_measured() -> None:
    period, decay, ring = 0.1, 0.1, 0.08
    time, depth = path(ring_mm=ring, period_s=period, decay_s=decay)
    found = stopped(time, depth)
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
    found = stopped(time, np.interp(time, [0, 2, 7, 9, 15, 19, 25], [0, 2, 2, 4, 4, 0, 0]))
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
    found = divided(time, *noisy)
    assert kinds(found) == ["approach", "approach", "ramp", "hold"]
    assert "rupture" not in codes(found)
    assert found.phases[-1].start_s == pytest.approx(3.6, abs=0.4)


def test_the_first_sample_of_the_next_move_is_no_overshoot_of_a_hold() -> None:
    # steps of 1 mm at 2 mm/s, 50 samples/s; a move begins between two samples, 0.018 mm before the next one
    time = np.arange(0.0, 12.0, 0.02)
    edges = [0.0, 0.009, 0.509, 3.509, 4.009, 7.509, 8.009, 12.0]
    found = stopped(time, np.interp(time, edges, [0.0, 0.0, 1.0, 1.0, 2.0, 2.0, 3.0, 3.0]))
    assert kinds(found) == ["ramp", "hold"] * 3
    assert [corner.overshoot_mm for corner in found.corners] == [0.0, 0.0, 0.0]
    assert "corner_overshoot" not in codes(found)


def test_braking_of_one_sampling_interval_is_no_slow_stop() -> None:
    # 10 samples/s; 2 mm/s end between two of them, and the line of the ramp is left one sample earlier
    time = np.arange(0.0, 100.0, 0.1)
    found = stopped(time, np.clip(2.0 * (time - 0.501), 0.0, 5.3))
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
    (corner,) = stops(time, depth, phases_between(time, [0, 200, 299], ["ramp", "retract"]), 1e-4)
    assert 0.0 <= corner.duration_s <= 10.0


def test_a_stop_between_two_samples_takes_no_time() -> None:
    # the corner lies a thousandth of a sample off: an area that is no time
    time = np.arange(0.0, 6.0, 0.01)
    depth = np.clip(2.0 * time, 0.0, 4.0 + 2e-5)
    (corner,) = stops(time, depth, phases_between(time, [0, 200, 599], ["ramp", "hold"]), 1e-3)
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
    found = stopped(time, depth + 0.003 * np.clip(time - CORNER_S, 0.0, None))
    assert "corner_overshoot" not in codes(found)
    assert only(found).overshoot_mm == 0.0


STEP_S = 0.01
PRELOAD_MM, DEPTH_MM = 0.3, 5.0
STATIC = (2.0, 0.3, 0.05)


def held_preload(branches, *, hold_s=10.0, rest_s=5.0, noise=0.002, seed=0):
    """Ramp of 1 mm/s from a relaxed preload at 0.3 mm, contact at 0; branches by closed form."""
    ramp_s = DEPTH_MM - PRELOAD_MM
    time = np.arange(0.0, rest_s + ramp_s + hold_s, STEP_S)
    pushed, held = np.clip(time - rest_s, 0.0, ramp_s), np.maximum(time - rest_s - ramp_s, 0.0)
    depth = PRELOAD_MM + pushed
    force = sum(a * depth ** (k + 1) for k, a in enumerate(STATIC))
    for tau, stiffness in branches:
        force = force + stiffness * tau * -np.expm1(-pushed / tau) * np.exp(-held / tau)
    force = force + noise * force.max() * np.random.default_rng(seed).normal(size=time.size)
    return Trial("preload", time, depth, force)


TISSUES = {
    "tau 1 s": ((1.0, 1.5),), "tau 5 s": ((5.0, 1.5),), "two": ((0.3, 1.2), (5.0, 1.0)),
    "tau 0.1 s": ((0.1, 1.5),), "elastic": (),
}  # fmt: skip


@pytest.mark.parametrize("rest_s", [0.0, 5.0])
@pytest.mark.parametrize("tissue", TISSUES)
def test_the_contact_behind_a_relaxed_preload_lies_in_its_interval(tissue, rest_s):
    found = [segment(held_preload(TISSUES[tissue], rest_s=rest_s, seed=seed)) for seed in range(12)]
    assert all("preload" in codes(one) for one in found)
    scores = np.array([one.contact.displacement_mm / one.contact.sd_mm for one in found])
    # 12 intervals of 95 %: three or more miss with probability 0.02
    assert (np.abs(scores) > 2.0).sum() <= 2
    assert abs(np.median(scores)) < 1.5


def test_a_contact_that_relaxing_tissue_hides_is_wide_and_that_of_elastic_tissue_is_not():
    def sd_mm(branches, hold_s):
        return segment(held_preload(branches, hold_s=hold_s)).contact.sd_mm

    relaxing, elastic = TISSUES["tau 1 s"], TISSUES["elastic"]
    assert sd_mm(relaxing, 10.0) > 0.15 * PRELOAD_MM
    # a hold in which nothing relaxes tells that the ramp is the static curve; no hold tells nothing
    assert sd_mm(elastic, 10.0) < 0.2 * PRELOAD_MM < sd_mm(elastic, 0.05)


@pytest.mark.parametrize(("tau", "stiffness"), [(1.0, 1.5), (5.0, 1.5), (5.0, 0.0)])
def test_a_hold_shows_the_stiffness_that_relaxes(tau, stiffness):
    trial = held_preload(((tau, stiffness),), noise=0.0)
    record = (trial.time_s, trial.displacement_mm, trial.force_N)
    shown = relaxing_stiffness(record, Piece(1, 500, 970), 0.0)
    # the first tenth of the ramp's time averages the rate at which the force falls, and 10 s end its fall
    assert 0.8 * stiffness - 1e-9 <= shown <= stiffness + 1e-9


@pytest.mark.parametrize(
    ("first_N", "said"), [(2.0, "under 2 N, by its ramp 15"), (5.0, "under 5 N; contact")]
)
def test_the_force_at_the_start_is_told_as_measured_and_as_the_ramp_says(first_N, said):
    time = np.arange(0.0, 4.0, 0.01)
    force = 5.0 * (time + 1.0)
    force[0] = first_N
    found = divided(time, time, force + 1e-3 * np.cos(7e3 * time))
    assert any(said in flag.message for flag in found.flags if flag.code == "preload"), found.flags


def test_no_hold_no_knowledge_of_what_relaxes():
    trial = held_preload(((1.0, 1.5),), hold_s=0.05)
    record = (trial.time_s, trial.displacement_mm, trial.force_N)
    assert relaxing_stiffness(record, Piece(1, 500, 970), 0.0) is None
    # 1 N under 2 N/mm: 0.5 / (1 - r) mm back, r uniform up to 0.75; moments by midpoints
    before, sd = with_relaxed(0.5, 0.0, 1.0, (2.0, 0.0), None, 10.0)
    back = 0.5 / (1.0 - LARGEST_SHARE * (np.arange(10_000) + 0.5) / 10_000)
    assert before == pytest.approx(back.mean(), rel=1e-6)
    assert sd == pytest.approx(back.std(), rel=1e-4)
    assert with_relaxed(0.5, 0.01, 1.0, (2.0, 0.0), 0.0, 10.0) == pytest.approx((0.5, 0.01))


def touched(touch_mm: float, *, noise: float, seed: int = 0, film_N: float = 0.0) -> Trial:
    """Approach of 1 mm/s from 2 mm above the tissue to ``touch_mm``, 8 s of standing, and a push to 5 mm."""
    time = np.arange(0.0, 30.0, 0.02)
    times = [0.0, 3.0, 5.0 + touch_mm, 13.0 + touch_mm, 18.0, 30.0]
    depth = np.interp(time, times, [-2.0, -2.0, touch_mm, touch_mm, DEPTH_MM, DEPTH_MM])
    into = np.maximum(depth, 0.0)
    force = sum(a * into ** (k + 1) for k, a in enumerate(STATIC))
    # a film of liquid under the tool, pressed out while it stands
    film = np.interp(time, [times[2] - 0.4, times[2], times[2] + 0.5], [0.0, film_N, 0.0])
    force, rng = force + branch_state(time, into, 2.0) + film, np.random.default_rng(seed)
    force = force + noise * force.max() * rng.normal(size=time.size)
    return Trial("touch", time, depth + 1e-4 * rng.normal(size=time.size), force)


@pytest.mark.parametrize("noise", [1e-4, 2e-3])
@pytest.mark.parametrize("touch_mm", [-0.5, 0.0, 0.4])
def test_a_tool_that_stands_where_it_touches_has_shown_air_on_its_way_there(touch_mm, noise):
    found = [segment(touched(touch_mm, noise=noise, seed=seed)) for seed in range(8)]
    assert all(one.contact.in_record for one in found)
    assert not any({"starts_in_contact", "contact_uncertain"} & set(codes(one)) for one in found)
    errors = np.array([one.contact.displacement_mm for one in found])
    assert abs(np.median(errors)) < 0.01 * DEPTH_MM
    assert np.abs(errors).max() < 0.07 * DEPTH_MM
    assert ("hold" in kinds(found[0])[:-1]) == (touch_mm > 0.0)


def test_a_force_that_is_gone_while_the_tool_stands_is_no_touch():
    contact = segment(touched(-0.2, noise=1e-3, film_N=1.0)).contact
    assert abs(contact.displacement_mm) < 0.03 * DEPTH_MM


def test_a_touch_near_its_noise_leaves_the_contact_to_the_push():
    found = [segment(touched(1.0, noise=0.01, seed=seed)).contact for seed in range(8)]
    scores = np.array([one.displacement_mm / one.sd_mm for one in found])
    assert np.abs(scores).max() < 2.0
    assert max(abs(one.displacement_mm) for one in found) < 0.1 * DEPTH_MM


def noise_of(phi, size, seed):
    """AR(1) noise of sd 1 in its stationary state."""
    white = np.random.default_rng(seed).normal(size=size + 1000)
    return lfilter([np.sqrt(1.0 - phi * phi)], [1.0, -phi], white)[1000:]


def lasting_sd(values):
    time = np.arange(float(values.size))
    left = without_slow(time, values)
    return white_noise_sd(time, left) * long_run_ratio([left])


def test_white_noise_lasts_no_longer_than_its_differences_say():
    stretches = [without_slow(np.arange(700.0), noise_of(0.0, 700, seed)) for seed in range(100)]
    ratios = np.array([long_run_ratio([one]) for one in stretches])
    assert (ratios == 1.0).sum() >= 97


@pytest.mark.parametrize(("phi", "truth"), [(0.0, 1.0), (0.7, 5.3)])
def test_many_short_standstills_beside_a_long_one_tell_how_the_noise_lasts(phi: float, truth: float) -> None:
    lengths = (68,) * 10 + (2067,)
    found = []
    for seed in range(20):
        noise = (noise_of(phi, size, 100 * seed + k) for k, size in enumerate(lengths))
        found.append(long_run_ratio([without_slow(np.arange(float(one.size)), one) for one in noise]))
    assert np.median(found) == pytest.approx(truth, rel=0.15)


@pytest.mark.parametrize(("phi", "spread"), [(0.5, 0.15), (0.9, 0.25), (0.97, 0.35)])
def test_the_sd_of_means_is_that_of_the_noise(phi, spread):
    found = [lasting_sd(noise_of(phi, 2000, seed)) for seed in range(40)]
    truth = np.sqrt((1.0 + phi) / (1.0 - phi))
    assert np.median(found) == pytest.approx(truth, rel=0.1)
    assert np.std(found) / truth < spread


def test_a_hum_does_not_last_and_steps_of_a_coarse_reading_are_no_noise():
    time = np.arange(2000.0)
    hum = np.sin(2.0 * np.pi * time / 20.0) + 0.1 * noise_of(0.0, 2000, 1)
    # over means of a period and longer nothing of it is left
    assert lasting_sd(hum) < 1.0
    assert without_slow(time, np.round(np.sin(time / 300.0) * 3.0)) is None
    assert without_slow(time[:20], hum[:20]) is None


def push(phi, noise, seed, *, hold):
    """1 mm/s into tissue that relaxes within 2 s, contact at 0.3 or 2 mm; a hold of 20 s, or none."""
    contact, wait = (0.3, 0.5) if hold else (2.0, 0.0)
    time = np.arange(0.0, wait + contact + 5.0 + (20.0 if hold else 0.0), 0.01)
    x = np.clip(time - wait - contact, 0.0, 5.0)
    held = np.maximum(time - wait - contact - 5.0, 0.0)
    force = 2.0 * x + 0.3 * x**2 + 0.05 * x**3 + 3.0 * -np.expm1(-x / 2.0) * np.exp(-held / 2.0)
    force = force + noise * force.max() * noise_of(phi, time.size, seed)
    return segment(Trial("push", time, np.clip(time - wait, 0.0, contact + 5.0), force)).contact


def pushes(phi, noise, *, hold):
    return [push(phi, noise, seed, hold=hold) for seed in range(12 if hold else 6)]


@pytest.mark.parametrize(("phi", "noise"), [(0.5, 0.01), (0.9, 0.002), (0.9, 0.01)])
def test_the_contact_under_correlated_noise_lies_in_its_interval(phi, noise):
    scores = np.array([(one.displacement_mm - 0.3) / one.sd_mm for one in pushes(phi, noise, hold=True)])
    # 12 intervals of 95 %: more than three miss with probability 0.002
    assert (np.abs(scores) > 1.96).sum() <= 3


def test_air_alone_shows_that_noise_lasts():
    sds = [[one.sd_mm for one in pushes(phi, 0.01, hold=False)] for phi in (0.0, 0.5)]
    sd_white, sd_lasting = np.median(sds, axis=1)
    # noise^(2/3), a long-run sd of 1.73: 1.44; of differences alone it was 0.8
    assert sd_lasting > 1.2 * sd_white


def held(noise, *, step=0.0):
    """1 mm/s to 3 mm, contact at 0.5 mm, relaxing within 0.5 s, then 20 s of hold; 200 samples a second."""
    time = np.arange(0.0, 23.0, 0.005)
    x, since = np.clip(time - 0.5, 0.0, 2.5), np.maximum(time - 3.0, 0.0)
    force = x + np.exp(-since / 0.5) * -np.expm1(-x / 0.5) + noise(time)
    return divided(time, np.minimum(time, 3.0), np.round(force / step) * step if step else force)


def test_a_hum_is_no_rupture_and_no_slip():
    white = np.random.default_rng(1).normal(size=4600)
    found = held(lambda time: 0.01 * white + 0.1 * np.sin(2.0 * np.pi * 20.0 * time))
    assert found.events == ()
    assert kinds(found) == ["approach", "ramp", "hold"]


def test_a_hold_that_reads_one_level_shows_no_lasting_noise():
    found = held(lambda time: np.zeros(time.size), step=0.07)
    assert found.contact.displacement_mm == pytest.approx(0.5, abs=0.1)


def test_a_jump_between_two_samples_is_a_move_with_the_contact_anywhere_on_its_way():
    time = np.arange(0.0, 30.0, 0.05)
    step = np.where(time < 1.0, 0.0, 2.0)
    force = 5.0 * step * np.exp(-np.maximum(time - 1.0, 0.0)) + normal(0.05, time, 2)
    found = divided(time, step, force)
    assert [one.stop - one.start for one in found.phases] == [20, 2, 580]
    assert found.contact.sd_mm > 1.0
    assert "contact_uncertain" in codes(found)
