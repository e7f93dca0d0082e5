"""Inspection of one recording before anything is fitted: the words of ``tissueid inspect``.

Numbers are those of the file: signs and zeros are as recorded, decisions stand beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tissueid.decided import arithmetic_refusal
from tissueid.documents import members, plain
from tissueid.documents.inspect import Contact, Corner, Event, Phase, Point
from tissueid.documents.measured import Measured, MeasuredPush
from tissueid.flags import Flag
from tissueid.manifest import Study
from tissueid.measured import measure
from tissueid.measured.cycles import cycle_rows
from tissueid.measured.geometry import DEFAULT_POISSON, TipOf, stated_geometry
from tissueid.measured.verdict import verdict_of
from tissueid.result import Refusal
from tissueid.segment import SegmentOptions, segment
from tissueid.trial import Phase as Stretch
from tissueid.trial import Segmentation, Trial

#: What is told of a source.
_READ = ("recipe", "recipe_reason", "recipe_confidence", "encoding", "delimiter", "decimal")


def segmented(trial: Trial, *, options: SegmentOptions | None = None) -> Segmentation | Refusal:
    """The trial divided into phases, or the refusal of one whose numbers defeat the arithmetic."""
    try:
        return segment(trial, options=options)
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        return arithmetic_refusal(trial.source.path, trial.source.sheet, "segmented", error)


def measured_of(trial: Trial, segmentation: Segmentation, study: Study | None = None) -> Measured:
    """Measured quantities of a trial, no model; moduli by the tip of the study, or of the header."""
    tip = TipOf()
    if study is not None and study.tip:
        thickness = study.specimens.get(trial.specimen, {}).get("thickness_mm")
        tip = TipOf(stated_geometry(study.tip, thickness, DEFAULT_POISSON), header=False)
    return measure(trial, segmentation, geometry=tip.of(trial))


def describe_segmented(
    trial: Trial,
    segmentation: Segmentation,
    *,
    excluded: str | None = None,
    measured: Measured | None = None,
    earlier: Sequence[MeasuredPush] = (),
) -> dict[str, Any]:
    """The object of ``schemas/inspect.schema.json`` for a trial beside ``earlier`` ones of its specimen."""
    measured = measured or measured_of(trial, segmentation)
    source = trial.source
    flags: list[Flag] = [*trial.flags, *segmentation.flags]
    contact = segmentation.contact
    return {
        "path": source.path,
        "sheet": source.sheet,
        "specimen": trial.specimen,
        "excluded": excluded,
        **{key: getattr(source, key) for key in _READ},
        "columns": dict(source.columns),
        "units": trial.axes.as_json(),
        "n_samples": int(trial.time_s.size),
        "first": _point(trial, 0),
        "last": _point(trial, -1),
        "peak_force": _point(trial, int(np.argmax(np.abs(trial.force_N)))),
        **{key: getattr(segmentation, key) for key in ("compression_sign", "force_sign", "force_noise_N")},
        "contact": None if contact is None else members(contact, Contact),
        "phases": [_phase(trial, phase) for phase in segmentation.phases],
        "corners": [members(corner, Corner) for corner in segmentation.corners],
        "events": plain([members(event, Event) for event in segmentation.events]),
        "cycles": plain(cycle_rows(trial, segmentation)),
        "measured": plain(measured),
        "verdict": plain(verdict_of(trial, segmentation, measured, earlier)),
        "flags": plain(flags),
    }


def _point(trial: Trial, index: int) -> dict[str, float]:
    return {name: float(channel[index]) for name, channel in members(trial, Point).items()}


def _phase(trial: Trial, phase: Stretch) -> dict[str, Any]:
    peak_s = None if phase.peak is None else float(trial.time_s[phase.peak])
    own = {name: getattr(phase, name) for name in Phase.__struct_fields__ if name != "peak_s"}
    return {**own, "peak_s": peak_s}
