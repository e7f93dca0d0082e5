"""Words of the report on a study: what is stated, decided, left out and missing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from msgspec.structs import asdict

from tissueid.digits import NOT_IDENTIFIED, number, with_error
from tissueid.documents.identification import Calibration, StatedSpecimen, StatedTrial
from tissueid.documents.study import Study, Tip
from tissueid.report.parts import Table
from tissueid.report.wording import trial_label

#: Unit at the end of a key -> how it is printed.
_UNITS = {"_N_per_mm": "N/mm", "_mm_s": "mm/s", "_mm": "mm", "_years": "years", "_Hz": "Hz", "_deg": "°"}
_UNITS |= {"_C": "°C", "_N": "N", "_s": "s", "_h": "h"}
#: What is not a covariate, or stands elsewhere on the page.
_ELSEWHERE = {"only_listed", "title", "frame"}
#: Columns of a trial that are its name, or stand in sentences.
_OF_TRIAL = {"path", "sheet", "listed", "overridden", "because"}
_NOTHING: tuple[Any, ...] = (None, (), "")


def key_words(key: str) -> str:
    """Words of a key of a study file: ``"thickness_mm_sd"`` is ``"thickness sd"``."""
    bare = key.removesuffix("_sd")
    unit = next((end for end in _UNITS if bare.endswith(end)), "")
    return bare.removesuffix(unit).replace("_", " ") + (" sd" if key.endswith("_sd") else "")


def _value(key: str, value: Any) -> str:
    """A value with the unit of its key."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list | tuple):
        return ", ".join(str(one) for one in value)
    if not isinstance(value, int | float):
        return str(value)
    bare = key.removesuffix("_sd")
    unit = next((sign for end, sign in _UNITS.items() if bare.endswith(end)), "")
    # as stated: a thickness of 20 mm claims no further digits
    return f"{value:g} {unit}".strip().replace("-", "−")


def stated_facts(table: Study | Tip | Calibration) -> list[tuple[str, str]]:
    """Words and value of everything that a table states."""
    known = asdict(table).items()
    stated = {key: value for key, value in known if value is not None and key not in _ELSEWHERE}
    return [(key_words(key), _value(key, value)) for key, value in stated.items()]


def frame_words(calibration: Calibration) -> str:
    """The frame in one sentence."""
    frame = calibration.frame
    if frame is None:
        return "Machine and fixture were taken as rigid: no frame stiffness was stated."
    if frame.range_N is None:
        stiffness = with_error(calibration.frame_stiffness_N_per_mm, calibration.frame_stiffness_N_per_mm_sd)
        return f"A frame of {stiffness} N/mm, as stated, was taken off the displacement."
    low, high = frame.range_N
    return (
        f"The deflection measured on a rigid block ({frame.path}, {number(low, 3)} to {number(high, 3)} N)"
        " was taken off the displacement."
    )


def stated_table(given: Sequence[StatedSpecimen] | Sequence[StatedTrial]) -> Table | None:
    """Columns of some rows that are stated at least once."""
    rows = [asdict(row) for row in given]
    keys = [key for key in (rows[0] if rows else ()) if any(row[key] not in _NOTHING for row in rows)]
    of_trials = isinstance(next(iter(given), None), StatedTrial)
    keys = [key for key in keys if key not in (_OF_TRIAL if of_trials else {"specimen"})]
    names = [trial_label(one) if isinstance(one, StatedTrial) else one.specimen for one in given]
    cells = [["" if row[key] in _NOTHING else _value(key, row[key]) for key in keys] for row in rows]
    named = [[name, *own] for name, own in zip(names, cells, strict=True)]
    head = "Trial" if of_trials else "Specimen"
    return Table([head, *map(key_words, keys)], named, f"{head}s") if keys else None


def change_words(without: float | None, with_it: float | None) -> str:
    """Change of a parameter by a log that was left out, in percent."""
    if without is None or with_it is None or without == 0.0:
        return NOT_IDENTIFIED if without is None or with_it is None else ""
    return f"{100 * (with_it / without - 1):+.1f} %".replace("-", "−")
