"""The output set of ``tissueid rupture``: rupture.json, rupture.html and a bundle for each specimen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tissueid.errors import UsageError
from tissueid.report.rupture_page import render_rupture
from tissueid.rupture.document import as_document
from tissueid.rupture.run import RuptureRun
from tissueid.store.bundle import bundle_from_fit, write_bundle
from tissueid.store.files import json_bytes, plain_json
from tissueid.store.names import IDENTIFICATION, bundle_names
from tissueid.store.outputs import OutputSet
from tissueid.store.schema import check

RUPTURE = "rupture.json"
PAGE = "rupture.html"


def write_rupture(out: Path, run: Callable[[], RuptureRun]) -> dict[str, Any]:
    """Write the set, all at once or not at all.

    ``run``: gives the study; called once the folder is ours.  Returns rupture.json.  Raises UsageError: the
    folder holds the outputs of a fit, or files that are not ours.
    """
    refuse_foreign(out)
    with OutputSet(out) as files:
        found = run()
        specimens = found.identification.specimens
        by_specimen = bundle_names(fit.specimen for fit in specimens)
        document: dict[str, Any] = plain_json(as_document(found, by_specimen))
        check(document, "rupture", where=RUPTURE)
        files.write(RUPTURE, json_bytes(document))
        for fit in specimens:
            bundle = bundle_from_fit(fit, provenance=found.identification.provenance)
            law = found.study.laws.get(fit.specimen)
            write_bundle(replace(bundle, rupture=law), files.path(by_specimen[fit.specimen]))
        created = datetime.now(UTC).isoformat(timespec="seconds")
        files.write(PAGE, render_rupture(document, created=created).encode("utf-8"))
        files.commit()
    return document


def refuse_foreign(out: Path) -> None:
    """A fit's outputs, and files that nobody of ours wrote, stay where they are."""
    if (out / IDENTIFICATION).exists():
        msg = f"{out} holds the outputs of `tissueid fit`, which this would replace: choose another folder"
        raise UsageError(msg)
    if (out / ".current").exists() or not out.is_dir():
        return
    foreign = sorted(path.name for name in (RUPTURE, PAGE, "bundle*.h5") for path in out.glob(name))
    if foreign:
        msg = (
            f"{out} holds {', '.join(foreign)} that tissueid did not write there: choose another folder "
            "with -o, or move them away"
        )
        raise UsageError(msg)
