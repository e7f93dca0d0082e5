"""Records of the simulations, and the file they are appended to.

One line of JSON a simulation, written and flushed as soon as it is finished; the first line names what is
being checked.  A line that a kill has cut is dropped, and the next call goes on behind the last whole one.
Simulation ``i`` draws from its own stream of the seed, so the records do not depend on how many workers
made them, in which order, or in how many calls.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import UsageError
from tissueid.selfcheck.ranks import DRAWS, rank_of
from tissueid.store.files import write_file

FORMAT = "tissueid/selfcheck-records/1"


@dataclass(frozen=True, slots=True, eq=False)
class Replicate:
    """One simulation: a truth, and draws of its posterior."""

    truth: Mapping[str, float]  # name -> true value
    #: The same names -> draws, shape (L,), L >= :data:`~tissueid.selfcheck.ranks.DRAWS`, independent or
    #: nearly so.
    draws: Mapping[str, FloatArray]
    #: Further numbers that are kept, as the acceptance of the sampler.
    detail: Mapping[str, float] = field(default_factory=dict)
    #: Some of the names -> the 95 % interval that a fit quotes.
    quoted: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Record:
    """Numbers that are kept of one simulation."""

    index: int
    #: True value, posterior mean and standard deviation by name.
    truth: Mapping[str, float] = field(default_factory=dict)
    mean: Mapping[str, float] = field(default_factory=dict)
    sd: Mapping[str, float] = field(default_factory=dict)
    #: Rank of the truth among the thinned draws, 0 to DRAWS.
    rank: Mapping[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    failed: str | None = None  # why there is no posterior; the mappings are then empty
    detail: Mapping[str, float] = field(default_factory=dict)
    #: True where the quoted interval held the truth, for names that have one.
    held: Mapping[str, bool] = field(default_factory=dict)

    def line(self) -> bytes:
        """One line of the checkpoint."""
        values = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return json.dumps(values, allow_nan=False).encode() + b"\n"


def thinned(draws: FloatArray) -> FloatArray:
    """DRAWS draws, evenly spread over all of them."""
    if draws.size < DRAWS:
        msg = f"{draws.size} draws, {DRAWS} are needed to rank a truth"
        raise ValueError(msg)
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


class Checkpoint:
    """The records of a check, in a file that survives a kill.

    ``path``: read where it exists, else made; ``digest``: of what is checked; a file with another is refused.
    Raises UsageError: the file holds another check, or none.
    """

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
            msg = (
                f"{self.path} holds the simulations of another check (other data, options, seed or version): "
                "choose another folder with -o, or delete that file to begin anew"
            )
            raise UsageError(msg)
        for line in lines[1:]:
            record = _record_of_line(line)
            if record is None:
                msg = f"{self.path} is damaged: delete it to begin anew, or choose another folder with -o"
                raise UsageError(msg)
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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()


def _record_of_line(line: bytes) -> Record | None:
    """The record a line holds; ``None`` where it holds none."""
    try:
        values = json.loads(line)
        known = isinstance(values, dict) and isinstance(values.get("index"), int)
        return Record(**values) if known else None
    except (ValueError, TypeError):
        return None


def failures(records: Iterable[Record]) -> list[Record]:
    """Records without a posterior."""
    return [record for record in records if record.failed is not None]
