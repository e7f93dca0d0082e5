"""The page of ``tissueid training``: attempts of each person, their ways, and how practice changed them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tissueid.digits import number
from tissueid.documents.session import Attempt, Learning, Training
from tissueid.report.page import render_plain
from tissueid.report.parts import Figure, Section, Table, trace

#: Measures that practice is looked for in: words and unit.
LEARNED = {
    "end_error_mm": ("End error", "mm"),
    "angle_deg": ("Angle of the track", "degrees"),
    "seconds": ("Time", "s"),
}
HEADS = (
    "Attempt", "Recorded", "End error [mm]", "At the bone [mm]", "Angle [degrees]", "Time [s]",
    "Way over chord", "Mean force [N]", "Peak force [N]", "Less ln jerk", "Through",
)  # fmt: skip


def render_training(document: Training, tracks: Mapping[str, tuple[Sequence[float], Sequence[float]]]) -> str:
    """Write the page.

    ``tracks``: file of an attempt -> height above the entry point and distance from the axis [mm].
    """
    who = dict.fromkeys(row.pseudonym for row in document.attempts)
    sections = [_person(document, tracks, one) for one in who]
    if document.refused:
        rows = [(one.file, one.reason) for one in document.refused]
        sections.append(Section("Logs without an attempt", tables=[Table(("Log", "Why"), rows)]))
    return render_plain("Guided sessions", sections)


def _person(
    document: Training, tracks: Mapping[str, tuple[Sequence[float], Sequence[float]]], who: str | None
) -> Section:
    rows = [row for row in document.attempts if row.pseudonym == who]
    curves = {one.measure: one for one in document.learning if one.pseudonym == who}
    text = (
        f"{len(rows)} attempts, from {document.cone_entry_mm:g} mm above the bone to the end of the "
        "drilling. A device without orientation has no angle of its own: it is that of the chord. "
        + ("" if curves else "Practice is looked for from four attempts on. ")
        + "For research: no number here says that somebody may operate."
    )
    learned = [_learned(measure, rows, curves[measure]) for measure in LEARNED if measure in curves]
    return Section(
        who or "Nobody named",
        text,
        tables=[Table(HEADS, [_row(at, row) for at, row in enumerate(rows, 1)])],
        figures=[_ways(rows, tracks), *learned],
    )


def _row(at: int, row: Attempt) -> tuple[str, ...]:
    return (
        str(at),
        row.started[:19].replace("T", " "),
        number(row.end_error_mm, 3),
        number(row.entry_error_mm, 3),
        f"{row.angle_deg:.2f} \u00b1 {row.angle_se_deg:.2f}",
        number(row.seconds, 3),
        number(row.path_over_chord, 3),
        number(row.mean_force_N, 3),
        number(row.peak_force_N, 3),
        number(row.log_jerk, 3),
        "yes" if row.complete else "no",
    )


def _ways(rows: Sequence[Attempt], tracks: Mapping[str, tuple[Sequence[float], Sequence[float]]]) -> Figure:
    ways = [[[round(value, 4) for value in axis] for axis in tracks[row.file]] for row in rows]
    traces = [trace(x, y, "lines", name=f"attempt {at}") for at, (x, y) in enumerate(ways, 1)]
    caption = "Distance of the tip from the planned axis over its height above the entry point, way by way."
    layout = {"xaxis": {"autorange": "reversed"}, "yaxis": {"rangemode": "tozero"}}
    return Figure(caption, "Height above the bone [mm]", "Distance from the axis [mm]", traces, layout)


def _learned(measure: str, rows: Sequence[Attempt], curve: Learning) -> Figure:
    words, unit = LEARNED[measure]
    at = list(range(1, len(rows) + 1))
    drawn = np.linspace(1.0, len(rows), 60)
    found = [getattr(row, measure) for row in rows]
    fitted = (curve.first * drawn**curve.exponent).round(6).tolist()
    traces = [
        trace(at, found, "markers", name="attempts", marker={"ink": "data", "size": 8}),
        trace(drawn.round(4).tolist(), fitted, "lines", name="power law", line={"ink": "model"}),
    ]
    layout = {"xaxis": {"dtick": max(1, len(rows) // 10)}, "yaxis": {"rangemode": "tozero"}}
    caption = (
        f"{words} goes with attempt to the power of {curve.exponent:.2f} \u00b1 "
        f"{curve.exponent_se:.2f}, from {number(curve.first, 3)} {unit} at the first. A few attempts "
        "tell no power law from another curve."
    )
    return Figure(caption, "Attempt", f"{words} [{unit}]", traces, layout)
