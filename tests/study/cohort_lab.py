"""A folder of small specimens, two short logs each, tasks for workers, and what two output folders share."""

import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
from command_line import read_json, write_log

from tissueid.own_process import threads
from tissueid.store.results import each_result

STRIDE = 16


def write_specimen(folder: Path, number: int, *, times: float = 1.0) -> None:
    """Two 6 Hz logs of specimen ``head-<number>``, forces scaled by specimen and by log."""
    for log in range(2):
        scale = times * (1.0 + 0.05 * number + 0.01 * log)
        path = folder / f"h{number}-{log}.csv"
        write_log(path, label=f"head-{number}", stride=STRIDE, force_times=scale)


def write_cohort(folder: Path, specimens: int) -> Path:
    for number in range(specimens):
        write_specimen(folder, number)
    return folder


def numbers_of(out: Path) -> dict[str, Any]:
    """Everything a run found: the document, and every curve and draw."""
    found: dict[str, Any] = {"document": read_json(out / "identification.json")}
    for document, curves, posterior in each_result(out):
        arrays = [getattr(one.curve, name) for one in curves for name in ("time_s", "force_N", "model_N")]
        if posterior is not None:
            arrays += [posterior.draws, posterior.chain]
        found[document.specimen] = [np.ascontiguousarray(array).tobytes() for array in arrays]
    return found


def doubled(payload: bytes) -> bytes:
    """A task that ends well."""
    return payload * 2


def threads_there(_: bytes) -> bytes:
    """Number of threads, of seven, that a computation may start."""
    return str(threads(7)).encode()


def killed(payload: bytes) -> bytes:
    """A task that takes its process with it."""
    os.kill(os.getpid(), signal.SIGKILL)
    return payload


def killed_once(payload: bytes) -> bytes:
    """A task that takes its first process with it: the payload names a file that says it did."""
    mark = Path(payload.decode())
    if mark.exists():
        return b"second time"
    mark.touch()
    return killed(payload)


def out_of_memory(payload: bytes) -> bytes:
    raise MemoryError


def with_a_bug(payload: bytes) -> bytes:
    return payload[len(payload) + 1 :] + bytes([payload[len(payload)]])
