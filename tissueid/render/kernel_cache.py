"""Compiled kernels on the disk, and when they are no longer those of the sources.

numba keeps a compiled function for as long as the file that defines it stays the same.  The loop holds the
guard, the law and the arm, which stand in other files: an edited guard would not be the one that runs.  So
whatever was compiled before the last change of any of these files is deleted and compiled again.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

__all__ = ["forget_stale_kernels", "kernel_modules"]

#: Packages whose kernels call each other.
_PACKAGES = ("tissueid.compiled", "tissueid.model", "tissueid.haptics", "tissueid.render")


def kernel_modules() -> list[ModuleType]:
    """Modules of the rendering half that are imported."""
    return [module for name, module in sorted(sys.modules.items()) if name.startswith(_PACKAGES)]


def forget_stale_kernels(modules: Iterable[ModuleType]) -> int:
    """Delete what was compiled before the newest of some modules was written.

    Parameters
    ----------
    modules : iterable of module
        All whose kernels may call each other.

    Returns
    -------
    int
        Files that were deleted.
    """
    newest, folders = 0.0, set()
    for module in modules:
        kernels = [value for value in vars(module).values() if hasattr(value, "stats")]
        paths = {Path(str(path)) for one in kernels if (path := getattr(one.stats, "cache_path", None))}
        if (paths or module.__name__ == _PACKAGES[0]) and module.__file__:
            newest = max(newest, Path(module.__file__).stat().st_mtime)
        folders |= paths
    stale = [path for folder in folders for path in folder.glob("*.nb[ci]") if path.stat().st_mtime < newest]
    for path in stale:
        path.unlink(missing_ok=True)
    return len(stale)
