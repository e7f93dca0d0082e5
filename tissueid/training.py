"""Measures of attempts: the tip's way from the cone's entry to the end of the drilling; practice.

The angle of a track is that of the chord between two places of the tip.  Practice is a power law ``y = a
n^b`` (Newell & Rosenbloom 1981, Mechanisms of skill acquisition and the law of practice).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, evenly
from tissueid.documents.session import Curve, Way
from tissueid.haptics.states import State
from tissueid.rendering import guidance as gd
from tissueid.rendering.environment import GUIDED

#: Height above the entry point of the bone at which the cone begins [mm] (assumed).
CONE_ENTRY_MM = 40.0
#: Half of the stretch that places one end of a chord, and half of the window of the smoothed path [s].
STRETCH_S = 0.05
SMOOTHED_S = 0.025
#: Half of the window of the jerk, whose third derivative is that of a local polynomial of this degree.
JERK_S = 0.1
JERK_DEGREE = 5
JERK_STEP_S = 0.01
MM = 1000.0
#: Points of a drawn way.
TRACK_POINTS = 300


def measured(head: Mapping[str, Any], records: NDArray[Any], *, cone_entry_mm: float = CONE_ENTRY_MM) -> Way:
    """Measures of a session's log; ValueError where it was not guided, or there is no attempt in it."""
    if head["environment"] != "guidance":
        raise ValueError(
            f"the session was not guided (it was {head['environment']}): there is no plan to compare it with"
        )
    felt, place, drill_mm = _felt(head, records)
    time = felt["time_s"]
    first, last, complete = _ends(place[:, 2], cone_entry_mm, drill_mm)
    begin, begin_se = _placed(time, place, first)
    end, end_se = _placed(time, place, last)
    chord = end - begin
    length = float(np.linalg.norm(chord))
    sideways = float(np.hypot(chord[0], chord[1]))
    way = slice(first, last + 1)
    smooth = _smoothed(time, place)[way]
    path = float(np.linalg.norm(np.diff(smooth, axis=0), axis=1).sum())
    force = np.linalg.norm(felt["force_N"][way], axis=1)
    entered = np.flatnonzero(place[way, 2] <= 0.0)
    entry = first + int(entered[0]) if entered.size else None
    return Way(
        complete=complete,
        seconds=float(time[last] - time[first]),
        entry_error_mm=None if entry is None else float(np.hypot(*_placed(time, place, entry)[0][:2])),
        end_error_mm=float(np.hypot(end[0], end[1])),
        angle_deg=math.degrees(math.atan2(sideways, -chord[2])),
        angle_se_deg=math.degrees(math.hypot(begin_se, end_se) / length),
        path_mm=path,
        path_over_chord=path / length,
        mean_force_N=float(force.mean()),
        peak_force_N=float(force.max()),
        log_jerk=_log_jerk(time[way], smooth),
    )


def track(
    head: Mapping[str, Any], records: NDArray[Any], *, cone_entry_mm: float = CONE_ENTRY_MM
) -> tuple[FloatArray, FloatArray]:
    """Smoothed way of an attempt that :func:`measured` accepts: height and distance from the axis [mm]."""
    felt, place, drill_mm = _felt(head, records)
    first, last, _ = _ends(place[:, 2], cone_entry_mm, drill_mm)
    way = _smoothed(felt["time_s"], place)[first : last + 1]
    kept = way[evenly(len(way), TRACK_POINTS)]
    return kept[:, 2], np.hypot(kept[:, 0], kept[:, 1])


def _felt(head: Mapping[str, Any], records: NDArray[Any]) -> tuple[NDArray[Any], FloatArray, float]:
    """Records with force, their places along the axis [mm], and the depth of the drilling [mm]."""
    numbers = np.asarray(head["tissues"][0]["block"])[GUIDED : GUIDED + gd.GUIDANCE_SIZE]
    felt = records[(records["state"] == State.ENGAGED) & np.isfinite(records["position_m"]).all(axis=1)]
    return felt, _along_axis(numbers, felt["position_m"]), MM * float(numbers[gd.DRILL_END])


def _along_axis(numbers: FloatArray, position_m: FloatArray) -> FloatArray:
    """Two coordinates across the planned axis and the height along it [mm], shape (n, 3)."""
    axis = numbers[gd.AXIS : gd.AXIS + 3]
    # any direction that is not the axis gives a frame; no measure depends on which
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    across = np.cross(axis, helper)
    across /= np.linalg.norm(across)
    frame = np.stack([across, np.cross(axis, across), axis])
    return np.asarray(MM * (position_m - numbers[gd.ORIGIN : gd.ORIGIN + 3]) @ frame.T)


def _ends(height: FloatArray, cone_entry_mm: float, drill_mm: float) -> tuple[int, int, bool]:
    """First and last sample of the attempt, and whether the drilling came to its end."""
    through = np.flatnonzero(-height >= drill_mm) if drill_mm > 0.0 else np.zeros(0, np.int64)
    last = int(through[0]) if through.size else int(np.argmin(height)) if height.size else 0
    above = np.flatnonzero(height[:last] > cone_entry_mm)
    if not above.size or not height[last] < cone_entry_mm:
        raise ValueError(
            f"the tip never came from {cone_entry_mm:g} mm above the entry point toward the bone: there is "
            "no attempt in this session"
        )
    return int(above[-1]) + 1, last, bool(through.size)


def _placed(time: FloatArray, place: FloatArray, at: int) -> tuple[FloatArray, float]:
    """Place of the tip at a sample [mm], by a line through a short stretch; its error across the axis."""
    near = np.abs(time - time[at]) <= STRETCH_S
    t = time[near] - time[at]
    design = np.column_stack([np.ones_like(t), t])
    if t.size < 4:
        return place[at].copy(), 0.0
    line, *_ = np.linalg.lstsq(design, place[near], rcond=None)
    left = (place[near] - design @ line)[:, :2]
    spread = (left**2).sum(axis=0)
    lag = np.divide((left[1:] * left[:-1]).sum(axis=0), spread, out=np.zeros(2), where=spread > 0.0)
    lag = np.clip(lag, 0.0, 0.98)
    variance = spread / (t.size - 2) * (1.0 + lag) / (1.0 - lag) * np.linalg.inv(design.T @ design)[0, 0]
    return line[0], float(np.sqrt(variance.sum()))


def _smoothed(time: FloatArray, place: FloatArray) -> FloatArray:
    """Running mean of the places: encoder counts and tremor are no way."""
    count = max(int(SMOOTHED_S / max(float(np.median(np.diff(time))), 1e-6)), 1)
    padded = np.pad(place, ((count, count), (0, 0)), mode="edge")
    total = np.cumsum(np.vstack([np.zeros(3), padded]), axis=0)
    return np.asarray((total[2 * count + 1 :] - total[: -2 * count - 1]) / (2 * count + 1))


def _log_jerk(time: FloatArray, smooth: FloatArray) -> float | None:
    """Less ln of the dimensionless jerk of a smoothed way; none where it is shorter than the window."""
    from scipy.signal import savgol_filter

    # a hundred samples a second hold all of a hand, and a local polynomial over them is well conditioned
    even = np.arange(time[0], time[-1], JERK_STEP_S)
    window = 2 * round(JERK_S / JERK_STEP_S) + 1
    if even.size < window:
        return None
    places = np.column_stack([np.interp(even, time, smooth[:, k]) for k in range(3)])
    jerk = savgol_filter(places, window, JERK_DEGREE, deriv=3, delta=JERK_STEP_S, axis=0)
    span, length = float(time[-1] - time[0]), float(np.linalg.norm(smooth[-1] - smooth[0]))
    energy = float((jerk**2).sum()) * JERK_STEP_S
    return None if length == 0.0 or energy == 0.0 else -math.log(energy * span**5 / length**2)


#: Attempts from which a slope has a standard error worth a word.
FEWEST = 4


def learning_curve(values: Sequence[float | None]) -> Curve | None:
    """The curve through a measure of attempts in their order; None for fewer than four positive ones."""
    y = np.asarray(values, dtype=np.float64)
    number = np.arange(1, y.size + 1)
    known = np.isfinite(y) & (y > 0.0)
    if int(known.sum()) < FEWEST:
        return None
    (slope, intercept), covariance = np.polyfit(np.log(number[known]), np.log(y[known]), 1, cov=True)
    return Curve(math.exp(intercept), float(slope), math.sqrt(covariance[0, 0]), int(known.sum()))
