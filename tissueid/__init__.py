"""Identify the contact mechanics of soft tissue from test-machine recordings, and feel the result.

The public functions are loaded on first use, so that ``import tissueid`` costs next to nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

__all__ = [
    "FitOptions",
    "IdentifyOptions",
    "PosteriorOptions",
    "ReadOptions",
    "__version__",
    "identify",
    "load_bundle",
    "read_study",
    "read_trials",
]

if TYPE_CHECKING:
    from tissueid.inference.posterior import PosteriorOptions
    from tissueid.inference.specimen import FitOptions
    from tissueid.ingest import ReadOptions, read_trials
    from tissueid.ingest.manifest import read_study
    from tissueid.pipeline import IdentifyOptions, identify
    from tissueid.store.bundle import load_bundle

_LAZY = {
    "FitOptions": "tissueid.inference.specimen",
    "IdentifyOptions": "tissueid.pipeline",
    "PosteriorOptions": "tissueid.inference.posterior",
    "ReadOptions": "tissueid.ingest",
    "identify": "tissueid.pipeline",
    "load_bundle": "tissueid.store.bundle",
    "read_study": "tissueid.ingest.manifest",
    "read_trials": "tissueid.ingest",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from importlib import import_module

        return getattr(import_module(_LAZY[name]), name)
    msg = f"module 'tissueid' has no attribute {name!r}"
    raise AttributeError(msg)
