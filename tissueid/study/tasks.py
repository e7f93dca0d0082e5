"""Tasks, bytes in and bytes out, computed in this process or in spawned ones of this machine.

Every process has a pipe of its own, so that a death is that of a known task: the process is replaced, the
task tried once more, and named if it dies again.
"""

from __future__ import annotations

import copyreg
import os
import pickle
import platform
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import connection, get_context
from types import MappingProxyType
from typing import Any, Protocol, Self

from tissueid import __version__
from tissueid.errors import InputError, TissueidError
from tissueid.own_process import end_with_parent, one_processor

#: Libraries whose version may change a number or a byte of a result.
_LIBRARIES = ("emcee", "h5py", "lmfit", "numba", "numpy", "pandas", "scipy")


@dataclass(frozen=True, slots=True)
class Task:
    """One piece of work."""

    number: int  # by which its outcome is known
    what: str  # function from bytes to bytes, as ``module:name``
    payload: bytes  # from :func:`packed`
    label: str = ""  # what a person calls it


@dataclass(frozen=True, slots=True)
class Fault:
    """Why a task has no result: a code of refusals, and a sentence."""

    code: str
    message: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a task."""

    number: int
    result: bytes | None
    fault: Fault | None
    seconds: float  # wall time of the computation
    worker: str


def _frozen(items: dict[str, Any]) -> MappingProxyType[str, Any]:
    return MappingProxyType(items)


# options and studies are frozen, mappings included, and pickle knows no mapping proxies
copyreg.pickle(MappingProxyType, lambda proxy: (_frozen, (dict(proxy),)))


def packed(value: Any) -> bytes:
    """A value as a task carries it."""
    return pickle.dumps(value, protocol=5)


def unpacked(content: bytes) -> Any:
    """Unpack what :func:`packed` packed; only ever of our own processes."""
    return pickle.loads(content)  # noqa: S301 -- tasks come from the process that started this one


@cache
def versions() -> dict[str, str]:
    """Versions of tissueid, Python and the numeric libraries in this process."""
    found = {"tissueid": __version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found


def perform(what: str, payload: bytes) -> bytes:
    """Run the function of a task."""
    module, _, name = what.partition(":")
    result: bytes = getattr(import_module(module), name)(payload)
    return result


def _was_interrupted(error: BaseException | None) -> bool:
    """True where an interrupt is behind an error: a compiled kernel wraps one that arrives within it."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def attempt(
    task: Task, worker: str | None = None, function: Callable[[str, bytes], bytes] = perform
) -> Outcome:
    """Run a task, by default as this process; whatever it raises, but an interrupt, becomes its fault."""
    worker = worker or f"process {os.getpid()}"
    began = time.perf_counter()
    result, fault = None, None
    try:
        result = function(task.what, task.payload)
    except MemoryError:
        fault = Fault("out_of_memory", "the memory did not suffice; use fewer --workers, or a larger machine")
    except TissueidError as error:
        fault = Fault(error.code if isinstance(error, InputError) else "job_failed", str(error))
    except Exception as error:
        # the outer shell of a job: a bug must not stop the others
        if _was_interrupted(error):
            raise KeyboardInterrupt from error
        fault = Fault(
            "job_failed", f"internal error ({type(error).__name__}: {error}). This is a bug in tissueid"
        )
    return Outcome(task.number, result, fault, time.perf_counter() - began, worker)


#: Times a task may take its process with it.
ATTEMPTS = 2
#: How long a process may take to end by itself [s].
_GRACE_S = 2.0

#: Told the number of a task and who begins it.
Started = Callable[[int, str], None]


class Workforce(Protocol):
    """Whoever computes tasks, so many at a time."""

    @property
    def size(self) -> int:
        """Tasks computed at once."""
        ...

    def run(self, tasks: Iterable[Task], started: Started) -> Iterator[Outcome]:
        """Outcomes as they come, in any order; tasks are taken from the iterable as they are needed."""
        ...


class InThisProcess:
    """No process but this one; ``one``: take one processor, and no threads on others."""

    size = 1

    def __init__(self, function: Callable[[str, bytes], bytes] = perform, *, one: bool = False) -> None:
        self._function, self._one = function, one

    def run(self, tasks: Iterable[Task], started: Started) -> Iterator[Outcome]:
        """Outcomes in the order of the tasks."""
        for task in tasks:
            started(task.number, "this process")
            with one_processor() if self._one else nullcontext():
                outcome = attempt(task, "this process", self._function)
            yield outcome


def _serve(pipe: Any) -> None:
    """A worker: tasks in, outcomes out, until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), one_processor():
        while True:
            try:
                task = unpacked(pipe.recv_bytes())
            except EOFError:
                return
            outcome = packed(attempt(task))
            pipe.send_bytes(outcome)


@dataclass(slots=True, eq=False)
class _Worker:
    """A process, its pipe, and the task it computes."""

    process: Any
    pipe: Any
    task: Task | None = None

    @property
    def name(self) -> str:
        return f"process {self.process.pid}"


class LocalProcesses:
    """Spawned processes of this machine, which ignore Ctrl-C and end when their parent does."""

    def __init__(self, workers: int) -> None:
        self.size = workers
        self._context = get_context("spawn")
        self._workers: list[_Worker] = []
        self._attempts: dict[int, int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.pipe.close()
            if worker.task is not None:
                worker.process.kill()
        deadline = time.monotonic() + _GRACE_S
        for worker in self._workers:
            worker.process.join(max(deadline - time.monotonic(), 0.0))
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
            worker.process.close()
        self._workers.clear()

    def _spawned(self) -> _Worker:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(theirs,), daemon=True)
        process.start()
        theirs.close()
        return _Worker(process, ours)

    def run(self, tasks: Iterable[Task], started: Started) -> Iterator[Outcome]:
        """Outcomes as they come; a process that dies is replaced and its task tried once more."""
        source = iter(tasks)
        again: deque[Task] = deque()
        self._attempts.clear()
        while True:
            self._hand_out(source, again, started)
            busy = [worker for worker in self._workers if worker.task is not None]
            if not busy:
                return
            ready = connection.wait([worker.pipe for worker in busy])
            outcomes = [self._received(worker, again) for worker in busy if worker.pipe in ready]
            # nobody waits for what the caller does with the results
            self._hand_out(source, again, started)
            yield from (outcome for outcome in outcomes if outcome is not None)

    def _hand_out(self, source: Iterator[Task], again: deque[Task], started: Started) -> None:
        """Give every process that has nothing to do a task."""
        while True:
            idle = next((worker for worker in self._workers if worker.task is None), None)
            if idle is None and len(self._workers) == self.size:
                return
            task = again.popleft() if again else next(source, None)
            if task is None:
                return
            if idle is None:
                idle = self._spawned()
                self._workers.append(idle)
            try:
                idle.pipe.send_bytes(packed(task))
            except OSError:
                # it died while it had nothing to do
                again.appendleft(task)
                self._remove(idle)
                continue
            idle.task = task
            started(task.number, idle.name)

    def _received(self, worker: _Worker, again: deque[Task]) -> Outcome | None:
        """The outcome a process has sent; ``None`` where it died and its task is tried again."""
        try:
            outcome: Outcome = unpacked(worker.pipe.recv_bytes())
        except (EOFError, OSError):
            return self._buried(worker, again)
        worker.task = None
        self._attempts.pop(outcome.number, None)
        return outcome

    def _remove(self, worker: _Worker) -> int | None:
        self._workers.remove(worker)
        worker.pipe.close()
        worker.process.join(_GRACE_S)
        code: int | None = worker.process.exitcode
        if code is None:
            worker.process.kill()
            worker.process.join()
        worker.process.close()
        return code

    def _buried(self, worker: _Worker, again: deque[Task]) -> Outcome | None:
        """Take a dead process away; what it computed is tried once more, or named."""
        name, task = worker.name, worker.task
        code = self._remove(worker)
        assert task is not None  # noqa: S101  (only those that compute are waited for)
        tried = self._attempts.get(task.number, 0) + 1
        self._attempts[task.number] = tried
        if tried < ATTEMPTS:
            again.append(task)
            return None
        message = (
            f"the process that computed it died {tried} times ({_how(code)}); the likely reason is memory: "
            "use fewer --workers, or a larger machine"
        )
        return Outcome(task.number, None, Fault("worker_killed", message), 0.0, name)


def _how(code: int | None) -> str:
    """End of a process, in words."""
    if code is None or code >= 0 or sys.platform == "win32":
        return f"exit code {code}"
    try:
        return f"signal {-code}, {signal.Signals(-code).name}"
    except ValueError:
        return f"signal {-code}"
