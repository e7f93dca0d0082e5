"""A cohort: files to specimens, specimens to files of their own, those to the set that is public.

Results are put down as they come, so that a run that ended early is gone on with by the same command; who
computed them, and how many at a time, changes nothing.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import platform
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from tissueid.collection import (
    Collected,
    Progress,
    RecentTrials,
    display_names,
    exclusion_rows,
    study_document,
    unmatched_sheets,
    without_excluded,
)
from tissueid.documents import plain
from tissueid.documents.identification import Exit
from tissueid.documents.identification import Identification as Document
from tissueid.errors import BundleError, InputError
from tissueid.manifest import Study
from tissueid.model.grammar import KELVIN_VOIGT, candidates
from tissueid.pipeline import IdentifyOptions, exit_of, identify, refuse_unused, run_provenance
from tissueid.result import Identification, Refusal
from tissueid.store.files import IDENTIFICATION, JsonList, replacing, sha256_of, write_file, write_json
from tissueid.store.index import Index, JobRow
from tissueid.store.merged import (
    LISTED,
    SPECIMENS,
    ListedSpecimen,
    list_specimens,
    load_record,
    merge_files,
    specimen_bytes,
)
from tissueid.store.outputs import OutputSet
from tissueid.store.schema import check
from tissueid.study.inventory import (
    LOCAL,
    Inventory,
    Request,
    Workplace,
    decided_row,
    expected_seconds,
    found_in,
)
from tissueid.study.one_order import LawOrder, agreed, scores_of
from tissueid.study.pages import FIT_WITH_PAGE, PAGES, begin_pages, page_path, with_page, write_pages
from tissueid.study.recordings import StudyParts, read_decided, read_decided_one
from tissueid.study.specimen_job import FIT, SpecimenJob, chain_file, fit_here, result_of
from tissueid.study.tasks import Fault, Outcome, Task, packed, perform, unpacked
from tissueid.trial import Source, Trial

#: Specimens from which on a set has no merged files and its report has pages.
LARGE = 200


@dataclass(slots=True)
class Assembled:
    """Results of a run, in few words."""

    document: Path  # identification.json, in the folder of the run
    #: Specimens looked at, and specimens with a model.
    jobs: int = 0
    fitted: int = 0
    refused: list[Refusal] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)  # what was asked for and is not identified
    exclusions: list[Mapping[str, Any]] = field(default_factory=list)
    #: Trials that the study does not name, of all.
    beside: int = 0
    trials: int = 0
    exit: Exit = field(default_factory=lambda: Exit(0, ()))

    @property
    def large(self) -> bool:
        """True where the set has no merged files."""
        return self.jobs > LARGE


def specimen_path(out: Path, key: str) -> Path:
    """The file of a key."""
    return out / SPECIMENS / f"{key}.h5"


class _Assembly:
    """The lists of a document, written down as they grow, and what is remembered of it in few words."""

    def __init__(self, run: OutputSet, index: Index, stack: ExitStack) -> None:
        def new(level: int) -> JsonList:
            return stack.enter_context(JsonList(level))

        self.out, self.index = run.out, index
        self.found = Assembled(run.path(IDENTIFICATION), jobs=index.count("done") + index.count("failed"))
        self.specimens, self.refused, self.cycles = new(2), new(2), new(2)
        self.trials, self.exclusions, self.inputs = new(3), new(3), new(3)
        self.names: list[str] = []
        #: File and inputs of every fitted specimen of a set that is not large.
        self.files: dict[str, Path] = {}
        self.inputs_of: dict[str, Any] = {}

    def refuse(self, refusal: Refusal) -> None:
        """Add one refusal."""
        self.found.refused.append(refusal)
        self.refused.add(refusal.as_json())

    def gather(self) -> Iterator[ListedSpecimen]:
        """Every result in its order into the lists; of a large cohort nothing else is remembered."""
        found = self.found
        for job in self.index.jobs("done"):
            path = specimen_path(self.out, job.key)
            record = load_record(path)
            fitted = record.fitted
            if fitted is not None:
                found.fitted += 1
                self.specimens.add(fitted)
                self.names.append(job.specimen)
                if not found.large:
                    self.files[job.specimen], self.inputs_of[job.specimen] = path, record.inputs
            for rows, target in (
                (record.unfitted_cycles, self.cycles),
                (record.inputs, self.inputs),
                (record.trials, self.trials),
                (record.exclusions, self.exclusions),
            ):
                for row in rows:
                    target.add(row)
            for row in record.refused:
                self.refuse(Refusal(row["path"], row["sheet"], **row["error"]))
            found.exclusions += record.exclusions
            found.reasons += record.reasons
            found.trials += len(record.trials)
            found.beside += sum(not row["listed"] for row in record.trials)
            digest, size = self.index.result(job.key) or ("", 0)
            yield ListedSpecimen(job.specimen, path.name, fitted is not None, digest, size)


def assemble(run: OutputSet, index: Index, request: Request) -> Assembled:
    """Write the document, and the merged files of a set that is not large, into an open output set.

    Raises BundleError: a specimen's file is damaged, or the document breaks its schema.
    """
    study = request.study
    with ExitStack() as stack:
        parts = _Assembly(run, index, stack)
        found = parts.found
        kept, taken_out = _refusals_of_readers(index, study)
        for refusal in kept:
            parts.refuse(refusal)
        with replacing(run.path(LISTED)) as listed, listed.open("w", encoding="utf-8", newline="") as stream:
            list_specimens(parts.gather(), stream)
        if study is None or not study.trials:
            # a study that names no trial leaves none aside
            found.beside = 0
        for job in index.jobs("failed"):
            parts.refuse(Refusal(**json.loads(job.reason or "{}")))
        if study is not None and any(entry.sheet is not None for entry in study.entries):
            decisions: Any = dict.fromkeys(index.named())
            for refusal in unmatched_sheets(study, Collected(decisions=decisions), ()):
                parts.refuse(refusal)
        for row in taken_out:
            parts.exclusions.add(row)
            found.exclusions.append(row)
        refused = [str(one) for one in found.refused]
        found.exit = exit_of(found.fitted, refused, found.reasons, len(found.exclusions))
        record = None if study is None else study_document(study, parts.names, parts.trials, parts.exclusions)
        document = {
            "schema": "tissueid/identification/1",
            "specimens": parts.specimens,
            "refused": parts.refused,
            "unfitted_cycles": parts.cycles,
            "study": record,
            "provenance": run_provenance(request.options, parts.inputs, record, request.provenance),
            "exit": plain(found.exit),
        }
        _check_frame(document)
        with replacing(found.document) as whole, whole.open("wb") as file:
            write_json(file, document)
    if parts.files:
        provenance = run_provenance(request.options, [], record, request.provenance)
        merge_files(run, parts.files, parts.inputs_of, provenance)
    return found


def _refusals_of_readers(index: Index, study: Study | None) -> tuple[list[Refusal], list[Mapping[str, Any]]]:
    """Refusals of what could not be read, and rows for those of them that the user had taken out anyway."""
    refused = [row.refusal for row in index.refused() if row.refusal is not None]
    collected = Collected()
    kept = without_excluded(refused, collected, study)

    def never(*_: Any) -> Any:
        raise AssertionError

    return kept, [plain(row) for row in exclusion_rows(collected, {}, (), IdentifyOptions().fit, never)]


def _check_frame(document: Mapping[str, Any]) -> None:
    """The document without its lists, whose elements were checked where they were made."""

    def bare(value: Any) -> Any:
        if isinstance(value, JsonList):
            return []
        if isinstance(value, Mapping):
            return {key: bare(child) for key, child in value.items()}
        return plain(value)

    check(bare(document), Document, where=IDENTIFICATION)


class _SeveralSpecimensError(Exception):
    """The recordings are of more than one specimen."""


#: What a page is expected to cost [s].
SECONDS_A_PAGE = 0.05
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})


def fit_cohort(request: Request, run: OutputSet, progress: Progress) -> Assembled:
    """Fit every specimen among some files and put the public set together, without committing it.

    Raises BundleError: the output can't be written, a full disk included; what is finished is kept.
    UsageError: the study states a prior of a parameter that the law does not have.
    """
    refuse_unused(request.options.fit.model, request.study)
    with Index(run.out) as index:
        index.begin_run(time.time(), {"pid": os.getpid(), "host": platform.node()}, len(request.found))
        state, reason = "failed", None
        try:
            found = _Cohort(request, run, index, progress).fit()
            state = "finished"
        except OSError as error:
            reason = _lost_output(run.out, index, error)
            raise BundleError(reason) from error
        except KeyboardInterrupt:
            state = "interrupted"
            raise
        finally:
            # where the disk is full the run stays "running" in the index, and its process is gone
            with contextlib.suppress(OSError):
                index.end_run(time.time(), state, reason)
        return found


def prune_specimens(out: Path) -> None:
    """Remove files and pages of specimens that the committed set does not name; call it after the commit."""
    with Index(out) as index:
        used = index.forget_unused()
    for path in (*(out / SPECIMENS).glob("*.h5"), *(out / PAGES).glob("*.html")):
        if path.stem not in used:
            path.unlink(missing_ok=True)


def _lost_output(out: Path, index: Index, error: OSError) -> str:
    """Error of a run that could not write a file."""
    done = index.count("done")
    kept = f"{done} finished specimen{'s' * (done != 1)} are kept" if done else "nothing was finished"
    way_out = "free space and run" if error.errno in _FULL else "run"
    return f"{error.filename or out}: {error.strerror or error}; {kept}: {way_out} the same command again"


class _Cohort:
    """One run over some files."""

    def __init__(self, request: Request, run: OutputSet, index: Index, progress: Progress) -> None:
        self.request, self.run, self.index, self.progress = request, run, index, progress
        self.parts = None if request.study is None else StudyParts(request.study)
        self.recent = RecentTrials()
        self.specimens: list[tuple[str, str, str | None]] = []
        self.names: dict[str, str] = {}
        self.chains: Path | None = None
        #: Order of the study, where that of the specimen at a position would be another.
        self.orders: dict[int, LawOrder] = {}

    def fit(self) -> Assembled:
        """Survey, jobs, assembly."""
        (self.run.out / SPECIMENS).mkdir(exist_ok=True)
        inventory = Inventory(self.request, self.index, self.parts)
        new = not self.index.knows_files()
        inventory.put_down_refusals()
        with Workplace(self.request.workers, self.request.scheduler) as workplace:
            if self.request.scheduler == LOCAL:
                # workers see the folders of this process
                self.chains = self.run.sampling()
            at_once = self._while_read(inventory) if new and self.chains is not None else None
            if at_once is None:
                inventory.complete(workplace, self.recent, self.progress)
                self.request.all_read()
            self._plan()
            if at_once is not None:
                for job in self.index.jobs("waiting"):
                    result = result_of(at_once, shown=job.specimen, options=self.request.options)
                    self._keep(job, specimen_bytes(result), 0.0)
            if self.large:
                begin_pages(self.run.out)
            self._compute(workplace)
            if self._agree():
                self._compute(workplace)
                for job in self.index.jobs("failed"):
                    if job.position in self.orders:
                        # its own order, where that of the study could not be fitted
                        self.index.restore(job.position, self._spare(job.position))
            if self.large:
                self._make_pages(workplace)
        self.progress("putting the results together", 0, 0)
        return assemble(self.run, self.index, self.request)

    @property
    def large(self) -> bool:
        """True where the report has a page a specimen."""
        return len(self.specimens) > LARGE

    def _while_read(self, inventory: Inventory) -> Identification | None:
        """Read every file and fit its one specimen; ``None`` where there are several."""
        request, chains = self.request, self.chains
        names: dict[str, str] = {}
        try:
            return identify(
                self._trials(inventory, names),
                study=request.study,
                options=request.options,
                reload=lambda one: read_decided_one(one.path, one.sheet, request.reading, request.study),
                provenance=request.provenance,
                progress=self.progress,
                checkpoint=None if chains is None else lambda name: chain_file(chains, name),
                names=names,
            )
        except _SeveralSpecimensError:
            return None

    def _trials(self, inventory: Inventory, names: dict[str, str]) -> Iterator[Trial]:
        """Trials of one specimen as they are read; its name as shown goes into ``names``."""
        for position, one in enumerate(self.request.found):
            if isinstance(one, Refusal):
                continue
            file = inventory.file(position)
            found = []
            for item in read_decided(Path(file.path), file.options, file.study):
                found.append(found_in(file.path, item))
                if isinstance(item, InputError):
                    continue
                self.recent.keep((item.source.path, item.source.sheet), item)
                row = decided_row(found[-1], file.study)
                if row.kind in {"trial", "excluded"} and row.specimen not in names:
                    if names:
                        raise _SeveralSpecimensError
                    names.update(display_names([(row.specimen, Source(path=row.path, sheet=row.sheet))]))
                yield item
            inventory.put_down(file, found)
        self.request.all_read()
        self.recent = RecentTrials()

    def _job(self, position: int) -> SpecimenJob:
        """The job of the specimen at a position, made anew whenever it is needed."""
        specimen = self.specimens[position][0]
        shown = self.names[specimen]
        recordings = tuple((row.path, row.sheet, row.sha256) for row in self.index.recordings_of(specimen))
        study = None
        if self.parts is not None:
            study = self.parts.of_specimen(shown, [(path, sheet) for path, sheet, _ in recordings])
        options, order = self.request.options, self.orders.get(position)
        if order is not None:
            options = replace(options, fit=order.taken_by(options.fit))
        return SpecimenJob(
            specimen=specimen,
            shown=shown,
            recordings=recordings,
            study=study,
            reading=self.request.reading,
            options=options,
            provenance=self.request.provenance,
            chains=None if self.chains is None else str(self.chains),
            order=None if order is None else str(order),
        )

    def _agree(self) -> bool:
        """Give specimens of a study one law and order; true where one of them has to be fitted again."""
        if self.request.study is None or not self.request.one_order:
            return False
        own: dict[int, LawOrder] = {}
        tables, laws = [], candidates(self.request.options.fit.model or KELVIN_VOIGT).choose
        for job in self.index.jobs("done"):
            fitted = load_record(specimen_path(self.run.out, job.key)).fitted
            if fitted is not None and fitted["selection"]:
                own[job.position] = LawOrder.of_fit(fitted)
                tables.append(scores_of(fitted, laws=laws))
        order = agreed(tables) if len(tables) > 1 else None
        self.orders = {k: order for k, one in own.items() if order is not None and one != order}
        for position in self.orders:
            self.index.replan(self._row(position), self._spare(position))
        return bool(self.orders)

    def _spare(self, position: int) -> int:
        """Place of the job that a specimen had alone."""
        return len(self.specimens) + position

    def _plan(self) -> None:
        """One job a specimen; those whose result is there, whole, are done."""
        self.specimens = self.index.specimens()
        sources = [(name, Source(path=path, sheet=sheet)) for name, path, sheet in self.specimens]
        self.names = display_names(sources)
        with self.index.batch():
            for position in range(len(self.specimens)):
                self.index.plan(self._row(position))

    def _row(self, position: int) -> JobRow:
        """The job of a specimen as the index has it: done where its result is there, whole."""
        key = self._job(position).key()
        digest, size = self.index.result(key) or ("", -1)
        path = specimen_path(self.run.out, key)
        whole = path.is_file() and path.stat().st_size == size and sha256_of(path) == digest
        name = self.names[self.specimens[position][0]]
        return JobRow(position, key, name, "done" if whole else "waiting", None)

    def _keep(self, job: JobRow, content: bytes, seconds: float) -> None:
        write_file(specimen_path(self.run.out, job.key), content)
        self.index.finish(job, hashlib.sha256(content).hexdigest(), len(content), seconds)

    def _compute(self, workplace: Workplace) -> None:
        total = len(self.specimens)
        waiting = {job.position: job for job in self.index.jobs("waiting")}
        if not waiting:
            return
        samples = self.index.samples()
        seconds = expected_seconds(samples * len(waiting) // total, len(waiting), self.request.options)
        done = total - len(waiting)

        def here(_what: str, payload: bytes) -> bytes:
            result = fit_here(
                unpacked(payload),
                recent=self.recent,
                progress=lambda message, _done, _total: self.progress(message, done, total),
            )
            content = specimen_bytes(result)
            return with_page(content) if self.large else content

        what = FIT_WITH_PAGE if self.large else FIT
        running: dict[int, str] = {}

        def started(number: int, worker: str) -> None:
            self.index.start(number, worker, time.time())
            running[number] = waiting[number].specimen
            self.progress(", ".join(running.values()), done, total)

        def tasks() -> Iterator[Task]:
            for position in waiting:
                yield Task(position, what, packed(self._job(position)))

        crew = workplace.workforce(len(waiting), seconds, here, asked=True)
        for outcome in crew.run(tasks(), started):
            running.pop(outcome.number, None)
            done += 1
            self._take(waiting[outcome.number], outcome)
            self.progress(", ".join(running.values()), done, total)

    def _make_pages(self, workplace: Workplace) -> None:
        """A page for every specimen that has none yet: those fitted when the cohort was not yet large."""
        out, total = self.run.out, self.index.count("done")
        files = (specimen_path(out, job.key) for job in self.index.jobs("done"))
        crew = workplace.workforce(total, SECONDS_A_PAGE * total, perform, asked=True)
        for made in write_pages(out, files, crew):
            self.progress("pages of the report", made, total)

    def _take(self, job: JobRow, outcome: Outcome) -> None:
        if outcome.result is not None:
            content, page = unpacked(outcome.result) if self.large else (outcome.result, None)
            self._keep(job, content, outcome.seconds)
            if page is not None:
                write_file(page_path(self.run.out, f"{job.key}.h5"), page)
            return
        fault = outcome.fault or Fault("job_failed", "no reason is known")
        _, path, sheet = self.specimens[job.position]
        message = f"specimen {job.specimen!r} could not be fitted: {fault.message}"
        self.index.fail(job.position, json.dumps(asdict(Refusal(path, sheet, fault.code, message))))
