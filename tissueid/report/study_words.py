"""Words of the report on a study: what is stated, decided, left out and missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from msgspec.structs import asdict

from tissueid.digits import NOT_IDENTIFIED, number, with_error
from tissueid.documents.identification import Calibration, Exclusion, StatedSpecimen, StatedTrial, StudyRecord
from tissueid.report.wording import trial_label, unit_words

#: Unit at the end of a key -> how it is printed.
_UNITS = {"_N_per_mm": "N/mm", "_mm_s": "mm/s", "_mm": "mm", "_years": "years", "_Hz": "Hz", "_deg": "°"}
_UNITS |= {"_C": "°C", "_N": "N", "_s": "s", "_h": "h"}
#: What is not a covariate, or stands elsewhere on the page.
_ELSEWHERE = {"only_listed", "title", "frame"}


def key_words(key: str) -> str:
    """Words of a key of a study file: ``"thickness_mm_sd"`` is ``"thickness sd"``."""
    bare = key.removesuffix("_sd")
    unit = next((end for end in _UNITS if bare.endswith(end)), "")
    return bare.removesuffix(unit).replace("_", " ") + (" sd" if key.endswith("_sd") else "")


def _value(key: str, value: Any) -> str:
    """A value with the unit of its key."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return ", ".join(str(one) for one in value)
    if not isinstance(value, int | float):
        return str(value)
    bare = key.removesuffix("_sd")
    unit = next((sign for end, sign in _UNITS.items() if bare.endswith(end)), "")
    # as stated: a thickness of 20 mm claims no further digits
    return f"{value:g} {unit}".strip().replace("-", "−")


def _pairs(table: Mapping[str, Any]) -> list[tuple[str, str]]:
    stated = {key: value for key, value in table.items() if value is not None and key not in _ELSEWHERE}
    return [(key_words(key), _value(key, value)) for key, value in stated.items()]


def _frame(calibration: Calibration) -> str:
    """The frame in one sentence."""
    frame = calibration.frame
    if frame is None:
        return "Machine and fixture were taken as rigid: no frame stiffness was stated."
    if frame.range_N is None:
        sd = calibration.frame_stiffness_N_per_mm_sd
        stiffness = with_error(calibration.frame_stiffness_N_per_mm, sd)
        return f"A frame of {stiffness} N/mm, as stated, was taken off the displacement."
    low, high = frame.range_N
    return (
        f"The deflection measured on a rigid block ({frame.path}, {number(low, 3)} to {number(high, 3)} N)"
        " was taken off the displacement."
    )


def _table(given: Sequence[StatedSpecimen | StatedTrial], first: str) -> dict[str, Any] | None:
    """Columns of some rows that are stated at least once."""
    rows = [asdict(row) for row in given]
    keys = [key for key in (rows[0] if rows else ()) if any(row[key] not in (None, (), "") for row in rows)]
    keys = [key for key in keys if key not in {first, "path", "sheet", "listed", "overridden", "because"}]
    if not keys:
        return None
    return {
        "head": [key_words(key) for key in keys],
        "rows": [
            {
                "name": trial_label(one) if isinstance(one, StatedTrial) else one.specimen,
                "cells": ["" if row[key] in (None, (), "") else _value(key, row[key]) for key in keys],
            }
            for one, row in zip(given, rows, strict=True)
        ],
    }


def _exclusion(row: Exclusion) -> dict[str, Any]:
    """One excluded trial: its parameters without and with it, and by how much they move."""
    numbers = [
        {
            "symbol": one.symbol,
            "unit": unit_words(one.unit),
            "without": with_error(one.without, one.without_stderr),
            "with": with_error(one.with_it, one.with_stderr),
            "change": _change(one.without, one.with_it),
        }
        for one in row.with_it
    ]
    said = {key: getattr(row, key) for key in ("specimen", "because", "note")}
    return {"trial": trial_label(row), "numbers": numbers, **said}


def _change(without: float | None, with_it: float | None) -> str:
    if without is None or with_it is None or without == 0.0:
        return NOT_IDENTIFIED if without is None or with_it is None else ""
    return f"{100 * (with_it / without - 1):+.1f} %".replace("-", "−")


def study_view(study: StudyRecord | None) -> dict[str, Any] | None:
    """Everything the study section of the report prints, in words; ``None`` without a study."""
    if study is None:
        return None
    return {
        "path": study.path,
        "sha256": study.sha256,
        "title": study.study.title,
        "about": _pairs(asdict(study.study)),
        "tip": _pairs(asdict(study.tip)),
        "calibration": _pairs(asdict(study.calibration)),
        "frame": _frame(study.calibration),
        "corrected": study.calibration.frame is not None,
        "specimens": _table(study.specimens, "specimen"),
        "trials": _table(study.trials, "path"),
        "overrides": [
            {"trial": trial_label(row), "decided": ", ".join(row.overridden), "because": row.because}
            for row in study.trials
            if row.overridden
        ],
        "exclusions": [_exclusion(row) for row in study.exclusions],
        "unlisted": [trial_label(row) for row in study.trials if not row.listed],
    }
