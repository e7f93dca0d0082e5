"""Real recordings for :mod:`real`: found, read and framed by the public interface, and fitted by it.

Recordings stay where they are. Contact, signs and holds are those that ``tissueid inspect --json`` prints.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
from real_baselines import Log, cone_weights, curve_rays

import tissueid
from tissueid.model.base import ContactPath
from tissueid.model.channels import ChannelModel
from tissueid.model.grammar import rebuilt
from tissueid.pipeline import FitOptions, IdentifyOptions, PosteriorOptions, identify

MEAT = "zwick-meat-gpl3"
#: What a fit may raise that is no fault of the benchmark: it is told and the rest goes on.
FAULTS = (ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
_CUT = re.compile(r"^(\d{6})[-_]([A-Za-z]+\d)")
_RAMP = re.compile(r"Avg(.+)_([\d.]+)s$")


@dataclass(frozen=True, slots=True)
class Source:
    """Recordings of one kind in the folder of all."""

    kind: str
    folder: str
    pattern: str
    #: As ``--columns`` takes them; empty where the file speaks for itself.
    columns: Mapping[str, str] = field(default_factory=dict)
    from_start: bool = False  # contact is the first sample, whatever a search for it finds


SOURCES = (
    Source("meat", MEAT, "*.xlsx"),
    Source(
        "muscle",
        "muscle-ramp-hold-mit",
        "*.csv",
        {"time": "Time", "displacement": "L", "force": "F"},
        from_start=True,
    ),
    Source("oocyte", "oocyte-afm-mit", "*_full.csv"),
    Source("nano-indenter", "optics11-chiaro-mit", "*.zip"),
)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A ramp and a hold."""

    name: str
    kind: str
    group: str  # the cut of a sheet, the condition of a muscle; empty where there is one recording
    trial: tissueid.trial.Trial  # its specimen is ``name``
    log: Log  # from contact to the end of the hold
    contact_sd_mm: float


def tell(text: str) -> None:
    """Print progress to stderr."""
    print(text, file=sys.stderr, flush=True)


def workbooks(data: Path) -> list[Path]:
    """The meat workbooks."""
    return sorted((data / MEAT).glob("*.xlsx"))


def _names(source: Source, path: Path, sheet: str | None) -> tuple[str, str]:
    """Name and group of a recording."""
    if source.kind == "meat" and sheet is not None:
        cut = _CUT.match(sheet)
        return sheet.replace("_", "-"), "" if cut is None else f"{cut[1]}-{cut[2].upper()}"
    ramp = _RAMP.match(path.stem)
    if source.kind == "muscle" and ramp is not None:
        return f"{ramp[1]} {ramp[2]} s", ramp[1]
    return f"{source.kind} {path.stem}", ""


def inspected(path: Path, columns: Mapping[str, str]) -> dict[str | None, dict[str, Any]]:
    """Documents of ``tissueid inspect --json`` for a file, by sheet; refused recordings are left out."""
    extra = ["--columns", ",".join(f"{key}={name}" for key, name in columns.items())] if columns else []
    ended = subprocess.run(
        [sys.executable, "-P", "-m", "tissueid", "inspect", str(path), "--json", "--no-study", *extra],
        check=False,
        capture_output=True,
        text=True,
    )
    documents = json.loads(ended.stdout)
    return {one["sheet"]: one for one in documents if one.get("measured") and one.get("contact")}


def _log(name: str, trial: Any, told: Mapping[str, Any], *, from_start: bool) -> Log | None:
    """The push from contact to the end of its first position-controlled hold; ``None`` without one."""
    holds = [one for one in told["measured"]["holds"] if one["control"] == "position"]
    if not holds:
        return None
    contact = told["contact"]
    at = trial.displacement_mm[0] if from_start else contact["displacement_mm"]
    depth = told["compression_sign"] * (trial.displacement_mm - at)
    force = told["force_sign"] * (trial.force_N - contact["baseline_N"])
    last = int(np.searchsorted(trial.time_s, holds[0]["end_s"], side="right"))
    air = np.flatnonzero(depth[:last] <= 0.0)
    first = int(air[-1]) if air.size else 0
    part = slice(first, last)
    time_s = trial.time_s[part] - trial.time_s[first]
    return Log(name, time_s, np.maximum(depth[part], 0.0), force[part], np.ones(last - first, dtype=bool))


def recordings(data: Path, only: str = "*", limit: int | None = None) -> list[Recording]:
    """Recordings with a position-controlled hold, ``only`` of such names, and at most ``limit`` of a file."""
    found = []
    for source in SOURCES:
        for path in sorted((data / source.folder).glob(source.pattern)):
            tell(f"reading {path.name}")
            told = inspected(path, source.columns)
            kept: list[Recording] = []
            for trial in tissueid.read_trials(path, tissueid.ReadOptions(columns=source.columns)):
                document = told.get(trial.source.sheet)
                name, group = _names(source, path, trial.source.sheet)
                mean_curve = any(flag.code == "not_a_specimen" for flag in trial.flags)
                if document is None or mean_curve or not fnmatch(name.lower(), only.lower()):
                    continue
                log = _log(name, trial, document, from_start=source.from_start)
                if log is not None:
                    own = replace(trial, specimen=name)
                    sd = document["contact"]["sd_mm"]
                    kept.append(Recording(name, source.kind, group, own, log, sd))
            found += kept[:limit]
    return found


def grouped(found: Sequence[Recording], kind: str, least: int = 2) -> dict[str, list[Recording]]:
    """Recordings of a kind by group, groups of at least so many."""
    groups: dict[str, list[Recording]] = {}
    for one in found:
        if one.kind == kind and one.group:
            groups.setdefault(one.group, []).append(one)
    return {name: members for name, members in groups.items() if len(members) >= least}


def left_out(
    found: Sequence[Recording], kind: str, least: int, cuts: int | None, logs: int | None
) -> Iterator[tuple[str, Recording, list[Recording]]]:
    """Group, a recording that is left out of it, and the others; most groups, and most recordings of each."""
    for group, members in list(grouped(found, kind, least).items())[:cuts]:
        for place, one in enumerate(members[:logs]):
            yield group, one, [*members[:place], *members[place + 1 :]]


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A fitted specimen."""

    fit: Any
    document: Mapping[str, Any]  # its entry in ``identification.json``
    cpu_s: float  # of this process

    @property
    def order(self) -> tuple[int, int]:
        """Branches, and degree of K."""
        return self.document["model"]["branches"], self.document["model"]["stiffness_degree"]

    @property
    def pooling(self) -> str:
        """Static pooling of its logs."""
        return str(self.document["model"]["static_pooling"])

    def printed(self) -> dict[str, Mapping[str, Any]]:
        """Parameters with a value."""
        return {one["name"]: one for one in self.document["parameters"] if one["value"] is not None}

    @property
    def law(self) -> ChannelModel:
        """Contact model that belongs to theta."""
        return rebuilt(self.fit.model, float(self.fit.depth_mm))

    @property
    def offset_apart(self) -> bool:
        """True if the law takes depths less the contact offsets, and not the depths that its curves keep."""
        law, theta = self.law, np.asarray(self.fit.theta, dtype=np.float64)
        if not any(one.contact_offset_mm for one in self.fit.trials):
            return False
        misses = []
        for moved in (0.0, 1.0):
            total = 0.0
            for one in self.fit.trials:
                depth = np.maximum(np.asarray(one.curve.depth_mm) - moved * one.contact_offset_mm, 0.0)
                force = law.force(theta, ContactPath(np.asarray(one.curve.time_s), depth))
                # a log may have a gain or a curve of its own
                columns = curve_rays(depth / law.depth_mm, 2) * force[:, None]
                model = np.asarray(one.curve.model_N)
                total += float(((columns @ cone_weights(columns, model) - model) ** 2).sum())
            misses.append(total)
        return misses[1] < misses[0]

    def logs(self, *, as_recorded: bool = False) -> list[Log]:
        """Its logs in the frame of the law, or with contact before it was fitted."""
        moved = not as_recorded and self.offset_apart
        return [
            Log(
                f"{one.path} {one.sheet}",
                np.asarray(one.curve.time_s),
                np.asarray(one.curve.depth_mm) - (one.contact_offset_mm if moved else 0.0),
                np.asarray(one.curve.force_N),
                np.asarray(one.curve.fitted, dtype=bool),
            )
            for one in self.fit.trials
        ]


def value_of(parameter: Mapping[str, Any]) -> tuple[float, float | None]:
    """Value and total standard deviation, the latter from the width of its total interval."""
    total = parameter.get("ci95_total")
    return float(parameter["value"]), None if total is None else (total[1] - total[0]) / 3.92


def fit_of(
    members: Sequence[Recording], name: str, *, seed: int = 0, sampled: bool = True, **options: Any
) -> Found | str:
    """Identify the recordings as one specimen, by the public interface; the reason where nothing was fitted.

    ``sampled``: sample the posterior as the command does by default; ``**options``: of
    :class:`tissueid.FitOptions`.
    """
    trials = [replace(one.trial, specimen=name) for one in members]
    posterior = PosteriorOptions(seed=seed) if sampled else None
    start = time.process_time()
    try:
        asked = IdentifyOptions(fit=FitOptions(**options), posterior=posterior, seed=seed)
        found = identify(trials, options=asked)
        documents = found.as_json()["specimens"]
    except FAULTS as error:
        return f"{type(error).__name__}: {error}"
    if len(documents) != 1:
        return "; ".join(str(one) for one in found.refused) or "nothing was fitted"
    return Found(found.specimens[0], documents[0], time.process_time() - start)
