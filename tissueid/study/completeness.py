"""Completeness of a study's description: what a reviewer asks for, what is missing, and a grade A to F.

Weight 3: numbers can't be compared without it; 2: a reviewer asks for it; 1: it helps.  An item of the
specimens counts by the share of specimens that state it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from msgspec.structs import asdict

from tissueid.documents.identification import StudyRecord
from tissueid.manifest import Study
from tissueid.result import Refusal

ESSENTIAL, ASKED, HELPS = 3, 2, 1
#: Grade -> least share.
GRADES: Mapping[str, float] = {"A": 0.95, "B": 0.80, "C": 0.60, "D": 0.40, "E": 0.20, "F": 0.0}
#: Grades that need every item of weight 3.
_NEEDS_ESSENTIALS = {"A", "B"}


@dataclasses.dataclass(frozen=True, slots=True)
class Item:
    """One thing to state."""

    table: str  # where it stands: ``study``, ``calibration``, ``tip``, ``specimen`` or ``trial``
    keys: tuple[str, ...]  # any one of them will do
    weight: int
    why: str  # why it is asked for


@dataclasses.dataclass(frozen=True, slots=True)
class Missing:
    """An item that is not, or not everywhere, stated; ``where`` names the specimens or trials without it."""

    item: Item
    where: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The ``missing`` object of ``schemas/study-check.schema.json``."""
        return {**dataclasses.asdict(self.item), "keys": list(self.item.keys), "where": list(self.where)}


@dataclasses.dataclass(frozen=True, slots=True)
class Completeness:
    """The verdict on a study file."""

    grade: str  # a to F
    share: float  # share of the weights that is stated
    missing: tuple[Missing, ...]  # the weightiest first
    unmatched: tuple[Refusal, ...]  # files and sheets that are named and not there

    @property
    def usable(self) -> bool:
        """Nothing essential is missing and every named file is there."""
        return not self.unmatched and all(one.item.weight < ESSENTIAL for one in self.missing)

    def as_json(self, path: str) -> dict[str, Any]:
        """The document of ``schemas/study-check.schema.json``."""
        return {
            "schema": "tissueid/study-check/1",
            "path": path,
            "grade": self.grade,
            "share": self.share,
            "missing": [one.as_json() for one in self.missing],
            "unmatched": [one.as_json() for one in self.unmatched],
        }


ITEMS: tuple[Item, ...] = (
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


def _without(item: Item, tables: Mapping[str, Mapping[str, Any]]) -> tuple[str, ...]:
    """Names of the tables that state none of the keys."""
    return tuple(name for name, table in tables.items() if all(table.get(key) is None for key in item.keys))


def completeness(study: Study, unmatched: Sequence[Refusal] = ()) -> Completeness:
    """Grade a study file; ``unmatched``: files that it names in vain."""
    calibration = dict(study.calibration.values)
    if study.calibration.frame is not None:
        calibration["frame"] = study.calibration.frame
    single: dict[str, Mapping[str, Any]] = {
        "study": study.about,
        "calibration": calibration,
        "tip": study.tip,
    }
    several: dict[str, dict[str, Mapping[str, Any]]] = {
        # what the study says of the tissue holds for every specimen
        "specimen": {name: {**study.about, **table} for name, table in study.specimens.items()},
        "trial": {str(entry.values["file"]): entry.values for entry in study.trials},
    }
    return _graded(single, several, unmatched)


def completeness_of_result(study: StudyRecord | None) -> Completeness:
    """Grade the ``study`` of identification.json; without one nothing is stated."""
    if study is None:
        return _graded({"study": {}, "calibration": {}, "tip": {}}, {"specimen": {}, "trial": {}}, ())
    about = _stated(asdict(study.study))
    single = {
        "study": about,
        "calibration": _stated(asdict(study.calibration)),
        "tip": _stated(asdict(study.tip)),
    }
    specimens = {row.specimen: {**about, **_stated(asdict(row))} for row in study.specimens}
    trials = {row.path: asdict(row) for row in study.trials if row.listed}
    return _graded(single, {"specimen": specimens, "trial": trials}, ())


def _stated(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if value not in (None, [], (), "")}


def _graded(
    single: Mapping[str, Mapping[str, Any]],
    several: Mapping[str, Mapping[str, Mapping[str, Any]]],
    unmatched: Sequence[Refusal],
) -> Completeness:
    """The verdict on tables of which there is one, and of which there are several by name."""
    about = single["study"]
    stated, missing = 0.0, []
    for item in ITEMS:
        if item.table in single:
            lacking = _without(item, {item.table: single[item.table]})
            share = 0.0 if lacking else 1.0
            where: tuple[str, ...] = ()
        else:
            tables = several[item.table] or ({"": about} if item.table == "specimen" else {"": {}})
            lacking = _without(item, tables)
            share = 1.0 - len(lacking) / len(tables)
            where = lacking if len(lacking) < len(tables) else ()
        stated += item.weight * share
        if lacking:
            missing.append(Missing(item, where))
    missing.sort(key=lambda one: -one.item.weight)
    total = stated / sum(item.weight for item in ITEMS)
    whole = all(one.item.weight < ESSENTIAL for one in missing)
    grade = next(
        name for name, least in GRADES.items() if total >= least and (whole or name not in _NEEDS_ESSENTIALS)
    )
    return Completeness(grade, total, tuple(missing), tuple(unmatched))
