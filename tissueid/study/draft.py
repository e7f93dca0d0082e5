"""The first study file of a folder: what headers and data say, and comments for what only people know."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.collection import display_names
from tissueid.digits import number
from tissueid.documents.measured import Measured, MeasuredPush
from tissueid.ingest.manifest import SCHEMA
from tissueid.ingest.quality import capacity_in
from tissueid.inspection import measured_of, segmented
from tissueid.report.inspect_decisions import toml_value
from tissueid.report.wording import counted, reach
from tissueid.result import Refusal
from tissueid.store.schema import load_schema
from tissueid.trial import Segmentation, Trial

#: Speeds and holds within this share of each other are one program; machines keep them to a per cent or two.
SAME = 0.05
#: Depths that agree to this share are one commanded depth; others end by contact, force or hand.
SAME_DEPTH = 0.03
#: Steps that are told one by one.
MOST_STEPS_TOLD = 4


@dataclass(frozen=True, slots=True)
class Step:
    """One move and what came after it."""

    speed_mm_s: float
    travel_mm: float
    hold_s: float | None = None  # ``None`` where nothing was held
    control: str = "position"  # what was held: ``position`` or ``force``

    def held_like(self, other: Step) -> bool:
        """True where two steps are held alike."""
        return self.control == other.control and _near(self.hold_s, other.hold_s)

    def like(self, other: Step) -> bool:
        """True where two steps are one of a program; how far they go is left open."""
        return self.held_like(other) and _near(self.speed_mm_s, other.speed_mm_s)


@dataclass(frozen=True, slots=True)
class _Run:
    """One recording and its program."""

    position: int  # of the recording among those that were given
    trial: Trial
    divided: Segmentation
    push: MeasuredPush | None
    steps: tuple[Step, ...]
    cycles: int
    travel_mm: float

    @property
    def kind(self) -> str:
        if any(step.hold_s is not None for step in self.steps):
            return "creep" if all(step.control == "force" for step in self.steps) else "ramp-hold"
        return "cyclic" if self.cycles else "ramp"

    def like(self, other: _Run) -> bool:
        # a header's speed is what the machine was told, whatever a soft frame made of it
        stated, its_own = self.trial.protocol.speed_mm_s, other.trial.protocol.speed_mm_s
        alike = Step.like if stated is None else Step.held_like
        return (
            self.kind == other.kind
            and len(self.steps) == len(other.steps)
            and _near(self.cycles, other.cycles)
            and _near(stated, its_own)
            and self.trial.axes == other.trial.axes
            and all(alike(mine, its) for mine, its in zip(self.steps, other.steps, strict=True))
        )


@dataclass(frozen=True, slots=True)
class Program:
    """Recordings of one program; the first one is the measure."""

    runs: list[_Run]

    @property
    def trials(self) -> list[int]:
        """Positions of its recordings among those that were given."""
        return [run.position for run in self.runs]

    @property
    def steps(self) -> tuple[Step, ...]:
        """Median steps of its recordings."""
        return tuple(_median_step(each) for each in zip(*(run.steps for run in self.runs), strict=True))

    @property
    def table(self) -> dict[str, Any]:
        """Its ``[[protocol]]``, without a name; what differs between recordings is left to the comments."""
        first, steps = self.runs[0], self.steps
        table: dict[str, Any] = {"kind": first.kind}
        speeds, stated = [step.speed_mm_s for step in steps], first.trial.protocol
        if stated.speed_mm_s or _all_near(speeds):
            table["speed_mm_s"] = stated.speed_mm_s or float(np.median(speeds))
        travels = [run.travel_mm for run in self.runs]
        if _all_near(travels, SAME_DEPTH):
            table["depth_mm"] = float(np.median(travels))
        holds = [step.hold_s for step in steps if step.hold_s is not None]
        if _all_near(holds):
            table["hold_s"] = stated.hold_s or float(np.median(holds))
        if first.cycles:
            table["cycles"] = round(float(np.median([run.cycles for run in self.runs])))
        if len(steps) > 1:
            table["notes"] = self._steps_told()
        return table

    @property
    def name(self) -> str:
        """The program in a few words."""
        first, steps, table = self.runs[0], self.steps, self.table
        length = first.trial.axes.length
        parts = [first.kind if len(steps) < 2 else f"{first.kind} in {len(steps)} steps"]
        if "speed_mm_s" in table:
            parts.append(f"{table['speed_mm_s']:.3g} {length}/s")
        if "depth_mm" in table:
            parts.append(f"to {table['depth_mm']:.3g} {length}")
        if "hold_s" in table:
            parts.append(f"hold {table['hold_s']:.3g} s")
        if first.cycles:
            parts.append(f"{table['cycles']} cycles")
        return " ".join(parts)

    def comments(self) -> list[str]:
        """Observations, with their counts."""
        axes = self.runs[0].trial.axes
        specimens = {run.trial.specimen for run in self.runs}
        lines = [f"{counted(len(self.runs), 'recording')} of {counted(len(specimens), 'specimen')}"]
        divided = [run.divided for run in self.runs]
        preloaded = sum(one.contact is not None and not one.contact.in_record for one in divided)
        broken = sum(any(event.kind == "rupture" for event in one.events) for one in divided)
        counts = ((preloaded, "starts in contact", "start in contact"), (broken, "breaks", "break"))
        lines += [f"{many} {one if many == 1 else more}" for many, one, more in counts if many]
        if len(self.steps) == 1:
            lines.append(_step_words(self.steps[0], axes.length))
        pushes = [run.push for run in self.runs if run.push is not None]
        depths = [one.depth_mm for one in pushes if one.depth_mm is not None]
        for words, values, unit in (
            ("travel", [run.travel_mm for run in self.runs], axes.length),
            ("depth below contact", depths, axes.length),
            ("peak force", [one.peak.force_N for one in pushes], axes.force),
        ):
            if values:
                lines.append(f"{words} {reach((min(values), max(values)))} {unit}")
        return lines

    def _steps_told(self) -> str:
        """The steps in words: once where they are alike."""
        length, steps = self.runs[0].trial.axes.length, self.steps
        if all(step.like(steps[0]) and _near(step.travel_mm, steps[0].travel_mm) for step in steps):
            return f"{len(steps)} steps, each {_step_words(steps[0], length)}"
        told = "; ".join(_step_words(step, length) for step in steps[:MOST_STEPS_TOLD])
        more = f"; and {len(steps) - MOST_STEPS_TOLD} more" if len(steps) > MOST_STEPS_TOLD else ""
        return f"{len(steps)} steps: {told}{more}"


def programs_of(trials: Sequence[Trial]) -> list[Program]:
    """Group recordings by what was run, in the order of their first; what can't be segmented is in none."""
    found: list[Program] = []
    for position, trial in enumerate(trials):
        divided = segmented(trial)
        if isinstance(divided, Refusal):
            continue
        run = _run(position, trial, divided, measured_of(trial, divided))
        program = next((one for one in found if one.runs[0].like(run)), None)
        if program is None:
            found.append(Program([run]))
        else:
            program.runs.append(run)
    return found


def _run(position: int, trial: Trial, divided: Segmentation, measured: Measured) -> _Run:
    push = measured.push
    steps = [
        Step(hold.push.speed_mm_s, hold.push.travel_mm, hold.length_s, hold.control)
        for hold in measured.holds
        if hold.push is not None
    ]
    if not steps and push is not None:
        steps = [Step(push.speed_mm_s, push.travel_mm)]
    travel = divided.compression_sign * (trial.displacement_mm - trial.displacement_mm[0])
    cycles = len(divided.of_kind("cycle"))
    return _Run(position, trial, divided, push, tuple(steps), cycles, float(travel.max()))


def _median_step(steps: Sequence[Step]) -> Step:
    holds = [step.hold_s for step in steps if step.hold_s is not None]
    return Step(
        float(np.median([step.speed_mm_s for step in steps])),
        float(np.median([step.travel_mm for step in steps])),
        float(np.median(holds)) if holds else None,
        steps[0].control,
    )


def _near(one: float | None, other: float | None, share: float = SAME) -> bool:
    if one is None or other is None:
        return one is other
    return abs(one - other) <= share * max(abs(one), abs(other))


def _all_near(values: Sequence[float], share: float = SAME) -> bool:
    """True where there are values, and they are one."""
    return bool(values) and min(values) > 0.0 and _near(min(values), max(values), share)


def _step_words(step: Step, length: str) -> str:
    moved = f"{number(step.travel_mm, 3)} {length} at {number(step.speed_mm_s, 3)} {length}/s"
    if step.hold_s is None:
        return moved
    held = "held" if step.control == "position" else "force held"
    return f"{moved}, {held} {number(step.hold_s, 3)} s"


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
    return toml_value(float(f"{value:.6g}") if isinstance(value, float) else value)


def _stated(trials: Sequence[Trial], pattern: re.Pattern[str]) -> str | None:
    """The one value that the headers give under such a key, where they agree."""
    found = {
        value.strip()
        for trial in trials
        for key, value in trial.source.metadata.items()
        if pattern.fullmatch(key) and value.strip().casefold() not in _NOTHING
    }
    return found.pop() if len(found) == 1 else None


def _agreed(values: Sequence[float | None]) -> float | None:
    """One number where all that is stated agrees to three digits."""
    found = {float(f"{value:.3g}") for value in values if value is not None}
    return found.pop() if len(found) == 1 else None


def _table(name: str, stated: Mapping[str, Any], offered: str, *, explain: bool = True) -> list[str]:
    """A table with what is known, and what is not as comments with their meaning."""
    properties = load_schema("study")["$defs"][offered]["properties"]
    lines = [name, *(f"{key} = {_quoted(value)}" for key, value in stated.items() if value is not None)]
    for key in _OFFERED[offered]:
        if stated.get(key) is None:
            meaning = properties[key].get("description") if explain else None
            lines.append(f"# {key} =" + (f"   # {meaning}" if meaning else ""))
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
    """TOML of a study file for the recordings of a folder; those that could not be read are in comments."""
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
        stated = {
            "file": Path(os.path.relpath(os.path.realpath(trial.source.path), root)).as_posix(),
            "sheet": trial.source.sheet,
            "specimen": names[trial.specimen],
            "protocol": of_trial.get(i),
        }
        lines += _table("[[trial]]", stated, "trial", explain=i == 0)
    for one in refused:
        lines += [f"# not read: {str(one).splitlines()[0]}"]
    return "\n".join(lines).rstrip() + "\n"
