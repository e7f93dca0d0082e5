"""Ruptures, aborts and load limits of a recording in words, from the numbers behind them."""

from __future__ import annotations

from collections.abc import Mapping

from tissueid.digits import number
from tissueid.report.wording import unit_words
from tissueid.trial import Axes

#: Key -> words and unit; what is not listed is not shown.
_WORDS: Mapping[str, tuple[str, str]] = {
    "force_before_N": ("force before", "N"),
    "drop_N": ("falls by", "N"),
    "settles_mm": ("travels on by", "mm"),
    "depth_mm": ("depth", "mm"),
    "work_N_mm": ("work from contact", "N mm"),
    "force_N": ("force", "N"),
    "limit_N": ("stated limit", "N"),
    "creep_mm": ("sinks on by", "mm"),
    "reached_mm": ("depth reached", "mm"),
    "stated_mm": ("depth stated", "mm"),
    "stated_hold_s": ("hold stated", "s"),
    "earlier_mm": ("the least before it", "mm"),
    "turns": ("turns", ""),
}


def event_words(values: Mapping[str, float], units: Mapping[str, str]) -> str:
    """The numbers of an event as a list in words.

    ``values``: of an event of ``schemas/inspect.schema.json``; ``units``: ``units`` of its recording.

    Examples
    --------
    >>> event_words({"drop_N": 12.5, "depth_mm": 3.0}, {"length": "mm", "force": "N"})
    'falls by 12.50 N, depth 3.000 mm'
    """
    axes = Axes(units["length"], units["force"])
    said = []
    for key, value in values.items():
        if key in _WORDS:
            words, unit = _WORDS[key]
            printed = unit_words(axes.unit(unit)) if unit else "1"
            said.append(f"{words} {value:g}" if printed == "1" else f"{words} {number(value)} {printed}")
    return ", ".join(said)


def took(duration_s: float) -> str:
    """Duration of a stop: none is shorter than sampling shows."""
    return "too short to see" if duration_s == 0.0 else f"took {number(duration_s, 2)} s"
