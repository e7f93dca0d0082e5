"""How the functions of a servo's tick are compiled: for the disk, without the interpreter, without a heap.

numba's memory runtime is left out of them.  A function that allocates is then refused by the compiler, so
that "nothing is allocated in the loop" is checked whenever the loop is built; and no array is counted on its
way from function to function, which took more time than the arithmetic (an atomic operation for each array
and call).  Arrays belong to whoever calls from Python and outlive every call.

Floating point stays as it is written: no fast-math, no contraction, so that numba, Python and C agree bit
for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba as nb

__all__ = ["tick_kernel", "tick_part"]

Function = TypeVar("Function", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "_nrt": False}


def tick_kernel(function: Function) -> Function:
    """Compile a function of the tick: it may not allocate, and returns numbers alone."""
    kernel: Function = nb.njit(**_OPTIONS)(function)
    return kernel


def tick_part(function: Function) -> Function:
    """Compile a small function into whoever calls it: a call with four arrays passes 28 arguments."""
    kernel: Function = nb.njit(**_OPTIONS, forceinline=True)(function)
    return kernel
