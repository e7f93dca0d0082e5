"""One specimen of a run in one HDF5 file, ``OUT/specimens/<key>.h5``, named by a hash of what made it.

The root is a bundle, so that ``tissueid render`` opens the file as it is; what else the run found stands in a
group beside it::

    <key>.h5
    |  document, theta, covariance, draws      as in a bundle; none of them where nothing could be fitted
    `-- specimen/
        |  attributes: format = "tissueid/specimen", schema_version = 1
        |-- record       JSON text: its entry of identification.json, refusals, inputs, rows of the study
        |-- curves/      as curves.h5
        `-- posterior/   as posteriors.h5, where one was sampled

A file is written and read as bytes, so that whoever computes it needs no folder of the run.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from tissueid.store.bundle import SPECIMEN_GROUP, Bundle, put_bundle
from tissueid.store.curves import TrialCurve, get_curves, put_curves
from tissueid.store.files import json_bytes
from tissueid.store.hdf5 import get_text, new_file, open_file, put_text
from tissueid.store.posteriors import StoredPosterior, get_posteriors, put_posteriors

SPECIMEN_SCHEMA_VERSION = 1
_FORMAT = "tissueid/specimen"


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenResult:
    """Result of one job."""

    #: ``specimen`` (name as shown), ``fitted`` (entry of identification.json, or ``None``), ``refused``,
    #: ``unfitted_cycles``, ``inputs``, ``provenance``, ``reasons`` (why its exit code is not 0), ``trials``
    #: and ``exclusions`` (rows of the study).
    record: dict[str, Any]
    bundle: Bundle | None = None
    curves: tuple[TrialCurve, ...] = ()
    posterior: StoredPosterior | None = None


def specimen_bytes(result: SpecimenResult) -> bytes:
    """The bytes of a specimen's file; equal results give equal bytes.

    Raises BundleError: if its bundle could not be loaded again.
    """
    buffer = io.BytesIO()
    with new_file(buffer) as file:
        if result.bundle is not None:
            put_bundle(file, result.bundle, where=result.bundle.specimen)
        group = file.create_group(SPECIMEN_GROUP)
        group.attrs["format"] = _FORMAT
        group.attrs["schema_version"] = np.int64(SPECIMEN_SCHEMA_VERSION)
        put_text(group, "record", json_bytes(result.record))
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
            msg = f"format {group.attrs.get('format')!r}, schema version {version}"
            raise ValueError(msg)
        yield group


def _record(group: Any) -> dict[str, Any]:
    record: dict[str, Any] = json.loads(get_text(group, "record"))
    return record


def load_record(path: Path) -> dict[str, Any]:
    """The JSON of a specimen's file alone.

    Raises BundleError: if the file is missing, damaged or another kind of file.
    """
    with _opened(path) as group:
        return _record(group)


def load_specimen(
    path: Path | IO[bytes],
) -> tuple[dict[str, Any], tuple[TrialCurve, ...], StoredPosterior | None]:
    """Record, curves and draws of a specimen's file: all that a report draws.

    ``path``: where it stands, or its bytes.  Raises BundleError: if the file is missing, damaged or another
    kind of file.
    """
    with _opened(path) as group:
        curves = get_curves(group["curves"]) if "curves" in group else ()
        posteriors = get_posteriors(group["posterior"]) if "posterior" in group else ()
        return _record(group), curves, posteriors[0] if posteriors else None
