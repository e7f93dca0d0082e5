"""Trials by specimen, read, decided on and segmented, before anything is fitted.

What a study file says is applied here: names, protocols, overrides with their reasons, and exclusions, which
are segmented as well so that the fit can be repeated with them.
"""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any

import numpy as np

from tissueid.decided import arithmetic_refusal, decided_options, decided_trial, why_excluded
from tissueid.documents.quantities import Cycle
from tissueid.errors import InputError
from tissueid.inference.frame_effect import beyond_calibration
from tissueid.inference.logs import LogHandle
from tissueid.inference.window import fitted_log
from tissueid.manifest import Decision, Study
from tissueid.measured.cycles import cycle_rows
from tissueid.result import Refusal
from tissueid.segment import SegmentOptions, segment
from tissueid.signal_noise import quantum
from tissueid.trial import Axes, Segmentation, Source, Trial

#: Samples kept in memory between the passes [bytes].
CACHE_BYTES = 16 * 2**20
#: Standard deviations of a contact behind air that its prior is wide: behind a start without slope (x^1.5
#: of a sphere) a hinge is four of its own late, and it is told from samples that the fit sees.
CONTACT_WIDER = 3.0

_Progress = Callable[[str, int, int], None]


class TrialCache:
    """The most recent trials, up to a number of bytes."""

    def __init__(self, reload: Callable[[Source], Trial] | None) -> None:
        self._reload = reload
        self._trials: OrderedDict[tuple[str, str | None], Trial] = OrderedDict()
        self._bytes = 0

    @property
    def reloads(self) -> bool:
        """True where a trial that was dropped can be read again."""
        return self._reload is not None

    @staticmethod
    def _size(trial: Trial) -> int:
        return trial.time_s.nbytes + trial.displacement_mm.nbytes + trial.force_N.nbytes

    def add(self, key: tuple[str, str | None], trial: Trial) -> None:
        """Keep a trial; the oldest give way."""
        self._trials[key] = trial
        self._bytes += self._size(trial)
        while self._reload is not None and self._bytes > CACHE_BYTES and len(self._trials) > 1:
            _, oldest = self._trials.popitem(last=False)
            self._bytes -= self._size(oldest)

    def get(self, key: tuple[str, str | None], source: Source) -> Trial:
        """The trial of that key, read again where it was dropped."""
        if key in self._trials:
            self._trials.move_to_end(key)
            return self._trials[key]
        if self._reload is None:
            raise KeyError(key)
        trial = self._reload(source)
        if trial.source.sha256 != source.sha256:
            msg = "the file changed while it was being fitted; run again when it is whole"
            raise InputError(code="unreadable_file", message=msg, path=source.path, sheet=source.sheet)
        self.add(key, trial)
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

    def add(self, trial: Trial, handle: LogHandle) -> None:
        """Count one trial in."""
        self.axes.setdefault(trial.specimen, trial.axes)
        if trial.specimen not in self.groups:
            self.sources.append((trial.specimen, trial.source))
        self.groups.setdefault(trial.specimen, []).append(handle)
        self.radii.setdefault(trial.specimen, []).append(trial.protocol.tip_radius_mm)
        self.inputs.append(
            {
                "path": trial.source.path,
                "sheet": trial.source.sheet,
                "sha256": trial.source.sha256,
                "recipe": trial.source.recipe,
                "columns": dict(trial.source.columns),
                "specimen": trial.specimen,
                "n_samples": int(trial.time_s.size),
            }
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
    return LogHandle(
        load=load,
        segmentation=segmentation,
        facts=log.without_samples(),
        contact_sd_mm=sd,
    )


def collect(
    trials: Iterable[Trial],
    options: SegmentOptions,
    cache: TrialCache,
    progress: _Progress,
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
        trial, own, decision = raw, options, None
        source = raw.source
        if study is not None:
            decision = study.decision(source.path, source.sheet)
            if study.only_listed and not decision.listed and decision.excluded is None:
                continue
            trial, own = decided_trial(raw, decision, study), decided_options(options, decision)
            collected.decisions[source.path, source.sheet] = decision
        pattern = options.excludes(trial)
        why = why_excluded(raw, decision, study)
        if why is None and pattern is not None:
            why = f"--exclude {pattern}"
        if why is None and trial.axes != collected.axes.get(trial.specimen, trial.axes):
            collected.left_out.append(_mixed_axes(trial))
            continue
        key = (source.path, source.sheet) if cache.reloads else (str(count), None)
        handle = _handle(trial, own, study, _loader(cache, key, source, study), unfitted, unloading=unloading)
        if why is not None:
            itself = pattern is None and (decision is None or decision.excluded is None)
            collected.excluded.append(
                Excluded(source.path, source.sheet, trial.specimen, why, handle, no_specimen=itself)
            )
        elif isinstance(handle, Refusal):
            collected.left_out.append(handle)
            continue
        else:
            collected.add(trial, handle)
        cache.add(key, raw)
    return collected


def _loader(
    cache: TrialCache, key: tuple[str, str | None], source: Source, study: Study | None
) -> Callable[[], Trial]:
    """Loads a trial again and decides on it again."""

    def load() -> Trial:
        raw = cache.get(key, source)
        if study is None:
            return raw
        return decided_trial(raw, study.decision(source.path, source.sheet), study)

    return load
