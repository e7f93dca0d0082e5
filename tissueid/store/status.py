"""Progress of a run, read from its index while it goes on or after it ended.

Every answer is of one moment: one transaction of the index, which holds finished results only.
"""

from __future__ import annotations

import json
import os
import platform
import sqlite3
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissueid.errors import BundleError
from tissueid.result import Refusal
from tissueid.store.index import INDEX, open_for_reading

#: Finished jobs that the rate is taken over.
_RECENT = 50
#: Failures, and refused inputs, that are listed.
_LISTED = 100


def read_status(out: Path) -> dict[str, Any]:
    """The document of ``schemas/status.schema.json``.

    ``out``: output folder.  Raises BundleError: there is no index, or it can't be read.
    """
    database = open_for_reading(out)
    try:
        database.execute("BEGIN")
        run = database.execute("SELECT * FROM runs ORDER BY id DESC LIMIT 1").fetchone()
        if run is None:
            msg = f"{out}: no run has begun here"
            raise BundleError(msg)
        jobs = _read_jobs(database)
        refused, refusals = _read_refusals(database, run["id"])
    except sqlite3.Error as error:
        msg = f"{out / INDEX}: can't be read ({error}); the next `tissueid fit` begins it anew"
        raise BundleError(msg) from error
    finally:
        database.close()
    alive = _alive(json.loads(run["process"]))
    state = "stopped" if run["state"] == "running" and alive is False else run["state"]
    going = state == "running"
    counts = jobs.counts
    left = counts.get("waiting", 0) + counts.get("running", 0)
    rate = _rate(run["started"], jobs.ends) if going else None
    return {
        "schema": "tissueid/status/1",
        "state": state,
        "started": run["started"],
        "ended": run["ended"],
        "writer": json.loads(run["process"]) if going else None,
        "reason": run["reason"],
        "files": {"looked_into": run["surveyed"], "total": run["files"], "refused": refused},
        "specimens": {
            "total": sum(counts.values()),
            "done": counts.get("done", 0),
            "known_before": jobs.known,
            "running": counts.get("running", 0) if going else 0,
            "waiting": left if not going else counts.get("waiting", 0),
            "failed": counts.get("failed", 0),
        },
        "specimens_per_minute": None if rate is None else 60.0 * rate,
        "left_s": None if not rate else left / rate,
        "running": jobs.running if going else [],
        "failures": jobs.failures,
        "refusals": refusals,
    }


@dataclass(frozen=True, slots=True)
class _Jobs:
    """Jobs of an index: how many in which state, those that run, and the newest ends."""

    counts: dict[str, int]
    running: list[dict[str, Any]]
    failures: list[dict[str, Any]]
    ends: list[float]
    known: int


def _read_jobs(database: sqlite3.Connection) -> _Jobs:
    counts = dict(database.execute("SELECT state, COUNT(*) FROM jobs GROUP BY state").fetchall())
    running = database.execute(
        "SELECT specimen, worker, began, attempts FROM jobs WHERE state = 'running' ORDER BY position"
    )
    failed = database.execute(
        "SELECT specimen, reason FROM jobs WHERE state = 'failed' ORDER BY position LIMIT ?", (_LISTED,)
    )
    ends = database.execute(
        "SELECT began + seconds FROM jobs WHERE state = 'done' AND began IS NOT NULL"
        " ORDER BY began + seconds DESC LIMIT ?",
        (_RECENT,),
    )
    known = database.execute("SELECT COUNT(*) FROM jobs WHERE state = 'done' AND seconds IS NULL")
    return _Jobs(
        counts,
        [
            {
                "specimen": row["specimen"],
                "worker": row["worker"],
                "attempts": row["attempts"],
                "seconds": max(time.time() - row["began"], 0.0),
            }
            for row in running
        ],
        [{"specimen": row["specimen"], "reason": json.loads(row["reason"])["message"]} for row in failed],
        [end for (end,) in ends],
        known.fetchone()[0],
    )


def _read_refusals(database: sqlite3.Connection, run: int) -> tuple[int, list[str]]:
    """Count of refused inputs, and the message of the first."""
    these = "FROM recordings WHERE run = ? AND kind = 'refused'"
    (count,) = database.execute(f"SELECT COUNT(*) {these}", (run,)).fetchone()
    rows = database.execute(
        f"SELECT refusal {these} ORDER BY position, number LIMIT ?",
        (run, _LISTED),
    )
    return count, [str(Refusal(**json.loads(row["refusal"]))) for row in rows]


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


def _rate(started: float, ends: list[float]) -> float | None:
    """Specimens a second over the last ones that were finished."""
    if not ends:
        return None
    first = started if len(ends) < _RECENT else ends[-1]
    passed = time.time() - first
    return len(ends) / passed if passed > 0.0 else None
