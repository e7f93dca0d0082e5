"""Motion of a test machine as knots of a carried grip: a recording's own travel, or strokes of a script."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import UsageError
from tissueid.haptics.hand import Hand, along
from tissueid.haptics.shared_hand import MAX_KNOTS
from tissueid.rendering.session_plan import Script
from tissueid.segment import segment
from tissueid.trial import Trial, contact_frame

#: Rest above the tissue before the motion [s]: longer than the ramp of a start; height and speed of the way
#: to it [mm, mm/s].
REST_S, CLEARANCE_MM, APPROACH_MM_S = 0.7, 0.5, 2.0
#: Deviation of straight stretches from a recording's travel that is tried first, over its depth.
FINEST = 2e-4
#: Claimed over travelled depth from which a travel is taken as it is, and below which it is of other tissue:
#: between them a frame gave way.
SAME_DEPTH, MOST_SCALED = 0.99, 0.67


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """Depth by time, straight between knots."""

    #: (k,): from rest above the tissue on.
    time_s: FloatArray
    depth_mm: FloatArray  # (k,)
    contact_s: float  # when the surface is crossed
    words: str
    recorded: FloatArray | None = None  # (n, 2), time [s] and force [N] of the recording that it is of

    @property
    def duration_s(self) -> float:
        """Time of the last knot [s]."""
        return float(self.time_s[-1])

    @property
    def speed_mm_s(self) -> float:
        """Fastest way into the tissue."""
        return float((np.diff(self.depth_mm) / np.diff(self.time_s)).max())

    def hand(self, *, motion_scale: float, surface_m: FloatArray, inward: FloatArray) -> Hand:
        """A machine that carries the grip along it."""
        travel_m = self.depth_mm * motion_scale * 1e-3
        return replace(along(surface_m, inward, self.time_s.tolist(), travel_m), rigid=True)


def program_of_script(script: Script) -> Program:
    """Strokes of a script, from above the tissue on."""
    time, depth = [0.0, REST_S], [-CLEARANCE_MM, -CLEARANCE_MM]
    for stroke in script.strokes:
        time.append(time[-1] + stroke.duration_s)
        depth.append(stroke.depth_mm)
    return _whole(np.array(time), np.array(depth), script.text)


def program_of_recording(trial: Trial, depth_mm: float) -> Program:
    """A recording's own travel from contact on.

    ``depth_mm``: to which the tissue is claimed; the travel of a recording that is a little deeper (its frame
    gave way) is scaled to it, and its force is not compared.  Raises UsageError: it has no contact, goes much
    deeper than that, or needs more straight stretches than a grip is led by.
    """
    segmentation = segment(trial)
    if segmentation.contact is None:
        msg = f"{trial.name}: there is no contact in it; name a recording that touches tissue"
        raise UsageError(msg)
    depth, force = contact_frame(trial, segmentation)
    start = segmentation.contact.index
    time, depth, force = trial.time_s[start:] - trial.time_s[start], depth[start:], force[start:]
    scale = min(depth_mm / float(depth.max()), 1.0)
    if scale < MOST_SCALED:
        msg = f"{trial.name} is {depth.max():.3g} mm deep, the bundle is claimed to {depth_mm:.3g} mm"
        raise UsageError(msg)
    deeper = scale < SAME_DEPTH
    depth = scale * depth if deeper else depth
    words = f"travel of {trial.name}" + f", scaled to {depth_mm:.3g} mm" * deeper
    path = np.column_stack([time, np.maximum(depth, -CLEARANCE_MM)])
    tolerance = FINEST * float(depth.max())
    knots = _simplified(path, tolerance)
    while len(knots) > MAX_KNOTS - 3:
        tolerance *= 1.5
        knots = _simplified(path, tolerance)
    came_s = CLEARANCE_MM / APPROACH_MM_S
    time = np.concatenate([[0.0, REST_S], REST_S + came_s + knots[:, 0]])
    depths = np.concatenate([[-CLEARANCE_MM, -CLEARANCE_MM], knots[:, 1]])
    depths[2] = 0.0
    whole = _whole(time, depths, words)
    recorded = np.column_stack([REST_S + came_s + path[:, 0], force])
    return whole if deeper else replace(whole, recorded=recorded)


def _whole(time_s: FloatArray, depth_mm: FloatArray, words: str) -> Program:
    rising = np.concatenate([[True], np.diff(time_s) > 1e-6])
    time, depth = time_s[rising], depth_mm[rising]
    first = int(np.argmax(depth > 0.0))
    share = -depth[first - 1] / (depth[first] - depth[first - 1])
    contact = time[first - 1] + share * (time[first] - time[first - 1])
    return Program(time, depth, float(contact), words)


def _simplified(path: FloatArray, tolerance: float) -> FloatArray:
    """Fewest points between which a path is straight to a tolerance (Ramer 1972, Douglas & Peucker 1973)."""
    keep, stack = np.zeros(len(path), dtype=bool), [(0, len(path) - 1)]
    keep[[0, -1]] = True
    while stack:
        first, last = stack.pop()
        if last <= first + 1:
            continue
        time, depth = path[first : last + 1].T
        off = np.abs(depth - np.interp(time, time[[0, -1]], depth[[0, -1]]))
        at = int(np.argmax(off))
        if off[at] > tolerance:
            keep[first + at] = True
            stack += [(first, first + at), (first + at, last)]
    return path[keep]
