"""The log of a session: what was rendered, tick by tick, and at which scale.

While a session runs it is appended to as fixed records; a process that is killed leaves whole records::

    16 bytes  "tissueid-session"
     8 bytes  length of the head, little-endian
     head     JSON text, padded with spaces
     records  of head["record"], one after the other; a last one that is cut is left out

At its close the log becomes one HDF5 file::

    log.h5
    |  attributes: format = "tissueid/session", schema_version = 1, content_sha256
    |-- document   JSON text, schemas/session.schema.json: the head, and the summary of the session
    `-- records    (n,)  compound, chunked and compressed

Both are read by :func:`read_session_log`, and as a recording by ``tissueid fit``.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from tissueid.arrays import RecordArray
from tissueid.documents import plain
from tissueid.documents.session import Session
from tissueid.errors import BundleError
from tissueid.store.files import json_bytes
from tissueid.store.hdf5 import HDF5_ERRORS, check_format, get_text, new_file, put_text
from tissueid.store.schema import check

SESSION_FORMAT = "tissueid/session"
SESSION_SCHEMA_VERSION = 1
RAW_MAGIC = b"tissueid-session"
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
_LENGTH_BYTES = 8
#: The head is padded to a multiple of this, so that records lie on cache lines.
_HEAD_ALIGNMENT = 128
#: A head is a few kilobytes; a larger one is no head.
_LARGEST_HEAD = 1 << 22
#: RecordArray a chunk of the HDF5 file holds: half a megabyte.
_CHUNK = 4096
#: RecordArray converted at a time.
_PIECE = 1 << 16
#: What a log must have to be read as a recording.
_NEEDED = ("time_s", "position_m", "force_N", "depth_mm", "tissue_force_N", "lamps", "state", "label")


@dataclass(frozen=True, slots=True, eq=False)
class SessionLog:
    """One session."""

    head: Mapping[str, Any]  # device, scale, surface, tissues: see ``schemas/session.schema.json``
    records: RecordArray  # (n,), one a tick, fields as the head's ``record`` says
    summary: Mapping[str, Any] | None  # of the session; None where it was killed before it could be written


def raw_head(head: Mapping[str, Any], record: np.dtype[Any]) -> bytes:
    """Write the beginning of a raw log, ``schema`` and ``record`` added; records follow as they are.

    Raises BundleError: the head does not follow its schema.
    """
    document = plain(
        {
            **head,
            "schema": f"{SESSION_FORMAT}/{SESSION_SCHEMA_VERSION}",
            "record": [
                [name, record[name].base.str, list(record[name].shape)] for name in record.names or ()
            ],
            "summary": None,
        }
    )
    check(document, Session, where="session log")
    text = json.dumps(document, ensure_ascii=False, allow_nan=False).encode("utf-8")
    text += b" " * (-(len(text) + len(RAW_MAGIC) + _LENGTH_BYTES) % _HEAD_ALIGNMENT)
    return RAW_MAGIC + len(text).to_bytes(_LENGTH_BYTES, "little") + text


def is_session_log(data: bytes) -> bool:
    """True where bytes are those of a session's log, raw or HDF5; a damaged one counts."""
    if data.startswith(RAW_MAGIC):
        return True
    if not data.startswith(HDF5_MAGIC):
        return False
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            return bool(file.attrs.get("format") == SESSION_FORMAT)
    except HDF5_ERRORS:
        return False


def read_session_log(source: Path | str | bytes, *, where: str | None = None) -> SessionLog:
    """Read a log, raw or HDF5, by its file or its bytes, and refuse what no session wrote.

    ``where``: name for messages, where bytes are given.  A raw log's last record is left out where it was
    cut.  Raises BundleError: naming the file, what is wrong, and the way out.
    """
    name = where or (str(source) if not isinstance(source, bytes) else "session log")
    try:
        data = source if isinstance(source, bytes) else Path(source).read_bytes()
    except OSError as error:
        msg = f"{name}: the log can't be read ({error.strerror or error}); name the file that --log wrote"
        raise BundleError(msg) from error
    if data.startswith(RAW_MAGIC):
        head, start, record = _parsed_head(data, name)
        count = (len(data) - start) // record.itemsize
        return SessionLog(head, np.frombuffer(data, record, count, start).copy(), None)
    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            attributes = dict(file.attrs)
            check_format(file, SESSION_FORMAT)
            text, records = get_text(file, "document"), np.asarray(file["records"][()])
        _check_record(records.dtype)
    except HDF5_ERRORS as error:
        msg = f"{name}: cannot be read as a session log ({error}); it is damaged or another kind of file"
        raise BundleError(msg) from error
    if attributes.get("schema_version") != SESSION_SCHEMA_VERSION:
        raise BundleError(
            f"{name}: schema version {attributes.get('schema_version')}, this tissueid reads version "
            f"{SESSION_SCHEMA_VERSION}; use the tissueid that wrote it"
        )
    digest = hashlib.sha256(_seal(text, records.dtype, records.size))
    digest.update(np.ascontiguousarray(records).tobytes())
    if attributes.get("content_sha256") != digest.hexdigest():
        raise BundleError(f"{name}: changed since it was written (the content hash differs); record it again")
    document = _document(text, name)
    return SessionLog(document, records, document["summary"])


def convert_session_log(raw: Path, target: Path, summary: Mapping[str, Any]) -> None:
    """Turn a raw log into the HDF5 file, whole or not at all; the raw one is left as it is.

    Raises BundleError: the raw log is none, or the summary does not follow the schema; OSError: there is no
    room for it.
    """
    with raw.open("rb") as stream:
        data = stream.read(len(RAW_MAGIC) + _LENGTH_BYTES)
        length = int.from_bytes(data[len(RAW_MAGIC) :], "little")
        data += stream.read(min(length, _LARGEST_HEAD))
    head, start, record = _parsed_head(data, str(raw))
    count = (raw.stat().st_size - start) // record.itemsize
    document = plain({**head, "summary": summary})
    check(document, Session, where=str(target))
    text = json_bytes(document)
    digest = hashlib.sha256(_seal(text, record, count))
    with new_file(target) as file, raw.open("rb") as stream:
        stream.seek(start)
        put_text(file, "document", text)
        packed = {"compression": "gzip", "compression_opts": 1, "shuffle": True, "track_times": False}
        table = file.create_dataset(
            "records", shape=(count,), dtype=record, chunks=(_CHUNK,), maxshape=(None,), **packed
        )
        for first in range(0, count, _PIECE):
            piece = stream.read(min(_PIECE, count - first) * record.itemsize)
            digest.update(piece)
            table[first : first + len(piece) // record.itemsize] = np.frombuffer(piece, record)
        file.attrs["format"] = SESSION_FORMAT
        file.attrs["schema_version"] = np.int64(SESSION_SCHEMA_VERSION)
        file.attrs["content_sha256"] = digest.hexdigest()


def _seal(text: bytes, record: np.dtype[Any], count: int) -> bytes:
    """Beginning of the content hash: everything but the records themselves."""
    about = f"{SESSION_FORMAT}/{SESSION_SCHEMA_VERSION}/{count}/{record.descr}".encode()
    return about + len(text).to_bytes(_LENGTH_BYTES, "little") + text


def _parsed_head(data: bytes, name: str) -> tuple[dict[str, Any], int, np.dtype[Any]]:
    """Head of a raw log, where its records start, and what they are."""
    begin = len(RAW_MAGIC) + _LENGTH_BYTES
    length = int.from_bytes(data[len(RAW_MAGIC) : begin], "little")
    try:
        if length > _LARGEST_HEAD or len(data) < begin + length:
            # told like what numpy says of a wrong layout
            raise ValueError("it is cut, or no head")  # noqa: TRY301
        head = _document(data[begin : begin + length], name)
        record = np.dtype([(field, kind, tuple(shape)) for field, kind, shape in head["record"]])
        _check_record(record)
    except (ValueError, TypeError, KeyError) as error:
        msg = f"{name}: its head is damaged ({error}); nothing of this log can be read"
        raise BundleError(msg) from error
    return head, begin + length, record


def _check_record(record: np.dtype[Any]) -> None:
    missing = [name for name in _NEEDED if name not in (record.names or ())]
    if missing or record.hasobject:
        raise ValueError(f"its records lack {', '.join(missing) or 'a plain layout'}")


def _document(text: bytes, name: str) -> dict[str, Any]:
    try:
        document = json.loads(text)
    except ValueError as error:
        raise BundleError(f"{name}: its document is not JSON ({error}); record the session again") from error
    check(document, Session, where=name)
    assert isinstance(document, dict)  # noqa: S101 -- what the schema demands
    return document
