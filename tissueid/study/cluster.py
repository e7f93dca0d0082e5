"""Tasks on a Dask cluster: a few in hand for every worker, and nothing kept by the scheduler.

A scheduler that is lost is waited for, and given up after a minute with what was finished kept.  Workers must
have the versions of this process, and see the files where it sees them.
"""

from __future__ import annotations

import os
import time
from concurrent.futures import CancelledError, Executor, Future
from pathlib import Path
from typing import Any, Self

from tissueid.errors import BundleError, refuse
from tissueid.study.tasks import Fault, Futures, Outcome, Started, Task, attempt_beside_others, versions

#: Tasks in hand for every worker: one is computed while the next waits beside it.
IN_HAND = 2
#: How long a scheduler may take to answer, and how often and how far apart it is asked again [s].
CONNECT_S = 10.0
RECONNECTS = 6
RECONNECT_S = 5.0
#: How long to wait for the first worker [s].
WORKERS_S = 60.0


def compute(task: Task, folder: str, wanted: dict[str, str]) -> Outcome:
    """Work of a worker; relative paths are those of ``folder``.  UsageError: it has other versions."""
    other = {name: version for name, version in versions().items() if wanted.get(name) != version}
    if other:
        from distributed import get_worker

        said = ", ".join(f"{name} {version} (not {wanted.get(name)})" for name, version in other.items())
        refuse(f"worker {get_worker().address} has {said}")
    if Path(folder).is_dir() and Path.cwd() != Path(folder):
        os.chdir(folder)
    return attempt_beside_others(task)


class DaskWorkers(Futures):
    """The workers of a Dask scheduler at ``tcp://HOST:8786`` or ``tls://HOST:8786``.

    Raises UsageError: Dask is not installed, there is no scheduler or no worker there, or a worker has
    other versions.
    """

    _client: Any = None
    _executor: Executor
    _scheduler: str  # which one of those that ever were at the address has the tasks in hand

    def __init__(self, address: str) -> None:
        if "://" not in address:
            refuse(f"--scheduler {address}: give an address, as tcp://HOST:8786, or local")
        self._address = address
        self._folder, self._versions = str(Path.cwd()), versions()

    def __enter__(self) -> Self:
        try:
            import distributed  # noqa: F401
        except ImportError as error:
            refuse(f"--scheduler {self._address} needs Dask ({error}); pip install 'tissueid[cluster]'")
        try:
            self._connect(WORKERS_S)
        except (OSError, ValueError) as error:
            self._close()
            refuse(
                f"{self._address}: no Dask scheduler with a worker answers there ({error}); start them by "
                "`dask scheduler` and `dask worker ADDRESS --nthreads 1`"
            )
        self._check_versions()
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def _connect(self, patience_s: float) -> None:
        import distributed

        self._close()
        client: Any = distributed.Client
        self._client = client(self._address, timeout=CONNECT_S, direct_to_workers=False)
        self._client.wait_for_workers(1, timeout=patience_s)
        self._executor = self._client.get_executor(pure=False)
        self._scheduler = self._client.scheduler_info()["id"]

    def _close(self) -> None:
        if self._client is not None:
            self._client.close(timeout=1.0)
            self._client = None

    def _check_versions(self) -> None:
        """Refuse a cluster whose numbers would not be ours, naming every worker that differs."""
        wanted = self._versions
        try:
            found = self._client.run(versions)
        except ImportError as error:
            self._close()
            refuse(f"{self._address}: a worker can't import tissueid ({error}); install it there")
        others = [
            f"{worker}: {', '.join(f'{name} {has[name]} (here {wanted[name]})' for name in differ)}"
            for worker, has in found.items()
            if (differ := [name for name in wanted if has.get(name) != wanted[name]])
        ]
        if others:
            self._close()
            refuse(f"workers of {self._address} have other versions: {'; '.join(others)}")

    @property
    def most(self) -> int:
        """A few tasks for every thread of all workers."""
        found = self._client.scheduler_info(n_workers=-1)["workers"].values()
        return IN_HAND * (sum(worker["nthreads"] for worker in found) or 1)

    def submit(self, task: Task, started: Started) -> Future[Outcome]:
        """Hand a task to the scheduler."""
        future = self._executor.submit(compute, task, self._folder, self._versions)
        started(task.number, self._address)
        return future

    def outcome(self, task: Task, future: Future[Outcome]) -> Outcome | None:
        """Outcome a worker has sent, or named as lost with several; ``None`` where the scheduler was lost."""
        from distributed import KilledWorker

        try:
            return future.result()
        except KilledWorker as error:
            message = (
                f"the workers that computed it died ({error.last_worker.address} the last of them); the "
                "likely reason is memory: give workers more, or start fewer on a machine"
            )
            return Outcome(task.number, None, Fault("worker_killed", message))
        except (CancelledError, OSError, TypeError):
            # a result that is lost on its way is what Dask's executor takes for an error, and can't unpack
            return None

    def lost(self) -> bool:
        """True after another scheduler was found; BundleError where one that was lost stays away."""
        client = self._client
        if client.status == "running" and client.scheduler_info()["id"] == self._scheduler:
            return False
        for number in range(RECONNECTS):
            try:
                self._connect(CONNECT_S)
            except (OSError, ValueError):
                if number + 1 < RECONNECTS:
                    time.sleep(RECONNECT_S)
            else:
                return True
        self._close()
        raise BundleError(
            f"{self._address}: the Dask scheduler was lost and is not back; what was finished is kept: run "
            "the same command again when it is there"
        )
