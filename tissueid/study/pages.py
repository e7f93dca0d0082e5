"""The report of a set, one page or an index with a page a specimen, and the rendering of its tissues.

Pages stand in ``OUT/pages/`` under the keys of the files they were made from, so that a page is made once.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.arrays import evenly
from tissueid.documents import plain, typed
from tissueid.documents.identification import Identification, Specimen
from tissueid.documents.session import Scale
from tissueid.documents.twin import Twin
from tissueid.errors import TissueidError
from tissueid.haptics.registry import reported_devices
from tissueid.rendering.precheck import MM_PER_M, Demands, Precheck, check_before_force, demands_of
from tissueid.rendering.tissue_block import WORKSPACE_CENTRE_M
from tissueid.rendering.tissue_block import Tissue as RenderedTissue
from tissueid.report.law_payload import tissue_of
from tissueid.report.page import index_row, plotly_script, render_index, render_report
from tissueid.report.rendering_words import NORMALISED, RefusedDevice, RenderedDevice, Rendering
from tissueid.report.twin_page import twin_sections
from tissueid.report.wording import whole_label
from tissueid.store.curves import TrialCurve, load_curves
from tissueid.store.files import CURVES, IDENTIFICATION, POSTERIORS, REPORT, json_bytes, time_now, write_file
from tissueid.store.merged import LISTED, SPECIMENS, load_record, load_specimen, read_listed
from tissueid.store.outputs import OutputSet
from tissueid.store.posteriors import StoredPosterior, load_posteriors
from tissueid.study.completeness import completeness_of_result
from tissueid.study.specimen_job import fit_specimen_job
from tissueid.study.tasks import Task, Workforce, attempt, packed

#: A hand that explores moves a grip at some 0.1 m/s.
EXPLORING_MM_S = 100.0
#: Draws that are looked at.
MOST_DRAWS = 500


def _devices() -> dict[str, Demands]:
    """Demands of the devices that a report speaks of, behind a surface in the middle of each."""
    return {
        words: replace(demands_of(able), travel_m=WORKSPACE_CENTRE_M[2] - able.workspace_m[2][0])
        for words, able in reported_devices().items()
    }


def _row(name: str, check: Precheck, speeds_mm_s: tuple[float, float]) -> RenderedDevice:
    fastest_mm_s = speeds_mm_s[1] * check.scaling.motion
    return RenderedDevice(
        name=name,
        scale=typed(plain(check.as_json()), Scale),
        travel_mm=check.depth_mm * check.scaling.motion,
        room_mm=MM_PER_M * check.demands.travel_m,
        fastest_hand_mm_s=fastest_mm_s,
        faster_than_identified=fastest_mm_s < EXPLORING_MM_S,
    )


def rendering_of(specimen: Specimen, stored: StoredPosterior | None) -> Rendering | str | None:
    """Check before force on the known devices; ``None`` without a whole model, a word without mm and N."""
    if (specimen.units.length, specimen.units.force) != ("mm", "N"):
        return NORMALISED
    tissue = tissue_of(specimen, stored)
    if tissue is None:
        return None
    model, theta, valid = tissue.model, tissue.theta, specimen.validity
    rendered = RenderedTissue(model, theta, valid.speeds_mm_s, valid.tip_radius_mm)
    rows: list[RenderedDevice | RefusedDevice] = []
    for name, demands in _devices().items():
        try:
            rows.append(_row(name, check_before_force(rendered, demands), valid.speeds_mm_s))
        except (TissueidError, ValueError) as error:
            rows.append(RefusedDevice(name, str(error)))
    draws = np.zeros((0, theta.size))
    if stored is not None:
        # some of the draws that a bundle carries, in the order of the model
        kept = evenly(len(stored.draws), MOST_DRAWS)
        draws = stored.draws[kept][:, [stored.theta_names.index(name) for name in model.parameter_names]]
    return Rendering(
        passive=model.is_passive(theta),
        draws=len(draws),
        draws_passive=int(model.passive(draws).sum()),
        unique=model.contact_loss_is_unique(theta),
        devices=tuple(rows),
    )


#: Folder of the pages, in the output folder.
PAGES = "pages"
#: The tasks of this module.
PAGE = "tissueid.study.pages:specimen_page"
FIT_WITH_PAGE = "tissueid.study.pages:fit_with_page"
_LIBRARY = "plotly.min.js"


def page_path(out: Path, file: str) -> Path:
    """The page of a specimen's file."""
    return out / PAGES / f"{Path(file).stem}.html"


def specimen_page(payload: bytes) -> bytes:
    """The task: the bytes of a specimen's file in, its page out; empty where nothing was fitted."""
    record, curves, posterior = load_specimen(io.BytesIO(payload))
    if record.fitted is None:
        return b""
    document = {
        "schema": "tissueid/identification/1",
        "specimens": [record.fitted],
        "refused": record.refused,
        "unfitted_cycles": record.unfitted_cycles,
        "study": None,
        "provenance": record.provenance | {"inputs": record.inputs},
        "exit": {"code": 0, "reasons": record.reasons},
    }
    posteriors = () if posterior is None else (posterior,)
    return report_page(document, curves, posteriors, script_file=_LIBRARY, graded=False).encode("utf-8")


def with_page(content: bytes) -> bytes:
    """A specimen's file and its page, packed; ``None`` for a page that could not be made."""
    return packed((content, attempt(Task(0, PAGE, content)).result))


def fit_with_page(payload: bytes) -> bytes:
    """The task: a packed job in, :func:`with_page` of its file out."""
    return with_page(fit_specimen_job(payload))


def report_page(
    written: Mapping[str, Any],
    curves: Sequence[TrialCurve],
    posteriors: Sequence[StoredPosterior],
    *,
    graded: bool = True,
    twin: Twin | None = None,
    **more: Any,
) -> str:
    """The report of a run, with what a renderer will do and how complete the study's description is.

    ``written``: identification.json; ``graded``: it knows of the study; ``**more``: of
    :func:`tissueid.report.page.render_report`.
    """
    known = {one.specimen: one for one in posteriors}
    document = typed(written, Identification)
    return render_report(
        document,
        curves,
        posteriors,
        renderings=[rendering_of(one, known.get(one.specimen)) for one in document.specimens],
        metadata=completeness_of_result(document.study) if graded else None,
        twin=() if twin is None else twin_sections(twin),
        digest=hashlib.sha256(json_bytes(written)).hexdigest(),
        **more,
    )


def begin_pages(out: Path) -> None:
    """Make the folder of pages, with the library that they share."""
    folder = out / PAGES
    folder.mkdir(exist_ok=True)
    write_file(folder / _LIBRARY, str(plotly_script()).encode("utf-8"))


def write_pages(out: Path, files: Iterable[Path], crew: Workforce) -> Iterator[int]:
    """Make the pages of specimens' files that are not there; yields how many are made, one by one."""
    names: dict[int, Path] = {}

    def tasks() -> Iterator[Task]:
        for number, path in enumerate(files):
            target = page_path(out, path.name)
            if not target.exists():
                names[number] = target
                yield Task(number, PAGE, path.read_bytes())

    for made, outcome in enumerate(crew.run(tasks(), lambda *_: None), 1):
        target = names.pop(outcome.number)
        said = b"" if outcome.fault is None else f"<p>no page: {outcome.fault.message}</p>".encode()
        write_file(target, outcome.result or said)
        yield made


def write_report(run: OutputSet, refused: Sequence[str] | None = None) -> None:
    """Write the report into a set that holds the other files already."""
    created = time_now()
    if run.path(CURVES).is_file():
        sampled = run.path(POSTERIORS)
        page = report_page(
            json.loads(run.path(IDENTIFICATION).read_bytes()),
            load_curves(run.path(CURVES)),
            load_posteriors(sampled) if sampled.is_file() else (),
            created=created,
        )
    else:
        if refused is None:
            document = typed(json.loads(run.path(IDENTIFICATION).read_bytes()), Identification)
            refused = [f"{whole_label(one)}: {one.error.message}" for one in document.refused]
        page = _index_page(run, refused, created)
    run.write(REPORT, page.encode("utf-8"))


def _index_page(run: OutputSet, refused: Sequence[str], created: str) -> str:
    rows = []
    for one in read_listed(run.path(LISTED)):
        record = load_record(run.out / SPECIMENS / one.file)
        if record.fitted is not None:
            page = page_path(run.out, one.file).relative_to(run.out).as_posix()
            rows.append(index_row(typed(record.fitted, Specimen), page))
    return render_index(rows, refused, created=created)
