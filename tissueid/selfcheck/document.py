"""The document of a check: what was asked, of which tissue, protocol and priors, and the verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissueid import PosteriorOptions, __version__
from tissueid.selfcheck.protocol import Protocol
from tissueid.selfcheck.ranks import DRAWS
from tissueid.selfcheck.records import Record, failures
from tissueid.selfcheck.tissue import TissueCheck
from tissueid.selfcheck.truth import prior_words
from tissueid.selfcheck.verdicts import Verdict, verdict_of


@dataclass(frozen=True, slots=True)
class Asked:
    """Request of the user."""

    kind: str  # ``recipe``, ``study`` or ``bundle``
    path: str
    specimen: str
    simulations: int
    seed: int


def _priors(check: TissueCheck) -> list[dict[str, Any]]:
    words = prior_words(
        check.priors, correlated=check.correlated, pooling=check.pooling, defects=check.defects
    )
    stated = set(check.stated)
    return [{"name": name, "prior": said, "stated": name in stated} for name, said in words.items()]


def _protocol(protocol: Protocol) -> dict[str, Any]:
    return {
        "words": protocol.words,
        "logs": len(protocol.logs),
        "samples": protocol.samples,
        "step_s": protocol.step_s,
        "duration_s": protocol.duration_s,
        "depth_mm": protocol.depth_mm,
        "speeds_mm_s": list(protocol.speeds_mm_s),
        "contact_sd_mm": max(log.contact_sd_mm for log in protocol.logs),
    }


def check_document(
    asked: Asked, protocol: Protocol, check: TissueCheck, records: Sequence[Record]
) -> tuple[dict[str, Any], Verdict]:
    """The document of ``schemas/selfcheck.schema.json``, and the verdict behind it.

    ``records``: at least one with a posterior.
    """
    verdict = verdict_of(records)
    good = [record for record in records if record.failed is None]
    return {
        "schema": "tissueid/selfcheck/1",
        "source": {"kind": asked.kind, "path": asked.path, "specimen": asked.specimen},
        "model": {
            "branches": check.model.branches,
            "stiffness_degree": check.model.stiffness_degree,
            "static_pooling": check.pooling,
            "depth_mm": check.model.depth_mm,
        },
        "noise": {
            "model": check.noise_model,
            "white_share": check.white_share,
            "reference_step_s": check.reference_step_s,
        },
        "interval": "total" if check.defects else "statistical",
        "protocol": _protocol(protocol),
        "priors": _priors(check),
        "simulations": {
            "asked": asked.simulations,
            "done": len(records),
            "failed": [str(record.failed) for record in failures(records)],
            "draws": DRAWS,
            "seed": asked.seed,
            "sampler": PosteriorOptions().sampler,
            "median_seconds": float(np.median([record.seconds for record in good])),
            "detail": _details(good),
        },
        **verdict.as_json(),
        "provenance": {"tissueid": __version__},
    }, verdict


def _details(records: Sequence[Record]) -> Mapping[str, float]:
    """Mean over the simulations of what was kept of each."""
    names = dict.fromkeys(name for record in records for name in record.detail)
    return {
        name: float(np.mean([record.detail[name] for record in records if name in record.detail]))
        for name in names
    }
