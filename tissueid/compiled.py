"""Compilation of functions: for the disk, without the interpreter, and in a servo's tick without a heap.

numba keeps a compiled function while the file that defines it stays the same, whatever it calls: the folder
of kernels is therefore named by a hash of every source, version and flag that they are made with.

In a tick numba's memory runtime is left out: a function that allocates is refused by the compiler, and no
array is counted on its way from function to function.  Floating point stays as it is written (no fast-math,
no contraction), so that numba, Python and C agree bit for bit.  Without numba functions stay as they are
written, and a fit or a population needs no more; a servo asks for it (:func:`tissueid.extras.require`).
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, cached_property, update_wrapper
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

from tissueid.extras import installed

Function = TypeVar("Function", bound=Callable[..., Any])

_TICK: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
_LINEAR_ALGEBRA = "scipy.linalg"


class _Compiled:
    """A function that is compiled, or loaded, when it is first called: numba takes a fifth of a second."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        self.function, self.options = function, options
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        """Call what was compiled."""
        return self.dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        """Say what the compiled function says of itself, its type in other compiled functions among it."""
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.dispatcher, name)

    @cached_property
    def dispatcher(self) -> Any:
        """Compiled function; what stands in the source where numba is switched off."""
        import numba as nb

        settings: Any = nb.config
        folder, before = cache_folder(), settings.CACHE_DIR
        if folder is not None:
            settings.CACHE_DIR = str(folder)
        try:
            return nb.njit(cache=folder is not None, nogil=True, **self.options)(self.function)
        finally:
            settings.CACHE_DIR = before


def _for_the_disk(function: Function, options: dict[str, Any]) -> Function:
    """Compile at the first call, or load what was compiled from the same sources."""
    return cast("Function", _Compiled(function, options)) if installed("numba") else function


def kernel(*, error_model: str = "numpy") -> Callable[[Function], Function]:
    """Compile a function of arrays and numbers, without the interpreter's lock."""
    return lambda function: _for_the_disk(function, {"error_model": error_model})


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


_PACKAGE = Path(__file__).resolve().parent
_PREFIX = "kernels-"
#: A module of kernels says so by what it imports.
_KERNELS = re.compile(r"^from tissueid\.compiled import|^from numba", re.MULTILINE)
#: Modules whose constants and functions a kernel may hold.
_IMPORTS = re.compile(r"^from (tissueid[\w.]*) import ([^\n(]*|\([^)]*\))", re.MULTILINE)
#: Folders of other sources that were not used for so long are deleted [s].
_FORGOTTEN = 30 * 86_400.0
_DIGITS = 16


def _imported(text: str, root: Path) -> set[Path]:
    """Files of the package's modules that a source imports as it is loaded."""
    found = set()
    for module, names in _IMPORTS.findall(text):
        base = root.joinpath(*module.split(".")[1:])
        inner = [base / name for name in re.findall(r"\w+", names)]
        for place in (base, *inner):
            found |= {file for file in (place.with_suffix(".py"), place / "__init__.py") if file.is_file()}
    return found


def kernel_sources(root: Path = _PACKAGE) -> dict[str, bytes]:
    """Sources of all kernels and of what they import, by their path in the package."""
    texts = {path: path.read_bytes() for path in sorted(root.rglob("*.py"))}
    waiting = [path for path, text in texts.items() if _KERNELS.search(text.decode())]
    found: set[Path] = set()
    while waiting:
        path = waiting.pop()
        if path not in found:
            found.add(path)
            waiting += _imported(texts[path].decode(), root)
    return {path.relative_to(root).as_posix(): texts[path] for path in sorted(found)}


def sources_key(root: Path = _PACKAGE) -> str:
    """Hash of sources, versions and flags of all kernels."""
    import llvmlite
    import numba
    import numpy as np

    digest = hashlib.sha256(f"{sys.version_info[:2]} {sys.platform}\0".encode())
    for library in (llvmlite, numba, np):
        digest.update(f"{library.__name__} {library.__version__}\0".encode())
    flags = {name: value for name, value in os.environ.items() if name.startswith("NUMBA_")}
    flags.pop("NUMBA_CACHE_DIR", None)
    digest.update(f"{sorted(flags.items())}\0".encode())
    for name, text in kernel_sources(root).items():
        digest.update(f"{name} {len(text)}\0".encode() + text)
    return digest.hexdigest()[:_DIGITS]


def _base() -> Path:
    """Folder that holds the folders of kernels: as told, beside the sources, or the user's own."""
    named = os.environ.get("NUMBA_CACHE_DIR")
    if named:
        return Path(named)
    beside = _PACKAGE / "__pycache__"
    try:
        beside.mkdir(exist_ok=True)
    except OSError:
        pass
    else:
        if os.access(beside, os.W_OK):
            return beside
    own = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME")
    return (Path(own) if own else Path.home() / ".cache") / "tissueid"


@cache
def cache_folder() -> Path | None:
    """The folder of this process's kernels; ``None`` where nothing is compiled or it can't be written."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in {"", "0"} or find_spec("numba") is None:
        return None
    base = _base()
    folder = base / f"{_PREFIX}{sources_key()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except OSError:
        return None
    _forget(base, folder)
    return folder


def _forget(base: Path, current: Path) -> None:
    """Delete folders of kernels that no run has used for a month."""
    oldest = time.time() - _FORGOTTEN
    for other in base.glob(f"{_PREFIX}*"):
        try:
            if other != current and other.stat().st_mtime < oldest:
                shutil.rmtree(other, ignore_errors=True)
        except OSError:
            continue
