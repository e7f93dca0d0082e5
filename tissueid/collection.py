"""Trials by specimen, read, decided on and segmented before a fit; and what a study adds to its result.

Names, protocols, overrides with their reasons are applied here, and exclusions, which are segmented as well
so that the fit can be repeated with them.  Rows of covariates are flat, to be joined on path and sheet.
"""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import Any

import numpy as np

from tissueid.between_logs import copies, order_effect, repeated_sites, spread_flags
from tissueid.decided import arithmetic_refusal, as_decided, decided_trial
from tissueid.documents import members, plain
from tissueid.documents.identification import Calibration, Frame, StatedSpecimen, StatedTrial
from tissueid.documents.quantities import Cycle
from tissueid.errors import InputError
from tissueid.inference.frame_effect import beyond_calibration, frame_flags
from tissueid.inference.logs import LogHandle
from tissueid.inference.specimen import FitOptions
from tissueid.inference.window import fitted_log
from tissueid.manifest import Decision, Study, TomlTable
from tissueid.measured.cycles import cycle_rows
from tissueid.result import Estimate, Refusal, SpecimenFit
from tissueid.segment import SegmentOptions, segment
from tissueid.signal_noise import quantum
from tissueid.trial import Axes, Segmentation, Source, Trial

#: Samples kept in memory between the passes [bytes].
CACHE_BYTES = 16 * 2**20
#: Standard deviations of a contact behind air that its prior is wide: behind a start without slope (x^1.5
#: of a sphere) a hinge is four of its own late, and it is told from samples that the fit sees.
CONTACT_WIDER = 3.0

#: Message, tasks done, and all of them; 0 where these are not known.
Progress = Callable[[str, int, int], None]
#: Path and sheet of a recording.
_Key = tuple[str, str | None]


class RecentTrials:
    """The most recent trials, up to a number of bytes."""

    def __init__(self, most: float = CACHE_BYTES) -> None:
        self._trials: OrderedDict[_Key, Trial] = OrderedDict()
        self._bytes, self._most = 0, most

    def keep(self, key: _Key, trial: Trial) -> None:
        """Remember a trial; the oldest give way."""
        self._trials[key] = trial
        self._bytes += 3 * trial.time_s.nbytes
        while self._bytes > self._most and len(self._trials) > 1:
            self.take(next(iter(self._trials)))

    def take(self, key: _Key) -> Trial | None:
        """Give a trial away, where it is still there."""
        trial = self._trials.pop(key, None)
        self._bytes -= 0 if trial is None else 3 * trial.time_s.nbytes
        return trial


class TrialCache(RecentTrials):
    """Trials of which those that were dropped are read again; without a way to read them all are kept."""

    def __init__(self, reload: Callable[[Source], Trial] | None) -> None:
        super().__init__(math.inf if reload is None else CACHE_BYTES)
        self.reload = reload

    def get(self, key: _Key, source: Source) -> Trial:
        """The trial of that key, read again where it was dropped."""
        trial = self.take(key)
        if trial is None:
            if self.reload is None:
                raise KeyError(key)
            trial = self.reload(source)
            if trial.source.sha256 != source.sha256:
                msg = "the file changed while it was being fitted; run again when it is whole"
                raise InputError(code="unreadable_file", message=msg, path=source.path, sheet=source.sheet)
        self.keep(key, trial)
        return trial


def _mixed_axes(trial: Trial) -> Refusal:
    message = (
        f"its displacement is in {trial.axes.length} and its force in {trial.axes.force}, unlike the other"
        f" recordings of {trial.specimen}: give it a specimen of its own, or declare the same axes"
    )
    return Refusal(path=trial.source.path, sheet=trial.source.sheet, code="mixed_axes", message=message)


def _refusal_for(trial: Trial, segmentation: Segmentation) -> Refusal:
    if segmentation.contact is None:
        code = "no_contact"
        said = [flag.message for flag in segmentation.flags if flag.code == code and flag.message]
        message = "; ".join(said) or "no contact between tool and tissue was found"
        message += ": there is nothing to fit"
        chosen = [flag.values for flag in trial.flags if flag.code == "column_choice"]
        others = [name for one in chosen if one["quantity"] == "displacement" for name in one["alternatives"]]
        if others:
            message += f"; where another column is the travel, name it: --columns displacement={others[0]!r}"
    else:
        code = "too_few_samples"
        message = (
            "fewer than six samples, or samples of one and the same force, lie between contact and "
            "unloading: there is nothing to fit"
        )
    return Refusal(path=trial.source.path, sheet=trial.source.sheet, code=code, message=message)


def display_names(sources: Sequence[tuple[str, Source]]) -> dict[str, str]:
    """Specimens named after their file get the shortest ending of the path that tells them apart."""
    names: dict[str, str] = {}
    own: dict[str, tuple[str, ...]] = {}
    for specimen, source in sources:
        whole = source.path if source.sheet is None else f"{source.path}::{source.sheet}"
        if specimen == whole:
            path = PurePath(source.path)
            sheet = () if source.sheet is None else (source.sheet,)
            own[specimen] = (*path.parts[:-1], path.stem, *sheet)
        else:
            names[specimen] = specimen
    taken = set(names.values())
    waiting = dict(own)
    for length in range(1, max(map(len, own.values()), default=0) + 1):
        endings = {specimen: "/".join(parts[-length:]) for specimen, parts in own.items()}
        count = Counter(endings.values())
        for specimen in list(waiting):
            if count[endings[specimen]] == 1 and endings[specimen] not in taken:
                names[specimen] = endings[specimen]
                del waiting[specimen]
        taken.update(names.values())
    # files that differ in nothing but their suffix keep their whole path
    return names | {specimen: specimen for specimen in waiting}


@dataclass(frozen=True, slots=True, eq=False)
class Excluded:
    """A trial that the user took out."""

    #: What it is.
    path: str
    sheet: str | None
    specimen: str
    because: str
    handle: LogHandle | Refusal  # what a fit with it needs, or why there is none
    #: True where nobody took it out: a rigid block behind the frame's stiffness, a mean curve.
    no_specimen: bool


@dataclass(slots=True)
class Collected:
    """Trials by specimen, before anything is fitted."""

    groups: dict[str, list[LogHandle]] = field(default_factory=dict)
    radii: dict[str, list[float | None]] = field(default_factory=dict)
    axes: dict[str, Axes] = field(default_factory=dict)
    sources: list[tuple[str, Source]] = field(default_factory=list)
    inputs: list[dict[str, Any]] = field(default_factory=list)
    left_out: list[Refusal] = field(default_factory=list)
    unfitted_cycles: list[Cycle] = field(default_factory=list)
    decisions: dict[tuple[str, str | None], Decision] = field(default_factory=dict)
    excluded: list[Excluded] = field(default_factory=list)
    unlisted: list[tuple[str, str | None]] = field(default_factory=list)  # that a study leaves aside

    def add(self, trial: Trial, handle: LogHandle) -> None:
        """Count one trial in."""
        self.axes.setdefault(trial.specimen, trial.axes)
        if trial.specimen not in self.groups:
            self.sources.append((trial.specimen, trial.source))
        self.groups.setdefault(trial.specimen, []).append(handle)
        self.radii.setdefault(trial.specimen, []).append(trial.protocol.tip_radius_mm)
        source = trial.source
        self.inputs.append(
            {key: getattr(source, key) for key in ("path", "sheet", "sha256", "recipe")}
            | {"columns": dict(source.columns)}
            | {"specimen": trial.specimen, "n_samples": int(trial.time_s.size)}
        )


def _beyond_frame(trial: Trial, segmentation: Segmentation, study: Study | None) -> Refusal | None:
    frame = None if study is None else study.calibration.frame
    contact = segmentation.contact
    if frame is None or frame.range_N is None or contact is None:
        return None
    peak = float((segmentation.force_sign * (trial.force_N - contact.baseline_N)).max())
    if not beyond_calibration(frame, peak):
        return None
    message = (
        f"the force reaches {peak:.4g} N, far beyond the {frame.range_N[1]:.4g} N that the frame was "
        "calibrated to: its deflection there is unknown. Load the rigid block further and run "
        "`tissueid calibrate-frame` again"
    )
    return Refusal(path=trial.source.path, sheet=trial.source.sheet, code="frame_range", message=message)


def _handle(
    trial: Trial,
    options: SegmentOptions,
    study: Study | None,
    load: Callable[[], Trial],
    unfitted: Callable[[Trial, Segmentation], None],
    *,
    unloading: bool,
) -> LogHandle | Refusal:
    """The trial segmented, or why it can't be fitted; what was segmented only is handed to ``unfitted``."""
    try:
        segmentation = segment(trial, options=options)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        return arithmetic_refusal(trial.source.path, trial.source.sheet, "segmented", error)
    log = fitted_log(trial, segmentation, whole=unloading)
    if log is None:
        unfitted(trial, segmentation)
        return _refusal_for(trial, segmentation)
    refusal = _beyond_frame(trial, segmentation, study)
    if refusal is not None:
        return refusal
    contact = segmentation.contact
    told_by_air = contact is not None and contact.in_record and options.contact_displacement_mm is None
    sd = log.contact_sd_mm
    if not log.data.exact:
        # a travel in steps places contact, and a hold, to within its rounding
        stated = 0.0 if study is None else study.calibration.values.get("displacement_resolution_mm", 0.0)
        sd = math.hypot(sd, max(quantum(trial.displacement_mm), float(stated)) / math.sqrt(12.0))
        sd *= CONTACT_WIDER if told_by_air else 1.0
    return LogHandle(load=load, segmentation=segmentation, facts=log.without_samples(), contact_sd_mm=sd)


def collect(
    trials: Iterable[Trial],
    options: SegmentOptions,
    cache: TrialCache,
    progress: Progress,
    study: Study | None = None,
    *,
    depths_mm: tuple[float, ...] = (),
    unloading: bool = False,
) -> Collected:
    """Read and segment every trial; its samples stay only in the cache.

    ``progress``: ``progress(message, done, total)``; ``depths_mm``: depths at which the cycles of a trial
    that can't be fitted are described [mm]; ``unloading``: whether samples after the tool first turned back
    count as something to fit.
    """
    collected = Collected()

    def unfitted(trial: Trial, segmentation: Segmentation) -> None:
        collected.unfitted_cycles.extend(cycle_rows(trial, segmentation, depths_mm=depths_mm))

    progress("reading recording 1", 0, 0)  # said before: a network folder may take its time
    for count, raw in enumerate(trials, 1):
        progress(f"read {raw.name}, reading recording {count + 1}", count, 0)
        source, decision = raw.source, None
        if study is not None:
            decision = study.decision(source.path, source.sheet)
            if study.only_listed and not decision.listed and decision.excluded is None:
                collected.unlisted.append((source.path, source.sheet))
                continue
            collected.decisions[source.path, source.sheet] = decision
        trial, own, why = as_decided(raw, options, study, decision)
        if why is None and trial.axes != collected.axes.get(trial.specimen, trial.axes):
            collected.left_out.append(_mixed_axes(trial))
            continue
        key = (str(count), None) if cache.reload is None else (source.path, source.sheet)
        handle = _handle(trial, own, study, _loader(cache, key, source, study), unfitted, unloading=unloading)
        if why is not None:
            itself = options.excludes(trial) is None and (decision is None or decision.excluded is None)
            collected.excluded.append(
                Excluded(source.path, source.sheet, trial.specimen, why, handle, no_specimen=itself)
            )
        elif isinstance(handle, Refusal):
            collected.left_out.append(handle)
            continue
        else:
            collected.add(trial, handle)
        cache.keep(key, raw)
    return collected


def _loader(cache: TrialCache, key: _Key, source: Source, study: Study | None) -> Callable[[], Trial]:
    """Loads a trial again and decides on it again."""

    def load() -> Trial:
        raw = cache.get(key, source)
        if study is None:
            return raw
        return decided_trial(raw, study.decision(source.path, source.sheet), study)

    return load


#: Fits a specimen again: name, logs, options, and why, for the progress line.
Refit = Callable[[str, Sequence[LogHandle], FitOptions, str], SpecimenFit]


def study_flags(fit: SpecimenFit, collected: Collected, study: Study | None) -> SpecimenFit:
    """The fit with the flags that need its trials together, the study, or both."""
    said = [collected.decisions.get((trial.path, trial.sheet)) for trial in fit.trials]
    rows: list[TomlTable] = [{} if one is None else one.trial for one in said]
    frame = None if study is None else study.calibration.frame
    values = {} if study is None else study.calibration.values
    flags = [
        *frame_flags(fit, frame, values),
        *spread_flags(fit.trials),
        *order_effect(fit.trials, [row.get("run") for row in rows]),
        *repeated_sites(fit.trials, rows),
        *copies(fit.trials, collected.inputs),
    ]
    return replace(fit, flags=tuple(flags))


def study_record(
    study: Study, collected: Collected, names: Mapping[str, str], exclusions: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The ``study`` object of ``schemas/identification.schema.json``."""
    shown = [names[name] for name in collected.groups]
    trials = [_trial_row(collected, entry, names) for entry in collected.inputs]
    return study_document(study, shown, trials, list(exclusions))


def study_document(study: Study, fitted: Iterable[str], trials: Any, exclusions: Any) -> dict[str, Any]:
    """The ``study`` object from rows that are there."""
    shown = dict.fromkeys([*fitted, *study.specimens])
    frame = study.calibration.frame
    calibration = {key: study.calibration.values.get(key) for key in Calibration.__struct_fields__}
    return {
        "path": study.path,
        "sha256": study.sha256,
        "study": dict(study.about),
        "tip": dict(study.tip),
        "calibration": calibration | {"frame": None if frame is None else plain(members(frame, Frame))},
        "priors": study.priors.as_json(),
        **({} if study.population is None else {"population": study.population.as_json()}),
        "specimens": [_specimen_row(study, name) for name in shown],
        "trials": trials,
        "exclusions": exclusions,
    }


def _specimen_row(study: Study, name: str) -> dict[str, Any]:
    """Covariates of one specimen: its own, else the study's."""
    own = study.specimens.get(name, {})
    keys = [key for key in StatedSpecimen.__struct_fields__ if key not in {"specimen", "notes"}]
    row = {key: own.get(key, study.about.get(key)) for key in keys}
    return {"specimen": name, **row, "notes": own.get("notes")}


def _trial_row(collected: Collected, entry: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Covariates of one fitted trial."""
    decision = collected.decisions[entry["path"], entry["sheet"]]
    override = decision.override
    row = {key: decision.trial.get(key) for key in StatedTrial.__struct_fields__}
    return row | {
        "path": entry["path"],
        "sheet": entry["sheet"],
        "specimen": names[entry["specimen"]],
        "listed": decision.listed,
        "overridden": [key for key in override if key != "because"],
        "because": override.get("because"),
    }


def exclusion_rows(
    collected: Collected,
    names: Mapping[str, str],
    fits: Sequence[SpecimenFit],
    options: FitOptions,
    again: Refit,
) -> list[dict[str, Any]]:
    """Every excluded trial with its reason, and its specimen's numbers with and without it.

    The law chosen without the trial is kept, so that the difference is the trial's and not the choice's.
    """
    fitted = {fit.specimen: fit for fit in fits}
    rows = []
    for one in collected.excluded:
        name = names.get(one.specimen, one.specimen)
        without = fitted.get(name)
        note, with_it = _with_it(one, name, collected, without, options, again)
        said = {"path": one.path, "sheet": one.sheet, "specimen": name, "because": one.because}
        rows.append({**said, "note": note, "with_it": with_it})
    return rows


def _with_it(
    one: Excluded,
    name: str,
    collected: Collected,
    without: SpecimenFit | None,
    options: FitOptions,
    again: Refit,
) -> tuple[str | None, list[dict[str, Any]]]:
    """A remark, and a row a parameter; no rows where there is no fit to compare, or none with the trial."""
    if one.no_specimen:
        return None, []
    if isinstance(one.handle, Refusal):
        return f"it could not be fitted anyway: {one.handle.message}", []
    if without is None:
        return "the specimen has no other trial that was fitted, so there is nothing to compare", []
    handles = [*collected.groups.get(one.specimen, ()), one.handle]
    try:
        fit = again(name, handles, options.of_law(without.model), f"again, with {one.path}")
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        return arithmetic_refusal(one.path, one.sheet, "fitted", error).message, []
    before = {estimate.name: estimate for estimate in without.parameters}
    return None, [_difference(before.get(after.name), after) for after in fit.parameters]


def _difference(before: Estimate | None, after: Estimate) -> dict[str, Any]:
    return {
        "name": after.name,
        "symbol": after.symbol,
        "unit": after.unit,
        "without": None if before is None else before.value,
        "without_stderr": None if before is None else before.stderr,
        "with": after.value,
        "with_stderr": after.stderr,
    }


def without_excluded(refused: Sequence[Refusal], collected: Collected, study: Study | None) -> list[Refusal]:
    """The refusals that are not of recordings the user took out; those join the exclusions."""
    kept = []
    for one in refused:
        decision = None if study is None else study.decision(one.path, one.sheet)
        if decision is None or decision.excluded is None:
            kept.append(one)
            continue
        specimen = decision.trial.get("specimen", one.path)
        collected.excluded.append(
            Excluded(one.path, one.sheet, specimen, decision.excluded, one, no_specimen=False)
        )
    return kept


def unmatched_sheets(study: Study | None, collected: Collected, refused: Sequence[Refusal]) -> list[Refusal]:
    """Sheets that the study names in files that were read, and that are not there."""
    if study is None:
        return []
    found: dict[str, set[str | None]] = {}
    for path, sheet in [
        *collected.decisions,
        *collected.unlisted,
        *((one.path, one.sheet) for one in refused),
    ]:
        found.setdefault(study.real_path(path), set()).add(sheet)
    missing = []
    for entry in study.entries:
        sheets = [sheet for file in entry.files for sheet in found.get(file, ())]
        if entry.sheet is not None and sheets and entry.sheet not in sheets:
            there = ", ".join(sorted(f'"{sheet}"' for sheet in sheets if sheet is not None)) or "none"
            message = f'there is no sheet "{entry.sheet}" in {entry.values["file"]}; it has {there}'
            missing.append(Refusal(study.path, None, "study_unmatched", message, entry.line))
    return missing
