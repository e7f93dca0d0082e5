"""Request of a user for a cohort, and its workplace: this process, others of this machine, or a cluster."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from tissueid.ingest import ReadOptions
from tissueid.manifest import Study
from tissueid.pipeline import IdentifyOptions
from tissueid.result import Refusal
from tissueid.study.processes import InThisProcess, LocalProcesses, Workforce

#: The scheduler that is no scheduler.
LOCAL = "local"
#: Processes are worth their start from so much work on [s]: each imports for two seconds.
WORTH_PROCESSES_S = 8.0
#: What a job is expected to cost: reading, segmenting and fitting [s a sample], and sampling [s].
SECONDS_A_SAMPLE = 5e-6
SECONDS_SAMPLING: Mapping[str, float] = {"emcee": 2.5, "none": 0.2}

Progress = Callable[[str, int, int], None]


def _nothing(*_: Any) -> None:
    """Told, and silent."""


@dataclass(frozen=True, slots=True)
class Request:
    """Request for a fit."""

    #: Files in their order; a refusal stands in the place of what was refused.  A
    #: :class:`tissueid.study.file_list.FileList` is small however many they are.
    found: Sequence[tuple[Path, str | None] | Refusal]
    reading: ReadOptions
    study: Study | None
    options: IdentifyOptions
    provenance: Mapping[str, Any] = field(default_factory=dict)  # added to the provenance of the run
    #: Processes; ``None`` takes as many as there are processors, where the work is worth their start.
    workers: int | None = None
    scheduler: str = LOCAL  # ``local``, or the address of a Dask scheduler
    read: Callable[[str, str | None], None] = _nothing  # told path and sheet of every recording
    #: Told once, when every file was looked into and nothing is fitted yet.
    all_read: Callable[[], None] = _nothing


def expected_seconds(samples: int, specimens: int, options: IdentifyOptions) -> float:
    """Roughly what some specimens cost on one processor [s]."""
    sampler = "none" if options.posterior is None else options.posterior.sampler
    return samples * SECONDS_A_SAMPLE + specimens * SECONDS_SAMPLING.get(sampler, 1.0)


class Workplace:
    """Workplace of a run; processes and connections are opened when they are first needed."""

    def __init__(self, workers: int | None, scheduler: str) -> None:
        self._workers, self._scheduler = workers, scheduler
        self._stack = ExitStack()
        self._opened: Workforce | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    @property
    def shared_disk(self) -> bool:
        """True where workers see the folders of this process."""
        return self._scheduler == LOCAL

    def workforce(
        self, tasks: int, seconds: float, function: Callable[[str, bytes], bytes], *, asked: bool
    ) -> Workforce:
        """Who computes some tasks.

        ``tasks``: how many there are; ``seconds``: what they are expected to cost together; ``function``: how
        this process computes one: word and payload -> result; ``asked``: whether the number of processes that
        the user asked for is meant for these tasks, however small.
        """
        if self._opened is None and self._scheduler != LOCAL:
            from tissueid.study.cluster import DaskWorkers

            self._opened = self._stack.enter_context(DaskWorkers(self._scheduler))
        if self._scheduler == LOCAL and self._opened is None:
            workers = min(self._workers or os.cpu_count() or 1, tasks)
            small = seconds < WORTH_PROCESSES_S and (self._workers is None or not asked)
            if workers < 2 or small:
                return InThisProcess(function, one=self._workers == 1)
            most = self._workers or os.cpu_count() or 1
            self._opened = self._stack.enter_context(LocalProcesses(most))
        assert self._opened is not None  # noqa: S101  (opened above)
        return self._opened
