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

_LAZY = {
    "Bundle": "tissueid.library",
    "ContactModel": "tissueid.model.composed",
    "Fit": "tissueid.library",
    "FitOptions": "tissueid.inference.specimen",
    "IdentifyOptions": "tissueid.pipeline",
    "Polynomial": "tissueid.model.composed",
    "PosteriorOptions": "tissueid.inference.posterior",
    "Priors": "tissueid.priors",
    "Prony": "tissueid.model.composed",
    "ReadOptions": "tissueid.ingest",
    "Sampled": "tissueid.library",
    "SegmentOptions": "tissueid.segment",
    "Trial": "tissueid.trial",
    "fit": "tissueid.library",
    "identify": "tissueid.pipeline",
    "load_bundle": "tissueid.store.bundle",
    "read": "tissueid.library",
    "read_study": "tissueid.ingest.manifest",
    "read_trials": "tissueid.ingest",
    "render": "tissueid.library",
}


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        from importlib import import_module

        return getattr(import_module(_LAZY[name]), name)
    msg = f"module 'tissueid' has no attribute {name!r}"
    raise AttributeError(msg)
