"""``OUT/index.sqlite``: what a run has read, what it still has to compute, and which results it holds.

::

    runs        one row a run: when, by which process, how it ended
    recordings  what each file was found to hold, by content, so that a file is parsed once; and, for the
                latest run, where it stands in the order of files and which specimen it belongs to
    jobs        the latest run: one row a specimen, with its state (waiting, running, done, failed;
                superseded: what a specimen alone would take, behind those of the specimens)
    results     key of a file in ``specimens/`` -> hash and size of its bytes, seconds it took

One process writes (it holds the folder's lock); others read at any time, since the file is written ahead of
(WAL) and every change is a transaction.  The index is a memory, not a result: without it a run computes
everything again and ends the same.
"""

from __future__ import annotations

import errno
import json
import os
import platform
import sqlite3
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import asdict, astuple, dataclass
from pathlib import Path
from typing import Any

from tissueid.errors import BundleError
from tissueid.result import Refusal

INDEX = "index.sqlite"
INDEX_SCHEMA_VERSION = 1
#: How long a statement waits for another one's transaction [s].
_BUSY_S = 20.0
#: Recordings of a run, those among them that belong to a specimen, and the order of files.
_OF_RUN = "FROM recordings WHERE run = ?"
_OF_SPECIMENS = f"{_OF_RUN} AND kind IN ('trial', 'excluded')"
_IN_ORDER = "ORDER BY position, number"
_TABLES = """
CREATE TABLE runs (
    id INTEGER PRIMARY KEY, started REAL NOT NULL, ended REAL, state TEXT NOT NULL, process TEXT NOT NULL,
    files INTEGER NOT NULL DEFAULT 0, surveyed INTEGER NOT NULL DEFAULT 0, reason TEXT
);
CREATE TABLE recordings (
    path TEXT NOT NULL, reading TEXT NOT NULL, number INTEGER NOT NULL, sha256 TEXT NOT NULL, sheet TEXT,
    raw TEXT NOT NULL, samples INTEGER NOT NULL, refusal TEXT,
    run INTEGER NOT NULL, position INTEGER NOT NULL, specimen TEXT NOT NULL, kind TEXT NOT NULL,
    PRIMARY KEY (path, reading, number)
) WITHOUT ROWID;
CREATE INDEX recordings_of_run ON recordings (run, specimen, position, number);
CREATE TABLE jobs (
    position INTEGER PRIMARY KEY, key TEXT NOT NULL, specimen TEXT NOT NULL, state TEXT NOT NULL,
    attempts INTEGER NOT NULL DEFAULT 0, worker TEXT, began REAL, seconds REAL, reason TEXT
);
CREATE INDEX jobs_by_state ON jobs (state);
CREATE TABLE results (
    key TEXT PRIMARY KEY, sha256 TEXT NOT NULL, bytes INTEGER NOT NULL, seconds REAL NOT NULL
) WITHOUT ROWID;
"""


@dataclass(frozen=True, slots=True)
class RecordingRow:
    """One recording of a file, or the refusal in its place."""

    path: str
    sheet: str | None
    sha256: str
    raw: str  # specimen as the file was read; ``specimen`` is what the study calls it
    samples: int
    #: ``trial``, ``excluded``, ``unlisted`` (the study wants none but listed ones), ``refused`` or
    #: ``refused_excluded`` (the study does not want it either).
    kind: str
    specimen: str
    refusal: Refusal | None = None


@dataclass(frozen=True, slots=True)
class JobRow:
    """One specimen of the latest run; ``position`` is its place in the results."""

    position: int
    key: str
    specimen: str
    state: str
    reason: str | None


class Index(AbstractContextManager["Index"]):
    """The index of an output folder, open for writing.

    ``out``: output folder, whose lock the caller holds.  Raises BundleError: the file is of another schema
    version, or this file system can't hold it.
    """

    def __init__(self, out: Path) -> None:
        self.path = out / INDEX
        self._run = 0
        try:
            self._open()
        except sqlite3.DatabaseError as error:
            if isinstance(error, sqlite3.OperationalError):
                raise BundleError(_unusable(self.path, error)) from error
            # cut or overwritten: it is a memory only, so a new one is begun
            for suffix in ("", "-wal", "-shm"):
                self.path.with_name(self.path.name + suffix).unlink(missing_ok=True)
            self._open()

    def _open(self) -> None:
        self._database = sqlite3.connect(self.path, timeout=_BUSY_S, isolation_level=None)
        self._database.row_factory = sqlite3.Row
        # where the file system shares no memory between processes, readers wait for the writer at times
        self._database.execute("PRAGMA journal_mode=WAL")
        # a commit survives a killed process; a crash of the machine may lose the last ones, not the file
        self._database.execute("PRAGMA synchronous=NORMAL")
        version = self._database.execute("PRAGMA user_version").fetchone()[0]
        if version == 0:
            self._database.executescript(
                f"BEGIN; {_TABLES} PRAGMA user_version={INDEX_SCHEMA_VERSION}; COMMIT;"
            )
        elif version != INDEX_SCHEMA_VERSION:
            self._database.close()
            raise BundleError(
                f"{self.path}: schema version {version}, this tissueid writes {INDEX_SCHEMA_VERSION}; run "
                f"`tissueid migrate {self.path.parent}`"
            )
        self._run = self._database.execute("SELECT MAX(id) FROM runs").fetchone()[0] or 0

    def _do(self, statement: str, *values: Any) -> sqlite3.Cursor:
        """Execute a statement; a disk that is full is an error of the system like any other file's."""
        try:
            return self._database.execute(statement, values)
        except sqlite3.OperationalError as error:
            number = errno.ENOSPC if "full" in str(error) else errno.EIO
            raise OSError(number, str(error), str(self.path)) from error

    def __exit__(self, *_: object) -> None:
        self._database.close()

    @contextmanager
    def batch(self) -> Iterator[None]:
        """Many changes in one transaction."""
        self._do("BEGIN IMMEDIATE")
        try:
            yield
        except BaseException:
            with suppress(OSError):
                self._do("ROLLBACK")
            raise
        self._do("COMMIT")

    def _recordings(self, which: str, *values: Any) -> Iterator[RecordingRow]:
        """Some recordings of the run, in the order of files."""
        return map(_recording, self._do(f"SELECT * {which} {_IN_ORDER}", self._run, *values))

    def begin_run(self, now: float, process: Mapping[str, Any], files: int) -> None:
        """Open a run over so many files; what the runs before it found stays known."""
        begin = "INSERT INTO runs (started, state, process, files) VALUES (?, 'running', ?, ?)"
        with self.batch():
            self._do("UPDATE runs SET state = 'stopped', ended = ? WHERE state = 'running'", now)
            cursor = self._do(begin, now, json.dumps(process), files)
            self._do("DELETE FROM jobs")
        self._run = int(cursor.lastrowid or 0)

    def end_run(self, now: float, state: str, reason: str | None = None) -> None:
        """Close the run: ``finished``, ``interrupted`` or ``failed``."""
        change = "UPDATE runs SET state = ?, ended = ?, reason = ? WHERE id = ?"
        self._do(change, state, now, reason, self._run)

    def knows_files(self) -> bool:
        """True where an earlier run has left anything to go by."""
        return self._do("SELECT 1 FROM recordings LIMIT 1").fetchone() is not None

    def known_file(self, path: str, reading: str) -> list[RecordingRow]:
        """Contents of a file, read in one way, at the last look; empty where it never was."""
        wanted = "SELECT * FROM recordings WHERE path = ? AND reading = ? ORDER BY number"
        return [_recording(row) for row in self._do(wanted, path, reading)]

    def add_file(self, position: int, path: str, reading: str, rows: Iterable[RecordingRow]) -> None:
        """Put down what the file at ``position`` holds."""
        self._do("DELETE FROM recordings WHERE path = ? AND reading = ?", path, reading)
        for number, row in enumerate(rows):
            self._do(
                "INSERT OR REPLACE INTO recordings VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                *(path, reading, number, row.sha256, row.sheet, row.raw, row.samples),
                None if row.refusal is None else json.dumps(asdict(row.refusal)),
                *(self._run, position, row.specimen, row.kind),
            )
        self._do("UPDATE runs SET surveyed = surveyed + 1 WHERE id = ?", self._run)

    def specimens(self) -> list[tuple[str, str, str | None]]:
        """Specimens of the run with their first recording, in its order; wholly excluded ones come last."""
        rows = self._do(
            # path and sheet are those of the row with the least place
            "SELECT specimen, path, sheet, MIN((kind = 'excluded') * 1000000000000000000"
            " + position * 10000000 + number) AS place"
            f" {_OF_SPECIMENS} GROUP BY specimen ORDER BY place",
            self._run,
        )
        return [(row["specimen"], row["path"], row["sheet"]) for row in rows]

    def recordings_of(self, specimen: str) -> list[RecordingRow]:
        """Recordings of one specimen of the run in the order of files, excluded ones among them."""
        return list(self._recordings(f"{_OF_SPECIMENS} AND specimen = ?", specimen))

    def refused(self) -> Iterator[RecordingRow]:
        """Refusals of the readers, in the order of files."""
        return self._recordings(f"{_OF_RUN} AND kind IN ('refused', 'refused_excluded')")

    def named(self) -> Iterator[tuple[str, str | None]]:
        """Path and sheet of everything the run has found."""
        rows = self._do("SELECT path, sheet FROM recordings WHERE run = ?", self._run)
        return ((row["path"], row["sheet"]) for row in rows)

    def samples(self) -> int:
        """Samples of all recordings of the run."""
        return int(self._do(f"SELECT TOTAL(samples) {_OF_SPECIMENS}", self._run).fetchone()[0])

    def plan(self, job: JobRow) -> None:
        """Add one job of the run."""
        self._do(
            "INSERT INTO jobs (position, key, specimen, state, reason) VALUES (?, ?, ?, ?, ?)", *astuple(job)
        )

    def replan(self, job: JobRow, spare: int) -> None:
        """Give a specimen another job; the one it had stands at a spare position, so that its file stays."""
        with self.batch():
            change = "UPDATE jobs SET position = ?, state = 'superseded' WHERE position = ?"
            self._do(change, spare, job.position)
            self.plan(job)

    def restore(self, position: int, spare: int) -> None:
        """Take back a job that was replaced, with its result."""
        with self.batch():
            self._do("DELETE FROM jobs WHERE position = ?", position)
            self._do("UPDATE jobs SET position = ?, state = 'done' WHERE position = ?", position, spare)

    def jobs(self, state: str) -> Iterator[JobRow]:
        """Jobs of the run in one state, in their order; jobs may change while they are gone through."""
        positions = self._do("SELECT position FROM jobs WHERE state = ? ORDER BY position", state).fetchall()
        for (position,) in positions:
            row = self._do("SELECT * FROM jobs WHERE position = ?", position).fetchone()
            yield JobRow(position, row["key"], row["specimen"], row["state"], row["reason"])

    def count(self, state: str) -> int:
        """Count of the run's jobs in a state."""
        found: int = self._do("SELECT COUNT(*) FROM jobs WHERE state = ?", state).fetchone()[0]
        return found

    def start(self, position: int, worker: str, now: float) -> None:
        """Say that a job is being computed."""
        self._do(
            "UPDATE jobs SET state = 'running', worker = ?, began = ?, attempts = attempts + 1"
            " WHERE position = ?",
            *(worker, now, position),
        )

    def finish(self, job: JobRow, digest: str, size: int, seconds: float) -> None:
        """Say that the file of a job is there, whole."""
        with self.batch():
            self._do("INSERT OR REPLACE INTO results VALUES (?, ?, ?, ?)", job.key, digest, size, seconds)
            self._do("UPDATE jobs SET state = 'done', seconds = ? WHERE position = ?", seconds, job.position)

    def fail(self, position: int, reason: str) -> None:
        """Say why a job has no result."""
        self._do("UPDATE jobs SET state = 'failed', reason = ? WHERE position = ?", reason, position)

    def result(self, key: str) -> tuple[str, int] | None:
        """SHA-256 and size of the file of a key, ``None`` where no run has finished it."""
        row = self._do("SELECT sha256, bytes FROM results WHERE key = ?", key).fetchone()
        return None if row is None else (row["sha256"], row["bytes"])

    def forget_unused(self) -> set[str]:
        """Drop results that no job of the run names, and files it did not look at; keys of all its jobs."""
        with self.batch():
            self._do("DELETE FROM results WHERE key NOT IN (SELECT key FROM jobs)")
            self._do("DELETE FROM recordings WHERE run != ?", self._run)
        return {row["key"] for row in self._do("SELECT key FROM jobs")}


def _recording(row: sqlite3.Row) -> RecordingRow:
    refusal = None if row["refusal"] is None else Refusal(**json.loads(row["refusal"]))
    names = ("path", "sheet", "sha256", "raw", "samples", "kind", "specimen")
    return RecordingRow(**{name: row[name] for name in names}, refusal=refusal)


def _unusable(path: Path, error: Exception) -> str:
    return (
        f"{path}: can't be used as a database ({error}); some network file systems have no locks for it: "
        "write to a local folder and copy the result"
    )


def open_for_reading(out: Path) -> sqlite3.Connection:
    """Open the index of a folder for queries, also while a run writes it; BundleError where there is none."""
    path = out / INDEX
    if not path.is_file():
        raise BundleError(f"{out}: holds no index of a run; `tissueid fit ... -o {out}` makes one")
    problem: sqlite3.Error | None = None
    # a folder that can't be written to holds no writer either: then the file alone is the whole truth
    for way in ("mode=ro", "immutable=1"):
        try:
            database = sqlite3.connect(f"{path.resolve().as_uri()}?{way}", uri=True, timeout=_BUSY_S)
            database.row_factory = sqlite3.Row
            version = database.execute("PRAGMA user_version").fetchone()[0]
        except sqlite3.Error as error:
            problem = error
            continue
        if version != INDEX_SCHEMA_VERSION:
            database.close()
            raise BundleError(f"{path}: schema version {version}, this tissueid reads {INDEX_SCHEMA_VERSION}")
        return database
    raise BundleError(_unusable(path, problem or OSError("no way to open it")))


#: Finished jobs that the rate is taken over.
_RECENT = 50
#: Failures, and refused inputs, that are listed.
_LISTED = 100


def read_status(out: Path) -> dict[str, Any]:
    """The document of ``schemas/status.schema.json`` of one moment; BundleError where there is no index."""
    database = open_for_reading(out)
    try:
        database.execute("BEGIN")
        run = database.execute("SELECT * FROM runs ORDER BY id DESC LIMIT 1").fetchone()
        if run is None:
            raise BundleError(f"{out}: no run has begun here")
        return _status(database, run)
    except sqlite3.Error as error:
        msg = f"{out / INDEX}: can't be read ({error}); the next `tissueid fit` begins it anew"
        raise BundleError(msg) from error
    finally:
        database.close()


def _status(database: sqlite3.Connection, run: sqlite3.Row) -> dict[str, Any]:
    process = json.loads(run["process"])
    state = "stopped" if run["state"] == "running" and _alive(process) is False else run["state"]
    going = state == "running"
    counts = Counter(dict(database.execute("SELECT state, COUNT(*) FROM jobs GROUP BY state").fetchall()))
    left = counts["waiting"] + counts["running"]
    rate = _rate(database, run["started"]) if going else None
    known = "SELECT COUNT(*) FROM jobs WHERE state = 'done' AND seconds IS NULL"
    refused = f"{_OF_RUN} AND kind = 'refused'"
    of_state = "SELECT * FROM jobs WHERE state = ? ORDER BY position LIMIT ?"
    refusals = database.execute(f"SELECT refusal {refused} {_IN_ORDER} LIMIT ?", (run["id"], _LISTED))
    return {
        "schema": "tissueid/status/1",
        "state": state,
        "started": run["started"],
        "ended": run["ended"],
        "writer": process if going else None,
        "reason": run["reason"],
        "files": {
            "looked_into": run["surveyed"],
            "total": run["files"],
            "refused": database.execute(f"SELECT COUNT(*) {refused}", (run["id"],)).fetchone()[0],
        },
        "specimens": {
            "total": counts.total() - counts["superseded"],
            "done": counts["done"],
            "known_before": database.execute(known).fetchone()[0],
            "running": counts["running"] if going else 0,
            "waiting": counts["waiting"] if going else left,
            "failed": counts["failed"],
        },
        "specimens_per_minute": None if rate is None else 60.0 * rate,
        "left_s": None if not rate else left / rate,
        "running": [
            {key: row[key] for key in ("specimen", "worker", "attempts")}
            | {"seconds": max(time.time() - row["began"], 0.0)}
            for row in database.execute(of_state, ("running", counts["running"]))
            if going
        ],
        "failures": [
            {"specimen": row["specimen"], "reason": json.loads(row["reason"])["message"]}
            for row in database.execute(of_state, ("failed", _LISTED))
        ],
        "refusals": [str(Refusal(**json.loads(row["refusal"]))) for row in refusals],
    }


def _alive(process: dict[str, Any]) -> bool | None:
    """True where a process still runs; ``None`` where it is one of another machine."""
    if process.get("host") != platform.node():
        return None
    try:
        os.kill(int(process["pid"]), 0)
    except ProcessLookupError:
        return False
    except (OSError, KeyError, ValueError):
        return None
    return True


def _rate(database: sqlite3.Connection, started: float) -> float | None:
    """Specimens a second over the last ones that were finished."""
    ended = "SELECT began + seconds AS ended FROM jobs WHERE state = 'done' AND began IS NOT NULL"
    ends = [row["ended"] for row in database.execute(f"{ended} ORDER BY ended DESC LIMIT ?", (_RECENT,))]
    if not ends:
        return None
    passed = time.time() - (started if len(ends) < _RECENT else ends[-1])
    return len(ends) / passed if passed > 0.0 else None
