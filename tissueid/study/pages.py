"""The report of a set: one page, or for a large cohort an index with a page a specimen."""

from __future__ import annotations

import json
from datetime import UTC, datetime

from tissueid.report import render_report
from tissueid.store.curves import load_curves
from tissueid.store.outputs import OutputSet
from tissueid.store.posteriors import load_posteriors
from tissueid.store.results import CURVES, POSTERIORS, REPORT
from tissueid.study.assembly import Assembled

__all__ = ["write_report"]


def write_report(run: OutputSet, found: Assembled) -> None:
    """Write the report of an assembled set into it.

    Parameters
    ----------
    run : OutputSet
    found : Assembled
    """
    created = datetime.now(UTC).isoformat(timespec="seconds")
    document = json.loads(found.document.read_bytes())
    sampled = run.path(POSTERIORS)
    page = render_report(
        document,
        load_curves(run.path(CURVES)),
        load_posteriors(sampled) if sampled.is_file() else (),
        created=created,
    )
    run.write(REPORT, page.encode("utf-8"))
