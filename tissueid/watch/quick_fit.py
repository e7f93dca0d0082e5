"""Fit a test alone, one branch and constant stiffness: a first number, no result."""

from __future__ import annotations

from typing import Any

from tissueid.inference.specimen import FitOptions
from tissueid.inspection import as_decided
from tissueid.manifest import Study
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.segment import SegmentOptions
from tissueid.trial import Trial


def quick_fit(
    trial: Trial, options: SegmentOptions | None, study: Study | None = None
) -> dict[str, Any] | None:
    """Parameters of the test alone; ``None`` where nothing can be fitted.

    ``trial``: as read; ``study``: followed.  Returns ``fit`` of ``schemas/watch.schema.json``.
    """
    trial, options, _ = as_decided(trial, options, study)
    quick = IdentifyOptions(fit=FitOptions(branches=1, stiffness_degree=0), segment=options)
    fits = identify([trial], options=quick).specimens
    if not fits:
        return None
    return {
        "nrmsd": fits[0].nrmsd.range,
        "parameters": [
            {"name": one.name, "unit": one.unit, "value": one.value, "stderr": one.stderr}
            for one in fits[0].parameters
        ],
    }
