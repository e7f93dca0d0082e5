"""Why a recording was refused: the closed list of codes, and the place a refusal points at.

The codes below are repeated as an enumeration in ``schemas/inspect.schema.json``; a test holds both together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

from tissueid.errors import InputError

#: code -> what it means, for the documentation.
REFUSAL_MEANINGS: Mapping[str, str] = {
    # the file as a whole
    "unreadable_file": "the operating system would not let the file be read",
    "empty_file": "the file has no bytes, or blank lines only",
    "not_an_export": "the file is not a table of numbers: an image, a program, prose, JSON",
    "unreadable_workbook": "the workbook is damaged, protected or unreasonably large inside",
    "unreadable_archive": "the archive is damaged, protected, or unreasonably large inside",
    "reader_failed": "a reader that was installed beside tissueid broke on this file",
    "no_trial_sheet": "no sheet of the workbook holds time, displacement and force",
    "unknown_sheet": "the workbook has no sheet of that name",
    "no_recording": "the directory holds no file of a known kind",
    # the columns
    "no_rows": "there is no row of numbers, or only one",
    "no_columns": "no column could be told to be the time, the displacement or the force",
    "column_not_found": "a column named by the user is not in the file",
    "unknown_unit": "the unit of a column is not known",
    "wrong_unit": "the unit of a column measures something else",
    "unit_conflict": "name and units row give different units for one column",
    # the cells
    "ambiguous_decimal": "point and comma can't be told apart: decimal mark or thousands separator",
    "inconsistent_decimal": "a number is printed with another decimal mark than the rest of the file",
    "damaged_number": "a number has lost or doubled its decimal mark, or its digits are grouped wrongly",
    "text_in_numbers": "text stands where a number must be",
    "empty_cell": "a cell of a used column is empty",
    "not_finite": "a value is NaN, infinite or too large",
    "ragged_rows": "a row has more or fewer cells than the others",
    "mixed_tables": "rows of numbers stand outside the table of the recording",
    "time_backwards": "the time falls from one row to the next",
    "several_clocks": "channels have times of their own, which differ",
    "implausible_range": "travel, force or time is beyond any test: decimal marks or units are wrong",
    # the log of a session
    "damaged_log": "the log of a rendered session is damaged, changed or of another version",
    "wrong_scale": "the log of a rendered session states a scale that its samples contradict",
    # the study
    "invalid_study": "the study file says something that can't be: a key, a unit, a value",
    "study_unmatched": "the study file names a file or a sheet that is not there",
    "invalid_frame": "the frame file is not one, or is damaged",
    "not_rigid": "the recording is no rigid block under load",
}

REFUSAL_CODES: tuple[str, ...] = tuple(REFUSAL_MEANINGS)


def moved(error: InputError, **place: str | int | None) -> InputError:
    """The same refusal at another path, sheet, line or column."""
    here = {name: getattr(error, name) for name in ("path", "sheet", "line", "column")}
    return InputError(error.code, error.message, **(here | place))


@dataclass(frozen=True, slots=True)
class Place:
    """A file, and sheet, as the user named it; makes refusals that point there."""

    path: str
    sheet: str | None = None

    def refusal(
        self, code: str, message: str, *, line: int | None = None, column: int | None = None
    ) -> InputError:
        """An :class:`~tissueid.errors.InputError` at this place; ``line`` and ``column`` count from 1."""
        if code not in REFUSAL_MEANINGS:
            raise ValueError(f"unknown refusal code {code!r}")
        return InputError(code, message, path=self.path, sheet=self.sheet, line=line, column=column)

    def refuse(
        self, code: str, message: str, *, line: int | None = None, column: int | None = None
    ) -> NoReturn:
        """Raise the refusal."""
        raise self.refusal(code, message, line=line, column=column)
