"""Every file of a request looked into: what it holds is put down in the index, in the order of files."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from tissueid.ingest import ReadOptions
from tissueid.manifest import Study
from tissueid.result import Refusal
from tissueid.store.index import Index
from tissueid.study.partition import StudyParts
from tissueid.study.request import Progress, Request, Workplace
from tissueid.study.specimen_job import RecentTrials
from tissueid.study.survey import (
    SURVEY,
    Found,
    NamedFile,
    found_again,
    look_into,
    reading_key,
    recording_rows,
)
from tissueid.study.tasks import Fault, Task, packed, unpacked

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

    def file(self, position: int) -> NamedFile | None:
        """The file at a position; ``None`` where a refusal stands there."""
        one = self.request.found[position]
        if isinstance(one, Refusal):
            return None
        path, sheet = str(one[0]), one[1]
        options: ReadOptions = self.request.reading
        if sheet is not None:
            options = replace(options, sheet=sheet)
        study: Study | None = None if self.parts is None else self.parts.of_file(path)
        return NamedFile(position, path, options, study)

    def put_down(self, position: int, found: Sequence[Found]) -> None:
        """Say what the file at a position holds."""
        file = self.file(position)
        if file is None:
            refusal = self.request.found[position]
            assert isinstance(refusal, Refusal)  # noqa: S101  (file() says so)
            path, key = refusal.path, f"refused before it was read, {position}"
        else:
            path, key = _stored(file.path), reading_key(file.options, file.study)
        rows = list(recording_rows(path, found, self.parts))
        self.index.add_file(position, path, key, rows)
        self._missing.discard(position)
        for row in rows:
            if row.refusal is None:
                self.request.read(row.path, row.sheet)

    def put_down_refusals(self) -> None:
        """Put down what was refused before any file was opened."""
        with self.index.batch():
            for position, one in enumerate(self.request.found):
                if isinstance(one, Refusal):
                    self.put_down(position, [Found(one.sheet, "", "", 0, one)])

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
            lambda _what, payload: packed(
                [(one.position, look_into(one, recent.keep)) for one in unpacked(payload)]
            ),
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
            assert file is not None  # noqa: S101  (refusals are never looked into)
            refusal = Refusal(file.path, None, fault.code, f"it can't be read: {fault.message}")
            self.put_down(chunk[0], [Found(None, "", "", 0, refusal)])
            return
        for position, found in unpacked(result):
            if found is None:
                file = self.file(position)
                assert file is not None  # noqa: S101  (only files are looked into)
                found = found_again(
                    self.index.known_file(_stored(file.path), reading_key(file.options, file.study))
                )
            self.put_down(position, found)

    def _known(self, position: int) -> NamedFile:
        file = self.file(position)
        assert file is not None  # noqa: S101  (refusals are put down first)
        rows = self.index.known_file(_stored(file.path), reading_key(file.options, file.study))
        return replace(file, known=next((row.sha256 for row in rows if row.sha256), None))

    def _bytes(self, position: int) -> int:
        file = self.file(position)
        try:
            return 0 if file is None else Path(file.path).stat().st_size
        except OSError:
            return 0


def files_a_task(files: int, size: float) -> int:
    """Files a task looks into, of so many of that size [bytes].

    A task costs some 12 ms of handing out on a cluster, and a scheduler keeps its name; a short recording
    takes less to look into.
    """
    if size <= 0.0:
        return FEW_FILES
    return max(FEW_FILES, min(MANY_FILES, files // TASKS, int(BYTES_A_TASK / size)))


def _stored(path: str) -> str:
    """A path as a database can hold it; one that is not UTF-8 names a file that is refused."""
    return path.encode("utf-8", "backslashreplace").decode("utf-8")
