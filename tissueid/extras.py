"""Libraries that a part of tissueid needs, and the extra of the installation that brings each."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

from tissueid.errors import UsageError

#: Module -> extra of ``pip install 'tissueid[...]'``.
EXTRA_OF = {
    "numba": "haptics",
    "llvmlite": "haptics",
    "starlette": "viewer",
    "uvicorn": "viewer",
    "websockets": "viewer",
    "dask": "cluster",
    "distributed": "cluster",
    "arviz": "arviz",
    "h5netcdf": "arviz",
    "fsspec": "remote",
}


def installed(library: str) -> bool:
    """True where a library can be imported."""
    return find_spec(library) is not None


def versions(libraries: Iterable[str]) -> dict[str, str]:
    """Versions of those libraries that are installed."""
    found = {}
    for name in libraries:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


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
