"""Run simulations, in this process or in several: each from its own stream of the seed, none twice."""

from __future__ import annotations

import multiprocessing
import pickle
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tissueid.own_process import end_with_parent
from tissueid.selfcheck.records import Checkpoint, Record, Replicate, record_of

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
    progress: _Progress | None = None,
) -> tuple[Record, ...]:
    """Simulate what the checkpoint does not hold yet.

    ``checkpoint``: each finished simulation is appended; ``simulations``: in all, those of the checkpoint
    included; ``workers``: processes; 1 stays in this one; ``progress``: ``progress(message, done, total)``.
    Returns the first ``simulations``, in their order.
    """
    progress = progress or (lambda _message, _done, _total: None)
    missing = checkpoint.missing(simulations)
    done = simulations - len(missing)
    progress("simulating", done, simulations)
    for record in _records(check, seed, missing, workers):
        checkpoint.add(record)
        done += 1
        progress("simulating", done, simulations)
    return checkpoint.first(simulations)
