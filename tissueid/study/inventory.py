"""Request of a cohort, and every file of it looked into: what it holds goes into the index in their order.

A file whose bytes are those that an earlier run saw, read in the same way, is hashed and not parsed.
"""

from __future__ import annotations

import hashlib
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tissueid.collection import Progress, RecentTrials
from tissueid.errors import InputError
from tissueid.ingest import ReadOptions
from tissueid.ingest.manifest import READING
from tissueid.manifest import Study
from tissueid.pipeline import IdentifyOptions
from tissueid.result import Refusal
from tissueid.store.files import json_bytes, sha256_of
from tissueid.store.index import Index, RecordingRow
from tissueid.study.recordings import FileList, StudyParts, read_decided
from tissueid.study.tasks import (
    Fault,
    InThisProcess,
    LocalProcesses,
    Task,
    Workforce,
    packed,
    unpacked,
    versions,
)
from tissueid.trial import Trial

#: The scheduler that is no scheduler.
LOCAL = "local"
#: Processes are worth their start from so much work on [s]: each imports for two seconds.
WORTH_PROCESSES_S = 8.0
#: What a job is expected to cost: reading, segmenting and fitting [s a sample], and sampling [s].
SECONDS_A_SAMPLE = 5e-6
SECONDS_SAMPLING: Mapping[str, float] = {"emcee": 2.5, "none": 0.2}


@dataclass(frozen=True, slots=True)
class Request:
    """Request for a fit."""

    found: FileList  # files in their order; a refusal stands in the place of what was refused
    reading: ReadOptions
    study: Study | None
    options: IdentifyOptions
    provenance: Mapping[str, Any]  # added to the provenance of the run
    #: Processes; ``None`` takes as many as there are processors, where the work is worth their start.
    workers: int | None
    scheduler: str  # ``local``, or the address of a Dask scheduler
    one_order: bool  # specimens of a study have one law and order
    read: Callable[[str, str | None], None]  # told path and sheet of every recording
    #: Told once, when every file was looked into and nothing is fitted yet.
    all_read: Callable[[], None]


def expected_seconds(samples: int, specimens: int, options: IdentifyOptions) -> float:
    """Roughly what some specimens cost on one processor [s]."""
    sampler = "none" if options.posterior is None else options.posterior.sampler
    return samples * SECONDS_A_SAMPLE + specimens * SECONDS_SAMPLING.get(sampler, 1.0)


class Workplace(AbstractContextManager["Workplace"]):
    """Workplace of a run; processes and connections are opened when they are first needed."""

    def __init__(self, workers: int | None, scheduler: str) -> None:
        self._workers, self._scheduler = workers, scheduler
        self._stack = ExitStack()
        self._opened: Workforce | None = None

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def workforce(
        self, tasks: int, seconds: float, function: Callable[[str, bytes], bytes], *, asked: bool
    ) -> Workforce:
        """Who computes some tasks that cost ``seconds`` together; ``function``: how this process does.

        ``asked``: the number of processes that the user asked for is meant for these tasks, however
        small.
        """
        if self._opened is None and self._scheduler == LOCAL:
            most = self._workers or os.cpu_count() or 1
            small = seconds < WORTH_PROCESSES_S and (self._workers is None or not asked)
            if min(most, tasks) < 2 or small:
                return InThisProcess(function, one=self._workers == 1)
            self._opened = self._stack.enter_context(LocalProcesses(most))
        elif self._opened is None:
            from tissueid.study.cluster import DaskWorkers

            self._opened = self._stack.enter_context(DaskWorkers(self._scheduler))
        return self._opened


#: The task of this module.
SURVEY = "tissueid.study.inventory:survey_files"


@dataclass(frozen=True, slots=True)
class NamedFile:
    """One file to look into."""

    position: int  # its place in the order of files
    path: str  # as the user named it
    options: ReadOptions  # with the sheet that was named, if one was
    study: Study | None  # what the study says of this file
    known: str | None = None  # SHA-256 it had when it was last read in this way


def refused_row(refusal: Refusal) -> RecordingRow:
    """The row of what could not be read."""
    return RecordingRow(refusal.path, refusal.sheet, "", "", 0, "refused", "", refusal)


def found_in(path: str, item: Trial | InputError) -> RecordingRow:
    """Row of one item of a file's reader, without the study's decisions."""
    if isinstance(item, InputError):
        return replace(refused_row(Refusal.of(item)), path=path)
    where, name = item.source, item.specimen
    return RecordingRow(path, where.sheet, where.sha256, name, int(item.time_s.size), "trial", name)


def look_into(file: NamedFile, recent: RecentTrials | None) -> list[RecordingRow] | None:
    """Everything a file holds, as it was read; ``None`` where it is the file that was known."""
    # of a file that can't be opened the reader says what is wrong
    with suppress(OSError):
        if file.known and sha256_of(Path(file.path)) == file.known:
            return None
    found = []
    for item in read_decided(Path(file.path), file.options, file.study):
        found.append(found_in(file.path, item))
        if recent is not None and isinstance(item, Trial):
            recent.keep((item.source.path, item.source.sheet), item)
    return found


def survey_files(payload: bytes, recent: RecentTrials | None = None) -> bytes:
    """The task: a list of :class:`NamedFile` in, a list of (position, what each holds) out."""
    return packed([(file.position, look_into(file, recent)) for file in unpacked(payload)])


def reading_key(options: ReadOptions, study: Study | None) -> str:
    """Hash of everything that decides how a file is read."""
    said: list[Any] = []
    if study is not None:
        said = [
            [entry.sheet, {key: entry.values[key] for key in READING if key in entry.values}]
            for entry in study.overrides
            if any(key in entry.values for key in READING)
        ]
    asked = {name: getattr(options, name) for name in sorted(options.__dataclass_fields__)}
    return hashlib.sha256(json_bytes({"asked": asked, "said": said, "versions": versions()})).hexdigest()[:32]


def decided_row(row: RecordingRow, study: Study | None) -> RecordingRow:
    """The row of a recording with the study's decisions on it."""
    specimen, kind = row.raw, "trial" if row.refusal is None else "refused"
    if study is not None:
        decision, frame = study.decision(row.path, row.sheet), study.calibration.frame
        if row.refusal is not None:
            kind = "refused" if decision.excluded is None else "refused_excluded"
        else:
            specimen = str(decision.trial.get("specimen", specimen))
            if decision.excluded is not None or (frame is not None and row.sha256 in frame.sources):
                kind = "excluded"
            elif study.only_listed and not decision.listed:
                kind = "unlisted"
    return replace(row, kind=kind, specimen=specimen)


#: Files a task looks into: few of long recordings, more of short ones, as far as every worker has its share.
FEW_FILES, MANY_FILES, TASKS = 8, 64, 100
#: Bytes of the files of a task that looks into more than a few.
BYTES_A_TASK = 2**20
#: What reading a file is expected to cost [s a byte].
SECONDS_A_BYTE = 1e-7


class Inventory:
    """The files of a request on their way into the index."""

    def __init__(self, request: Request, index: Index, parts: StudyParts | None) -> None:
        self.request, self.index, self.parts = request, index, parts
        self._missing = set(range(len(request.found)))

    def file(self, position: int) -> NamedFile:
        """The file at a position where no refusal stands."""
        one = self.request.found[position]
        assert not isinstance(one, Refusal)  # noqa: S101  (refusals are put down first)
        path, sheet = str(one[0]), one[1]
        reading: ReadOptions = self.request.reading
        options = reading if sheet is None else replace(reading, sheet=sheet)
        return NamedFile(position, path, options, None if self.parts is None else self.parts.of_file(path))

    def put_down(self, file: NamedFile, found: Iterable[RecordingRow]) -> None:
        """Say what a file holds."""
        rows = [decided_row(row, file.study) for row in found]
        self._put_down(file.position, _key(file), rows)
        for row in rows:
            if row.refusal is None:
                self.request.read(row.path, row.sheet)

    def _put_down(self, position: int, key: tuple[str, str], rows: Sequence[RecordingRow]) -> None:
        self.index.add_file(position, *key, rows)
        self._missing.discard(position)

    def put_down_refusals(self) -> None:
        """Put down what was refused before any file was opened."""
        with self.index.batch():
            for position, one in enumerate(self.request.found):
                if isinstance(one, Refusal):
                    key = one.path, f"refused before it was read, {position}"
                    study = None if self.parts is None else self.parts.of_file(one.path)
                    self._put_down(position, key, [decided_row(refused_row(one), study)])

    def complete(self, workplace: Workplace, recent: RecentTrials, progress: Progress) -> None:
        """Look into every file that was not looked into yet."""
        waiting = deque(sorted(self._missing))
        if not waiting:
            return
        first, done = list(waiting)[:FEW_FILES], 0
        size = sum(map(self._bytes, first)) / len(first)
        expected = SECONDS_A_BYTE * size * len(waiting)
        files = files_a_task(len(waiting), size)
        crew = workplace.workforce(
            -(-len(waiting) // files),
            expected,
            lambda _what, payload: survey_files(payload, recent),
            asked=False,
        )
        tasks, alone = {}, deque[int]()

        def chunks() -> Iterator[Task]:
            while waiting or alone:
                if alone:
                    chunk = [alone.popleft()]
                else:
                    chunk = [waiting.popleft() for _ in range(min(files, len(waiting)))]
                tasks[chunk[0]] = chunk
                yield Task(chunk[0], SURVEY, packed([self._known(position) for position in chunk]))

        total = len(waiting)
        while waiting or alone:
            for outcome in crew.run(chunks(), lambda *_: None):
                chunk = tasks.pop(outcome.number)
                if outcome.result is None and len(chunk) > 1:
                    # one of them is at fault: each is looked into by itself
                    alone.extend(chunk)
                    continue
                done += len(chunk)
                progress(f"reading recording {done + 1}", done, total)
                with self.index.batch():
                    self._take(chunk, outcome.result, outcome.fault)

    def _take(self, chunk: Sequence[int], result: bytes | None, fault: Fault | None) -> None:
        if result is None:
            assert fault is not None  # noqa: S101  (a task has either)
            file = self.file(chunk[0])
            refusal = Refusal(file.path, None, fault.code, f"it can't be read: {fault.message}")
            self.put_down(file, [refused_row(refusal)])
            return
        for position, found in unpacked(result):
            file = self.file(position)
            # of a file that was known, as an earlier run put it down
            self.put_down(file, self.index.known_file(*_key(file)) if found is None else found)

    def _known(self, position: int) -> NamedFile:
        file = self.file(position)
        rows = self.index.known_file(*_key(file))
        return replace(file, known=next((row.sha256 for row in rows if row.sha256), None))

    def _bytes(self, position: int) -> int:
        try:
            return Path(self.file(position).path).stat().st_size
        except OSError:
            return 0


def files_a_task(files: int, size: float) -> int:
    """Files a task looks into, of so many of that size [bytes]; a task costs a cluster some 12 ms."""
    if size <= 0.0:
        return FEW_FILES
    return max(FEW_FILES, min(MANY_FILES, files // TASKS, int(BYTES_A_TASK / size)))


def _key(file: NamedFile) -> tuple[str, str]:
    """Path and way of reading by which the index knows a file."""
    # a path that is not UTF-8 names a file that is refused; a database can't hold it
    path = file.path.encode("utf-8", "backslashreplace").decode("utf-8")
    return path, reading_key(file.options, file.study)
