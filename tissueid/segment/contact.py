"""The contact point of a recording: in the record, before its first sample, or given by the user."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.segment.hinge import STANDING_SHARE, STEP, HingeFit, fit_contact
from tissueid.segment.motion import Piece, slope_of
from tissueid.segment.options import SegmentOptions
from tissueid.segment.preload import relaxing_stiffness, with_relaxed
from tissueid.signal_noise import quantum, without_spikes
from tissueid.trial import Contact

#: Force has left the reading in air beyond so many sd of its own scatter there.
LEFT_SD = 4.0
#: Normal sd over the median absolute deviation.
NORMAL_SD_OVER_MAD = 1.4826
#: Air is no air where its force rises, from sample to sample, by more than this share of what it does after
#: contact ...
RISING_SHARE = 0.2
#: ... by so many standard errors; a drift of the load cell is as sure over so many samples at least.
SURE = 3.0
FEWEST_DRIFTING = 20
#: ... and at rest, where it is taken off, by more of them, so that noise that lasts is none.
DRIFTING = 10.0
#: A tool that starts pulls at its cell by its own mass.  Such a kick is over within so many samples of the
#: start, at least, or this share of the move; it leaves the reading at rest by so many sd of it and comes
#: back within so many, for as long as it lasted.
KICK_SAMPLES = 5
KICK_SHARE = 0.2
KICK_SD = 6.0
BACK_SD = 1.5
BACK_SAMPLES = 3


def _reading(force_N: FloatArray, noise_N: float) -> tuple[float, float]:
    """Median and robust sd of samples in air, the latter at least the white noise."""
    level = float(np.median(force_N))
    return level, max(NORMAL_SD_OVER_MAD * float(np.median(np.abs(force_N - level))), noise_N)


def without_kick(force_N: FloatArray, start: int, noise_N: float) -> FloatArray:
    """The force with the kick at the start of a move replaced by the reading at rest before it."""
    if start < FEWEST_AIR_SAMPLES:
        return force_N
    level, sd = _reading(force_N[:start], noise_N)
    off = np.abs(force_N[start : start + max(KICK_SAMPLES, int(KICK_SHARE * (force_N.size - start)))] - level)
    kicks = np.flatnonzero(off > KICK_SD * sd)
    if kicks.size == 0:
        return force_N
    first = int(kicks[0])
    back = np.flatnonzero(off[first:] <= BACK_SD * sd)
    if back.size == 0:
        return force_N
    over = first + int(back[0])
    after = force_N[start + over : start + over + max(BACK_SAMPLES, over - first)]
    if abs(float(np.median(after)) - level) > BACK_SD * sd:
        return force_N
    calm = force_N.copy()
    calm[start + first : start + over] = level
    return calm


def left_air(depth_mm: FloatArray, force_N: FloatArray, contact_mm: float, noise_N: float) -> float | None:
    """Depth of the first sample from which on the force stays above its reading in air."""
    before = int(np.argmax(depth_mm >= contact_mm))
    if before < 2 * FEWEST_AIR_SAMPLES:
        return None
    air = force_N[: before // 2]
    slope, error = _rise(air, noise_N)
    drift = slope if air.size >= FEWEST_DRIFTING and abs(slope) > SURE * error else 0.0
    calm = force_N - drift * np.arange(force_N.size)
    level, sd = _reading(calm[: before // 2], noise_N)
    inside = np.flatnonzero(calm <= level + LEFT_SD * sd)
    last = int(inside[-1]) if inside.size else 0
    return float(depth_mm[last + 1]) if last + 1 < depth_mm.size else None


def _drift_at_rest(depth_mm: FloatArray, force_N: FloatArray, start: int, noise_N: float) -> float:
    """Straight drift of the load cell, from sample to sample, where the tool stands before its move [N].

    Relaxing tissue lets go of a tool that stands and cannot pull at it: only a force that grows, or falls
    below nothing, is the cell's.
    """
    before = depth_mm[:start]
    elsewhere = np.abs(before - before[-1:]) > STANDING_SHARE * float(np.ptp(depth_mm))
    force = force_N[int(np.flatnonzero(elsewhere).max(initial=-1)) + 1 : start]
    if force.size < FEWEST_DRIFTING:
        return 0.0
    slope, error = _rise(force, noise_N)
    least = PRELOAD_SD * noise_N / np.sqrt(force.size)
    half, half_error = _rise(force[force.size // 2 :], noise_N)
    straight = abs(half - slope) <= SURE * half_error
    its_own = slope > 0.0 or float(force.mean()) < -least
    return slope if abs(slope) > DRIFTING * error and straight and its_own else 0.0


def _rise(force_N: FloatArray, noise_N: float) -> tuple[float, float]:
    """Mean rise of the force from sample to sample, and its standard error."""
    slope, spread = slope_of(np.arange(float(force_N.size)), force_N)
    return slope, noise_N / float(np.sqrt(spread))


def rises(before_N: FloatArray, after_N: FloatArray, noise_N: float) -> bool:
    """True where the force in what was taken for air rises as it does in tissue, so that it is none."""
    if before_N.size < 2 or after_N.size < 2:
        return False
    slope, error = _rise(before_N, noise_N)
    later, _ = _rise(after_N[: max(before_N.size, FEWEST_AIR_SAMPLES)], noise_N)
    return slope - SURE * error > RISING_SHARE * max(later, 0.0)


#: Fewest samples in air, while moving, that show the tool in air; where the load cell reads more than
#: nothing there, and they may be a preload, and where it does not.
FEWEST_AIR_SAMPLES = 5
FEWEST_ZERO_SAMPLES = 2
#: Air is believed where the density of a contact at the start is below this share of the highest (3.9 sd of a
#: normal one: a toe that stiffens as an exponential does looks like air) ...
START_DENSITY = 0.0005
#: ... or below this one (4.1 sd), where it may be a preload ...
DOUBTFUL_START_DENSITY = 0.0002
#: ... and, where samples in air are few, where contact lies this many of its sd behind the start.
FEW_AIR_SD = 6.5
#: Share of the depth over which the secant of a curved tip is taken.
EARLY_SHARE = 0.2
#: A preload is believed where that density, with a load cell that was tared, is below this share.
PRELOAD_DENSITY = 0.05
#: ... and where contact all along would have raised the force by so many sd of its mean in air; more where
#: it may be a preload.
MISSING_RISE_SD = 8.0
DOUBTFUL_RISE_SD = 10.0
#: A load cell that drifts in air by more than so many sd of the drift is quoted at contact.
DRIFT_SD = 3.0
#: How far back the contact may lie, in starting forces over stiffness: tissue may soften towards contact.
REACH = 4.0
#: Noise sd added to the starting force when looking how far back the contact may lie.
REACH_SD = 3.0
#: A force before the tool moves is one where it exceeds its noise by so many sd.
PRELOAD_SD = 4.0
#: A start is preloaded by more than this share of the force range; less may be the load cell's zero.
PRELOAD_SHARE = 0.01
#: Samples at rest before a ramp that tell what it starts from: after them a start kick tells nothing.
FEWEST_RESTING = 3
#: Force that rises by less than this many noise sd over a ramp never met anything.
CONTACT_SD = 6.0
#: Share of the samples of a move over which either end of it is a mean.
END_SHARE = 0.1
#: A move has touched the tissue before another pushes into it where, while the tool stands in between, this
#: share of the force is left.  It places the contact where the force has reached this share of its range and
#: so many noise sd, and where it does with less, but better than a push that begins in contact.
TOUCH_SHARE = 0.005
TOUCH_SD = 20.0
#: A move under which force rises by this share of its range is one of the test, whatever the noise.
CLEAR_SHARE = 0.1
STAYING_SHARE = 0.25
#: Share of readings in air that repeat the last where its noise does not cross the steps of its digits.
STEADY_SHARE = 0.9
#: A start in air after all is said where contact would lie so many of its sd behind the start.
DOUBTFUL_SD = 2.0
#: Contact sd above this share of the depth is said.
UNCERTAIN_SHARE = 0.05
#: Fewest samples of a ramp from which a contact can be found.
FEWEST_SAMPLES = 6


def find_contact(
    time_s: FloatArray,
    depth_mm: FloatArray,
    force_N: FloatArray,
    loading: list[Piece],
    *,
    touches: list[Piece],
    noise_N: float,
    signs: tuple[int, int],
    options: SegmentOptions,
) -> tuple[Contact | None, list[Flag]]:
    """The contact on the first loading move that shows it; depth and force grow into the tissue.

    ``touches``: moves into the tissue before those of ``loading``, under which force hardly rises.
    """
    if options.contact_displacement_mm is not None:
        return _given(depth_mm, force_N, signs, options.contact_displacement_mm, options.contact_sd_mm)
    # a single wild reading of travel is no travel
    depth_mm = without_spikes(depth_mm, noise=0.0)
    meeting = [k for k, piece in enumerate(loading) if _meets(force_N, piece, noise_N)]
    # a later move tells more than one under which force rises little above its noise
    least = min(TOUCH_SD * noise_N, CLEAR_SHARE * float(np.ptp(force_N)))
    clear = [k for k in meeting if force_N[loading[k].stop] - force_N[loading[k].start] > least]
    at = min(clear or meeting, default=None)
    if at is None:
        reach = max((float(np.ptp(force_N[one.start : one.stop + 1])) for one in loading), default=0.0)
        message = f"force stays within {reach:.3g} N (noise {noise_N:.3g} N) on every move into the tissue"
        if not loading:
            message = "the tool makes no move into the tissue"
        return None, [Flag("no_contact", message, {"force_range_N": reach, "noise_N": noise_N})]
    move = loading[at]
    light: list[Contact] = []
    for touch, after in pairwise((*touches, *loading[: at + 1])):
        if not _stays(force_N, touch, after, noise_N):
            continue
        contact = _Approach.of(depth_mm, force_N, touch, first=0, noise_N=noise_N).in_air(signs)
        if contact is not None and _touched(force_N, touch, noise_N):
            return contact, _uncertain(contact, depth_mm[: move.stop + 1])
        if contact is not None:
            light.append(contact)
    # rest before the move tells the reading in air as well, an earlier move in air too
    first = move.start if at else 0
    approach = _Approach.of(depth_mm, force_N, move, first=first, noise_N=noise_N)
    contact = approach.in_air(signs)
    if contact is not None:
        return contact, _uncertain(contact, approach.depth_mm)
    contact, dragged = _dragged(
        (depth_mm, force_N), move, approach.force_N[: approach.start], noise_N=noise_N, signs=signs
    )
    if contact is not None:
        return contact, dragged + _uncertain(contact, approach.depth_mm)
    relaxing = relaxing_stiffness((time_s, depth_mm, force_N), move, approach.noise_N)
    begun, flags = _start_in_contact(approach, signs=signs, relaxing=relaxing)
    best = min(light, key=lambda one: one.sd_mm, default=begun)
    return (best, _uncertain(best, approach.depth_mm)) if best.sd_mm < begun.sd_mm else (begun, flags)


@dataclass(frozen=True, slots=True, eq=False)
class _Approach:
    """A move into the tissue behind what stands before it, and its contact if it begins in air."""

    depth_mm: FloatArray
    force_N: FloatArray
    noise_N: float
    noise_samples: int  # of the record
    begins: int  # sample of the record at which the move begins
    start: int  # sample of these at which it does
    air: HingeFit
    drift_N: float  # that the force has lost from sample to sample, where a drift shows at rest

    @classmethod
    def of(
        cls, depth_mm: FloatArray, force_N: FloatArray, move: Piece, *, first: int, noise_N: float
    ) -> _Approach:
        """The move behind the record from a sample on."""
        u, f, start = depth_mm[first : move.stop + 1], force_N[first : move.stop + 1], move.start - first
        noise = max(noise_N, 1e-6 * float(np.ptp(f)))
        drift = _drift_at_rest(u, f, start, noise)
        f = without_kick(f - drift * np.arange(-start, f.size - start), start, noise)
        shallower = u[:start] < _stands_at(u, start) - STANDING_SHARE * float(np.ptp(u))
        if shallower.any():
            # the tool stands where it may touch, and what it touches relaxes: the way there tells more
            kept = np.append(shallower, np.ones(u.size - start, dtype=np.bool_))
            u, f, start = u[kept], f[kept], int(shallower.sum())
        fitted = partial(
            fit_contact, u, f, noise_N=noise, noise_samples=force_N.size, baseline=True, reach_back_mm=0.0
        )
        air = fitted()
        latest = left_air(u, f, air.contact_mm, noise)
        if latest is not None and latest < air.contact_mm:
            air = fitted(latest_mm=latest)
        return cls(u, f, noise, force_N.size, move.start, start, air, drift)

    def in_air(self, signs: tuple[int, int]) -> Contact | None:
        """The contact, where samples before it show air."""
        u, f, air, noise = self.depth_mm, self.force_N, self.air, self.noise_N
        moved = np.arange(u.size) >= self.start
        # a tool may stand where it touches: what lies shallower, on its way there, is air as well
        shallower = u < _stands_at(u, self.start) - STANDING_SHARE * float(np.ptp(u))
        in_air = (u < air.contact_mm) & (moved | shallower)
        count = int(in_air.sum())
        start_mm = float(np.median(u[: self.start + 1]))
        start_mm = min(start_mm, float(u[in_air].min(initial=start_mm)))
        # what the force would have risen by, had the tool been in contact all along, against its noise
        missing = _least_slope(u, f, air) * (air.contact_mm - start_mm) * np.sqrt(count) / noise
        least = max(PRELOAD_SD * noise / np.sqrt(max(count, 1)), PRELOAD_SHARE * float(np.ptp(f)))
        zero = air.baseline_N <= least
        many = count >= FEWEST_AIR_SAMPLES
        few = zero and count >= FEWEST_ZERO_SAMPLES and air.contact_mm - start_mm > FEW_AIR_SD * air.sd_mm
        far = air.at_start < (START_DENSITY if zero else DOUBTFUL_START_DENSITY)
        flat = missing > (MISSING_RISE_SD if zero else DOUBTFUL_RISE_SD)
        if not (far and flat and (many or few)) or rises(f[in_air], f[u >= air.contact_mm], noise):
            return None
        met = int(np.argmax(u[self.start :] >= air.contact_mm))
        return Contact(
            index=self.begins + met,
            displacement_mm=signs[0] * air.contact_mm,
            sd_mm=float(np.hypot(air.sd_mm, _digits(f[in_air], quantum(f)) / _least_slope(u, f, air))),
            baseline_N=signs[1] * (_reading_in_air(u, f, air, noise) + self.drift_N * met),
            in_record=True,
        )


def _dragged(
    record: tuple[FloatArray, FloatArray],
    move: Piece,
    resting_N: FloatArray,
    *,
    noise_N: float,
    signs: tuple[int, int],
) -> tuple[Contact | None, list[Flag]]:
    """The contact behind air through which a tool is dragged: its force leaps as it sets off, and stays."""
    if resting_N.size < FEWEST_AIR_SAMPLES:
        return None, []
    moving = record[1][move.start : move.stop + 1]
    level = float(np.median(resting_N[-FEWEST_DRIFTING:]))
    _, sd = _reading(resting_N, TOUCH_SHARE * float(np.ptp(moving)) / KICK_SD)
    left = int(np.argmax(moving > level + 0.5 * KICK_SD * sd))
    # as long again for the leap to be over
    over = replace(move, start=move.start + 2 * left + KICK_SAMPLES)
    if left > KICK_SAMPLES or over.stop - over.start < FEWEST_SAMPLES or not _meets(record[1], over, noise_N):
        return None, []
    contact = _Approach.of(*record, over, first=over.start, noise_N=noise_N).in_air(signs)
    air = record[1][over.start : over.start if contact is None else contact.index]
    if contact is None or air.size < FEWEST_DRIFTING:
        return None, []
    drag, (slope, error) = signs[1] * contact.baseline_N - level, _rise(air, noise_N)
    # in tissue force goes on as it began
    if drag < max(KICK_SD * sd, 2.0 * air.size * (abs(slope) + SURE * error)):
        return None, []
    message = f"force leaps by {drag:.3g} N as the tool sets off in air, and stays: something drags"
    return contact, [Flag("drag", message, {"drag_N": drag})]


def _stands_at(depth_mm: FloatArray, start: int) -> float:
    """Depth at which the tool stood before a move, whose first sample may have left it [mm]."""
    return float(depth_mm[max(start - 1, 0) : start + 1].min())


def _meets(force_N: FloatArray, piece: Piece, noise_N: float) -> bool:
    """True where force rises significantly during a move."""
    force = force_N[piece.start : piece.stop + 1]
    if force.size < FEWEST_SAMPLES:
        return force.size > 1 and bool(force[-1] - force[0] > CONTACT_SD * noise_N)
    edge = max(1, int(END_SHARE * force.size))
    rise = float(force[-edge:].mean() - force[:edge].mean())
    return rise > CONTACT_SD * noise_N / np.sqrt(edge) and rise > 0.05 * float(np.ptp(force_N))


def _touched(force_N: FloatArray, touch: Piece, noise_N: float) -> bool:
    """True where a move has met so much force that it places the contact better than a push after it."""
    air = float(np.median(force_N[: touch.start + 1]))
    least = max(TOUCH_SHARE * float(np.ptp(force_N)), TOUCH_SD * noise_N)
    return float(force_N[touch.stop]) - air > least


def _stays(force_N: FloatArray, touch: Piece, after: Piece, noise_N: float) -> bool:
    """True where a tool stands, before it pushes, under a force that a move has met, and no drag or kick."""
    standing = force_N[touch.stop + 1 : after.start + 1]
    if standing.size < FEWEST_RESTING or touch.stop - touch.start < FEWEST_SAMPLES:
        return False
    air = float(np.median(force_N[: touch.start + 1]))
    reached, left = float(force_N[touch.stop]) - air, float(np.median(standing)) - air
    least = CONTACT_SD * noise_N / np.sqrt(FEWEST_RESTING)
    return reached > CONTACT_SD * noise_N and left > max(least, STAYING_SHARE * reached)


def _digits(air_N: FloatArray, quantum_N: float) -> float:
    """Standard deviation of a force by the step of its digits, where no noise averages it out [N]."""
    steady = air_N.size > 1 and float(np.mean(np.diff(air_N) == 0.0)) > STEADY_SHARE
    return quantum_N / STEP if steady else 0.0


def _least_slope(u: FloatArray, f: FloatArray, air: HingeFit) -> float:
    """The smaller of the stiffness at contact and that of the whole ramp [N/mm], > 0.

    At contact the branch adds to the static stiffness, further in the static curve may harden. A curved tip
    begins without any: its secant over the first travel in tissue counts.
    """
    depth = max(float(u.max()) - air.contact_mm, 1e-3 * float(np.ptp(u)))
    whole = float(np.ptp(f)) / depth
    first = (u >= air.contact_mm) & (u <= air.contact_mm + EARLY_SHARE * depth)
    early = float(f[first].max() - air.baseline_N) / (EARLY_SHARE * depth) if first.any() else 0.0
    return max(min(max(air.slope_N_per_mm, early), whole), 1e-3 * whole)


def _reading_in_air(u: FloatArray, f: FloatArray, air: HingeFit, noise_N: float) -> float:
    """Mean force in air, or its value at contact where the load cell drifts [N]."""
    before = int(np.argmax(u >= air.contact_mm))
    if before < FEWEST_AIR_SAMPLES:
        return air.baseline_N
    drift, error = _rise(f[:before], noise_N)
    if abs(drift) > DRIFT_SD * error:
        return air.baseline_N
    return float(f[:before].mean())


def _given(
    depth_mm: FloatArray, force_N: FloatArray, signs: tuple[int, int], given: float, sd_mm: float
) -> tuple[Contact | None, list[Flag]]:
    """The user's contact, with the reading in air where there is any; outside the record it is said."""
    ends = sorted((signs[0] * float(depth_mm.min()), signs[0] * float(depth_mm.max())))
    where = {"contact_mm": given, "from_mm": ends[0], "to_mm": ends[1]}
    record = f"the record runs from {ends[0]:.4g} to {ends[1]:.4g} mm"
    inside = depth_mm >= signs[0] * given
    if not inside.any():
        message = f"the stated contact, {given:.4g} mm, is never reached: {record}"
        return None, [Flag("no_contact", message, where)]
    flags = []
    if inside.all():
        message = f"the stated contact, {given:.4g} mm, lies before the first sample: {record}"
        flags.append(Flag("starts_in_contact", message, where))
    index = int(np.argmax(inside))
    in_record = index >= FEWEST_AIR_SAMPLES
    contact = Contact(
        index=index,
        displacement_mm=given,
        sd_mm=sd_mm,
        baseline_N=signs[1] * float(np.mean(force_N[:index])) if in_record else 0.0,
        in_record=in_record,
    )
    return contact, flags


def _resting(u: FloatArray) -> int:
    """Samples before the tool moves, at least one."""
    return max(1, int(np.argmin(u <= u[0] + STANDING_SHARE * float(u.max() - u[0]))))


class _Before(NamedTuple):
    """Contact of a ramp that begins in contact."""

    contact_mm: float
    sd_mm: float
    ahead_N: float  # force at the first sample, above the zero of the load cell
    believed: bool  # whether it lies before that sample


def _extrapolated(approach: _Approach, f: FloatArray, ahead: float, relaxing: float | None) -> _Before:
    """Contact that the force at the first sample and the ramp behind it tell."""
    u, noise_N = approach.depth_mm, approach.noise_N
    start, few = float(u[0]), _resting(u)
    if u.size < FEWEST_SAMPLES:
        slope = max(float(f[-1] - f[0]) / max(float(u.max() - start), 1e-300), 1e-300)
        sd = max(noise_N / slope, 0.3 * float(np.ptp(u)) / u.size)
        return _Before(start - ahead / slope, sd, ahead, ahead > PRELOAD_SD * noise_N / np.sqrt(few))
    back = REACH * (max(ahead, 0.0) + REACH_SD * noise_N) / _least_slope(u, f, approach.air)
    back = min(back, 2.0 * float(u.max() - start))
    fit = fit_contact(
        u, f, noise_N=noise_N, noise_samples=approach.noise_samples, baseline=False, reach_back_mm=back
    )
    contact_mm, sd = fit.contact_mm, fit.sd_mm
    if few < FEWEST_RESTING:
        # the whole ramp says more of the force it starts from, which is below its middle, than a sample
        says = fit.slope_N_per_mm * (start - contact_mm)
        ahead = max(ahead, min(says, float(np.median(f))))
    if contact_mm < start:
        stiffness = (fit.secant_N_per_mm, fit.relaxing_share)
        before, sd = with_relaxed(start - contact_mm, sd, ahead, stiffness, relaxing, back)
        contact_mm = start - before
    return _Before(contact_mm, sd, ahead, fit.at_start < PRELOAD_DENSITY)


def _falls(resting_N: FloatArray, noise_N: float) -> float:
    """Force that a tool that stands has lost beyond its noise, as what it stands on relaxes [N]."""
    if resting_N.size < FEWEST_DRIFTING:
        return 0.0
    slope, error = _rise(resting_N, noise_N)
    return -slope * resting_N.size if slope < -DRIFTING * error else 0.0


def _start_in_contact(
    approach: _Approach, *, signs: tuple[int, int], relaxing: float | None
) -> tuple[Contact, list[Flag]]:
    """No air in the record: the contact is the first sample, or lies before it."""
    u, f, air = approach.depth_mm, approach.force_N, approach.air
    compression, force_sign = signs
    start, few, zero, fell = float(u[0]), _resting(u), 0.0, 0.0
    measured = float(f[:few].mean())
    if few >= FEWEST_ZERO_SAMPLES and measured < -PRELOAD_SD * approach.noise_N / np.sqrt(few):
        # a tool at rest cannot be pulled by the tissue: this is where the load cell's zero lies
        fell = _falls(f[:few], approach.noise_N)
        zero, measured, f = measured, 0.0, f - measured
    before = _extrapolated(approach, f, measured, relaxing)
    flags: list[Flag] = []
    loaded = before.ahead_N > PRELOAD_SHARE * float(np.ptp(f))
    if before.believed and loaded and before.contact_mm < start:
        contact = Contact(index=0, displacement_mm=compression * before.contact_mm, sd_mm=before.sd_mm)
        ramp = f", by its ramp {before.ahead_N:.3g} N" if before.ahead_N > measured else ""
        back = f"contact is {start - before.contact_mm:.3g} mm back, sd {before.sd_mm:.2g} mm"
        told = {"force_N": before.ahead_N, "before_mm": start - before.contact_mm, "sd_mm": before.sd_mm}
        flags.append(Flag("preload", f"the record starts under {measured:.3g} N{ramp}; {back}", told))
    else:
        # the first sample is quoted, so its distance from what the force says is part of its sd
        sd = float(np.hypot(before.sd_mm, before.contact_mm - start))
        sd = float(np.hypot(sd, REACH * fell / _least_slope(u, f, air)))
        step = float(u[min(few, u.size - 1)]) - start
        if few >= FEWEST_RESTING and step > UNCERTAIN_SHARE * float(np.ptp(u)):
            # a tool that stands and then jumps may have met the tissue anywhere on its way
            sd = float(np.hypot(sd, step / np.sqrt(3.0)))
        contact = Contact(
            index=0, displacement_mm=compression * start, sd_mm=sd, baseline_N=force_sign * zero
        )
    # a start in air after all is taken as equally likely beforehand: in contact, or a contact on the ramp
    odds = air.at_start * float(u.max() - u[0]) / (np.sqrt(2.0 * np.pi) * max(air.sd_mm, 1e-300))
    apart = abs(compression * contact.displacement_mm - air.contact_mm)
    doubt = float(apart * np.sqrt(odds) / (1.0 + odds))
    # nobody knows less of it than that it lies somewhere along the travel
    contact = replace(contact, sd_mm=min(float(np.hypot(contact.sd_mm, doubt)), float(np.ptp(u))))
    message = "the record shows no samples in air before contact"
    if air.contact_mm - start > DOUBTFUL_SD * air.sd_mm:
        later = f"from one after {air.contact_mm - start:.3g} mm in air; the start is taken"
        message = f"force does not tell contact at the start {later}"
    flags.append(Flag("starts_in_contact", message, {"sd_mm": contact.sd_mm}))
    if fell > 0.0:
        words = f"the force falls by {fell:.3g} N below its zero while the tool stands: zeroed in contact?"
        values = {"sd_mm": contact.sd_mm, "travel_mm": float(np.ptp(u))}
        return contact, [*flags, Flag("contact_uncertain", words, values)]
    return contact, flags + _uncertain(contact, u)


def _uncertain(contact: Contact, u: FloatArray) -> list[Flag]:
    depth = float(u.max()) - float(u.min())
    if contact.sd_mm <= UNCERTAIN_SHARE * depth:
        return []
    message = f"contact is known to {contact.sd_mm:.3g} mm only, in {depth:.3g} mm of travel"
    return [Flag("contact_uncertain", message, {"sd_mm": contact.sd_mm, "travel_mm": depth})]
