"""Name the moves and standstills of a recording: approach, ramp, hold, creep, retract, rest, cycle."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.segment.endings import Held
from tissueid.segment.motion import SPEED_RATIO, Path, Piece, corner_near, leaves_line
from tissueid.segment.options import SegmentOptions
from tissueid.segment.stop import travel_line
from tissueid.trial import Contact, Phase

#: A hold has at least so many samples: fewer cannot show a decay beside its plateau.
HOLD_SAMPLES = 8
#: A hold lasts at least this share of its ramp: a crosshead takes 50-300 ms to stop or to turn, and that
#: dwell, seen after a ramp of 10-60 s, is no relaxation test.
HOLD_SHARE_OF_RAMP = 0.05
#: A standstill between opposite moves takes at least this share of the time between their straight parts.
STAND_SHARE_OF_TURN = 0.5
#: Crossheads turn within this time [s].
LONGEST_CREST_S = 0.3
#: A way back this small against its ramp, ended by a standstill, is overshoot of the stop, not a retract.
OVERSHOOT_SHARE = 0.1
#: ... and so is a larger one that is over within this time [s] and half of the ramp's: small steps ring by
#: much of their travel.
SWING_SHARE = 0.3
LONGEST_SWING_S = 0.3
#: After swings, a move this slow against the ramp, no longer than an overshoot, and that does not swing, so
#: that this share of its way is left, is the servo's creep.
CREEPING_SHARE = 0.01
ONE_WAY_SHARE = 0.6
#: ... as is one that takes longer than ringing does, in times of the ramp.
LONGEST_RINGING = 20.0
#: Parts over which its way is averaged, so that the noise of the path is none of it.
CREEPING_PARTS = 20
#: A loop returns at least this share of its way in.
LOOP_RETURN = 0.5
#: Loops from which a recording is cyclic.
FEWEST_LOOPS = 2
#: Kinds whose speed is that of the line through the middle of their travel.
STEADY = ("approach", "ramp", "retract")
#: A standstill lies out of contact up to so many sd of the contact below it ...
CLEAR_SD = 3.0
#: ... which count as no more than this share of the depth, ...
CLEAR_AT_MOST = 0.1
#: ... and at least this one: tissue that was indented has not come back within it.
CLEAR_AT_LEAST = 0.01


@dataclass(frozen=True, slots=True)
class Surface:
    """Surface of the tissue."""

    contact: Contact | None
    depth_mm: float  # contact in the direction of compression [mm]
    clear_mm: float  # a tool standing shallower than this is out of contact [mm]

    @classmethod
    def of(cls, contact: Contact | None, depth_mm: FloatArray, compression_sign: int) -> Surface:
        """The surface of a recording; without contact everything is air."""
        if contact is None:
            return cls(None, float("inf"), float("inf"))
        surface = compression_sign * contact.displacement_mm
        travel = float(depth_mm.max()) - surface
        margin = np.clip(CLEAR_SD * contact.sd_mm, CLEAR_AT_LEAST * travel, CLEAR_AT_MOST * travel)
        return cls(contact, surface, surface + float(margin))


def settled(path: Path, found: list[Piece], options: SegmentOptions) -> list[Piece]:
    """Moves and standstills that mean something: ringing joins its ramp, the dwell of a stop its move."""
    calm = _without_ringing(path, found)
    result: list[Piece] = []
    for k, piece in enumerate(calm):
        if piece.direction == 0 and result:
            after = calm[k + 1] if k + 1 < len(calm) else None
            rounded = after is not None and _turns_round(path, result[-1], piece, after)
            if not _long_enough(path, piece, result[-1], options, rounded=rounded):
                stop = piece.stop
                if after is not None and after.direction == -result[-1].direction:
                    stop = _turn(path, result[-1], piece, after)
                    calm[k + 1] = replace(after, start=stop)
                result[-1] = replace(result[-1], stop=stop)
                continue
        if result and _goes_on(path, result[-1], piece):
            result[-1] = replace(result[-1], stop=piece.stop)
        else:
            result.append(piece)
    return result


def _turn(path: Path, before: Piece, stand: Piece, after: Piece) -> int:
    """The sample at which a move turns, given the short standstill there."""
    within = (before.start + before.stop) // 2, (after.start + after.stop) // 2
    at = (stand.start + stand.stop) // 2
    turn = corner_near(path, at, within, stands=(False, False))
    return min(max(turn, stand.start), stand.stop)


def _goes_on(path: Path, before: Piece, after: Piece) -> bool:
    """True where a move was only interrupted, by a standstill too short to be one."""
    if before.direction == 0 or before.direction != after.direction:
        return False
    slow, fast = sorted(abs(piece.speed(path)) for piece in (before, after))
    return fast <= SPEED_RATIO * slow


def _turns_round(path: Path, before: Piece, stand: Piece, after: Piece) -> bool:
    """True where a standstill between two opposite moves is the crest of a rounded turn."""
    if before.direction * after.direction >= 0:
        return False
    took = stand.took_s(path)
    if took > max(LONGEST_CREST_S, HOLD_SHARE_OF_RAMP * before.took_s(path)):
        return False
    leaves, joins = leaves_line(path, before, stand.start), leaves_line(path, after, stand.stop)
    return took < STAND_SHARE_OF_TURN * float(path.time_s[joins] - path.time_s[leaves])


def _without_ringing(path: Path, found: list[Piece]) -> list[Piece]:
    """Overshoot and ringing before a standstill belong to the ramp."""
    result: list[Piece] = []
    k = 0
    while k < len(found):
        ramp, stop = found[k], k
        while ramp.direction > 0 and stop + 1 < len(found) and not _settles(path, found[stop + 1], ramp):
            stop += 1
            if not _rings(path, found[stop], ramp):
                break
        stands = stop > k and stop + 1 < len(found) and _rings(path, found[stop], ramp)
        if stands:
            ramp = replace(ramp, stop=found[stop].stop)
            found = [*found[: stop + 1], replace(found[stop + 1], direction=0), *found[stop + 2 :]]
        result.append(ramp)
        k = stop + 1 if stands else k + 1
    return result


def _settles(path: Path, after: Piece, ramp: Piece) -> bool:
    """True where a ramp's swings end in a standstill, or in what a servo creeps on."""
    depth = path.depth_mm[after.start : after.stop + 1]
    way = float(np.ptp([part.mean() for part in np.array_split(depth, min(CREEPING_PARTS, depth.size))]))
    slow = way <= CREEPING_SHARE * abs(ramp.speed(path)) * after.took_s(path)
    goes_on = abs(after.travel_mm(path)) >= ONE_WAY_SHARE * way
    goes_on |= after.took_s(path) >= LONGEST_RINGING * ramp.took_s(path)
    small = way <= OVERSHOOT_SHARE * abs(ramp.travel_mm(path))
    return after.direction == 0 or (slow and goes_on and small)


def _rings(path: Path, swing: Piece, ramp: Piece) -> bool:
    """True where a move after a ramp is small beside it, or not large and over at once."""
    moved, travel = abs(swing.travel_mm(path)), abs(ramp.travel_mm(path))
    at_once = swing.took_s(path) <= min(LONGEST_SWING_S, 0.5 * ramp.took_s(path))
    return moved <= OVERSHOOT_SHARE * travel or (moved <= SWING_SHARE * travel and at_once)


def _long_enough(path: Path, stand: Piece, before: Piece, options: SegmentOptions, *, rounded: bool) -> bool:
    duration = stand.took_s(path)
    if options.minimum_hold_s is not None:
        return duration >= options.minimum_hold_s
    long = duration >= HOLD_SHARE_OF_RAMP * before.took_s(path)
    return long and stand.stop - stand.start + 1 >= HOLD_SAMPLES and not rounded


def name_phases(
    path: Path, found: list[Piece], surface: Surface, *, again: Contact | None = None
) -> tuple[Phase, ...]:
    """Name each settled piece; neighbours share their corner sample, together they cover the recording.

    ``again``: where the tool met the tissue again, on a later ramp.
    """
    loops = _loops(path, found, surface)
    named: list[tuple[str, Piece, int | None]] = []
    k = 0
    while k < len(found):
        piece, looped = found[k], k in loops
        peak = piece.stop if looped else None
        kind = "cycle" if looped else _kind(path, piece, surface, named)
        if looped:
            piece = Piece(0, piece.start, found[k + 1].stop)
        after_cycle = bool(named) and named[-1][0] == "cycle"
        touch = _touch(path, found[k], surface) if kind in ("ramp", "cycle") else None
        if kind == "ramp" and again is not None and piece.start < again.index < piece.stop:
            touch = again.index
        if touch is not None and touch > found[k].start and not (looped and after_cycle):
            named.append(("approach", Piece(1, piece.start, touch), None))
            piece = replace(piece, start=touch)
        named.append((kind, piece, peak))
        k += 2 if looped else 1
    return tuple(_phase(path, kind, piece, peak) for kind, piece, peak in named)


def _loops(path: Path, found: list[Piece], surface: Surface) -> set[int]:
    """Loading moves that are unloaded at once, where the recording repeats them."""
    loops: set[int] = set()
    for k in range(len(found) - 1):
        # the way through air is no loading
        into, out = found[k], found[k + 1]
        start, end = float(path.depth_mm[into.start]), float(path.depth_mm[into.stop])
        way_in = end - max(start, min(surface.depth_mm, end))
        way_out = -out.travel_mm(path)
        turns = into.direction > 0 and out.direction < 0
        if turns and way_in > 0.0 and way_out >= LOOP_RETURN * way_in:
            loops.add(k)
    return loops if len(loops) >= FEWEST_LOOPS else set()


def _touch(path: Path, piece: Piece, surface: Surface) -> int | None:
    """Contact of a move into the tissue: a sample of the piece, or ``None`` where all of it is air."""
    contact = surface.contact
    if contact is None:
        return None
    if piece.start < contact.index < piece.stop and contact.in_record:
        return contact.index
    if piece.stop <= contact.index and contact.in_record:
        return None
    depth = path.depth_mm[piece.start : piece.stop + 1]
    air = np.flatnonzero(depth < surface.depth_mm)
    begins_in_air = float(depth[0]) < surface.depth_mm - (surface.clear_mm - surface.depth_mm)
    if not begins_in_air or air.size == 0:
        return piece.start
    return min(piece.start + int(air[-1]) + 1, piece.stop - 1)


def _kind(path: Path, piece: Piece, surface: Surface, named: list[tuple[str, Piece, int | None]]) -> str:
    """The kind of a piece that is no loop."""
    contact = surface.contact
    if contact is None:
        return "retract" if piece.direction < 0 else "approach"
    if contact.in_record and piece.stop <= contact.index:
        return "approach"
    if piece.direction < 0:
        return "retract"
    if piece.direction > 0:
        return "ramp" if _touch(path, piece, surface) is not None else "approach"
    if not any(kind in ("ramp", "cycle") for kind, _, _ in named):
        return "approach"  # nothing was loaded: there is nothing to relax
    if isinstance(piece, Held):
        return "creep"
    level = float(np.median(path.depth_mm[piece.start : piece.stop + 1]))
    return "rest" if level < surface.clear_mm else "hold"


def _phase(path: Path, kind: str, piece: Piece, peak: int | None) -> Phase:
    start_s, end_s = float(path.time_s[piece.start]), float(path.time_s[piece.stop])
    turn = piece.stop if peak is None else peak
    moved, took = float(path.depth_mm[turn] - path.depth_mm[piece.start]), float(path.time_s[turn]) - start_s
    stands = kind != "creep" and piece.direction == 0 and peak is None
    speed = moved / took if took > 0.0 and not stands else 0.0
    if speed != 0.0 and kind in STEADY:
        speed, _ = travel_line(path.time_s, path.depth_mm, piece.start, piece.stop)
    return Phase(kind, piece.start, piece.stop + 1, start_s, end_s, speed, peak)
