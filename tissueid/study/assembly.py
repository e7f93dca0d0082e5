"""The public set of a run, put together from the files of its specimens in their order.

Up to :data:`LARGE` specimens the set is one document, one report and merged files.  A larger cohort has
the document, a report that is an index with a page a specimen, and leaves curves, draws and bundles
where they are, in ``specimens/``; memory does not grow with it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tissueid.collection import Collected
from tissueid.covariates import (
    Refit,
    exclusion_rows,
    study_document,
    unmatched_sheets,
    without_excluded,
)
from tissueid.manifest import Study
from tissueid.pipeline import IdentifyOptions, exit_of, run_provenance
from tissueid.result import Exit, Refusal
from tissueid.store.files import (
    IDENTIFICATION,
    TEMPORARY_PREFIX,
    JsonList,
    plain_json,
    replace_file,
    write_json,
)
from tissueid.store.index import Index, JobRow
from tissueid.store.merged import LISTED, SPECIMENS, ListedSpecimen, list_specimens, load_record, merge_files
from tissueid.store.outputs import OutputSet
from tissueid.store.schema import check

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
    exit: Exit = field(default_factory=lambda: Exit(0))

    @property
    def large(self) -> bool:
        """True where the set has no merged files."""
        return self.jobs > LARGE


def specimen_path(out: Path, key: str) -> Path:
    """The file of a key."""
    return out / SPECIMENS / f"{key}.h5"


class _Lists:
    """The lists of the document, each written down as it grows."""

    def __init__(self, stack: ExitStack) -> None:
        def new(level: int) -> JsonList:
            return stack.enter_context(JsonList(level))

        self.specimens, self.refused, self.cycles = new(2), new(2), new(2)
        self.trials, self.exclusions, self.inputs = new(3), new(3), new(3)


def assemble(
    run: OutputSet,
    index: Index,
    *,
    study: Study | None,
    options: IdentifyOptions,
    provenance: Mapping[str, Any],
) -> Assembled:
    """Write the document, and the merged files of a set that is not large, into an output set.

    ``run``: open, not yet committed; ``index``: all of whose jobs are done or failed; ``provenance``: added
    to what is recorded anyway.  Raises BundleError: a specimen's file is damaged, or the document breaks its
    schema.
    """
    found = Assembled(run.path(IDENTIFICATION), jobs=index.count("done") + index.count("failed"))
    files: dict[str, Path] = {}
    inputs: dict[str, Any] = {}
    names: list[str] = []
    with ExitStack() as stack:
        lists = _Lists(stack)
        kept, taken_out = _refusals_of_readers(index, study)
        for refusal in kept:
            _refuse(found, lists, refusal)
        temporary = run.path(LISTED).with_name(TEMPORARY_PREFIX + LISTED)
        with temporary.open("w", encoding="utf-8", newline="") as stream:
            list_specimens(_gather(run.out, index, found, lists, files, inputs, names), stream)
        replace_file(temporary, run.path(LISTED))
        for job in index.jobs("failed"):
            _refuse(found, lists, Refusal(**json.loads(job.reason or "{}")))
        for refusal in _unmatched(index, study):
            _refuse(found, lists, refusal)
        for row in taken_out:
            lists.exclusions.add(row)
            found.exclusions.append(row)
        found.exit = exit_of(found.fitted, [str(one) for one in found.refused], found.reasons)
        record = None if study is None else study_document(study, names, lists.trials, lists.exclusions)
        document = {
            "schema": "tissueid/identification/1",
            "specimens": lists.specimens,
            "refused": lists.refused,
            "unfitted_cycles": lists.cycles,
            "study": record,
            "provenance": run_provenance(options, lists.inputs, record, provenance),
            "exit": found.exit.as_json(),
        }
        _check_frame(document)
        temporary = found.document.with_name(TEMPORARY_PREFIX + IDENTIFICATION)
        with temporary.open("wb") as file:
            write_json(file, document)
        replace_file(temporary, found.document)
    if files and not found.large:
        merge_files(run, files, inputs, run_provenance(options, [], record, provenance))
    return found


def _refuse(found: Assembled, lists: _Lists, refusal: Refusal) -> None:
    found.refused.append(refusal)
    lists.refused.add(refusal.as_json())


def _gather(
    out: Path,
    index: Index,
    found: Assembled,
    lists: _Lists,
    files: dict[str, Path],
    inputs: dict[str, Any],
    names: list[str],
) -> Iterator[ListedSpecimen]:
    """Every result in its order into the lists; of a large cohort nothing else is remembered."""
    for job in index.jobs("done"):
        path = specimen_path(out, job.key)
        record = load_record(path)
        fitted = record["fitted"]
        if fitted is not None:
            found.fitted += 1
            lists.specimens.add(fitted)
            names.append(job.specimen)
            if not found.large:
                files[job.specimen], inputs[job.specimen] = path, record["inputs"]
        for name, target in (
            ("unfitted_cycles", lists.cycles),
            ("inputs", lists.inputs),
            ("trials", lists.trials),
            ("exclusions", lists.exclusions),
        ):
            for row in record[name]:
                target.add(row)
        for row in record["refused"]:
            _refuse(found, lists, Refusal(row["path"], row["sheet"], **row["error"]))
        found.exclusions += record["exclusions"]
        found.reasons += record["reasons"]
        found.trials += len(record["trials"])
        found.beside += sum(not row["listed"] for row in record["trials"])
        yield _listed(index, job, path, fitted=fitted is not None)


def _listed(index: Index, job: JobRow, path: Path, *, fitted: bool) -> ListedSpecimen:
    digest, size = index.result(job.key) or ("", 0)
    return ListedSpecimen(job.specimen, path.name, fitted, digest, size)


def _refusals_of_readers(index: Index, study: Study | None) -> tuple[list[Refusal], list[Mapping[str, Any]]]:
    """Refusals of what could not be read, and rows for those of them that the user had taken out anyway."""
    refused = [Refusal(**row.refusal) for row in index.refused() if row.refusal is not None]
    collected = Collected()
    kept = without_excluded(refused, collected, study)

    def never(*_: Any) -> Any:
        raise AssertionError

    rows = exclusion_rows(collected, {}, (), IdentifyOptions().fit, Refit(never))
    return kept, [plain_json(row) for row in rows]


def _unmatched(index: Index, study: Study | None) -> list[Refusal]:
    if study is None or all(entry.sheet is None for entry in study.entries):
        return []
    decisions: Any = dict.fromkeys(index.named())
    return unmatched_sheets(study, Collected(decisions=decisions), ())


def _check_frame(document: Mapping[str, Any]) -> None:
    """The document without its lists, whose elements were checked where they were made."""

    def bare(value: Any) -> Any:
        if isinstance(value, JsonList):
            return []
        if isinstance(value, Mapping):
            return {key: bare(child) for key, child in value.items()}
        return plain_json(value)

    check(bare(document), "identification", where=IDENTIFICATION)
