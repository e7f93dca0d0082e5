"""Tasks, bytes in and bytes out: futures of one executor of :mod:`concurrent.futures`, a few in hand at once.

On this machine each thread of the executor waits for a spawned process with a pipe of its own, so that a
death is that of a known task: the process is replaced, the task tried once more, and named if it dies again.
"""

from __future__ import annotations

import pickle
import platform
import signal
import time
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from multiprocessing import get_context
from typing import Any

from tissueid import __version__, extras
from tissueid.errors import InputError, TissueidError, was_interrupted
from tissueid.own_process import end_with_parent, one_processor

#: Libraries whose version may change a number or a byte of a result.
_LIBRARIES = ("emcee", "h5py", "lmfit", "numba", "numpy", "pandas", "scipy")


@dataclass(frozen=True, slots=True)
class Task:
    """One piece of work."""

    number: int  # by which its outcome is known
    what: str  # function from bytes to bytes, as ``module:name``
    payload: bytes  # from :func:`packed`


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
    seconds: float = 0.0  # wall time of the computation


def packed(value: Any) -> bytes:
    """A value as a task carries it."""
    return pickle.dumps(value, protocol=5)


def unpacked(content: bytes) -> Any:
    """Unpack what :func:`packed` packed; only ever of our own processes."""
    return pickle.loads(content)  # noqa: S301 -- tasks come from the process that started this one


@cache
def versions() -> dict[str, str]:
    """Versions of tissueid, Python and the numeric libraries in this process."""
    own = {"tissueid": __version__, "python": platform.python_version()}
    return {**own, **dict.fromkeys(_LIBRARIES, "none"), **extras.versions(_LIBRARIES)}


def perform(what: str, payload: bytes) -> bytes:
    """Run the function of a task."""
    module, _, name = what.partition(":")
    result: bytes = getattr(import_module(module), name)(payload)
    return result


def attempt(task: Task, function: Callable[[str, bytes], bytes] = perform) -> Outcome:
    """Run a task, by default as any process does; whatever it raises, but an interrupt, becomes its fault."""
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
        if was_interrupted(error):
            raise KeyboardInterrupt from error
        fault = Fault(
            "job_failed", f"internal error ({type(error).__name__}: {error}). This is a bug in tissueid"
        )
    return Outcome(task.number, result, fault, time.perf_counter() - began)


def attempt_beside_others(task: Task) -> Outcome:
    """Run a task on one processor, without threads on those that compute others."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), one_processor():
        return attempt(task)


#: Times a task may take its process with it.
ATTEMPTS = 2
#: How long a process may take to end by itself, and between two looks at who computes [s].
_GRACE_S, _LOOK_S = 2.0, 1.0

#: Told the number of a task and who begins it.
Started = Callable[[int, str], None]


class InThisProcess:
    """No process but this one; ``one``: take one processor, and no threads on others."""

    def __init__(self, function: Callable[[str, bytes], bytes] = perform, *, one: bool = False) -> None:
        self._function, self._one = function, one

    def run(self, tasks: Iterable[Task], started: Started) -> Iterator[Outcome]:
        """Outcomes in the order of the tasks."""
        for task in tasks:
            started(task.number, "this process")
            with one_processor() if self._one else nullcontext():
                outcome = attempt(task, self._function)
            yield outcome


class Futures(ABC):
    """Tasks as futures of an executor."""

    @property
    @abstractmethod
    def most(self) -> int:
        """Tasks in hand at once."""

    @abstractmethod
    def submit(self, task: Task, started: Started) -> Future[Outcome]:
        """Hand a task to the executor."""

    @abstractmethod
    def outcome(self, task: Task, future: Future[Outcome]) -> Outcome | None:
        """Outcome of a task whose future has ended; ``None`` where it is to be computed again."""

    def lost(self) -> bool:
        """True where those who had the tasks in hand are gone, and others there."""
        return False

    def run(self, tasks: Iterable[Task], started: Started) -> Iterator[Outcome]:
        """Outcomes as they come, in any order; tasks are taken from the iterable as they are needed."""
        source, again = iter(tasks), deque[Task]()
        in_hand: dict[Future[Outcome], Task] = {}
        outcomes: list[Outcome] = []
        most = 0
        while True:
            most = most if in_hand else self.most
            while len(in_hand) < most:
                task = again.popleft() if again else next(source, None)
                if task is None:
                    break
                in_hand[self.submit(task, started)] = task
            # nobody waits for what the caller does with the results
            yield from outcomes
            if not in_hand:
                return
            outcomes = []
            for future in wait(in_hand, _LOOK_S, FIRST_COMPLETED).done:
                task = in_hand.pop(future)
                outcome = self.outcome(task, future)
                if outcome is None:
                    again.append(task)
                else:
                    outcomes.append(outcome)
            if not outcomes and self.lost():
                again.extend(in_hand.values())
                in_hand.clear()


#: Whoever computes tasks, so many at a time.
Workforce = InThisProcess | Futures


def _serve(pipe: Any) -> None:
    """A worker: tasks in, outcomes out, until the pipe is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    with suppress(EOFError):
        while True:
            pipe.send(attempt_beside_others(pipe.recv()))


class _Worker:
    """A spawned process, which ignores Ctrl-C and ends when its parent does."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        self.process.start()
        theirs.close()
        self.name = f"process {self.process.pid}"

    def compute(self, task: Task) -> Outcome:
        """Outcome of a task; EOFError or OSError where the process dies of it."""
        self._pipe.send(task)
        outcome: Outcome = self._pipe.recv()
        return outcome

    def end(self) -> int | None:
        """End the process, at once where it died already; its exit code."""
        self._pipe.close()
        self.process.join(_GRACE_S)
        self.process.kill()
        self.process.join()
        return self.process.exitcode


class LocalProcesses(Futures, AbstractContextManager["LocalProcesses"]):
    """Spawned processes of this machine."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._threads = ThreadPoolExecutor(workers)
        self._idle: list[_Worker] = []
        self._busy: dict[Future[Outcome], _Worker] = {}
        self._deaths: Counter[int] = Counter()

    def __exit__(self, *_: object) -> None:
        for worker in self._busy.values():
            worker.process.kill()
        list(self._threads.map(_Worker.end, (*self._idle, *self._busy.values())))
        self._threads.shutdown()

    @property
    def most(self) -> int:
        """One task a process."""
        return self._workers

    def submit(self, task: Task, started: Started) -> Future[Outcome]:
        """Hand a task to a process that has nothing to do, or to a new one."""
        # one may have died while it had nothing to do
        self._idle = [worker for worker in self._idle if worker.process.is_alive()]
        worker = self._idle.pop() if self._idle else _Worker()
        future = self._threads.submit(worker.compute, task)
        self._busy[future] = worker
        started(task.number, worker.name)
        return future

    def outcome(self, task: Task, future: Future[Outcome]) -> Outcome | None:
        """Outcome a process has sent; where it died its task is tried once more, or named."""
        worker = self._busy.pop(future)
        try:
            outcome = future.result()
        except (EOFError, OSError):
            code = worker.end()
            self._deaths[task.number] += 1
            if self._deaths[task.number] < ATTEMPTS:
                return None
            message = (
                f"the process that computed it died {ATTEMPTS} times ({_how(code)}); the likely reason is "
                "memory: use fewer --workers, or a larger machine"
            )
            outcome = Outcome(task.number, None, Fault("worker_killed", message))
        else:
            self._idle.append(worker)
        del self._deaths[task.number]
        return outcome


def _how(code: int | None) -> str:
    """End of a process, in words."""
    if code is not None and code < 0:
        with suppress(ValueError):
            return f"signal {-code}, {signal.Signals(-code).name}"
    return f"exit code {code}"
