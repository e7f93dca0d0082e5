"""The page of ``tissueid inspect --html``: each recording drawn beside its flags and decisions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray, kept_samples
from tissueid.digits import number
from tissueid.documents.inspect import Phase
from tissueid.documents.inspect import Trial as TrialDocument
from tissueid.flags import flag_level
from tissueid.report.figures import packed
from tissueid.report.inspect_decisions import Decision
from tissueid.report.page import render_page
from tissueid.report.wording import LEVELS, flag_remarks, trial_label, whole_label
from tissueid.result import Refusal
from tissueid.trial import Segmentation, Trial

#: Samples of one recording that are kept for drawing at the most: a folder of large files then needs the
#: memory of one.
MOST_OF_ONE = 8_000
#: Samples on each side of a corner or event that are kept as they are.
_AROUND = 6


@dataclass(frozen=True, slots=True)
class DrawnRecording:
    """Drawn part of a recording."""

    #: (m,): as recorded, thinned.
    time_s: FloatArray
    displacement_mm: FloatArray  # (m,)
    force_N: FloatArray  # (m,)
    fixed: NDArray[np.bool_]  # (m,), samples that further thinning must keep
    phases: tuple[tuple[str, int, int], ...]  # kind, first and last drawn sample of each phase
    marks: dict[str, Any]  # contact, corners and events, in the words of the page's script


def drawn_recording(trial: Trial, segmentation: Segmentation) -> DrawnRecording:
    """Thin a recording for drawing."""
    force, x, size = trial.force_N, trial.displacement_mm, trial.time_s.size
    contact = segmentation.contact
    sharp = [corner.index for corner in segmentation.corners]
    sharp += [event.index for event in segmentation.events]
    edges = [0, size - 1, int(np.argmax(force)), int(np.argmin(force))]
    edges += [edge for phase in segmentation.phases for edge in (phase.start, phase.stop - 1)]
    edges += [phase.peak for phase in segmentation.phases if phase.peak is not None]
    if contact is not None:
        edges.append(min(contact.index, size - 1))
    near = [i + k for i in sharp[: MOST_OF_ONE // 20] for k in range(-_AROUND, _AROUND + 1)]
    fixed = np.unique([i for i in near if 0 <= i < size] + edges)
    index = kept_samples((force, x), MOST_OF_ONE, MOST_OF_ONE, fixed.tolist())
    places = np.searchsorted(index, [(phase.start, phase.stop - 1) for phase in segmentation.phases])
    phases = tuple(
        (phase.kind, int(first), int(last))
        for phase, (first, last) in zip(segmentation.phases, places.reshape(-1, 2), strict=True)
    )
    time, kept = trial.time_s[index], np.isin(index, fixed)
    return DrawnRecording(time, x[index], force[index], kept, phases, _marks(trial, segmentation))


def _marks(trial: Trial, segmentation: Segmentation) -> dict[str, Any]:
    contact = segmentation.contact
    return {
        "sign": segmentation.compression_sign,
        "contact": None
        if contact is None
        else {
            "x": contact.displacement_mm,
            "sd": contact.sd_mm,
            "base": contact.baseline_N if contact.in_record else None,
            "t": _contact_times(trial, segmentation),
        },
        "corners": [
            {"t": corner.time_s, "x": float(trial.displacement_mm[corner.index]), "s": corner.duration_s}
            for corner in segmentation.corners
        ],
        "events": [
            {
                "kind": event.kind.replace("_", " "),
                "t": event.time_s,
                "x": float(trial.displacement_mm[event.index]),
                "f": float(trial.force_N[event.index]),
            }
            for event in segmentation.events
        ],
    }


def _contact_times(trial: Trial, segmentation: Segmentation) -> list[float] | None:
    """Times at which the tool passed contact, contact - sd and contact + sd; ``None`` outside the record."""
    contact = segmentation.contact
    if contact is None or not contact.in_record:
        return None
    moving = [phase for phase in segmentation.phases if phase.start <= contact.index < phase.stop]
    if not moving:
        return None
    # from the approach before to the end of the ramp: the sd may reach into either
    first = max(0, min(phase.start for phase in moving) - 1)
    approaches = [phase for phase in segmentation.phases if phase.kind == "approach"]
    start = next((phase.start for phase in approaches if phase.stop - 1 == first + 1), first)
    span = slice(start, max(phase.stop for phase in moving))
    depth = segmentation.compression_sign * (trial.displacement_mm[span] - contact.displacement_mm)
    deepest = np.maximum.accumulate(depth)
    reached = [int(np.searchsorted(deepest, level)) for level in (0.0, -contact.sd_mm, contact.sd_mm)]
    times = trial.time_s[span]
    return [float(times[min(i, times.size - 1)]) for i in reached]


def packed_recording(drawn: DrawnRecording, most: int) -> dict[str, Any]:
    """A recording as the page carries it, thinned once more where it has to share.

    ``most``: samples beside the fixed ones.  Returns base64 ``t, x, f`` (float32; ``t`` from ``t0`` seconds),
    ``phases`` and the marks.
    """
    fixed = np.flatnonzero(drawn.fixed).tolist()
    index = kept_samples((drawn.force_N, drawn.displacement_mm), most, most, fixed)
    start = float(drawn.time_s[0])
    phases = [
        [kind, int(np.searchsorted(index, first)), int(np.searchsorted(index, last))]
        for kind, first, last in drawn.phases
    ]
    return {
        "t0": start,
        "t": packed(drawn.time_s[index] - start),
        "x": packed(drawn.displacement_mm[index]),
        "f": packed(drawn.force_N[index]),
        "phases": phases,
        **drawn.marks,
    }


@dataclass(frozen=True, slots=True)
class CorrectionRow:
    """One row of the form."""

    key: str  # key of study.toml, or ``exclude``
    title: str
    unit: str  # of the number; empty for a switch
    found: float | None  # what counts now
    stands: tuple[Any, str] | None  # what was decided, and why; ``None`` where the data decide


def corrections(
    recording: TrialDocument, standing: Mapping[str, tuple[Any, str]]
) -> tuple[CorrectionRow, ...]:
    """The rows of one recording; ``standing``: what the user decided: value and reason by key."""
    contact = recording.contact
    holds = [phase for phase in recording.phases if phase.kind in ("hold", "creep")]
    hold = max(holds, key=lambda phase: phase.end_s - phase.start_s, default=None)
    rows = (
        ("contact_mm", "Contact at", recording.units.length, contact.displacement_mm if contact else None),
        ("hold_from_s", "Hold from", "s", hold.start_s if hold else None),
        ("end_s", "Hold to (the rest is left out)", "s", hold.end_s if hold else None),
        ("rupture", "No fall of force is a rupture", "", None),
        ("exclude", "Leave it out of the fit", "", None),
    )
    return tuple(CorrectionRow(*row, standing.get(row[0])) for row in rows)


#: Samples a page carries in all: 16 bytes each, beside 5 MB of script.
MOST_SAMPLES = 150_000
FEWEST_OF_ONE = 160
#: Recordings that are drawn; of more, those that stand out least are listed only.
MOST_DRAWN = 250
_WORDS = {"ok": "nothing stands out", "note": "remarks", "caution": "look at it", "serious": "in doubt"}


@dataclass(frozen=True, slots=True)
class InspectedRecording:
    """One recording as the page needs it; its samples are thinned already."""

    document: TrialDocument  # one trial of ``schemas/inspect.schema.json``
    drawn: DrawnRecording
    decisions: tuple[Decision, ...]
    reader: str  # which reader read it, and why
    #: What the user decided: value and reason by key of study.toml.
    standing: Mapping[str, tuple[Any, str]] = field(default_factory=dict)

    @property
    def level(self) -> str:
        """The gravest level among its flags."""
        return max((flag_level(one.code) for one in self.document.flags), key=LEVELS.index, default="ok")


def render_inspection(
    recordings: Sequence[InspectedRecording],
    refused: Sequence[Refusal] = (),
    *,
    study: str = "study.toml",
    created: str | None = None,
    served: bool = False,
) -> str:
    """Write the page.

    ``recordings``: in the order of the command line; the page shows the gravest first; ``study``: where the
    entries belong; ``served``: a server hears what is decided on the page.
    """
    order = sorted(range(len(recordings)), key=lambda i: _gravity(recordings[i]), reverse=True)
    share = max(MOST_SAMPLES // max(len(order[:MOST_DRAWN]), 1), FEWEST_OF_ONE)
    names = _names([one.document for one in recordings])
    tally = Counter(one.level for one in recordings)
    counts = [(level, _WORDS[level], tally[level]) for level in reversed(LEVELS) if tally[level]]
    ids = [f"recording-{i + 1}" for i in range(len(recordings))]
    return render_page(
        "inspect",
        title=_title(recordings, refused),
        views=[_view(ids[i], recordings[i], names[i]) for i in order],
        refused=refused,
        counts=counts + ([("serious", "refused", len(refused))] if refused else []),
        codes=sorted({flag.code for one in recordings for flag in one.document.flags}),
        payload={ids[i]: packed_recording(recordings[i].drawn, share) for i in order[:MOST_DRAWN]},
        data="recordings",
        study=study,
        created=created,
        served=served,
        style="inspect.css",
        scripts=["tables.js", "inspect.js", *["inspect_served.js"] * served],
    )


def _gravity(recording: InspectedRecording) -> tuple[int, int]:
    """Gravest level; among equals, the one with more to say."""
    levels = [flag_level(flag.code) for flag in recording.document.flags]
    return LEVELS.index(recording.level), sum(level in {"caution", "serious"} for level in levels)


def _title(recordings: Sequence[InspectedRecording], refused: Sequence[Refusal]) -> str:
    if len(recordings) == 1 and not refused:
        return f"Inspection of {trial_label(recordings[0].document)}"
    return f"Inspection of {len(recordings)} recordings" if recordings else "Nothing could be read"


def _names(documents: Sequence[TrialDocument]) -> list[str]:
    """The sheet alone where that says which recording it is, else file and sheet, else the whole path."""
    short = [document.sheet or trial_label(document) for document in documents]
    whole = [trial_label(document) for document in documents]
    count, count_whole = Counter(short), Counter(whole)
    return [
        name if count[name] == 1 else label if count_whole[label] == 1 else whole_label(document)
        for name, label, document in zip(short, whole, documents, strict=True)
    ]


def _view(own: str, recording: InspectedRecording, name: str) -> dict[str, Any]:
    document = recording.document
    holds = [phase.end_s - phase.start_s for phase in document.phases if phase.kind == "hold"]
    flags = sorted(document.flags, key=lambda flag: -LEVELS.index(flag_level(flag.code)))
    return {
        "id": own,
        "name": name,
        "of": recording,
        "data": document,
        "words": _WORDS[recording.level],
        "flags": [
            replace(remark, numbers={name: _value(value) for name, value in flag.values.items()})
            for flag, remark in zip(flags, flag_remarks(flags), strict=True)
        ],
        "program": _program(document.phases),
        "hold_s": max(holds, default=None),
        "corrections": corrections(document, recording.standing),
        "alternative": _alternative(document),
    }


def _program(phases: Sequence[Phase]) -> str:
    """The phases in a few words: ``approach, ramp, hold`` or ``3 × cycle``."""
    words = [(kind, len(list(alike))) for kind, alike in groupby(phase.kind for phase in phases)]
    shown = [kind if count == 1 else f"{count} × {kind}" for kind, count in words[:6]]
    return ", ".join(shown) + (" ..." if len(words) > len(shown) else "")


def _value(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    if isinstance(value, float):
        return number(value)
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _alternative(document: TrialDocument) -> str:
    """The picture in words, for those who do not see it."""
    peak, contact = document.peak_force, document.contact
    touched = "no contact found" if contact is None else f"contact at {number(contact.displacement_mm)} mm"
    length = number(document.last.time_s - document.first.time_s)
    return (
        f"Force and displacement of {trial_label(document)} against time: {document.n_samples} samples"
        f" over {length} s, {_program(document.phases)}; {touched}; largest force"
        f" {number(peak.force_N)} N at {number(peak.time_s)} s."
    )
