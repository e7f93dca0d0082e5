"""A session at the machine: looks, verdicts, a first fit, and a log from which the next session goes on.

New recordings are noticed when they are whole, judged, and compared with earlier ones.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import MsgspecError, structs
from msgspec.json import decode

from tissueid.decided import as_decided
from tissueid.documents import plain, typed
from tissueid.documents.inspect import Fit, Judged, Parameter, Watch
from tissueid.errors import InputError, was_interrupted
from tissueid.inference.specimen import FitOptions
from tissueid.inspection import describe_segmented, measured_of, segmented
from tissueid.manifest import Study
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.result import Refusal
from tissueid.segment import SegmentOptions
from tissueid.store.files import write_file
from tissueid.trial import Trial

Fingerprint = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Look:
    """Result of one look at the folder."""

    ready: tuple[Path, ...] = ()  # new or changed, and whole; the oldest first
    gone: tuple[Path, ...] = ()  # seen before and no longer there
    reachable: bool = True  # false where the folder could not be listed: a network drive away is no deletion


@dataclass(slots=True)
class FolderWatch:
    """A folder that is looked at repeatedly."""

    #: Lists the recordings of the folder; an ``OSError`` means that it is not reachable.
    find: Callable[[], Iterable[Path]]
    #: Path -> fingerprint (size, time in ns) of what was handed out already.
    known: dict[Path, Fingerprint] = field(default_factory=dict)
    _growing: dict[Path, Fingerprint] = field(default_factory=dict)

    def look(self) -> Look:
        """Look once; a file is handed out at the second look that finds it the same."""
        try:
            seen = {path: mark for path in self.find() if (mark := fingerprint(path)) is not None}
        except OSError:
            return Look(reachable=False)
        changed = {path: mark for path, mark in seen.items() if self.known.get(path) != mark}
        ready = [path for path, mark in changed.items() if self._growing.get(path) == mark and opens(path)]
        gone = [path for path in self.known if path not in seen]
        self._growing = {path: mark for path, mark in changed.items() if path not in ready}
        self.known |= {path: changed[path] for path in ready}
        for path in gone:
            del self.known[path]
        # the order of testing is that of the files' times
        ready.sort(key=lambda path: (changed[path][1], path.name))
        return Look(tuple(ready), tuple(gone))


def fingerprint(path: Path) -> Fingerprint | None:
    """Size and time of a file; ``None`` where it is gone."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns


def opens(path: Path) -> bool:
    """True where the file holds something that can be read: Windows refuses what another program holds."""
    try:
        with path.open("rb") as stream:
            return bool(stream.read(1))
    except OSError:
        return False


def samples_digest(trial: Trial) -> str:
    """SHA-256 of the samples: tells a sheet that changed from one that was only saved again."""
    digest = hashlib.sha256()
    for channel in (trial.time_s, trial.displacement_mm, trial.force_N):
        digest.update(np.ascontiguousarray(channel, dtype="<f8").tobytes())
    return digest.hexdigest()


def refused_verdict(refusal: Refusal, trial: Trial | None = None) -> Watch:
    """The verdict on a file that can't be read, or on a trial that defeats the arithmetic."""
    said = refusal.as_json()
    said |= {"verdict": Judged("refused", f"this file can't be used: {refusal}"), "flags": ()}
    if trial is not None:
        said |= {"specimen": trial.specimen, "digest": samples_digest(trial)}
    return typed(dict.fromkeys(Watch.__struct_fields__) | said, Watch)


def judge(
    trial: Trial,
    earlier: Iterable[Watch] = (),
    *,
    options: SegmentOptions | None = None,
    study: Study | None = None,
) -> Watch:
    """Judge one test, as read, beside earlier ones of its specimen."""
    trial, options, excluded = as_decided(trial, options, study)
    divided = segmented(trial, options=options)
    if isinstance(divided, Refusal):
        return refused_verdict(divided, trial)
    alike = [one for one in earlier if one.specimen == trial.specimen and one.excluded is None]
    pushes = [None if one.measured is None else one.measured.push for one in alike]
    before = [push for push in pushes if push is not None]
    found = describe_segmented(
        trial, divided, excluded=excluded, measured=measured_of(trial, divided, study), earlier=before
    )
    kept = {name: found[name] for name in Watch.__struct_fields__ if name in found}
    return typed(kept | {"digest": samples_digest(trial), "error": None, "fit": None}, Watch)


#: Name of the log in the output folder.
LOG = "watch.jsonl"


@dataclass(frozen=True, slots=True)
class Happening:
    """Something to tell the operator."""

    #: ``verdict``, ``replaced`` (a verdict on a file that was judged before), ``fitted`` (the verdict with
    #: its fit), ``renamed``, ``copy``, ``gone``, ``unreachable`` or ``back``.
    kind: str
    text: str = ""  # in words, but for a verdict
    verdict: Watch | None = None


@dataclass(slots=True)
class WatchSession:
    """Verdicts on the recordings of a folder, as they come."""

    watch: FolderWatch
    read: Callable[[Path], Iterable[Trial | InputError]]  # trials and refusals of one file
    judge: Callable[[Trial, Iterable[Watch]], Watch]  # ``judge(trial, earlier) -> verdict``
    log: Path | None = None  # where verdicts are kept, rewritten whole after each
    #: In the order of testing; those of files that are gone stay, and are not compared with.
    verdicts: list[Watch] = field(default_factory=list)
    fit: Callable[[Trial], Fit | None] | None = None  # after the verdict is told
    _gone: set[str] = field(default_factory=set)
    _reachable: bool = True

    def step(self) -> Iterator[Happening]:
        """Look at the folder once, and tell what happened, as it is found."""
        look = self.watch.look()
        if look.reachable != self._reachable:
            self._reachable = look.reachable
            word = "is back" if look.reachable else "can't be reached; waiting"
            yield Happening("back" if look.reachable else "unreachable", f"the folder {word}")
        for path in look.ready:
            self._gone.discard(str(path))
            yield from self._judged(path)
        for path in look.gone:
            self._gone.add(str(path))
            if any(one.path == str(path) for one in self.verdicts):
                yield Happening("gone", f"{path}: gone; it takes no part in comparisons")

    def _judged(self, path: Path) -> Iterator[Happening]:
        for item in self.read(path):
            if isinstance(item, InputError):
                verdict = refused_verdict(Refusal.of(item))
                known = self._find(item.path, item.sheet)
                if known is None or known.error != verdict.error:
                    yield self._keep(verdict, known)
            else:
                yield from self._of_trial(item)

    def _of_trial(self, trial: Trial) -> Iterator[Happening]:
        digest, name = samples_digest(trial), trial.name
        known = self._find(trial.source.path, trial.source.sheet)
        if known is not None and known.digest == digest:
            return
        same = next((one for one in self.verdicts if one.digest == digest and one is not known), None)
        if same is None:
            earlier = [one for one in self.verdicts if one is not known and one.path not in self._gone]
            verdict = self._safely(trial, earlier)
            yield self._keep(verdict, known)
            if self.fit is not None and verdict.contact is not None:
                yield self._fitted(trial, verdict, self.fit)
        elif same.path in self._gone or not Path(same.path).exists():
            self._replace(same, path=trial.source.path, sheet=trial.source.sheet)
            yield Happening("renamed", f"{name}: was {same.path}, judged already")
        else:
            yield Happening("copy", f"{name}: the same samples as {same.path}, judged already")

    def _safely(self, trial: Trial, earlier: Iterable[Watch]) -> Watch:
        try:
            return self.judge(trial, earlier)
        except Exception as error:
            # one file must never end the session at the machine
            if was_interrupted(error):
                raise
            message = f"it could not be judged ({type(error).__name__}: {error}); `tissueid inspect` shows it"
            refusal = Refusal(trial.source.path, trial.source.sheet, "fit_failed", message)
            return refused_verdict(refusal, trial)

    def _fitted(self, trial: Trial, verdict: Watch, fit: Callable[[Trial], Fit | None]) -> Happening:
        try:
            verdict = self._replace(verdict, fit=fit(trial))
        except Exception as error:
            # one file must never end the session at the machine
            if was_interrupted(error):
                raise
        return Happening("fitted", verdict=verdict)

    def _find(self, path: str, sheet: str | None) -> Watch | None:
        return next((one for one in self.verdicts if (one.path, one.sheet) == (path, sheet)), None)

    def _keep(self, verdict: Watch, known: Watch | None) -> Happening:
        if known is not None:
            self.verdicts.remove(known)
        self.verdicts.append(verdict)
        self._save()
        return Happening("verdict" if known is None else "replaced", verdict=verdict)

    def _replace(self, verdict: Watch, **changes: Any) -> Watch:
        changed = structs.replace(verdict, **changes)
        self.verdicts[self.verdicts.index(verdict)] = changed
        self._save()
        return changed

    def _save(self) -> None:
        if self.log is not None:
            lines = [json.dumps(plain(one), ensure_ascii=False, allow_nan=False) for one in self.verdicts]
            write_file(self.log, ("\n".join(lines) + "\n").encode("utf-8"))


def load_log(path: Path) -> list[Watch]:
    """Verdicts of an earlier session; lines that are none are left out."""
    found: list[Watch] = []
    for line in path.read_bytes().splitlines() if path.is_file() else ():
        with suppress(MsgspecError, ValueError):
            found.append(typed(decode(line), Watch))
    return found


def quick_fit(trial: Trial, options: SegmentOptions | None, study: Study | None = None) -> Fit | None:
    """Parameters of the test alone, by the machine and the priors of the study; ``None`` without a fit."""
    trial, options, _ = as_decided(trial, options, study)
    quick = IdentifyOptions(fit=FitOptions(branches=1, stiffness_degree=0), segment=options)
    # decided on already, and fitted whatever it is excluded for
    known = study and Study(study.path, calibration=study.calibration, priors=study.priors)
    fits = identify([trial], study=known, options=quick).specimens
    if not fits:
        return None
    found = [Parameter(one.name, one.unit, one.value, one.stderr) for one in fits[0].parameters]
    return Fit(fits[0].nrmsd.range, tuple(found))
