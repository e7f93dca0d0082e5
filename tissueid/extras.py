"""Libraries that a part of tissueid needs, with the extra that brings each, and what other packages add."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, entry_points, version
from importlib.util import find_spec
from typing import Any

from tissueid.errors import UsageError

#: Module -> extra of ``pip install 'tissueid[...]'``.
EXTRA_OF = {
    **dict.fromkeys(("numba", "llvmlite"), "haptics"),
    **dict.fromkeys(("starlette", "uvicorn", "websockets"), "viewer"),
    **dict.fromkeys(("dask", "distributed"), "cluster"),
    **dict.fromkeys(("arviz", "h5netcdf"), "arviz"),
    "fsspec": "remote",
}


def installed(library: str) -> bool:
    """True where a library can be imported."""
    return find_spec(library) is not None


def versions(libraries: Iterable[str]) -> dict[str, str]:
    """Versions of those libraries that are installed."""
    return {name: found for name in libraries if (found := _version(name)) is not None}


@cache
def _version(name: str) -> str | None:
    with suppress(PackageNotFoundError):
        return version(name)
    return None


def faults_of(group: str, take: Callable[[Any], None]) -> dict[str, tuple[str, str]]:
    """Take what other packages give a group of entry points; place and fault of those that fail, by name."""
    faults: dict[str, tuple[str, str]] = {}
    for point in entry_points(group=group):
        try:
            take(point.load())
        except Exception as error:  # noqa: BLE001 - somebody else's code must not stop the others
            faults[point.name] = point.value, f"can't be used: {type(error).__name__}: {str(error)[:200]}"
    return faults


def require(library: str) -> None:
    """Refuse to go on without a library of an extra."""
    if not installed(library):
        raise _without(library)


def missing_extra(error: ImportError) -> UsageError | None:
    """Error to report for a library that isn't installed; ``None`` where no extra brings it."""
    library = (error.name or "").partition(".")[0]
    return _without(library) if library in EXTRA_OF else None


def _without(library: str) -> UsageError:
    return UsageError(
        f"this needs {library}, which is not installed: pip install 'tissueid[{EXTRA_OF[library]}]', "
        "or pip install '.[all]' in a clone for everything"
    )
