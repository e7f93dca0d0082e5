"""Files of earlier schema versions made into those of this one, version by version.

A step takes the document and the arrays of one version to those of the next; steps are never removed, so
that a bundle of any released version can be read for ever.  The new file is written beside the old one, read
back with every check, and only then moved over it: at every moment one of the two is there, whole.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from msgspec import ValidationError

from tissueid.arrays import FloatArray
from tissueid.errors import BundleError
from tissueid.store.bundle import BUNDLE_SCHEMA_VERSION, bundle_of_document, load_bundle, write_bundle
from tissueid.store.files import replacing
from tissueid.store.hdf5 import check_format, get_text, open_file
from tissueid.store.index import INDEX, INDEX_SCHEMA_VERSION
from tissueid.store.outputs import OutputSet, current_run, folder_lock

#: Document and arrays of one version -> those of the next.
Step = Callable[[dict[str, Any], dict[str, FloatArray]], tuple[dict[str, Any], dict[str, FloatArray]]]

#: Version -> the step to the next one.  Version 1 is the first that was released.
BUNDLE_STEPS: Mapping[int, Step] = {}
#: Version -> SQL statements to the next one.
INDEX_STEPS: Mapping[int, str] = {}


@dataclass(frozen=True, slots=True)
class Migrated:
    """One file that was of another version: which, and which it was."""

    path: Path
    version: int


def _contents(path: Path) -> tuple[int, dict[str, Any], dict[str, FloatArray]]:
    """Version, document and arrays of a bundle of any version."""
    with open_file(path, "a bundle", "copy it again or fit again") as file:
        check_format(file, "tissueid/bundle")
        version = int(file.attrs["schema_version"])
        document = json.loads(get_text(file, "document"))
        arrays = {
            name: np.asarray(data[()], dtype=np.float64)
            for name, data in file.items()
            if isinstance(data, h5py.Dataset) and name != "document"
        }
    return version, document, arrays


def _step_from(path: Path, version: int, steps: Mapping[int, Any], newest: int) -> Any:
    if version > newest:
        msg = f"{path}: schema version {version} is newer than this tissueid ({newest}); install a newer one"
        raise BundleError(msg)
    if version not in steps:
        raise BundleError(f"{path}: no way is known from schema version {version} to {newest}; fit again")
    return steps[version]


def migrate_bundle(path: Path, *, steps: Mapping[int, Step] = BUNDLE_STEPS) -> Migrated | None:
    """Bring a bundle to this version, in place; ``None`` where it is there already.

    ``steps``: version -> the step to the next.  Raises BundleError: it is damaged, newer, or no step is
    known; the file is as it was.
    """
    was, document, arrays = _contents(path)
    if was == BUNDLE_SCHEMA_VERSION:
        return None
    version = was
    while version != BUNDLE_SCHEMA_VERSION:
        step: Step = _step_from(path, version, steps, BUNDLE_SCHEMA_VERSION)
        document, arrays = step(document, arrays)
        version += 1
    try:
        bundle = bundle_of_document(document, arrays)
        with replacing(path) as temporary:
            write_bundle(bundle, temporary)
            load_bundle(temporary)
    except (KeyError, TypeError, ValueError, ValidationError) as error:
        msg = f"{path}: can't be brought to version {BUNDLE_SCHEMA_VERSION} ({error}); fit again"
        raise BundleError(msg) from error
    return Migrated(path, was)


def _migrate_index(path: Path, steps: Mapping[int, str]) -> Migrated | None:
    """Bring an index to this version: on a copy, which then takes its place."""
    try:
        with closing(sqlite3.connect(path)) as old:
            was = int(old.execute("PRAGMA user_version").fetchone()[0])
        if was == INDEX_SCHEMA_VERSION:
            return None
        if was > INDEX_SCHEMA_VERSION:
            _step_from(path, was, steps, INDEX_SCHEMA_VERSION)
        # both are closed before the new one takes the place of the old
        with (
            replacing(path) as temporary,
            closing(sqlite3.connect(path)) as old,
            closing(sqlite3.connect(temporary)) as new,
        ):
            old.backup(new)
            for version in range(was, INDEX_SCHEMA_VERSION):
                new.executescript(_step_from(path, version, steps, INDEX_SCHEMA_VERSION))
            new.execute(f"PRAGMA user_version={INDEX_SCHEMA_VERSION}")
            if new.execute("PRAGMA integrity_check").fetchone()[0] != "ok":
                raise sqlite3.DatabaseError("the new file is not whole")
    except sqlite3.Error as error:
        msg = f"{path}: can't be migrated ({error}); delete it, and the next `tissueid fit` computes again"
        raise BundleError(msg) from error
    return Migrated(path, was)


def migrate_folder(
    out: Path, *, bundles: Mapping[int, Step] = BUNDLE_STEPS, index: Mapping[int, str] = INDEX_STEPS
) -> list[Migrated]:
    """Bring the committed set and the index of an output folder to this version.

    Bundles change all at once, as a new set.  Files in ``specimens/`` are named by their version too: the
    next ``tissueid fit`` computes those of an older one again.

    Raises BundleError: a file can't be migrated, or another process writes; the folder is as it was.
    """
    found: list[Migrated] = []
    if (out / INDEX).is_file():
        with folder_lock(out):
            one = _migrate_index(out / INDEX, index)
        found += [] if one is None else [one]
    committed = current_run(out)
    if committed is None:
        return found
    names = [name for name in committed.files if name.startswith("bundle") and name.endswith(".h5")]
    if all(_contents(committed.folder / name)[0] == BUNDLE_SCHEMA_VERSION for name in names):
        return found
    with OutputSet(out) as run:
        run.carry_over()
        for name in names:
            changed = migrate_bundle(run.path(name), steps=bundles)
            if changed is not None:
                found.append(Migrated(out / name, changed.version))
        run.commit()
    return found
