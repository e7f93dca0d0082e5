"""The job of a cohort: one specimen from its recordings to the bytes of its file.

Its key is a hash of all that may change the result, so that what is there already is not computed again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Any

from tissueid.collection import RecentTrials
from tissueid.documents import plain
from tissueid.documents.identification import Identification as Document
from tissueid.errors import InputError
from tissueid.flags import Flag
from tissueid.ingest import ReadOptions
from tissueid.manifest import Study
from tissueid.pipeline import IdentifyOptions, identify, unmet
from tissueid.result import Identification, Refusal
from tissueid.store.bundle import bundle_from_fit
from tissueid.store.curves import curves_of_fits
from tissueid.store.files import json_bytes
from tissueid.store.merged import SPECIMEN_SCHEMA_VERSION, SpecimenRecord, SpecimenResult, specimen_bytes
from tissueid.store.posteriors import posteriors_of_fits
from tissueid.store.schema import check
from tissueid.study.recordings import facts_of, read_decided, read_decided_one
from tissueid.study.tasks import unpacked, versions
from tissueid.trial import Trial

#: The task of this module.
FIT = "tissueid.study.specimen_job:fit_specimen_job"
#: What the readers would say of a sheet that another job reads.
_NOT_OURS = "study_unmatched"
#: What a specimen's file holds; another number makes files of older versions be computed anew.
CONTENT = 2
#: What stands in a provenance and is more than one specimen's.
_OF_THE_RUN = ("inputs", "study")


@dataclass(frozen=True, slots=True)
class SpecimenJob:
    """One specimen."""

    #: As its recordings name it, and its name among all others of the run.
    specimen: str
    shown: str
    recordings: tuple[tuple[str, str | None, str], ...]  # in the order of files, excluded ones among them
    study: Study | None  # what the study says of this specimen
    reading: ReadOptions
    options: IdentifyOptions
    provenance: Mapping[str, Any] = field(default_factory=dict)  # added to the provenance of its bundle
    chains: str | None = None  # folder for chains that are being sampled; ``None`` where none is shared
    order: str | None = None  # words of the study's order, where the specimen alone would take another

    def key(self) -> str:
        """SHA-256 of everything that may change the result."""
        document = {
            "schema": SPECIMEN_SCHEMA_VERSION,
            "content": CONTENT,
            "specimen": self.shown,
            "recordings": [list(one) for one in self.recordings],
            "study": None if self.study is None else facts_of(self.study),
            "reading": repr(self.reading),
            "options": repr(self.options),
            "provenance": dict(self.provenance),
            "versions": versions(),
        }
        if self.order is not None:
            # the same order that is asked for by name says nothing of a study
            document["order"] = self.order
        return hashlib.sha256(json_bytes(document)).hexdigest()


def chain_file(folder: str | Path, specimen: str) -> Path:
    """Place of a specimen's chain while it is sampled."""
    return Path(folder) / f"{hashlib.sha256(specimen.encode()).hexdigest()[:16]}.npz"


def _own_trials(job: SpecimenJob, recent: RecentTrials | None) -> Iterator[Trial | InputError]:
    """The recordings of the job in its order, each file opened once."""
    for path, group in groupby(job.recordings, key=lambda one: one[0]):
        wanted = {sheet: digest for _, sheet, digest in group}
        there = [] if recent is None else [recent.take((path, sheet)) for sheet in wanted]
        items: Iterable[Trial | InputError] = [one for one in there if one is not None]
        if not there or None in there:
            items = read_decided(Path(path), job.reading, job.study)
        for item in items:
            sheet = item.sheet if isinstance(item, InputError) else item.source.sheet
            if isinstance(item, InputError) and (sheet is None or sheet in wanted):
                yield item
            elif isinstance(item, Trial) and sheet in wanted:
                if item.source.sha256 != wanted.pop(sheet):
                    message = "the file changed since its specimen was looked up; run again when it is whole"
                    raise InputError(code="unreadable_file", message=message, path=path, sheet=sheet)
                yield item
            if not wanted:
                break


def fit_here(
    job: SpecimenJob,
    *,
    recent: RecentTrials | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> SpecimenResult:
    """Fit the specimen of a job in this process; InputError where a file is not the one that was known."""
    refused: list[Refusal] = []

    def trials() -> Iterator[Trial]:
        for item in _own_trials(job, recent):
            if isinstance(item, InputError):
                refused.append(Refusal.of(item))
            else:
                yield item

    folder = job.chains
    identification = identify(
        trials(),
        study=job.study,
        options=job.options,
        reload=lambda source: read_decided_one(source.path, source.sheet, job.reading, job.study),
        refused=refused,
        provenance=job.provenance,
        progress=progress,
        checkpoint=None if folder is None else lambda name: chain_file(folder, name),
        names={job.specimen: job.shown},
    )
    if job.order is not None:
        said = Flag(
            "study_order", f"fitted with the order of its study, {job.order}; alone it takes another", {}
        )
        fits = tuple(replace(one, flags=(*one.flags, said)) for one in identification.specimens)
        identification = replace(identification, specimens=fits)
    return result_of(identification, shown=job.shown, options=job.options)


def result_of(identification: Identification, *, shown: str, options: IdentifyOptions) -> SpecimenResult:
    """Stored part of an identification of one specimen; BundleError where it breaks its schema."""
    document = plain(identification.as_json())
    check(document, Document, where=shown)
    study = document["study"]
    fits = identification.specimens
    provenance = document["provenance"]
    record = SpecimenRecord(
        specimen=shown,
        fitted=document["specimens"][0] if fits else None,
        refused=[one.as_json() for one in identification.refused if one.code != _NOT_OURS],
        unfitted_cycles=document["unfitted_cycles"],
        inputs=provenance["inputs"],
        provenance={key: value for key, value in provenance.items() if key not in _OF_THE_RUN},
        reasons=unmet(fits, options.required),
        trials=[] if study is None else study["trials"],
        exclusions=plain(identification.exclusions),
    )
    if not fits:
        return SpecimenResult(record)
    posteriors = posteriors_of_fits(fits)
    return SpecimenResult(
        record,
        bundle=bundle_from_fit(fits[0], provenance=identification.provenance),
        curves=curves_of_fits(fits),
        posterior=posteriors[0] if posteriors else None,
    )


def fit_specimen_job(payload: bytes) -> bytes:
    """The task: a packed :class:`SpecimenJob` in, the bytes of its file out."""
    return specimen_bytes(fit_here(unpacked(payload)))
