"""Collapse of force while the tool moves on: rupture of a layer, tear, or slip.

A fall within one move is a rupture where it is steep against the loading before it, or where most of the
force is lost.  Passive tissue at constant speed can do neither: its relaxing branch only grows towards K v
tau, and a softening static curve falls over lengths like those over which it rose (criterion reconstructed).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.segment.motion import Path, Piece, leaves_line, straight_line
from tissueid.signal_noise import MEDIAN_SAMPLES, running_median
from tissueid.trial import Event

#: A fall is at least this share of the force before it ...
DROP_SHARE = 0.1
#: ... this share of the whole force range ...
RANGE_SHARE = 0.02
#: ... more than the force swings while the tool stands, and so many noise sd: extremes of filtered noise over
#: 1e5 samples lie 2.5 sd out on either side.
DROP_SD = 8.0
#: A fall is steep where its slope exceeds this multiple of the secant stiffness before it.
STEEP = 2.0
#: A loss of this share of the force is a collapse at any slope.
COLLAPSE = 0.6
#: The tool moves on: speed over the fall is at least this share of the move's.
MOVES_ON = 0.7
#: ... watched over this many times what noise explains.
VISIBLE = 3.0
#: Levels of the fall, as shares of it, that its steepness is measured between and its start is seen at.
UPPER, LOWER = 0.1, 0.8
ONSET = 0.05
#: ... or where so many noise sd are lost, which count as no more than this share of the fall.
ONSET_SD = 3.0
UNCLEAR = 0.3
#: Fewest samples that show the low force, unless most of it is lost: fewer may be anything.
FEWEST_AFTER = 3
#: Falls that begin within this time of a stop or turn tell nothing of the tissue [s].
END_S = 0.1
#: Share of a move that must follow its line for its end to be told from its braking.
STRAIGHT_SHARE = 0.6
#: A loss up to this share that the same ramp makes good is a slip.
SLIP_SHARE = 0.2
#: A fall of which this share goes in so small a part of its time is a break at the end of it.
BREAK_SHARE = 0.5
BREAK_TIME = 0.1


class _Fall(NamedTuple):
    """From the highest sample to the lowest, both included."""

    top: int
    bottom: int


def ruptures(path: Path, loading: list[Piece], zero: tuple[float, float]) -> list[Event]:
    """Ruptures, slips and doubtful ruptures of loading moves; ``index`` is the last sample before a fall.

    ``zero``: depth and force of the contact.
    """
    inside = replace(path, depth_mm=path.depth_mm - zero[0], force_N=path.force_N - zero[1])
    least = max(DROP_SD * path.noise_N, RANGE_SHARE * float(np.ptp(path.force_N)), path.swing_N)
    events: list[Event] = []
    for piece in loading:
        span = slice(piece.start, piece.stop + 1)
        force = inside.force_N[span]
        if force.size < 2 * MEDIAN_SAMPLES or float((np.maximum.accumulate(force) - force).max()) < least:
            continue
        steady = running_median(force)
        move = replace(inside, time_s=path.time_s[span], depth_mm=inside.depth_mm[span], force_N=steady)
        # a move that goes on from a faster one without a stop: the branch relaxes to the lower speed
        before = next((one for one in loading if one.stop == piece.start), None)
        slowed = before is not None and piece.speed(path) < before.speed(path)
        until = _steady_until(path, piece, loading)
        sets_off = _sets_off_until(path, piece)
        for fall in _falls(steady, least):
            if slowed and fall.top < 2 * MEDIAN_SAMPLES:
                continue
            # the mass of a tool that sets off pushes on the cell, and the tissue more so later
            if fall.top < sets_off and steady[fall.bottom :].max() > steady[fall.top]:
                continue
            found = _judge(move, fall, least)
            if found is None:
                continue
            event = _event(inside, piece.start, found, steady)
            if event.index <= until:
                events.append(event)
            elif event.values["drop_fraction"] >= COLLAPSE and not _turns_back(path, piece):
                events.append(replace(event, kind="doubtful_rupture"))
    return events


def _turns_back(path: Path, piece: Piece) -> bool:
    """True where the tool leaves again after a move, by more than it settles."""
    after = path.depth_mm[piece.stop : piece.stop + max(piece.stop - piece.start, 2)]
    return bool(path.depth_mm[piece.stop] - after[-1] > SLIP_SHARE * piece.travel_mm(path))


def _steady_until(path: Path, piece: Piece, loading: list[Piece]) -> int:
    """The last sample of a move at which a fall of force is no relaxation or release."""
    if piece.stop >= path.time_s.size - 1 or any(one.start == piece.stop for one in loading):
        return piece.stop  # the record ends, or the move goes on at another speed
    leaves = leaves_line(path, piece, piece.stop)
    if leaves - piece.start < STRAIGHT_SHARE * (piece.stop - piece.start):
        leaves = piece.stop
    return min(leaves, int(np.searchsorted(path.time_s, path.time_s[piece.stop] - END_S)) - 1)


def _sets_off_until(path: Path, piece: Piece) -> int:
    """The sample of a move from which it keeps its speed; 0 where it hardly does."""
    begins = leaves_line(path, piece, piece.start) - piece.start
    return begins if begins <= (1.0 - STRAIGHT_SHARE) * (piece.stop - piece.start) else 0


def _event(inside: Path, start: int, found: tuple[int, int], steady_N: FloatArray) -> Event:
    """A fall of force as an event: of a slip where it is small and the ramp makes it good."""
    onset, bottom = found
    at = start + onset
    before = _level_at(inside, start, at)
    drop = before - float(steady_N[bottom])
    made_good = bool(float(steady_N[bottom:].max()) >= before)
    values = {
        "force_before_N": before,
        "drop_N": drop,
        "drop_fraction": drop / before,
        "depth_mm": float(inside.depth_mm[at]),
        "work_N_mm": _work(inside, start, at),
    }
    kind = "slip" if made_good and drop <= SLIP_SHARE * before else "rupture"
    return Event(kind, at, float(inside.time_s[at]), values)


def _falls(force: FloatArray, least_N: float) -> list[_Fall]:
    """Falls between alternate extremes that are at least the threshold apart."""
    falls: list[_Fall] = []
    top = bottom = 0
    falling = False
    for k, value in enumerate(force.tolist()):
        if falling:
            if value < force[bottom]:
                bottom = k
            elif value > force[bottom] + least_N:
                falls.append(_Fall(top, bottom))
                falling, top = False, k
        elif value > force[top]:
            top = k
        elif value < force[top] - max(least_N, DROP_SHARE * force[top]):
            falling, bottom = True, k
    if falling:
        falls.append(_Fall(top, bottom))
    return falls


def _judge(move: Path, fall: _Fall, least: float) -> tuple[int, int] | None:
    """Onset and lowest sample of a fall within a move that is a rupture, else ``None``."""
    time_s, depth_mm, force = move.time_s, move.depth_mm, move.force_N
    drop = float(force[fall.top] - force[fall.bottom])
    if force[fall.top] <= least or depth_mm[fall.top] <= 0.0:
        return None
    part = force[fall.top : fall.bottom + 1]
    high = fall.top + int(np.flatnonzero(part >= force[fall.top] - UPPER * drop)[-1])
    low = high + int(np.argmax(force[high : fall.bottom + 1] <= force[fall.top] - LOWER * drop))
    if force.size - low < FEWEST_AFTER and drop < COLLAPSE * float(force[fall.top]):
        return None
    # the top is the highest of many noisy samples: its own noise is no fall yet
    begun = min(max(ONSET * drop, ONSET_SD / DROP_SD * least), UNCLEAR * drop)
    onset = fall.top + int(np.flatnonzero(part >= force[fall.top] - begun)[-1])
    onset = max(onset, _break(move, fall))
    first, last = time_s.size // 4, 3 * time_s.size // 4
    speed = float(depth_mm[last] - depth_mm[first]) / max(float(time_s[last] - time_s[first]), 1e-300)
    if not _moves_on(move, (high, low), speed):
        return None
    secant = float(force[fall.top]) / float(depth_mm[fall.top])
    # a fall between two samples is as steep as can be
    took = float(time_s[low] - time_s[high]) - float(np.median(np.diff(time_s)))
    steep = (LOWER - UPPER) * drop >= STEEP * secant * speed * took
    if not steep and drop < COLLAPSE * float(force[fall.top]):
        return None
    return onset, fall.bottom


def _break(move: Path, fall: _Fall) -> int:
    """The sample before a break at the end of a slow fall, as of a neck; the top where there is none."""
    lowest = np.minimum.accumulate(move.force_N[fall.top : fall.bottom + 1])
    time = move.time_s[fall.top : fall.bottom + 1]
    lost = BREAK_SHARE * float(lowest[0] - lowest[-1])
    # the shortest stretch in which that much is lost
    ends = np.searchsorted(-lowest, lost - lowest)
    reached = np.flatnonzero(ends < lowest.size)
    took = time[ends[reached]] - time[reached]
    k = int(np.argmin(took))
    if took[k] > BREAK_TIME * float(time[-1] - time[0]):
        return fall.top
    return fall.top + int(reached[k])


def _moves_on(move: Path, fall: tuple[int, int], speed: float) -> bool:
    """True where the tool keeps its speed over a fall and after it, so far that noise can't hide a stop."""
    first, last = fall
    time_s = move.time_s
    span = VISIBLE * move.tolerance_mm / max(speed, 1e-300)
    last = max(last, min(int(np.searchsorted(time_s, time_s[first] + span)), time_s.size - 1))
    first = min(first, int(np.searchsorted(time_s, time_s[last] - span)))
    took = float(time_s[last] - time_s[first])
    return float(move.depth_mm[last] - move.depth_mm[first]) >= MOVES_ON * speed * took


def _level_at(path: Path, start: int, at: int) -> float:
    """Force at a sample from a straight line through those that lead to it."""
    lead = slice(max(start, at - 2 * MEDIAN_SAMPLES + 1), at + 1)
    slope, level = straight_line(path.time_s[lead], path.force_N[lead], flat=False)
    return level + slope * float(path.time_s[at])


def _work(path: Path, start: int, at: int) -> float:
    """Work from contact to a sample of the move [N mm]."""
    x, f = path.depth_mm[start : at + 1], path.force_N[start : at + 1]
    inside = x >= 0.0
    return float(np.trapezoid(f[inside], x[inside])) if inside.sum() > 1 else 0.0


def rupture_flags(events: list[Event], start_s: float) -> list[Flag]:
    """One flag each for the first rupture, slip and doubtful rupture, with their numbers."""
    flags: list[Flag] = []
    broken, slipped, doubtful = (
        [event for event in events if event.kind == kind] for kind in ("rupture", "slip", "doubtful_rupture")
    )
    if broken:
        deep = f"{broken[0].values['depth_mm']:.3g} mm deep"
        message = f"force falls by {_drop(broken[0], start_s)}, {deep}{_more(broken)}"
        flags.append(Flag("rupture", message, _values(broken)))
    if slipped:
        message = f"force slips by {_drop(slipped[0], start_s)}{_more(slipped)} and recovers"
        flags.append(Flag("slip", message, _values(slipped)))
    if doubtful:
        values = _values(doubtful)
        lost = f"{100 * values['drop_fraction']:.0f} % of the force is lost at the stop"
        message = f"{lost}, {values['time_s'] - start_s:.4g} s: relaxation or rupture?"
        flags.append(Flag("doubtful_rupture", message, values))
    return flags


def _drop(event: Event, start_s: float) -> str:
    values = event.values
    return (
        f"{values['drop_N']:.4g} N ({100 * values['drop_fraction']:.0f} %) at {event.time_s - start_s:.4g} s"
    )


def _more(events: list[Event]) -> str:
    return "" if len(events) == 1 else f", first of {len(events)}"


def _values(events: list[Event]) -> dict[str, float]:
    """Numbers of the first of some events, and how many there are."""
    return {"time_s": events[0].time_s, "count": len(events), **events[0].values}
