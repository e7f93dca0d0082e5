"""Corrections on a page that is served: a number or a switch, each with its reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class CorrectionRow:
    """One row of the form."""

    key: str  # key of study.toml, or ``exclude``
    title: str
    unit: str = ""  # of the number; empty for a switch
    #: What was decided, and why; empty where the data decide.
    value: str = ""
    because: str = ""
    found: str = ""  # what counts now
    stands: bool = False  # whether it was decided


def corrections(
    recording: Mapping[str, Any], standing: Mapping[str, tuple[Any, str]]
) -> tuple[CorrectionRow, ...]:
    """The rows of one recording.

    ``recording``: one trial of ``schemas/inspect.schema.json``; ``standing``: what the user decided: value
    and reason by key.
    """
    contact = recording["contact"]
    holds = [phase for phase in recording["phases"] if phase["kind"] in ("hold", "creep")]
    hold = max(holds, key=lambda phase: phase["end_s"] - phase["start_s"], default=None)
    rows = (
        (
            "contact_mm",
            "Contact at",
            recording["units"]["length"],
            None if contact is None else contact["displacement_mm"],
        ),
        ("hold_from_s", "Hold from", "s", None if hold is None else hold["start_s"]),
        ("end_s", "Hold to (the rest is left out)", "s", None if hold is None else hold["end_s"]),
        ("rupture", "No fall of force is a rupture", "", None),
        ("exclude", "Leave it out of the fit", "", None),
    )
    return tuple(
        CorrectionRow(
            key,
            title,
            unit,
            value=_typed(standing[key][0]) if key in standing and unit else "",
            because=standing[key][1] if key in standing else "",
            found="" if found is None else _typed(found),
            stands=key in standing,
        )
        for key, title, unit, found in rows
    )


def _typed(value: float) -> str:
    """A number as somebody would type it."""
    return f"{value:.7g}"
