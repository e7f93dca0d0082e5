"""A task is bytes in, bytes out: the same in this process, in a spawned one and on a cluster.

``perform`` finds the function by its name and runs it; ``attempt`` turns whatever it raises into a
:class:`Fault`, so that one specimen never stops the others.  Who computes checks first that it has the
versions of who asked: numbers of other libraries would not be the same numbers.
"""

from __future__ import annotations

import copyreg
import os
import pickle
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from types import MappingProxyType
from typing import Any

from tissueid import __version__
from tissueid.errors import InputError, TissueidError

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
    """Run a task; whatever it raises, but an interrupt, becomes its fault.

    ``worker``: who runs it; this process's number by default; ``function``: in place of :func:`perform`.
    """
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
