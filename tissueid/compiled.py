"""How the functions of a servo's tick are compiled: for the disk, without the interpreter, without a heap.

numba's memory runtime is left out of them.  A function that allocates is then refused by the compiler, so
that "nothing is allocated in the loop" is checked whenever the loop is built; and no array is counted on its
way from function to function, which took more time than the arithmetic (an atomic operation for each array
and call).  Arrays belong to whoever calls from Python and outlive every call.

Floating point stays as it is written: no fast-math, no contraction, so that numba, Python and C agree bit
for bit.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any, TypeVar

import numba as nb

__all__ = ["tick_kernel", "tick_part", "without_scipy"]

Function = TypeVar("Function", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}
_LINEAR_ALGEBRA = "scipy.linalg"


def tick_kernel(function: Function) -> Function:
    """Compile a function of the tick: it may not allocate, and returns numbers alone."""
    kernel: Function = nb.njit(**_OPTIONS)(function)
    return kernel


def tick_part(function: Function) -> Function:
    """Compile a small function into whoever calls it: a call with four arrays passes 28 arguments."""
    kernel: Function = nb.njit(**_OPTIONS, forceinline=True)(function)
    return kernel


@contextmanager
def without_scipy() -> Iterator[None]:
    """Let numba set itself up without scipy's linear algebra, which takes a fifth of a second.

    numba looks for it when it loads its first function; kernels of a tick have no matrices.  Whatever is
    imported afterwards finds it again.
    """
    if _LINEAR_ALGEBRA in sys.modules:
        yield
        return
    modules: dict[str, ModuleType | None] = sys.modules  # type: ignore[assignment] # None forbids an import
    modules[_LINEAR_ALGEBRA] = None
    try:
        yield
    finally:
        del modules[_LINEAR_ALGEBRA]
