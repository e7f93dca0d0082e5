"""One specimen of a run in one HDF5 file, and the public files of a set put together from these.

``OUT/specimens/<key>.h5`` is named by a hash of what made it.  Its root is a bundle, so that ``tissueid
render`` opens it as it is; what else the run found stands in a group beside it::

    <key>.h5
    |  document, theta, covariance, draws      as in a bundle; none of them where nothing could be fitted
    `-- specimen/
        |  attributes: format = "tissueid/specimen", schema_version = 1
        |-- record       JSON text: its entry of identification.json, refusals, inputs, rows of the study
        |-- curves/      as curves.h5
        `-- posterior/   as posteriors.h5, where one was sampled

It is written and read as bytes, so that whoever computes it needs no folder of the run.  Sets are merged with
one specimen in memory at a time; compressed columns are copied as they are.
"""

from __future__ import annotations

import csv
import io
import json
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import h5py
import numpy as np

from tissueid.documents import plain, typed
from tissueid.errors import BundleError
from tissueid.store.bundle import SPECIMEN_GROUP, Bundle, load_bundle, put_bundle, write_bundle
from tissueid.store.curves import TrialCurve, get_curves, put_curves, write_curves
from tissueid.store.files import CURVES, ONLY_BUNDLE, POSTERIORS, bundle_names, json_bytes
from tissueid.store.hdf5 import HDF5_ERRORS, get_text, new_file, open_file, put_text
from tissueid.store.outputs import OutputSet
from tissueid.store.posteriors import StoredPosterior, get_posteriors, put_posteriors

SPECIMEN_SCHEMA_VERSION = 1
_FORMAT = "tissueid/specimen"


@dataclass(frozen=True, slots=True)
class SpecimenRecord:
    """Entries of identification.json that a specimen brings, as they are written."""

    specimen: str  # name as shown
    fitted: dict[str, Any] | None  # ``None`` where no model was
    refused: list[dict[str, Any]]
    unfitted_cycles: list[dict[str, Any]]
    inputs: list[dict[str, Any]]
    provenance: dict[str, Any]
    reasons: list[str]  # why its exit code is not 0
    #: Rows of the study.
    trials: list[dict[str, Any]]
    exclusions: list[dict[str, Any]]


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenResult:
    """Result of one job."""

    record: SpecimenRecord
    bundle: Bundle | None = None
    curves: tuple[TrialCurve, ...] = ()
    posterior: StoredPosterior | None = None


def specimen_bytes(result: SpecimenResult) -> bytes:
    """The bytes of a specimen's file, equal for equal results; BundleError if its bundle would not load."""
    buffer = io.BytesIO()
    with new_file(buffer) as file:
        if result.bundle is not None:
            put_bundle(file, result.bundle, where=result.bundle.specimen)
        group = file.create_group(SPECIMEN_GROUP)
        group.attrs["format"] = _FORMAT
        group.attrs["schema_version"] = np.int64(SPECIMEN_SCHEMA_VERSION)
        put_text(group, "record", json_bytes(plain(result.record)))
        if result.curves:
            put_curves(group.create_group("curves"), result.curves)
        if result.posterior is not None:
            put_posteriors(group.create_group("posterior"), [result.posterior])
    return buffer.getvalue()


@contextmanager
def _opened(path: Path | IO[bytes]) -> Iterator[Any]:
    """The group of a specimen's file; whatever libhdf5 says of a damaged one becomes a BundleError."""
    anew = "run the same `tissueid fit` again, which computes it anew"
    with open_file(path, "a specimen of a run", anew) as file:
        group = file[SPECIMEN_GROUP]
        version = group.attrs.get("schema_version")
        if group.attrs.get("format") != _FORMAT or version != SPECIMEN_SCHEMA_VERSION:
            raise ValueError(f"format {group.attrs.get('format')!r}, schema version {version}")
        yield group


def load_record(path: Path) -> SpecimenRecord:
    """The JSON of a specimen's file alone; BundleError if it is missing, damaged or another kind of file."""
    with _opened(path) as group:
        return _record(group)


def _record(group: Any) -> SpecimenRecord:
    return typed(json.loads(get_text(group, "record")), SpecimenRecord)


def load_specimen(
    path: Path | IO[bytes],
) -> tuple[SpecimenRecord, tuple[TrialCurve, ...], StoredPosterior | None]:
    """Record, curves and draws of a specimen's file, or of its bytes; BundleError as :func:`load_record`."""
    with _opened(path) as group:
        curves = get_curves(group["curves"]) if "curves" in group else ()
        posteriors = get_posteriors(group["posterior"]) if "posterior" in group else ()
        return _record(group), curves, posteriors[0] if posteriors else None


#: Folder of the files of specimens, in the output folder.
SPECIMENS = "specimens"
#: Which of them belong to the run: part of the set.
LISTED = "specimens.csv"
_COLUMNS = ("specimen", "file", "fitted", "sha256", "bytes")


@dataclass(frozen=True, slots=True)
class ListedSpecimen:
    """One file of ``specimens/`` that belongs to a run."""

    specimen: str
    file: str  # its name in the folder
    fitted: bool  # whether a model was identified in it
    sha256: str
    bytes: int


def list_specimens(rows: Iterable[ListedSpecimen], stream: IO[str]) -> None:
    """Write ``specimens.csv``, a row as it comes."""
    writer = csv.writer(stream)
    writer.writerow(_COLUMNS)
    for row in rows:
        writer.writerow((row.specimen, row.file, "TRUE" if row.fitted else "FALSE", row.sha256, row.bytes))


def read_listed(path: Path) -> Iterator[ListedSpecimen]:
    """Read what :func:`list_specimens` wrote; BundleError where it is damaged or another kind of file."""
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            reader = csv.reader(stream)
            next(reader)
            for specimen, file, fitted, digest, size in reader:
                yield ListedSpecimen(specimen, file, fitted == "TRUE", digest, int(size))
    except (OSError, ValueError, StopIteration) as error:
        msg = f"{path}: cannot be read as a list of specimens ({error}); run `tissueid fit` again"
        raise BundleError(msg) from error


def merge_files(
    run: OutputSet, fitted: Mapping[str, Path], inputs: Mapping[str, Any], provenance: Mapping[str, Any]
) -> None:
    """Write bundles, curves and posteriors of a set from the files of its specimens.

    ``fitted``: specimen -> its file, in the order of the set; ``inputs``: specimen -> rows of its inputs;
    ``provenance``: of the run, without inputs.  Raises BundleError: a file is damaged.
    """
    names = bundle_names(fitted)
    for specimen, path in fitted.items():
        bundle = replace(load_bundle(path), provenance={**provenance, "inputs": inputs[specimen]})
        write_bundle(bundle, run.path(names[specimen]))
        if len(names) == 1:
            shutil.copyfile(run.path(names[specimen]), run.path(ONLY_BUNDLE))
    paths = list(fitted.values())
    try:
        curves: list[TrialCurve] = []
        for path in paths:
            with h5py.File(path, "r") as file:
                group = file[SPECIMEN_GROUP]
                curves += get_curves(group["curves"]) if "curves" in group else ()
        write_curves(curves, run.path(CURVES))
        _merge_posteriors(paths, run.path(POSTERIORS))
    except HDF5_ERRORS as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        msg = f"a specimen's file can't be read ({error}); run the same `tissueid fit` again"
        raise BundleError(msg) from error


def _merge_posteriors(paths: Iterable[Path], target: Path) -> None:
    """Numbered groups of many files in one, with one index; no file where no specimen has any."""
    index: list[Any] = []
    with new_file(target) as merged:
        for path in paths:
            with h5py.File(path, "r") as file:
                group = file[SPECIMEN_GROUP].get("posterior")
                if group is None:
                    continue
                merged.attrs.update(group.attrs)
                for position, entry in enumerate(json.loads(get_text(group, "index"))):
                    # a copy of compressed chunks, not of numbers
                    merged.copy(group[str(position)], merged, name=str(len(index)))
                    index.append(entry)
        put_text(merged, "index", json_bytes(index))
    if not index:
        target.unlink()
