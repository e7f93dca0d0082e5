"""The first study file of a folder: what headers and data say, and comments for what only people know."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from tissueid.collection import display_names
from tissueid.ingest.cell_range import capacity_in
from tissueid.ingest.manifest import SCHEMA
from tissueid.result import Refusal
from tissueid.segment import segment
from tissueid.store.schema import load_schema
from tissueid.trial import Segmentation, Trial

__all__ = ["draft_study"]

#: Speeds, depths and holds within this share of each other are one protocol.
SAME_PROTOCOL = 0.03
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


def _program(trial: Trial, segmentation: Segmentation) -> dict[str, Any]:
    """What the machine did: kind, first speed, depth from the start of the travel, first hold, cycles."""
    holds, cycles = segmentation.of_kind("hold"), segmentation.of_kind("cycle")
    moves = [phase for phase in segmentation.phases if phase.kind in {"approach", "ramp"}]
    fastest = max((phase.speed_mm_s for phase in moves), default=0.0)
    travel = segmentation.compression_sign * (trial.displacement_mm - trial.displacement_mm[0])
    kind = "cyclic" if cycles else "ramp-hold" if holds else "ramp"
    program: dict[str, Any] = {"kind": kind, "depth_mm": float(travel.max())}
    if fastest > 0.0:
        program["speed_mm_s"] = trial.protocol.speed_mm_s or fastest
    if holds:
        program["hold_s"] = trial.protocol.hold_s or holds[0].end_s - holds[0].start_s
    if cycles:
        program["cycles"] = len(cycles)
    return program


def _alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    if set(one) != set(other):
        return False
    return all(
        other[key] == value
        if isinstance(value, str)
        else abs(other[key] - value) <= SAME_PROTOCOL * abs(value)
        for key, value in one.items()
    )


def _protocol_name(program: Mapping[str, Any], taken: Sequence[str]) -> str:
    parts = [program["kind"]]
    if "speed_mm_s" in program:
        parts.append(f"{program['speed_mm_s']:.3g} mm/s")
    parts.append(f"to {program['depth_mm']:.3g} mm")
    if "hold_s" in program:
        parts.append(f"hold {program['hold_s']:.3g} s")
    name = " ".join(parts)
    return name if name not in taken else f"{name} ({sum(other.startswith(name) for other in taken) + 1})"


def _protocols(trials: Sequence[Trial]) -> tuple[dict[str, dict[str, Any]], list[str | None]]:
    """Protocols by name, and the name of every trial's; ``None`` where a trial can't be segmented."""
    known: dict[str, dict[str, Any]] = {}
    of_trial: list[str | None] = []
    for trial in trials:
        try:
            program = _program(trial, segment(trial))
        except (ArithmeticError, np.linalg.LinAlgError):
            of_trial.append(None)
            continue
        name = next((name for name, other in known.items() if _alike(other, program)), None)
        if name is None:
            name = _protocol_name(program, list(known))
            known[name] = program
        of_trial.append(name)
    return known, of_trial


def _rate(trial: Trial) -> float | None:
    steps = np.diff(trial.time_s)
    steps = steps[steps > 0.0]
    return 1.0 / float(np.median(steps)) if steps.size else None


def draft_study(folder: Path, trials: Sequence[Trial], refused: Sequence[Refusal] = ()) -> str:
    """The text of a study file for the recordings of a folder.

    Parameters
    ----------
    folder : Path
        Where the file will stand; names are relative to it.
    trials : sequence of Trial
    refused : sequence of Refusal
        Recordings that could not be read; named in comments.

    Returns
    -------
    str
        TOML that :func:`tissueid.ingest.manifest.read_study` reads.
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
    for name, program in protocols.items():
        lines += ["[[protocol]]", f"name = {_quoted(name)}"]
        lines += [*(f"{key} = {_quoted(value)}" for key, value in program.items()), ""]
    root = os.path.realpath(folder)
    for i, (trial, protocol) in enumerate(zip(trials, of_trial, strict=True)):
        file = Path(os.path.relpath(os.path.realpath(trial.source.path), root)).as_posix()
        stated = {
            "file": file,
            "sheet": trial.source.sheet,
            "specimen": names[trial.specimen],
            "protocol": protocol,
        }
        lines += _table("[[trial]]", stated, "trial", explain=i == 0)
    for one in refused:
        lines += [f"# not read: {str(one).splitlines()[0]}"]
    return "\n".join(lines).rstrip() + "\n"
