"""k, n and e of a contact law for every specimen among recordings: a document, and the page beside it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from tissueid import __version__
from tissueid.fit.contact_law import ContactLaw, fit_contact_law
from tissueid.fit.contact_path import ContactLog, contact_log
from tissueid.model.impact import KEY
from tissueid.result import Refusal
from tissueid.segment import SegmentOptions, segment
from tissueid.trial import Trial

__all__ = ["SCHEMA", "contact_law_document"]

SCHEMA = "tissueid/contact-law/1"


def contact_law_document(
    trials: Iterable[Trial], options: SegmentOptions, refused: Sequence[Refusal] = ()
) -> dict[str, Any]:
    """Identify the law of every specimen.

    Parameters
    ----------
    trials : iterable of Trial
        Those of one specimen are fitted together.
    options : SegmentOptions
    refused : sequence of Refusal
        Inputs refused while ``trials`` was read; looked at after the iteration has ended.

    Returns
    -------
    dict
        Of ``schemas/contact-law.schema.json``.
    """
    logs: dict[str, list[ContactLog]] = {}
    left_out: list[Refusal] = []
    inputs = []
    for trial in trials:
        log = contact_log(trial, segment(trial, options=options))
        if log is None:
            message = "too few samples lie between contact and its end: there is nothing to fit"
            left_out.append(Refusal(trial.source.path, trial.source.sheet, "too_few_samples", message))
            continue
        logs.setdefault(trial.specimen, []).append(log)
        inputs.append({"path": trial.source.path, "sheet": trial.source.sheet, "sha256": trial.source.sha256})
    return {
        "schema": SCHEMA,
        "model": KEY,
        "specimens": [_specimen(name, own, fit_contact_law(own)) for name, own in logs.items()],
        "refused": [one.as_json() for one in (*refused, *left_out)],
        "provenance": {"tissueid": __version__, "inputs": inputs},
    }


def _specimen(name: str, logs: Sequence[ContactLog], law: ContactLaw) -> Mapping[str, Any]:
    return {
        "specimen": name,
        "parameters": [
            {
                "name": one.name,
                "symbol": one.symbol,
                "unit": one.unit,
                "value": one.value,
                "stderr": one.stderr,
                "ci95": None if one.interval is None else list(one.interval),
                "reason": one.reason,
            }
            for one in law.parameters
        ],
        "loading_N_per_mm_n": law.loading,
        "returned_speed": law.returned,
        "depth_mm": law.depth_mm,
        "nrmsd": law.nrmsd,
        "residual_correlation": law.correlation,
        "whitened_correlation": law.left_correlation,
        "converged": law.converged,
        "n_samples": law.samples,
        "logs": [
            {
                "path": log.path,
                "sheet": log.sheet,
                "speed_mm_s": log.speed_mm_s,
                "contact_offset_mm": float(offset),
                "n_samples": int(log.depth_mm.size),
            }
            for log, offset in zip(logs, law.offsets_mm, strict=True)
        ],
    }
