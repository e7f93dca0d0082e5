"""Identify the contact mechanics of soft tissue from test-machine recordings, and feel the result.

The public functions are loaded on first use, so that ``import tissueid`` costs next to nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

__all__ = [
    "Bundle",
    "ContactModel",
    "Fit",
    "FitOptions",
    "IdentifyOptions",
    "Polynomial",
    "PosteriorOptions",
    "Priors",
    "Prony",
    "ReadOptions",
    "Sampled",
    "SegmentOptions",
    "Trial",
    "__version__",
    "fit",
    "identify",
    "load_bundle",
    "read",
    "read_study",
    "read_trials",
    "render",
]

if TYPE_CHECKING:
    from tissueid.inference.posterior import PosteriorOptions
    from tissueid.inference.specimen import FitOptions
    from tissueid.ingest import ReadOptions, read_trials
    from tissueid.ingest.manifest import read_study
    from tissueid.library import Bundle, Fit, Sampled, fit, read, render
    from tissueid.model.composed import ContactModel, Polynomial, Prony
    from tissueid.pipeline import IdentifyOptions, identify
    from tissueid.priors import Priors
    from tissueid.segment import SegmentOptions
    from tissueid.store.bundle import load_bundle
    from tissueid.trial import Trial

_PLACES = {
    "tissueid.inference.posterior": ("PosteriorOptions",),
    "tissueid.inference.specimen": ("FitOptions",),
    "tissueid.ingest": ("ReadOptions", "read_trials"),
    "tissueid.ingest.manifest": ("read_study",),
    "tissueid.library": ("Bundle", "Fit", "Sampled", "fit", "read", "render"),
    "tissueid.model.composed": ("ContactModel", "Polynomial", "Prony"),
    "tissueid.pipeline": ("IdentifyOptions", "identify"),
    "tissueid.priors": ("Priors",),
    "tissueid.segment": ("SegmentOptions",),
    "tissueid.store.bundle": ("load_bundle",),
    "tissueid.trial": ("Trial",),
}
_LAZY = {name: module for module, names in _PLACES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from importlib import import_module

        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module 'tissueid' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
