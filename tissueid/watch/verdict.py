"""The verdict on one test: what ``inspect`` says of it, beside the tests before it.

A verdict is a plain JSON object (``schemas/watch.schema.json``), so that a watch that was stopped goes on
from its own log.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from tissueid.inspection import as_decided, describe_segmented, measured_of, segmented
from tissueid.manifest import Study
from tissueid.measures import MeasuredPush
from tissueid.result import Refusal
from tissueid.segment import SegmentOptions
from tissueid.trial import Trial

Verdict = dict[str, Any]

#: What a verdict keeps of ``inspect --json``.
_KEPT = (
    "path", "sheet", "specimen", "excluded", "units", "contact", "measured", "verdict", "flags",
)  # fmt: skip


def samples_digest(trial: Trial) -> str:
    """SHA-256 of the samples: tells a sheet that changed from one that was only saved again."""
    digest = hashlib.sha256()
    for channel in (trial.time_s, trial.displacement_mm, trial.force_N):
        digest.update(np.ascontiguousarray(channel, dtype="<f8").tobytes())
    return digest.hexdigest()


def refused_verdict(refusal: Refusal, trial: Trial | None = None) -> Verdict:
    """The verdict on a file that can't be read, or on a trial that defeats the arithmetic."""
    nothing: Verdict = dict.fromkeys(_KEPT)
    return nothing | {
        "path": refusal.path,
        "sheet": refusal.sheet,
        "specimen": None if trial is None else trial.specimen,
        "verdict": {"level": "refused", "reason": f"this file can't be used: {refusal}"},
        "flags": [],
        "digest": None if trial is None else samples_digest(trial),
        "error": refusal.as_json()["error"],
        "fit": None,
    }


def judge(
    trial: Trial,
    earlier: Iterable[Mapping[str, Any]] = (),
    *,
    options: SegmentOptions | None = None,
    study: Study | None = None,
) -> Verdict:
    """Judge one test.

    ``trial``: as read; ``earlier``: verdicts on earlier tests, in their order; those of the same specimen are
    compared, but for excluded ones; ``study``: followed.  Returns the object of
    ``schemas/watch.schema.json``.
    """
    trial, options, excluded = as_decided(trial, options, study)
    divided = segmented(trial, options=options)
    if isinstance(divided, Refusal):
        return refused_verdict(divided, trial)
    before = [
        MeasuredPush.of_json(one["measured"]["push"])
        for one in earlier
        if one["specimen"] == trial.specimen and one["excluded"] is None and one["measured"] is not None
        if one["measured"]["push"] is not None
    ]
    found = describe_segmented(
        trial, divided, excluded=excluded, measured=measured_of(trial, divided, study), earlier=before
    )
    kept = {name: found[name] for name in _KEPT}
    return kept | {"digest": samples_digest(trial), "error": None, "fit": None}
