"""Completeness of a study's description: what a reviewer asks for, what is missing, and a grade A to F.

Weight 3: numbers can't be compared without it; 2: a reviewer asks for it; 1: it helps.  An item of the
specimens counts by the share of specimens that state it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Final, Literal

from msgspec import Struct
from msgspec.structs import asdict, replace

from tissueid.documents import typed
from tissueid.documents.identification import StudyRecord
from tissueid.documents.inspect import Refusal as RefusedInput
from tissueid.documents.study import Missing, StudyCheck
from tissueid.manifest import Study, TomlTable
from tissueid.result import Refusal

ESSENTIAL: Final = 3
ASKED: Final = 2
HELPS: Final = 1
Grade = Literal["A", "B", "C", "D", "E", "F"]
#: Grade -> least share.
GRADES: Mapping[Grade, float] = {"A": 0.95, "B": 0.80, "C": 0.60, "D": 0.40, "E": 0.20, "F": 0.0}
#: Grades that need every item of weight 3.
_NEEDS_ESSENTIALS = {"A", "B"}


#: One thing to state: its table, keys of which any one will do, weight, and why it is asked for.
Item = partial(Missing, where=())

ITEMS: tuple[Missing, ...] = (
    Item("specimen", ("species",), ESSENTIAL, "tissue of different species differs several-fold"),
    Item("specimen", ("tissue",), ESSENTIAL, "nothing can be compared without naming the tissue"),
    Item("specimen", ("thickness_mm",), ESSENTIAL, "a thin layer on a stiff support feels the support"),
    Item("specimen", ("temperature_C",), ESSENTIAL, "viscosity changes by per cents a degree"),
    Item("specimen", ("storage",), ESSENTIAL, "storage changes stiffness within hours"),
    Item("specimen", ("support",), ESSENTIAL, "what the tissue lies on deforms as well"),
    Item("tip", ("shape",), ESSENTIAL, "stiffness is that of this tip"),
    Item("tip", ("radius_mm", "half_angle_deg"), ESSENTIAL, "stiffness is that of this tip"),
    Item("calibration", ("load_cell_capacity_N",), ESSENTIAL, "small forces on a large cell carry no class"),
    Item(
        "calibration", ("frame", "frame_stiffness_N_per_mm"), ESSENTIAL,
        "a compliant frame makes relaxation look slower and tissue softer",
    ),
    Item("study", ("ethics",), ESSENTIAL, "journals ask for the approval, or why none is needed"),
    Item("specimen", ("sex",), ASKED, "reporting guidelines for animal research ask for it"),
    Item("specimen", ("age_years", "age_group"), ASKED, "stiffness changes with age"),
    Item("specimen", ("site",), ASKED, "tissue differs from place to place"),
    Item("specimen", ("side",), ASKED, "paired sides are not independent"),
    Item("specimen", ("hydration",), ASKED, "drying stiffens tissue within minutes"),
    Item("specimen", ("freeze_thaw_cycles",), ASKED, "freezing damages cells and matrix"),
    Item("specimen", ("time_post_mortem_h",), ASKED, "tissue changes after death"),
    Item("calibration", ("load_cell_class",), ASKED, "the class bounds the error of every force"),
    Item("calibration", ("verified_from_N",), ASKED, "below it a force is a number without a class"),
    Item("calibration", ("displacement_class",), ASKED, "the class bounds the error of every depth"),
    Item("calibration", ("force_filter_s",), ASKED, "a filter imitates a short relaxation time"),
    Item("calibration", ("skew_s",), ASKED, "a delay between channels imitates viscosity"),
    Item("calibration", ("sampling_Hz",), ASKED, "it bounds the shortest time that can be seen"),
    Item("trial", ("run",), ASKED, "without the order, conditioning can't be told from difference"),
    Item("trial", ("rest_s",), ASKED, "tissue recovers for minutes after a test"),
    Item("trial", ("site",), ASKED, "a site that was tested before is another tissue"),
    Item("trial", ("protocol",), ASKED, "speed, depth and hold are part of every number"),
    Item("study", ("machine",), ASKED, "the machine must be named"),
    Item("study", ("operator",), ASKED, "results can depend on who tests"),
    Item("study", ("licence",), ASKED, "without one nobody may use the data"),
    Item("study", ("authors",), ASKED, "data without authors can't be cited"),
    Item("study", ("title",), HELPS, "a data set needs a name"),
    Item("study", ("date",), HELPS, "calibrations expire"),
    Item("specimen", ("donor",), HELPS, "specimens of one animal are not independent"),
    Item("tip", ("material",), HELPS, "friction and adhesion depend on it"),
)  # fmt: skip


def completeness(study: Study, unmatched: Sequence[Refusal] = ()) -> StudyCheck:
    """Grade a study file; ``unmatched``: files and sheets that it names in vain."""
    frame = study.calibration.frame
    calibration = {**study.calibration.values, **({} if frame is None else {"frame": frame})}
    # what the study says of the tissue holds for every specimen
    specimens = {name: {**study.about, **table} for name, table in study.specimens.items()}
    trials = {str(entry.values["file"]): entry.values for entry in study.trials}
    return _graded(study.path, (study.about, calibration, study.tip), specimens, trials, unmatched)


def completeness_of_result(record: StudyRecord | None) -> StudyCheck:
    """Grade the ``study`` of identification.json; without one nothing is stated."""
    if record is None:
        return completeness(Study("study.toml"))
    about = _stated(record.study)
    specimens = {row.specimen: {**about, **_stated(row)} for row in record.specimens}
    trials = {row.path: asdict(row) for row in record.trials if row.listed}
    general = (about, _stated(record.calibration), _stated(record.tip))
    return _graded("study.toml", general, specimens, trials, ())


def _stated(table: Struct) -> dict[str, Any]:
    return {key: value for key, value in asdict(table).items() if value not in (None, [], (), "")}


def _graded(
    path: str,
    general: tuple[TomlTable, TomlTable, TomlTable],
    specimens: Mapping[str, TomlTable],
    trials: Mapping[str, TomlTable],
    unmatched: Sequence[Refusal],
) -> StudyCheck:
    """The verdict on study, calibration and tip, and on specimens and trials by name."""
    about, calibration, tip = general
    tables: Mapping[str, Mapping[str, TomlTable]] = {
        "study": {"": about},
        "calibration": {"": calibration},
        "tip": {"": tip},
        "specimen": specimens or {"": about},
        "trial": trials or {"": {}},
    }
    stated, missing = 0.0, []
    for item in ITEMS:
        rows = tables[item.table]
        lacking = [name for name, row in rows.items() if all(row.get(key) is None for key in item.keys)]
        stated += item.weight * (1.0 - len(lacking) / len(rows))
        if lacking:
            missing.append(replace(item, where=tuple(lacking) if len(lacking) < len(rows) else ()))
    missing.sort(key=lambda one: -one.weight)
    total = stated / sum(item.weight for item in ITEMS)
    whole = all(one.weight < ESSENTIAL for one in missing)
    grade = next(
        name for name, least in GRADES.items() if total >= least and (whole or name not in _NEEDS_ESSENTIALS)
    )
    vain = typed([one.as_json() for one in unmatched], tuple[RefusedInput, ...])
    return StudyCheck("tissueid/study-check/1", path, grade, total, tuple(missing), vain)
