"""Motion of the crosshead, as a polyline of travel over time.

A program of moves and holds is a polyline already.  A crosshead that slows down to its stop within a time
r is given a raised-cosine speed, v(t) = v/2 (1 + cos(pi u)), u = (t - t_c + r/2)/r, about the nominal
corner t_c, resolved into :data:`CHORDS` chords: travel is then exact at the knots and the sag between them
is below v r pi/(16 CHORDS^2), 1e-6 mm for 500 mm/min and 30 ms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.synth.recipe import Log, Move

CHORDS = 200


@dataclass(frozen=True, slots=True)
class Path:
    """A polyline: ``value_mm`` over strictly growing ``time_s``, both of shape (k,)."""

    time_s: FloatArray
    value_mm: FloatArray

    def at(self, time_s: FloatArray) -> FloatArray:
        """Value at given times [mm]; constant after the last knot."""
        return np.interp(time_s, self.time_s, self.value_mm)


def crosshead_path(log: Log, *, rounding_s: float = 0.0) -> Path:
    """Travel of the crosshead through a log's program.

    ``rounding_s``: time it takes to slow down to each stop [s]; at most as long as the moves and holds allow.
    Returns travel from 0 at t = 0.
    """
    times, values = [0.0], [0.0]
    for move in log.moves:
        if isinstance(move, Move):
            duration, target = abs(move.to_mm - values[-1]) / move.speed_mm_s, move.to_mm
        else:
            duration, target = move.hold_s, values[-1]
        if duration > 0.0:
            times.append(times[-1] + duration)
            values.append(target)
    knots = Path(np.array(times), np.array(values))
    return _round_stops(knots, rounding_s) if rounding_s > 0.0 else knots


def _round_stops(path: Path, rounding_s: float) -> Path:
    """Replace each corner at which a move ends in a standstill by a raised-cosine slow-down."""
    speed = np.diff(path.value_mm) / np.diff(path.time_s)
    times: list[FloatArray] = [path.time_s[:1]]
    values: list[FloatArray] = [path.value_mm[:1]]
    for k in range(1, path.time_s.size):
        corner, travel = path.time_s[k], path.value_mm[k]
        stops = k < speed.size and speed[k] == 0.0 and speed[k - 1] != 0.0
        if not stops:
            times.append(path.time_s[k : k + 1])
            values.append(path.value_mm[k : k + 1])
            continue
        room = 2.0 * min(corner - path.time_s[k - 1], path.time_s[k + 1] - corner)
        width = min(rounding_s, 0.999 * room)
        u = np.linspace(0.0, 1.0, CHORDS + 1)
        times.append(corner + (u - 0.5) * width)
        values.append(travel - 0.5 * speed[k - 1] * width * (1.0 - u - np.sin(np.pi * u) / np.pi))
    return Path(np.concatenate(times), np.concatenate(values))


def contact_path(travel: Path, offset_mm: float) -> Path:
    """Depth max(0, travel - offset) of a tool that meets the tissue at ``offset_mm`` of travel.

    A negative offset is a start that is indented already.  Knots are added where the tool crosses the
    surface, so that the result is the exact polyline.
    """
    depth = travel.value_mm - offset_mm
    crosses = np.flatnonzero(depth[:-1] * depth[1:] < 0.0)
    share = depth[crosses] / (depth[crosses] - depth[crosses + 1])
    times = travel.time_s[crosses] + share * (travel.time_s[crosses + 1] - travel.time_s[crosses])
    time_s = np.insert(travel.time_s, crosses + 1, times)
    depth = np.insert(depth, crosses + 1, 0.0)
    return Path(time_s, np.maximum(depth, 0.0))
