"""Compilation of functions: for the disk, without the interpreter, and in a servo's tick without a heap.

Compiled functions are kept in a folder that is named by a hash of all their sources
(:mod:`tissueid.kernel_cache`): numba's own key knows the caller's source and not its callees'.

In a tick numba's memory runtime is left out.  A function that allocates is then refused by the compiler, so
that "nothing is allocated in the loop" is checked whenever the loop is built; and no array is counted on its
way from function to function, which took more time than the arithmetic (an atomic operation for each array
and call).  Arrays belong to whoever calls from Python and outlive every call.

Floating point stays as it is written: no fast-math, no contraction, so that numba, Python and C agree bit
for bit.  Without numba (the extra ``haptics``) functions stay as they are written, and a fit needs no more;
a servo, or chains of a population, ask for it (:func:`tissueid.extras.require`).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import ModuleType
from typing import Any, TypeVar

from tissueid.extras import installed
from tissueid.kernel_cache import cache_folder

if installed("numba"):
    import numba as nb

Function = TypeVar("Function", bound=Callable[..., Any])

_TICK: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
_LINEAR_ALGEBRA = "scipy.linalg"


def _for_the_disk(function: Function, options: dict[str, Any]) -> Function:
    """Compile at the first call, or load what was compiled from the same sources."""
    if not installed("numba"):
        return function
    settings: Any = nb.config
    folder, before = cache_folder(), settings.CACHE_DIR
    if folder is not None:
        settings.CACHE_DIR = str(folder)
    try:
        compiled: Function = nb.njit(cache=folder is not None, nogil=True, **options)(function)
    finally:
        settings.CACHE_DIR = before
    return compiled


def kernel(
    *, error_model: str = "numpy", fastmath: set[str] | bool = False
) -> Callable[[Function], Function]:
    """Compile a function of arrays and numbers, without the interpreter's lock.

    ``error_model``: ``numpy`` divides by zero as arrays do, ``python`` raises; ``fastmath``: liberties with
    floating point, as LLVM names them.
    """
    options = {"error_model": error_model, "fastmath": fastmath}
    return lambda function: _for_the_disk(function, options)


def tick_kernel(function: Function) -> Function:
    """Compile a function of the tick: it may not allocate, and returns numbers alone."""
    return _for_the_disk(function, _TICK)


def tick_part(function: Function) -> Function:
    """Compile a small function into whoever calls it: a call with four arrays passes 28 arguments."""
    return _for_the_disk(function, {**_TICK, "forceinline": True})


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
