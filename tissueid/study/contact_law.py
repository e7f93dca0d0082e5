"""k, n and e of a contact law for every specimen among recordings: a document, and the page beside it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from tissueid import __version__
from tissueid.collection import TrialCache, collect, display_names
from tissueid.inference.contact_law import ContactLaw, fit_contact_law
from tissueid.inference.contact_path import ContactLog, contact_log
from tissueid.manifest import Study
from tissueid.model.impact import KEY
from tissueid.result import Refusal
from tissueid.segment import SegmentOptions
from tissueid.trial import Source, Trial

__all__ = ["SCHEMA", "contact_law_document"]

SCHEMA = "tissueid/contact-law/1"


def contact_law_document(
    trials: Iterable[Trial],
    options: SegmentOptions,
    refused: Sequence[Refusal] = (),
    *,
    study: Study | None = None,
    reload: Callable[[Source], Trial] | None = None,
) -> dict[str, Any]:
    """Identify the law of every specimen.

    Parameters
    ----------
    trials : iterable of Trial
        Those of one specimen are fitted together.
    options : SegmentOptions
    refused : sequence of Refusal
        Inputs refused while ``trials`` was read; looked at after the iteration has ended.
    study : Study, optional
        Whose decisions and exclusions are followed.
    reload : callable, optional
        Reads a trial again; without it all samples stay in memory.

    Returns
    -------
    dict
        Of ``schemas/contact-law.schema.json``.
    """
    collected = collect(trials, options, TrialCache(reload), lambda _message, _done, _total: None, study)
    names = display_names(collected.sources)
    specimens = []
    for specimen, handles in collected.groups.items():
        found = [contact_log(one.load(), one.segmentation) for one in handles]
        logs = [log for log in found if log is not None]
        if logs:
            specimens.append(_specimen(names[specimen], logs, fit_contact_law(logs)))
        for handle, log in zip(handles, found, strict=True):
            if log is None:
                collected.left_out.append(_too_few(handle.load().source))
    inputs = [{key: one[key] for key in ("path", "sheet", "sha256")} for one in collected.inputs]
    return {
        "schema": SCHEMA,
        "model": KEY,
        "specimens": specimens,
        "refused": [one.as_json() for one in (*refused, *collected.left_out)],
        "provenance": {"tissueid": __version__, "inputs": inputs},
    }


def _too_few(source: Source) -> Refusal:
    message = "too few samples lie between contact and its end: there is nothing to fit"
    return Refusal(path=source.path, sheet=source.sheet, code="too_few_samples", message=message)


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
