"""The first study file of a folder: what headers and data say, and comments for what only people know."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from tissueid.collection import display_names
from tissueid.ingest.manifest import SCHEMA
from tissueid.ingest.quality import capacity_in
from tissueid.result import Refusal
from tissueid.store.schema import load_schema
from tissueid.study.programs import programs_of
from tissueid.trial import Trial

_PEOPLE = {
    "operator": re.compile(
        r"(?:.*\W)?(?:operator|pruefer|prüfer|tester|operateur|operador)(?: id| name)?", re.IGNORECASE
    ),
    "machine": re.compile(
        r"(?:.*\W)?(?:test machine|machine|frame|maschine)(?: name| type| model)?", re.IGNORECASE
    ),
}
_NOTHING = {"", "-", "n/a", "none", "<none>"}
#: Fields that are offered as comments, by table.
_OFFERED: Mapping[str, tuple[str, ...]] = {
    "study": (
        "authors", "laboratory", "operator", "machine", "date", "ethics", "licence", "doi", "species",
        "tissue", "sex", "storage", "hydration", "temperature_C", "support",
    ),
    "calibration": (
        "load_cell_capacity_N", "load_cell_class", "verified_from_N", "displacement_class", "force_filter_s",
        "skew_s", "frame", "frame_stiffness_N_per_mm", "frame_stiffness_N_per_mm_sd",
    ),
    "tip": ("shape", "radius_mm", "half_angle_deg", "material"),
    "specimen": (
        "donor", "sex", "age_years", "site", "side", "thickness_mm", "freeze_thaw_cycles",
        "time_post_mortem_h",
    ),
    "trial": ("site", "run", "rest_s"),
}  # fmt: skip


def _quoted(value: Any) -> str:
    """A value as TOML writes it; numbers to six digits."""
    if isinstance(value, float):
        return repr(float(f"{value:.6g}"))
    return str(tomlkit.item(value).as_string())


def _stated(trials: Sequence[Trial], pattern: re.Pattern[str]) -> str | None:
    """The one value that the headers give under such a key, where they agree."""
    found = {
        value.strip()
        for trial in trials
        for key, value in trial.source.metadata.items()
        if pattern.fullmatch(key) and value.strip().casefold() not in _NOTHING
    }
    return found.pop() if len(found) == 1 else None


def _agreed(values: Sequence[float | None], digits: int = 3) -> float | None:
    """One number where all that is stated agrees to so many digits."""
    found = {float(f"{value:.{digits}g}") for value in values if value is not None}
    return found.pop() if len(found) == 1 else None


def _table(name: str, stated: Mapping[str, Any], offered: str, *, explain: bool = True) -> list[str]:
    """A table with what is known, and what is not as comments with their meaning."""
    properties = load_schema("study")["$defs"][offered]["properties"]
    lines = [name, *(f"{key} = {_quoted(value)}" for key, value in stated.items() if value is not None)]
    for key in _OFFERED[offered]:
        if stated.get(key) is None:
            meaning = (
                f"  # {properties[key]['description']}"
                if explain and "description" in properties[key]
                else ""
            )
            lines.append(f"# {key} = {meaning}".rstrip())
    return [*lines, ""]


def _protocols(trials: Sequence[Trial]) -> tuple[list[str], dict[int, str]]:
    """The [[protocol]] tables, each after what was seen of it, and the name of every trial's by position."""
    lines: list[str] = []
    of_trial: dict[int, str] = {}
    taken: set[str] = set()
    for program in programs_of(trials):
        names = chain([program.name], (f"{program.name} ({number})" for number in count(2)))
        name = next(one for one in names if one not in taken)
        taken.add(name)
        of_trial |= dict.fromkeys(program.trials, name)
        lines += [*(f"# {comment}" for comment in program.comments()), "[[protocol]]"]
        lines += [f"{key} = {_quoted(value)}" for key, value in {"name": name, **program.table}.items()]
        lines.append("")
    return lines, of_trial


def _rate(trial: Trial) -> float | None:
    steps = np.diff(trial.time_s)
    steps = steps[steps > 0.0]
    return 1.0 / float(np.median(steps)) if steps.size else None


def draft_study(folder: Path, trials: Sequence[Trial], refused: Sequence[Refusal] = ()) -> str:
    """The text of a study file for the recordings of a folder.

    ``folder``: where the file will stand; names are relative to it; ``refused``: recordings that could not be
    read; named in comments.  Returns TOML that :func:`tissueid.ingest.manifest.read_study` reads.
    """
    protocols, of_trial = _protocols(trials)
    names = display_names([(trial.specimen, trial.source) for trial in trials])
    capacity = [capacity_in(trial.source.metadata, decimal=trial.source.decimal) for trial in trials]
    people = {key: _stated(trials, pattern) for key, pattern in _PEOPLE.items()}
    lines = [
        "# Study file of tissueid: what the recordings can't say.  Fill in what you know, take out the #",
        "# before it, and run `tissueid study check`.  Units are in the names; text with a unit will do as",
        '# well: thickness = "5 mm".  What [study] says of the tissue holds for every specimen.',
        f'schema = "{SCHEMA}"',
        "",
        *_table("[study]", {"title": folder.resolve().name, **people}, "study"),
        *_table(
            "[calibration]",
            {
                "load_cell_capacity_N": _agreed(capacity),
                "sampling_Hz": _agreed([_rate(one) for one in trials]),
            },
            "calibration",
        ),
        *_table("[tip]", {"radius_mm": _agreed([one.protocol.tip_radius_mm for one in trials])}, "tip"),
    ]
    for i, specimen in enumerate(dict.fromkeys(names[trial.specimen] for trial in trials)):
        lines += _table("[[specimen]]", {"name": specimen}, "specimen", explain=i == 0)
    lines += protocols
    root = os.path.realpath(folder)
    for i, trial in enumerate(trials):
        file = Path(os.path.relpath(os.path.realpath(trial.source.path), root)).as_posix()
        stated = {
            "file": file,
            "sheet": trial.source.sheet,
            "specimen": names[trial.specimen],
            "protocol": of_trial.get(i),
        }
        lines += _table("[[trial]]", stated, "trial", explain=i == 0)
    for one in refused:
        lines += [f"# not read: {str(one).splitlines()[0]}"]
    return "\n".join(lines).rstrip() + "\n"
