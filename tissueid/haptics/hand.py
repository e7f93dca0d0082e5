"""Hands that hold a simulated arm, and scripts that move it like a test machine.

A hand is a spring and a damper (50 to 1000 N/m is what fingers and wrists do) around a target.  A script
carries the grip exactly, in **tissue** units: ``indent 8 mm at 250 mm/min; hold 2 s; retract at 250 mm/min``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import printable, refuse
from tissueid.haptics import shared_hand as layout

#: Names of :func:`preset`.
PRESETS = ("step", "slow press", "tap", "release", "tremor", "hold")
#: Stiffness of a hand that is not said otherwise [N/m].
DEFAULT_STIFFNESS = 300.0
#: A hand's damping as a share of the critical one of 0.25 kg on its spring; relaxed arms show 0.3 to 0.8.
DAMPING_RATIO = 0.5
DEFAULT_MASS_KG = 0.25
#: Height above the tissue at which a hand starts [m].
CLEARANCE_M = 0.003
#: Time of rest before a hand moves [s]: longer than the guard's start-up ramp.
REST_S = 1.2
#: Amplitude of a tremor [m].
TREMOR_M = 2e-4
#: A step of the hand takes this time [s]: faster is a blow, which the overspeed rule is for.
STEP_S = 0.03
MM = 1e-3
S_PER_MIN = 60.0
#: What a script may ask for: outside this a typing error is likelier than a wish.
MOST_SPEED_MM_S = 200.0
MOST_HOLD_S = 3600.0
MOST_STROKES = layout.MAX_KNOTS - 2
#: Height above the tissue, in tissue units [mm], at which a script starts and to which it retracts.
SCRIPT_CLEARANCE_MM = 0.5


@dataclass(frozen=True, slots=True)
class Hand:
    """A spring and a damper around a moving target, or a machine that carries the grip."""

    times_s: tuple[float, ...]  # times of the knots, rising
    positions_m: tuple[tuple[float, float, float], ...]  # target at the knots [m]
    grips: tuple[float, ...]  # share of stiffness and damping from each knot on: 1 holds, 0 lets go
    stiffness_N_per_m: float = DEFAULT_STIFFNESS
    damping_N_s_per_m: float = 2.0 * DAMPING_RATIO * math.sqrt(DEFAULT_STIFFNESS * DEFAULT_MASS_KG)
    rigid: bool = False  # carry the grip exactly, whatever the force
    #: Amplitude [m], frequency [Hz] and phase [rad] of a tremor.
    tremor_m: float = 0.0
    tremor_hz: float = 10.0
    tremor_phase: float = 0.0
    tremor_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if not 1 <= len(self.times_s) <= layout.MAX_KNOTS:
            raise ValueError(f"a hand has 1 to {layout.MAX_KNOTS} knots, this one {len(self.times_s)}")
        if not len(self.times_s) == len(self.positions_m) == len(self.grips):
            raise ValueError("a hand needs a time, a position and a grip at each knot")
        if not np.isfinite(self.knots()).all() or (np.diff(self.times_s) <= 0.0).any():
            raise ValueError(f"times of a hand must rise and all numbers be finite: {self.times_s}")

    @property
    def start_m(self) -> FloatArray:
        """Start of the hand [m], shape (3,)."""
        return np.array(self.positions_m[0], dtype=np.float64)

    @property
    def duration_s(self) -> float:
        """Time of the last knot [s]; the hand stays there."""
        return self.times_s[-1]

    def knots(self) -> FloatArray:
        """Time, x, y, z and grip of every knot, shape (n, 5)."""
        return np.column_stack([self.times_s, self.positions_m, self.grips]).astype(np.float64)

    def write(self, block: FloatArray) -> FloatArray:
        """Write the hand into an arm's block of parameters, and return that."""
        knots = self.knots()
        block[layout.KNOTS] = len(knots)
        block[layout.FIRST_KNOT : layout.FIRST_KNOT + layout.KNOT_COLUMNS * len(knots)] = knots.ravel()
        block[layout.HAND_STIFFNESS : layout.TREMOR_AXIS + 3] = (
            self.stiffness_N_per_m, self.damping_N_s_per_m, self.rigid,
            self.tremor_m, self.tremor_hz, self.tremor_phase, *self.tremor_axis,
        )  # fmt: skip
        return block


def along(
    surface_m: FloatArray,
    inward: FloatArray,
    times_s: Sequence[float],
    depths_m: FloatArray,
    grips: Sequence[float] | None = None,
) -> Hand:
    """Hand that moves along ``inward`` through ``surface_m``: depth [m] by time [s]."""
    axis = np.asarray(inward, dtype=np.float64)
    points = np.asarray(surface_m) + np.outer(depths_m, axis)
    return Hand(
        times_s=tuple(times_s),
        positions_m=tuple(map(tuple, points.tolist())),
        grips=tuple(grips or [1.0] * len(times_s)),
        tremor_axis=tuple(axis.tolist()),
    )


def preset(
    name: str,
    *,
    surface_m: FloatArray,
    inward: FloatArray,
    depth_m: float,
    speed_m_per_s: float = 0.02,
    rest_s: float = REST_S,
    stay_s: float = 1.0,
) -> Hand:
    """One of :data:`PRESETS` about a point of the surface [m], ``inward`` a unit vector into the tissue.

    ``depth_m``: of the target, which the grip stays above by force over stiffness.  Raises UsageError: there
    is no preset of that name.
    """
    if name not in PRESETS:
        refuse(f"there is no hand {printable(name)!r}; hands are {', '.join(PRESETS)}")
    times, depths, grips = _targets(name, depth_m, speed_m_per_s, rest_s, stay_s)
    hand = along(surface_m, inward, times, np.array(depths), grips)
    return replace(hand, tremor_m=TREMOR_M) if name == "tremor" else hand


def _targets(
    name: str, depth_m: float, speed_m_per_s: float, rest_s: float, stay_s: float
) -> tuple[list[float], list[float], list[float]]:
    """When [s] a preset wants to be how deep [m], and how firmly it grips (0 to 1)."""
    clear = -CLEARANCE_M
    if name == "slow press":
        clear = -5e-5  # a slow hand starts where it nearly touches, or it would take seconds to arrive
    arrival = rest_s + (STEP_S if name == "step" else (depth_m - clear) / speed_m_per_s)
    times, depths = [0.0, rest_s, arrival], [clear, clear, depth_m]
    if name == "tap":
        times, depths = [0.0, rest_s], [clear, clear]
        for beat in range(max(1, math.ceil(4.0 * stay_s))):
            times += [rest_s + 0.25 * beat + part for part in (0.06, 0.10, 0.16, 0.249)]
            depths += [depth_m, depth_m, clear, clear]
        times, depths = times[: layout.MAX_KNOTS], depths[: layout.MAX_KNOTS]
    elif name == "release":
        times.append(arrival + 0.5 * stay_s)
        depths.append(depth_m)
    last = 0.0 if name == "release" else 1.0
    return [*times, times[-1] + stay_s], [*depths, depths[-1]], [*[1.0] * (len(times) - 1), last, last]


@dataclass(frozen=True, slots=True)
class Stroke:
    """One line of a script, in tissue units."""

    kind: str  # {"indent", "hold", "retract"}
    depth_mm: float  # depth at its end [mm]; of a hold, the depth before it
    duration_s: float


#: Numbers and speeds in what a user writes, as regular expressions.
NUMBER = r"(\d+(?:\.\d*)?|\.\d+)"
SPEED = rf"{NUMBER}\s*mm\s*/\s*(min|s)"
_MOVES = {
    "indent": re.compile(rf"indent\s+{NUMBER}\s*mm\s+at\s+{SPEED}"),
    "retract": re.compile(rf"retract\s+(?:to\s+{NUMBER}\s*mm\s+)?at\s+{SPEED}"),
}
_HOLD = re.compile(rf"hold\s+{NUMBER}\s*s")


def parse_script(text: str) -> tuple[Stroke, ...]:
    """Read strokes between semicolons; a retract without a depth leaves the tissue; else UsageError."""
    strokes: list[Stroke] = []
    depth = -SCRIPT_CLEARANCE_MM
    for part in text.split(";"):
        line = " ".join(part.split())
        if not line:
            continue
        kind = line.partition(" ")[0]
        if kind in _MOVES and (found := _MOVES[kind].fullmatch(line)) is not None:
            target = -SCRIPT_CLEARANCE_MM if found[1] is None else float(found[1])
            speed = float(found[2]) / (S_PER_MIN if found[3] == "min" else 1.0)
            if not 0.0 < speed <= MOST_SPEED_MM_S:
                refuse(f"speed of {line!r} is {speed:g} mm/s, above 0 to {MOST_SPEED_MM_S:g} is offered")
            way = target - depth if kind == "indent" else depth - target
            if way <= 0.0:
                where = "deeper" if kind == "indent" else "back"
                refuse(f"{line!r} does not go {where}: the tool is at {depth:g} mm there")
            strokes.append(Stroke(kind, target, way / speed))
        elif (found := _HOLD.fullmatch(line)) is not None and 0.0 < float(found[1]) <= MOST_HOLD_S:
            strokes.append(Stroke("hold", depth, float(found[1])))
        else:
            refuse(
                f"{printable(line)!r} is no stroke of a script; write e.g. "
                "'indent 8 mm at 250 mm/min; hold 2 s; retract at 250 mm/min'"
            )
        depth = strokes[-1].depth_mm
    if not 1 <= len(strokes) <= MOST_STROKES:
        refuse(f"a script has 1 to {MOST_STROKES} strokes, this one {len(strokes)}")
    return tuple(strokes)


def way_of(strokes: Sequence[Stroke], rest_s: float) -> tuple[FloatArray, FloatArray]:
    """Times [s] and depths [mm] of the ends of strokes, behind a rest above the tissue."""
    clear = -SCRIPT_CLEARANCE_MM
    times = np.cumsum([0.0, rest_s, *(stroke.duration_s for stroke in strokes)])
    return times, np.array([clear, clear, *(stroke.depth_mm for stroke in strokes)])


def scripted_hand(
    strokes: Sequence[Stroke],
    *,
    motion_scale: float,
    surface_m: FloatArray,
    inward: FloatArray,
    rest_s: float = REST_S,
) -> Hand:
    """Machine that carries the grip through strokes, ``motion_scale`` times the depth in the tissue."""
    times, depths = way_of(strokes, rest_s)
    return replace(along(surface_m, inward, times.tolist(), MM * motion_scale * depths), rigid=True)
