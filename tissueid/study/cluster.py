"""Tasks on a Dask cluster: a few in hand for every worker, and nothing kept by the scheduler.

A scheduler that is lost is waited for, and given up after a minute with what was finished kept.  Workers must
have the versions of this process, and see the files where it sees them.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import time
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Self

from tissueid.errors import BundleError, UsageError
from tissueid.own_process import one_processor
from tissueid.study.tasks import Fault, Outcome, Started, Task, attempt, packed, unpacked, versions

#: Tasks in hand for every worker: one is computed while the next waits beside it.
IN_HAND = 2
#: How long a scheduler may take to answer, and how often and how far apart it is asked again [s].
CONNECT_S = 10.0
RECONNECTS = 6
RECONNECT_S = 5.0
#: How long to wait for the first worker [s].
WORKERS_S = 60.0
#: Between two looks whether the scheduler is still there [s].
LOOK_S = 1.0


def compute(content: bytes, folder: str, wanted: dict[str, str]) -> bytes:
    """Work of a worker: a packed task in, a packed outcome out; relative paths are those of ``folder``."""
    from distributed import get_worker

    worker = str(get_worker().address)
    task: Task = unpacked(content)
    other = {name: version for name, version in versions().items() if wanted.get(name) != version}
    if other:
        said = ", ".join(f"{name} {version} (not {wanted.get(name)})" for name, version in other.items())
        fault = Fault("other_versions", f"worker {worker} has {said}")
        return packed(Outcome(task.number, None, fault, 0.0, worker))
    if Path(folder).is_dir() and Path.cwd() != Path(folder):
        os.chdir(folder)
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1), one_processor():
        return packed(attempt(task, worker))


class _SchedulerLostError(Exception):
    """The scheduler does not answer."""


class DaskWorkers:
    """The workers of a Dask scheduler at ``tcp://HOST:8786`` or ``tls://HOST:8786``.

    Raises UsageError: Dask is not installed, there is no scheduler or no worker there, or a worker has
    other versions.
    """

    def __init__(self, address: str) -> None:
        if "://" not in address:
            msg = f"--scheduler {address}: give an address, as tcp://HOST:8786, or local"
            raise UsageError(msg)
        self._address = address
        self._client: Any = None
        self._distributed: Any = None
        self._runs = itertools.count()

    def __enter__(self) -> Self:
        try:
            import distributed
        except ImportError as error:
            msg = f"--scheduler {self._address} needs Dask ({error}); pip install 'tissueid[cluster]'"
            raise UsageError(msg) from error
        self._distributed = distributed
        try:
            self._connect()
            self._client.wait_for_workers(1, timeout=WORKERS_S)
        except (OSError, TimeoutError, ValueError, _SchedulerLostError) as error:
            self._close()
            msg = (
                f"{self._address}: no Dask scheduler with a worker answers there ({error}); start them by "
                "`dask scheduler` and `dask worker ADDRESS --nthreads 1`"
            )
            raise UsageError(msg) from error
        self._check_versions()
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    @property
    def size(self) -> int:
        """Threads of all workers."""
        found = self._client.scheduler_info(n_workers=-1)["workers"].values()
        return sum(worker["nthreads"] for worker in found) or 1

    def _connect(self) -> None:
        self._close()
        self._client = self._distributed.Client(self._address, timeout=CONNECT_S, direct_to_workers=False)

    def _close(self) -> None:
        if self._client is not None:
            self._client.close(timeout=LOOK_S)
            self._client = None

    def _check_versions(self) -> None:
        """Refuse a cluster whose numbers would not be ours, naming every worker that differs."""
        wanted = versions()
        try:
            found = self._client.run(_versions_there)
        except ImportError as error:
            self._close()
            msg = f"{self._address}: a worker can't import tissueid ({error}); install it there"
            raise UsageError(msg) from error
        others = [
            f"{worker}: {', '.join(f'{name} {has[name]} (here {wanted[name]})' for name in differ)}"
            for worker, has in found.items()
            if (differ := [name for name in wanted if has.get(name) != wanted[name]])
        ]
        if others:
            self._close()
            msg = f"workers of {self._address} have other versions: {'; '.join(others)}"
            raise UsageError(msg)

    def run(self, tasks: Iterable[Task], started: Started) -> Iterator[Outcome]:
        """Outcomes as they come; BundleError where a scheduler that was lost stays away."""
        source = iter(tasks)
        again: deque[Task] = deque()
        while True:
            in_hand: dict[Any, Task] = {}
            try:
                yield from self._run(source, again, in_hand, started)
            except _SchedulerLostError:
                again.extend(in_hand.values())
                self._reconnect()
            else:
                return

    def _run(
        self, source: Iterator[Task], again: deque[Task], in_hand: dict[Any, Task], started: Started
    ) -> Iterator[Outcome]:
        run = next(self._runs)
        folder, wanted = str(Path.cwd()), versions()
        most = IN_HAND * self.size
        while True:
            while len(in_hand) < most:
                task = again.popleft() if again else next(source, None)
                if task is None:
                    break
                key = f"tissueid-{os.getpid()}-{id(self)}-{run}-{task.number}"
                future = self._client.submit(compute, packed(task), folder, wanted, key=key, pure=False)
                in_hand[future] = task
                started(task.number, self._address)
            if not in_hand:
                return
            for future in self._done(list(in_hand)):
                task = in_hand[future]
                outcome = self._outcome(future, task)
                del in_hand[future]
                future.release()
                yield outcome

    def _done(self, futures: list[Any]) -> list[Any]:
        """Those that have ended, at least one; looks now and then whether the scheduler is there."""
        while True:
            if any(future.status in {"cancelled", "lost"} for future in futures):
                raise _SchedulerLostError
            done = [future for future in futures if future.done()]
            if done:
                return done
            if self._client.status != "running":
                raise _SchedulerLostError
            try:
                self._distributed.wait(futures, timeout=LOOK_S, return_when="FIRST_COMPLETED")
            except TimeoutError:
                continue
            except (asyncio.CancelledError, OSError, self._distributed.CancelledError) as error:
                raise _SchedulerLostError from error

    def _outcome(self, future: Any, task: Task) -> Outcome:
        try:
            outcome: Outcome = unpacked(future.result(timeout=CONNECT_S))
        except self._distributed.KilledWorker as error:
            message = (
                f"the workers that computed it died ({error.last_worker.address} the last of them); the "
                "likely reason is memory: give workers more, or start fewer on a machine"
            )
            return Outcome(task.number, None, Fault("worker_killed", message), 0.0, self._address)
        except (asyncio.CancelledError, self._distributed.CancelledError, OSError) as error:
            raise _SchedulerLostError from error
        if outcome.fault is not None and outcome.fault.code == "other_versions":
            raise UsageError(outcome.fault.message)
        return outcome

    def _reconnect(self) -> None:
        """Ask for the scheduler until it is back with a worker."""
        for number in range(RECONNECTS):
            try:
                self._connect()
                self._client.wait_for_workers(1, timeout=CONNECT_S)
            except (OSError, TimeoutError, ValueError):
                if number + 1 < RECONNECTS:
                    time.sleep(RECONNECT_S)
                continue
            return
        self._close()
        msg = (
            f"{self._address}: the Dask scheduler was lost and is not back; what was finished is kept: run "
            "the same command again when it is there"
        )
        raise BundleError(msg)


def _versions_there() -> dict[str, str]:
    return versions()
