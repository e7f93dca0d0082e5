"""The public files of a set put together from those of its specimens, one specimen in memory at a time.

Compressed columns are copied as they are: what a specimen's file holds is what the public file holds.
"""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any

import h5py

from tissueid.errors import BundleError
from tissueid.store.bundle import SPECIMEN_GROUP, load_bundle, write_bundle
from tissueid.store.curves import get_curves, write_curves
from tissueid.store.files import (
    CURVES,
    ONLY_BUNDLE,
    POSTERIORS,
    bundle_names,
    json_bytes,
)
from tissueid.store.hdf5 import HDF5_ERRORS, get_text, new_file, put_text
from tissueid.store.outputs import OutputSet

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
        fitted = "TRUE" if row.fitted else "FALSE"
        writer.writerow((row.specimen, row.file, fitted, row.sha256, row.bytes))


def read_listed(path: Path) -> Iterator[ListedSpecimen]:
    """Read what :func:`list_specimens` wrote.

    Raises BundleError: it is damaged or another kind of file.
    """
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
        write_curves([curve for path in paths for curve in _curves(path)], run.path(CURVES))
        _merge(paths, "posterior", run.path(POSTERIORS))
    except HDF5_ERRORS as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        msg = f"a specimen's file can't be read ({error}); run the same `tissueid fit` again"
        raise BundleError(msg) from error


def _curves(path: Path) -> Sequence[Any]:
    with h5py.File(path, "r") as file:
        group = file[SPECIMEN_GROUP]
        return get_curves(group["curves"]) if "curves" in group else ()


def _merge(paths: Iterable[Path], name: str, target: Path) -> None:
    """Numbered groups of many files in one, with one index; no file where no specimen has any."""
    index: list[Any] = []
    with new_file(target) as merged:
        for path in paths:
            with h5py.File(path, "r") as file:
                group = file[SPECIMEN_GROUP].get(name)
                if group is None:
                    continue
                for key, value in group.attrs.items():
                    merged.attrs[key] = value
                for position, entry in enumerate(json.loads(get_text(group, "index"))):
                    # a copy of compressed chunks, not of numbers
                    merged.copy(group[str(position)], merged, name=str(len(index)))
                    index.append(entry)
        put_text(merged, "index", json_bytes(index))
    if not index:
        target.unlink()
