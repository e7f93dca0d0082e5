"""The sums of every log in one file: all that a likelihood needs of the samples.

Layout: one group a specimen, in the order of ``index`` (JSON text: specimen, logs, basis, column facts)::

    sums.h5
    |  attributes: format = "tissueid/sums", schema_version = 1
    |-- index             JSON text
    `-- 0, 1, ...         attribute: content_sha256 of the specimen's entry and numbers
        |-- tau_s         (nodes,)                   nodes of the kernel basis [s]
        |-- center        (logs, m - 1)              what was taken off the force, by column
        |-- ratio, links  (groups of all logs,)      step over reference step; links of that step
        `-- gram          (matrices, m (m + 1) / 2)  upper triangles, row by row

The matrices stand log by log: the samples that start a chain, then the later samples of the links of every
step, then the earlier ones, then the differences (of logs with several steps only the sum over steps of later
less earlier is theirs: it is shared out by links).  Columns are 1, x, x^2, x^3, the node states by power of
x, and the force less ``columns @ center``.  Read back, they are the same bits.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from tissueid.errors import BundleError
from tissueid.store.files import TEMPORARY_PREFIX, json_bytes, replace_file

__all__ = [
    "SUMS_SCHEMA_VERSION",
    "StoredLog",
    "StoredSums",
    "get_sums",
    "put_sums",
    "read_sums",
    "with_logs_of",
    "write_sums",
]

FloatArray = NDArray[np.float64]

SUMS_SCHEMA_VERSION = 1
_FORMAT = "tissueid/sums"
_STATIC_COLUMNS = 4
#: Facts of a specimen that all its logs share, in the words of the index.
_FACTS = (
    "degree",
    "scale_mm",
    "reference_step_s",
    "moving_average",
    "filter_phi",
    "step_s",
    "duration_s",
    "log_range",
)
_ARRAYS = ("tau_s", "center", "ratio", "links", "gram")


@dataclass(frozen=True, slots=True, eq=False)
class StoredLog:
    """Sums of one log, as :class:`tissueid.likelihood.lag_sums.LagSums` has them.

    Attributes
    ----------
    path, sheet, sha256 : str, str or None, str
        The recording they come from.
    start : ndarray, shape (m, m)
    later, earlier, difference : ndarray, shape (groups, m, m)
    ratio : ndarray, shape (groups,)
    links : ndarray of int, shape (groups,)
    chains : int
    center : ndarray, shape (m - 1,)
    """

    path: str
    sheet: str | None
    sha256: str
    start: FloatArray
    later: FloatArray
    earlier: FloatArray
    difference: FloatArray
    ratio: FloatArray
    links: NDArray[np.int64]
    chains: int
    center: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class StoredSums:
    """Sums of the logs of one specimen.

    Attributes
    ----------
    specimen : str
    tau_s : ndarray, shape (nodes,)
        Nodes of the basis [s].
    degree : int
        Highest power of x that multiplies a node state.
    scale_mm : float
        Depth that theta is scaled with.
    reference_step_s : float
        Step over which the correlation of the noise is one [s].
    moving_average, filter_phi : float
        theta and phi of the pre-filter; zero where there was none.
    step_s, duration_s : float
    log_range : tuple of float or None
        What :func:`tissueid.likelihood.basis.kernel_basis` was asked for: finest step, longest log, range of
        ln(tau / s).
    logs : tuple of StoredLog
    """

    specimen: str
    tau_s: FloatArray
    degree: int
    scale_mm: float
    reference_step_s: float
    moving_average: float
    filter_phi: float
    step_s: float
    duration_s: float
    log_range: tuple[float, float] | None
    logs: tuple[StoredLog, ...]

    @property
    def columns(self) -> int:
        """Columns m of every matrix."""
        return _STATIC_COLUMNS + self.tau_s.size * (self.degree + 1) + 1


def with_logs_of(sums: StoredSums, other: StoredSums) -> StoredSums:
    """Sums of one specimen with the logs of another set: likelihoods of logs multiply.

    Raises
    ------
    ValueError
        The two are of other columns (basis, degree, scale, reference step, pre-filter), or share a recording.
    """
    for name in _FACTS:
        if getattr(sums, name) != getattr(other, name):
            msg = f"sums can't be added: {name} is {getattr(sums, name)} and {getattr(other, name)}"
            raise ValueError(msg)
    if not np.array_equal(sums.tau_s, other.tau_s):
        msg = "sums can't be added: they stand on other nodes"
        raise ValueError(msg)
    known = {(log.sha256, log.sheet) for log in sums.logs}
    twice = [log.path for log in other.logs if (log.sha256, log.sheet) in known]
    if twice:
        msg = f"sums can't be added: {', '.join(twice)} would count twice"
        raise ValueError(msg)
    return replace(sums, logs=sums.logs + other.logs)


def write_sums(sums: Iterable[StoredSums], path: Path | str) -> None:
    """Write the sums of specimens, whole or not at all; equal sums give equal bytes.

    Parameters
    ----------
    sums : iterable of StoredSums
        Taken one after the other, so that a generator needs the memory of one specimen.
    path : Path or str
        Its folder must exist.
    """
    path = Path(path)
    temporary = path.with_name(TEMPORARY_PREFIX + path.name)
    with h5py.File(temporary, "w", libver=("v110", "v110")) as file:
        put_sums(file, sums)
    replace_file(temporary, path)


def put_sums(file: Any, sums: Iterable[StoredSums]) -> None:
    """Write sums into an open HDF5 file or a group of one."""
    index = []
    file.attrs["format"] = _FORMAT
    file.attrs["schema_version"] = np.int64(SUMS_SCHEMA_VERSION)
    for position, one in enumerate(sums):
        entry, arrays = _entry(one), _arrays(one)
        index.append(entry)
        group = file.create_group(str(position), track_order=False)
        group.attrs["content_sha256"] = _content_hash(entry, arrays)
        for name, values in arrays.items():
            packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if values.size else {}
            group.create_dataset(name, data=values, track_times=False, **packed)
    text = json_bytes(index)
    kind = h5py.string_dtype("utf-8", length=len(text))
    file.create_dataset("index", data=np.array(text, dtype=kind), track_times=False)


def _entry(sums: StoredSums) -> dict[str, Any]:
    facts = {name: getattr(sums, name) for name in _FACTS}
    if sums.log_range is not None:
        facts["log_range"] = list(sums.log_range)
    logs = [
        {
            "path": log.path,
            "sheet": log.sheet,
            "sha256": log.sha256,
            "chains": int(log.chains),
            "groups": int(log.ratio.size),
        }
        for log in sums.logs
    ]
    return {"specimen": sums.specimen, **facts, "logs": logs}


def _arrays(sums: StoredSums) -> dict[str, NDArray[Any]]:
    size = sums.columns
    rows, columns = np.triu_indices(size)
    matrices = [
        part.reshape(-1, size, size)[:, rows, columns]
        for log in sums.logs
        for part in (log.start, log.later, log.earlier, log.difference)
    ]
    return {
        "tau_s": sums.tau_s.astype("<f8"),
        "center": np.array([log.center for log in sums.logs], dtype="<f8").reshape(-1, size - 1),
        "ratio": np.concatenate([np.empty(0), *(log.ratio for log in sums.logs)]).astype("<f8"),
        "links": np.concatenate([np.empty(0), *(log.links for log in sums.logs)]).astype("<i8"),
        "gram": np.concatenate([np.empty((0, rows.size)), *matrices]).astype("<f8"),
    }


def _content_hash(entry: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> str:
    digest = hashlib.sha256(f"{_FORMAT}/{SUMS_SCHEMA_VERSION}".encode() + json_bytes(entry))
    for name in _ARRAYS:
        digest.update(f"{name}{arrays[name].shape}".encode() + arrays[name].tobytes())
    return digest.hexdigest()


def read_sums(path: Path | str) -> Iterator[StoredSums]:
    """Read what :func:`write_sums` wrote, specimen by specimen.

    Parameters
    ----------
    path : Path or str

    Yields
    ------
    StoredSums
        In the order of writing; memory holds one at a time.

    Raises
    ------
    BundleError
        If the file is missing, of another schema version, damaged, or another kind of file.
    """
    path = Path(path)
    if not path.is_file():
        msg = f"{path}: there is no such file; `tissueid fit` writes it into its output folder"
        raise BundleError(msg)
    try:
        yield from _read(path)
    except (OSError, KeyError, ValueError, TypeError, RuntimeError, AttributeError, MemoryError) as error:
        msg = f"{path}: cannot be read as sums ({error}); copy it again or run `tissueid fit` again"
        raise BundleError(msg) from error


def _read(path: Path) -> Iterator[StoredSums]:
    with h5py.File(path, "r") as file:
        yield from get_sums(file)


def get_sums(file: Any) -> Iterator[StoredSums]:
    """Read what :func:`put_sums` wrote; ``ValueError`` or ``KeyError`` where it is something else."""
    if file.attrs.get("format") != _FORMAT:
        msg = f"its format is {file.attrs.get('format')!r}, not {_FORMAT!r}"
        raise ValueError(msg)
    version = file.attrs.get("schema_version")
    if version != SUMS_SCHEMA_VERSION:
        msg = f"schema version {version}, this tissueid reads version {SUMS_SCHEMA_VERSION}"
        raise ValueError(msg)
    for position, entry in enumerate(json.loads(bytes(file["index"][()]))):
        group = file[str(position)]
        arrays = {name: np.asarray(group[name][()]) for name in _ARRAYS}
        if group.attrs["content_sha256"] != _content_hash(entry, arrays):
            msg = f"the sums of {entry['specimen']!r} changed since they were written"
            raise ValueError(msg)
        yield _sums(entry, arrays)


def _sums(entry: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> StoredSums:
    facts = {name: entry[name] for name in _FACTS}
    if facts["log_range"] is not None:
        facts["log_range"] = tuple(facts["log_range"])
    empty = StoredSums(specimen=entry["specimen"], tau_s=arrays["tau_s"], logs=(), **facts)
    size = empty.columns
    rows, columns = np.triu_indices(size)
    logs = []
    first = matrix = 0
    for i, log in enumerate(entry["logs"]):
        groups = log["groups"]
        whole = np.zeros((1 + 3 * groups, size, size))
        whole[:, rows, columns] = arrays["gram"][matrix : matrix + whole.shape[0]]
        whole[:, columns, rows] = whole[:, rows, columns]
        parts = np.split(whole, [1, 1 + groups, 1 + 2 * groups])
        logs.append(
            StoredLog(
                path=log["path"],
                sheet=log["sheet"],
                sha256=log["sha256"],
                start=parts[0][0],
                later=parts[1],
                earlier=parts[2],
                difference=parts[3],
                ratio=arrays["ratio"][first : first + groups],
                links=arrays["links"][first : first + groups],
                chains=log["chains"],
                center=arrays["center"][i],
            )
        )
        first, matrix = first + groups, matrix + whole.shape[0]
    return replace(empty, logs=tuple(logs))
