"""Simulations, each from its own stream of the seed, and the file their records are appended to.

Records do not depend on how many workers made them, in which order, or in how many calls.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import pickle
import signal
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import MsgspecError, structs
from msgspec.json import decode
from threadpoolctl import threadpool_limits

from tissueid.arrays import FloatArray
from tissueid.documents.base import Document
from tissueid.errors import refuse
from tissueid.own_process import end_with_parent
from tissueid.store.files import write_file

FORMAT = "tissueid/selfcheck-records/1"
#: Draws a truth is ranked among: 400 equally likely ranks hold 80, 90 and 95 % without rounding.
DRAWS = 399


@dataclass(frozen=True, slots=True, eq=False)
class Replicate:
    """One simulation: a truth, and draws of its posterior."""

    truth: Mapping[str, float]  # name -> true value
    #: The same names -> draws, shape (L,), L >= :data:`DRAWS`, independent or nearly so.
    draws: Mapping[str, FloatArray]
    #: Further numbers that are kept, as the acceptance of the sampler.
    detail: Mapping[str, float] = field(default_factory=dict)
    #: Some of the names -> the 95 % interval that a fit quotes.
    quoted: Mapping[str, tuple[float, float]] = field(default_factory=dict)


class Record(Document, frozen=True):
    """Numbers that are kept of one simulation."""

    index: int
    #: True value, posterior mean and standard deviation by name.
    truth: Mapping[str, float] = {}
    mean: Mapping[str, float] = {}
    sd: Mapping[str, float] = {}
    #: Rank of the truth among the thinned draws, 0 to DRAWS.
    rank: Mapping[str, int] = {}
    seconds: float = 0.0
    failed: str | None = None  # why there is no posterior; the mappings are then empty
    detail: Mapping[str, float] = {}
    #: True where the quoted interval held the truth, for names that have one.
    held: Mapping[str, bool] = {}

    def line(self) -> bytes:
        """One line of the checkpoint."""
        return json.dumps(structs.asdict(self), allow_nan=False).encode() + b"\n"


def rank_of(truth: float, draws: FloatArray, rng: np.random.Generator) -> int:
    """Rank of a truth among draws: how many lie below it, ties broken at random."""
    below = int((draws < truth).sum())
    equal = int((draws == truth).sum())
    return below + (int(rng.integers(equal + 1)) if equal else 0)


def thinned(draws: FloatArray) -> FloatArray:
    """DRAWS draws, evenly spread over all of them."""
    if draws.size < DRAWS:
        raise ValueError(f"{draws.size} draws, {DRAWS} are needed to rank a truth")
    return draws[np.linspace(0, draws.size - 1, DRAWS).round().astype(np.int64)]


def record_of(index: int, replicate: Replicate, rng: np.random.Generator, *, seconds: float) -> Record:
    """Rank every truth among its draws; draws that are no numbers are no posterior."""
    for name, values in replicate.draws.items():
        if not np.isfinite(values).all():
            return Record(index=index, failed=f"draws of {name} that are no numbers", seconds=seconds)
    ranked = {
        name: rank_of(truth, thinned(replicate.draws[name]), rng) for name, truth in replicate.truth.items()
    }
    return Record(
        index=index,
        truth={name: float(value) for name, value in replicate.truth.items()},
        mean={name: float(values.mean()) for name, values in replicate.draws.items()},
        sd={name: float(values.std(ddof=1)) for name, values in replicate.draws.items()},
        rank=ranked,
        seconds=seconds,
        detail=dict(replicate.detail),
        held={
            name: bool(low <= replicate.truth[name] <= high) for name, (low, high) in replicate.quoted.items()
        },
    )


def fingerprint(what: Any) -> str:
    """SHA-256 of anything that JSON can say."""
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()


class Checkpoint(AbstractContextManager["Checkpoint"]):
    """The records of a check, in a file that survives a kill."""

    def __init__(self, path: Path, digest: str) -> None:
        self.path = path
        self.records: dict[int, Record] = {}
        header = json.dumps({"format": FORMAT, "digest": digest}).encode() + b"\n"
        whole = header
        if path.is_file():
            whole = self._read(path.read_bytes(), header)
        if not path.is_file() or path.stat().st_size != len(whole):
            write_file(path, whole)
        self._stream = path.open("ab")

    def _read(self, content: bytes, header: bytes) -> bytes:
        """Take over what is there; returns its whole lines."""
        whole = content[: content.rfind(b"\n") + 1]
        if not whole and header.startswith(content):
            # killed while the first line was written
            return header
        lines = whole.splitlines(keepends=True)
        if not lines or lines[0] != header:
            refuse(
                f"{self.path} holds the simulations of another check (other data, options, seed or version): "
                "choose another folder with -o, or delete that file to begin anew"
            )
        for line in lines[1:]:
            try:
                record = decode(line, type=Record)
            except (MsgspecError, ValueError):
                refuse(f"{self.path} is damaged: delete it to begin anew, or choose another folder with -o")
            self.records[record.index] = record
        return whole

    def missing(self, simulations: int) -> list[int]:
        """Indices that are still to be simulated."""
        return [index for index in range(simulations) if index not in self.records]

    def add(self, record: Record) -> None:
        """Append one record."""
        self.records[record.index] = record
        self._stream.write(record.line())
        self._stream.flush()

    def first(self, simulations: int) -> tuple[Record, ...]:
        """Records of the first simulations, in their order."""
        return tuple(self.records[index] for index in range(simulations) if index in self.records)

    def __exit__(self, *_: object) -> None:
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()


#: Draws a truth, simulates data and infers it again; goes to workers by pickle.  An ArithmeticError or
#: LinAlgError says that the inference failed on these data, which is counted.
Check = Callable[[np.random.Generator], Replicate]
_Progress = Callable[[str, int, int], None]


def one_record(check: Check, seed: int, index: int) -> Record:
    """Simulation ``index`` of a seed: the same whatever ran before it, and where."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(index,)))
    started = time.perf_counter()
    try:
        replicate = check(rng)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        return Record(index=index, failed=f"{type(error).__name__}: {error}")
    return record_of(index, replicate, rng, seconds=round(time.perf_counter() - started, 4))


_check: Any = None


def _begin(packed: bytes) -> None:
    """Unpack the check once a worker; an interrupt is the parent's to answer."""
    global _check
    end_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(limits=1, user_api="blas")
    _check = pickle.loads(packed)  # noqa: S301 -- packed by the parent process


def _in_worker(seed: int, index: int) -> Record:
    return one_record(_check, seed, index)


def _records(check: Check, seed: int, indices: list[int], workers: int) -> Iterator[Record]:
    if workers == 1 or len(indices) == 1:
        # small matrices lose by BLAS threads
        with threadpool_limits(limits=1, user_api="blas"):
            for index in indices:
                yield one_record(check, seed, index)
        return
    with ProcessPoolExecutor(
        min(workers, len(indices)),
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_begin,
        initargs=(pickle.dumps(check),),
    ) as pool:
        # left early, what waits is cancelled
        yield from pool.map(partial(_in_worker, seed), indices)


def run_simulations(
    check: Check,
    checkpoint: Checkpoint,
    *,
    simulations: int,
    seed: int,
    workers: int = 1,
    progress: _Progress = lambda _message, _done, _total: None,
) -> tuple[Record, ...]:
    """Simulate what the checkpoint does not hold yet."""
    missing = checkpoint.missing(simulations)
    done = simulations - len(missing)
    progress("simulating", done, simulations)
    for record in _records(check, seed, missing, workers):
        checkpoint.add(record)
        done += 1
        progress("simulating", done, simulations)
    return checkpoint.first(simulations)
