"""Compose signs, motion, contact, phases and decisions of the user into the segmentation of a recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import compress

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.digits import clock_start
from tissueid.flags import Flag
from tissueid.segment import endings, stop
from tissueid.segment.contact import END_SHARE, UNCERTAIN_SHARE, find_contact
from tissueid.segment.memory import largest_ratio, long_run_ratio, quiet_stretches, swing_of, without_slow
from tissueid.segment.motion import Path, Piece, leaves_line, pieces, quickens
from tissueid.segment.options import SegmentOptions
from tissueid.segment.phases import Surface, name_phases, settled
from tissueid.segment.rupture import STRAIGHT_SHARE, rupture_flags, ruptures
from tissueid.segment.signs import drift_in_air, signs
from tissueid.signal_noise import FEWEST_CHANGES, bridged, dropouts, white_noise_sd, without_spikes
from tissueid.trial import RENDERED, Contact, Event, Phase, Protocol, Segmentation, Trial

#: A hold may begin in these kinds of phase.
HOLDABLE = ("ramp", "hold", "creep", "rest")


def by_hand(trial: Trial, options: SegmentOptions) -> tuple[Flag, ...]:
    """``decision_overridden`` for what was decided of a run and not, with its reason, in a study file."""
    known = {key for flag in trial.flags for key in flag.values.get("keys", ())}
    stated = {key: value for key, value in options.stated().items() if key not in known}
    if not stated:
        return ()
    words = ", ".join(f"{key} = {str(value).lower()}" for key, value in stated.items())
    because = "stated for this run"
    values = {"keys": list(stated), "because": because}
    return (Flag("decision_overridden", f"{words}, because: {because}", values),)


def held_from_here(path: Path, phases: tuple[Phase, ...], start_s: float) -> tuple[Phase, ...]:
    """Phases of which the hold nearest to a time begins there; a ramp is parted where there is no hold."""
    at = int(np.argmin(np.abs(path.time_s - start_s)))
    holds = [k for k, phase in enumerate(phases) if phase.kind in ("hold", "creep") and k > 0]
    if holds:
        k = min(holds, key=lambda one: abs(phases[one].start_s - start_s))
        before, after = phases[k - 1], phases[k]
        if before.start < at < after.stop - 1:
            moved = (_ending(path, before, at), _starting(path, after, at))
            return (*phases[: k - 1], *moved, *phases[k + 1 :])
        return phases
    for k, phase in enumerate(phases):
        if phase.kind in HOLDABLE and phase.start < at < phase.stop - 1:
            hold = replace(_starting(path, phase, at), kind="hold", speed_mm_s=0.0)
            return (*phases[:k], _ending(path, phase, at), hold, *phases[k + 1 :])
    return phases


def _ending(path: Path, phase: Phase, at: int) -> Phase:
    """A phase that ends at a sample."""
    speed = phase.speed_mm_s
    if speed != 0.0:
        speed, _ = stop.travel_line(path.time_s, path.depth_mm, phase.start, at)
    return replace(phase, stop=at + 1, end_s=float(path.time_s[at]), speed_mm_s=speed)


def _starting(path: Path, phase: Phase, at: int) -> Phase:
    """A phase that starts at a sample."""
    return replace(phase, start=at, start_s=float(path.time_s[at]))


#: Fewest samples with which there is anything to divide.
FEWEST_SAMPLES = 5
#: Shorter moves can't spare a sample on which the force still rises.
FEWEST_STRAIGHT = 50
#: Share of the samples before contact that are air, for all that its place is not known.
AIR_SHARE = 0.9
#: Fewest different depths of a move that shows a contact.
FEWEST_DEPTHS = 3
#: Contact is lost where force falls to so many noise sd, or this share of its range, above that in air.
LOST_SD = 4.0
LOST_SHARE = 0.01
#: Contacts before and after loops are one within so many sd.
SAME_PLACE_SD = 3.0
#: Loss of this share of the force is a break: nothing is left to relax.
BROKEN_SHARE = 0.9
#: A ramp after cycles is the test where it goes this much deeper than they did, or is held.
DEEPER = 1.1


def segment(trial: Trial, *, options: SegmentOptions | None = None) -> Segmentation:
    """Divide a recording into phases and find its contact point; none of either is a result, with a flag."""
    options = options or SegmentOptions()
    decided = options
    if trial.protocol.kind == RENDERED and options.contact_displacement_mm is None:
        # the surface that a session renders is where its depths begin
        decided = replace(options, contact_displacement_mm=0.0, contact_sd_mm=0.0)
    found = _windowed(trial, decided)
    return replace(found, flags=(*by_hand(trial, options), *found.flags))


def _windowed(trial: Trial, options: SegmentOptions) -> Segmentation:
    """The segmentation of what lies between the first and last time that count."""
    inside = np.ones(trial.time_s.size, dtype=np.bool_)
    if options.start_s is not None:
        inside &= trial.time_s >= options.start_s
    if options.end_s is not None:
        inside &= trial.time_s <= options.end_s
    if inside.all():
        return _segment(trial, options)
    first, count = int(np.argmax(inside)), int(inside.sum())
    if count < FEWEST_SAMPLES:
        run = "times run from {:.10g} to {:.10g} s".format(*trial.time_s[[0, -1]])
        message = f"{count} of {inside.size} samples are asked for: {run}"
        flags = _nothing(message, count, 0.0)
        return Segmentation(options.compression_sign or 1, options.force_sign or 1, None, (), 0.0, flags)
    window = slice(first, first + count)
    names = ("time_s", "displacement_mm", "force_N")
    part = replace(trial, **{name: getattr(trial, name)[window] for name in names})
    return _shifted(_segment(part, options), first)


def _nothing(message: str, count: int, travel_mm: float) -> tuple[Flag, ...]:
    values = {"n_samples": count, "travel_mm": travel_mm}
    return (Flag("too_few_samples", message, values), Flag("no_hold", message, values))


def _shifted(found: Segmentation, by: int) -> Segmentation:
    """Sample indices of a part of a recording as those of the whole."""
    contact = found.contact
    phases = [replace(phase, start=phase.start + by, stop=phase.stop + by) for phase in found.phases]
    phases = [one if one.peak is None else replace(one, peak=one.peak + by) for one in phases]
    return replace(
        found,
        contact=None if contact is None else replace(contact, index=contact.index + by),
        phases=tuple(phases),
        corners=tuple(replace(corner, index=corner.index + by) for corner in found.corners),
        events=tuple(replace(event, index=event.index + by) for event in found.events),
    )


def _segment(trial: Trial, options: SegmentOptions) -> Segmentation:
    compression, force_sign, flags = signs(trial, options)
    time_s, depth, force = trial.time_s, compression * trial.displacement_mm, force_sign * trial.force_N
    noise = white_noise_sd(time_s, force)
    force = without_spikes(bridged(force, dropouts(force, depth, noise=noise)), noise=noise)
    if time_s.size < FEWEST_SAMPLES or np.ptp(depth) == 0.0:
        message = f"{time_s.size} samples over {np.ptp(depth):.3g} mm of travel: nothing to divide"
        few = _nothing(message, time_s.size, float(np.ptp(depth)))
        return Segmentation(compression, force_sign, None, (), noise, (*flags, *few))
    depth = without_spikes(depth, noise=white_noise_sd(time_s, depth, fewest=FEWEST_CHANGES))
    path = Path.of(time_s, depth, force, noise)
    found = endings.with_creep(path, stop.placed_stops(path, settled(path, pieces(path), options)))
    locate = partial(find_contact, signs=(compression, force_sign), options=options)
    quiet = quiet_stretches(time_s, force, found)
    path = replace(path, swing_N=swing_of(quiet))
    locate = partial(_lasting, path, quiet, locate)
    moves = _whole(path, found, breaks=options.rupture)
    contact, contact_flags = locate(moves, moves.shallow_from(path))
    if contact is None and options.rupture:
        # a swing of correlated noise in air may have been taken for a break that ends the move
        moves = _whole(path, found, breaks=False)
        contact, contact_flags = locate(moves, moves.shallow_from(path))
    surface = Surface.of(contact, depth, compression)
    phases = name_phases(path, found, surface)
    test = _test_phase(path, phases, surface)
    if contact is not None and _lets_go(path, phases[:test], force_sign * contact.baseline_N):
        start = phases[test].start
        again, again_flags = locate(moves, start)
        if again is not None:
            phases = name_phases(path, found, surface, again=again)
            contact, contact_flags = _set_or_slow((contact, contact_flags), (again, again_flags), path)
    divided = Segmentation(compression, force_sign, contact, phases, noise, test=test)
    events, remarks = _remarks(trial.protocol, divided, path, found, options)
    phases = _without_broken(phases, events)
    if options.hold_from_s is not None:
        phases = held_from_here(path, phases, options.hold_from_s)
    phases = stop.with_braking(path, phases)
    events = tuple(sorted((*events, *stop.settlings(path, phases)), key=lambda event: event.index))
    divided = replace(divided, phases=phases)
    corners = stop.corners_of(path, phases)
    flags += contact_flags + remarks + stop.corner_flags(path, phases, corners)
    flags += stop.speed_flags(phases, trial.protocol.speed_mm_s)
    flags += drift_in_air(time_s, trial.force_N, phases, contact)
    return replace(divided, flags=tuple(flags), corners=corners, events=events)


@dataclass(frozen=True, slots=True)
class _Moves:
    """Moves that may show the tissue's surface, each up to where it breaks."""

    meeting: list[Piece]  # from the first that meets the tissue
    before: list[Piece]  # that may have touched it

    def shallow_from(self, path: Path) -> int:
        """Sample from which the tool, having left, is on its way to the first: records may begin deep."""
        if not self.meeting:
            return 0
        first = self.meeting[0]
        deeper = np.flatnonzero(path.depth_mm[: first.start] >= path.depth_mm[first.stop])
        if not deeper.size:
            return 0
        left = int(deeper[-1]) + 1
        return left + int(np.argmin(path.depth_mm[left : first.start + 1]))


def _without_broken(phases: tuple[Phase, ...], events: tuple[Event, ...]) -> tuple[Phase, ...]:
    """Phases of which no standstill after a break is a hold: what broke can't relax."""
    broken = [e.index for e in events if e.kind == "rupture" and e.values["drop_fraction"] >= BROKEN_SHARE]
    first = min(broken, default=None)
    if first is None:
        return phases
    return tuple(replace(p, kind="rest") if p.kind == "hold" and p.start > first else p for p in phases)


def _lasting(
    path: Path,
    quiet: list[FloatArray],
    locate: Callable[..., tuple[Contact | None, list[Flag]]],
    moves: _Moves,
    start: int,
) -> tuple[Contact | None, list[Flag]]:
    """Contact on the moves from a sample on, and on what the record shows before them from there.

    The noise is that which lasts over many samples, as standstills show it, else the air.
    """
    touches, later = (
        [Piece(1, piece.start - start, piece.stop - start) for piece in some if piece.start >= start]
        for some in (moves.before, moves.meeting)
    )
    record = [values[start:] for values in (path.time_s, path.depth_mm, path.force_N)]
    ways = [record[1][piece.start : piece.stop + 1] for piece in later]
    deep = [bool(way[-1] > way[0]) and np.unique(way).size >= FEWEST_DEPTHS for way in ways]
    # a jump does not show where the tissue was met, and is looked at where nothing else is: what follows it
    # is a hold all the same
    later = list(compress(later, deep)) or later

    def located(ratio: float) -> tuple[Contact | None, list[Flag]]:
        contact, flags = locate(*record, later, touches=touches, noise_N=path.noise_N * ratio)
        return (None if contact is None else replace(contact, index=contact.index + start)), flags

    contact, flags = located(long_run_ratio(quiet))
    if contact is None and quiet and ways:
        # organs breathe: a mean over an end of a move is off by no more than one of its samples
        contact, flags = located(largest_ratio(quiet, END_SHARE * max(way.size for way in ways)))
    if quiet or contact is None or not contact.in_record:
        return contact, flags
    air = slice(start, start + int(AIR_SHARE * (contact.index - start)))
    left = without_slow(path.time_s[air], path.force_N[air])
    ratio = 1.0 if left is None else long_run_ratio([left])
    return (contact, flags) if ratio == 1.0 else located(ratio)


def _whole(path: Path, found: list[Piece], *, breaks: bool) -> _Moves:
    """Moves into the tissue up to where it breaks, those before any has met it apart."""
    loading = [piece for piece in found if piece.direction > 0]
    if not loading:
        return _Moves([], [])
    force, start = path.force_N, loading[0].start
    zero = (float(path.depth_mm[start]), float(np.median(force[: max(start, FEWEST_SAMPLES)])))
    breaking = ruptures(path, loading, zero) if breaks else ()
    broken = [event.index for event in breaking if event.kind == "rupture"]
    least = max(LOST_SD * path.noise_N, LOST_SHARE * float(np.ptp(force)))
    met = [k for k, piece in enumerate(loading) if float(force[piece.stop] - force[piece.start]) > least]
    moves = [
        replace(
            piece,
            stop=min(
                [_straight_until(path, piece), *(at for at in broken if piece.start < at <= piece.stop)]
            ),
        )
        for piece in loading
    ]
    first = met[0] if met else 0
    return _Moves(moves[first:], moves[:first])


def _straight_until(path: Path, move: Piece) -> int:
    """The last sample of a move before it stops: force relaxes while it does, and tells no contact."""
    move = replace(move, start=quickens(path, move))
    end = leaves_line(path, move, move.stop)
    start_N, end_N, stop_N = path.force_N[[move.start, end, move.stop]]
    if stop_N - end_N > end_N - start_N:
        return move.stop  # a move that slowed down before it met anything
    if move.stop - move.start < FEWEST_STRAIGHT and path.force_N[move.stop] >= path.force_N[end]:
        return move.stop
    # a move that is no straight line has no such sample
    return end if end - move.start >= STRAIGHT_SHARE * (move.stop - move.start) else move.stop


def _test_phase(path: Path, phases: tuple[Phase, ...], surface: Surface) -> int:
    """The phase after the last cycle, where a test follows it; else 0."""
    last = max((k for k, phase in enumerate(phases) if phase.kind == "cycle"), default=-1)
    if last < 0:
        return 0
    peaks = [float(path.depth_mm[phase.peak]) for phase in phases if phase.peak is not None]
    looped = max(peaks) - surface.depth_mm
    # a standstill where the last loop ended is its recovery
    ended = float(path.depth_mm[phases[last].stop - 1]) - surface.depth_mm
    for phase in phases[last + 1 :]:
        deep = float(path.depth_mm[phase.stop - 1]) - surface.depth_mm
        if phase.kind in ("hold", "creep") and deep > ended + (DEEPER - 1.0) * looped:
            return last + 1
        if phase.kind == "ramp" and deep > DEEPER * looped:
            return last + 1
    return 0


def _lets_go(path: Path, cycles: tuple[Phase, ...], baseline_N: float) -> bool:
    """True where tool and tissue part between the first peak and the test."""
    peaks = [phase.peak for phase in cycles if phase.peak is not None]
    if not peaks:
        return False
    between = np.sort(path.force_N[peaks[0] : cycles[-1].stop])
    # a low percentile and not the least: single samples may be anything
    least = float(between[min(FEWEST_SAMPLES, between.size - 1)])
    return least - baseline_N <= max(LOST_SD * path.noise_N, LOST_SHARE * float(np.ptp(path.force_N)))


def _set_or_slow(
    first: tuple[Contact, list[Flag]], again: tuple[Contact, list[Flag]], path: Path
) -> tuple[Contact, list[Flag]]:
    """Contact before loops, as uncertain as its distance from the one that is met after them.

    Tissue that is not back yet remembers its loops, and has set if it never comes back.  A tool that stands
    where it is met again, without air before it, does not tell where the surface was.
    """
    (before, flags), (after, _) = first, again
    apart = abs(after.displacement_mm - before.displacement_mm)
    same = apart <= SAME_PLACE_SD * float(np.hypot(before.sd_mm, after.sd_mm))
    if same or not after.in_record:
        return before, flags
    met = replace(before, sd_mm=float(np.hypot(before.sd_mm, apart)), moved_mm=apart)
    if apart <= UNCERTAIN_SHARE * float(np.ptp(path.depth_mm)):
        return met, flags
    message = f"the tool meets the tissue {apart:.3g} mm away after its loops: set, or not back yet"
    said = Flag("contact_uncertain", message, {"sd_mm": met.sd_mm, "apart_mm": apart})
    return met, [*(flag for flag in flags if flag.code != said.code), said]


def _remarks(
    protocol: Protocol, divided: Segmentation, path: Path, found: list[Piece], options: SegmentOptions
) -> tuple[tuple[Event, ...], list[Flag]]:
    """Flags of events beside the phases, and of the test that they tell."""
    phases, contact = divided.phases, divided.contact
    events: list[Event] = []
    flags: list[Flag] = []
    loops = endings.loops_of(path, phases)
    baseline = 0.0
    if contact is not None:
        baseline = divided.force_sign * contact.baseline_N
        zero = (divided.compression_sign * contact.displacement_mm, baseline)
        if options.rupture:
            loading = [piece for piece in found if piece.direction > 0]
            broken = ruptures(path, loading, zero)
            flags += rupture_flags(broken, clock_start(path.time_s[0]))
            events += broken
        ended = endings.aborts(path, phases, protocol)
        ended += endings.load_limits(path, phases, loops, zero=zero, stated_N=protocol.load_limit_N)
        flags += endings.ending_flags(ended)
        flags += endings.pull_off(path, surface_mm=zero[0])
        events += ended
    flags += endings.cycle_flags(loops, before_test=divided.test > 0, baseline_N=baseline)
    flags += _missing(phases)
    return tuple(sorted(events, key=lambda event: event.index)), flags


def _missing(phases: tuple[Phase, ...]) -> list[Flag]:
    """Ramps and holds: too few, or several."""
    flags: list[Flag] = []
    kinds = [phase.kind for phase in phases]
    ramps, holds = kinds.count("ramp"), kinds.count("hold")
    if not ramps and "cycle" not in kinds:
        flags.append(Flag("no_ramp", "no loading ramp was found"))
    if not holds:
        crept = ": under a held load the tool creeps" if "creep" in kinds else ""
        flags.append(Flag("no_hold", f"no hold was found{crept}"))
    if holds > 1 and ramps > 1:
        message = f"{holds} holds after {ramps} ramps"
        flags.append(Flag("several_steps", message, {"ramps": ramps, "holds": holds}))
    return flags
