"""Intervals as bars: those that belong together have one scale."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Bar", "bar_of", "bar_scale"]

#: Half-widths of the common scale, relative to the value; a wider interval is cut and marked.
_SCALES = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
_POINT_OVER_POSITION = 50.0


@dataclass(frozen=True, slots=True)
class Bar:
    """A dot with two bars on a scale of 0 to 100; a total bar of no width is none.

    Attributes
    ----------
    statistical, total : tuple of float
        Left end and width.
    cut_low, cut_high : bool
        Whether an interval goes on beyond the scale.
    """

    statistical: tuple[float, float]
    total: tuple[float, float]
    cut_low: bool
    cut_high: bool


def _reference(entry: Mapping[str, Any]) -> float:
    """What a deviation is relative to: the value, or the interval's own width where the value is none."""
    low, high = entry["ci95_total"] or entry["ci95"]
    return abs(entry["value"]) or (high - low) or 1.0


def _deviations(entry: Mapping[str, Any], key: str) -> tuple[float, float]:
    low, high = entry[key] or (entry["value"], entry["value"])
    reference = _reference(entry)
    return (low - entry["value"]) / reference, (high - entry["value"]) / reference


def bar_scale(entries: Sequence[Mapping[str, Any]]) -> float:
    """Half-width of a scale, relative to the values, that holds these parameters' intervals (1 at most)."""
    widest = max(
        (abs(end) for entry in entries for key in ("ci95", "ci95_total") for end in _deviations(entry, key)),
        default=_SCALES[-1],
    )
    return next((scale for scale in _SCALES if scale >= widest), _SCALES[-1])


def bar_of(entry: Mapping[str, Any], scale: float) -> Bar:
    """Where dot and bars of one parameter stand; the dot, its value, is in the middle.

    Parameters
    ----------
    entry : mapping
        A parameter of identification.json with intervals.
    scale : float
        From :func:`bar_scale`.
    """
    spans, ends = [], []
    for key in ("ci95", "ci95_total"):
        low, high = _deviations(entry, key)
        left, right = (min(max(end / scale, -1.0), 1.0) for end in (low, high))
        spans.append((_POINT_OVER_POSITION * (1.0 + left), _POINT_OVER_POSITION * (right - left)))
        ends += [low, high]
    return Bar(spans[0], spans[1], cut_low=min(ends) < -scale, cut_high=max(ends) > scale)
