"""The page of ``tissueid inspect --html``: each recording drawn beside its flags and decisions.

Self-contained like the report.  Recordings come one at a time and are thinned at once; the page shares a
fixed number of samples among them, so that it stays below 10 MB whatever was inspected.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from tissueid.digits import number
from tissueid.flags import flag_level
from tissueid.report.inspect_decisions import Decision, decisions
from tissueid.report.inspect_payload import DrawnRecording, drawn_recording, packed_recording
from tissueid.report.page import asset, page_environment, plotly_script
from tissueid.report.remarks import LEVELS, remark_title, trial_label
from tissueid.result import Refusal
from tissueid.trial import Segmentation, Trial


@dataclass(frozen=True, slots=True)
class CorrectionRow:
    """One row of the form."""

    key: str  # key of study.toml, or ``exclude``
    title: str
    unit: str = ""  # of the number; empty for a switch
    #: What was decided, and why; empty where the data decide.
    value: str = ""
    because: str = ""
    found: str = ""  # what counts now
    stands: bool = False  # whether it was decided


def corrections(
    recording: Mapping[str, Any], standing: Mapping[str, tuple[Any, str]]
) -> tuple[CorrectionRow, ...]:
    """The rows of one recording.

    ``recording``: one trial of ``schemas/inspect.schema.json``; ``standing``: what the user decided: value
    and reason by key.
    """
    contact = recording["contact"]
    holds = [phase for phase in recording["phases"] if phase["kind"] in ("hold", "creep")]
    hold = max(holds, key=lambda phase: phase["end_s"] - phase["start_s"], default=None)
    rows = (
        (
            "contact_mm",
            "Contact at",
            recording["units"]["length"],
            None if contact is None else contact["displacement_mm"],
        ),
        ("hold_from_s", "Hold from", "s", None if hold is None else hold["start_s"]),
        ("end_s", "Hold to (the rest is left out)", "s", None if hold is None else hold["end_s"]),
        ("rupture", "No fall of force is a rupture", "", None),
        ("exclude", "Leave it out of the fit", "", None),
    )
    return tuple(
        CorrectionRow(
            key,
            title,
            unit,
            value=_typed(standing[key][0]) if key in standing and unit else "",
            because=standing[key][1] if key in standing else "",
            found="" if found is None else _typed(found),
            stands=key in standing,
        )
        for key, title, unit, found in rows
    )


def _typed(value: float) -> str:
    """A number as somebody would type it."""
    return f"{value:.7g}"


#: Samples a page carries in all: 16 bytes each, beside 5 MB of script.
MOST_SAMPLES = 150_000
FEWEST_OF_ONE = 160
#: Recordings that are drawn; of more, those that stand out least are listed only.
MOST_DRAWN = 250
_S_PER_MIN = 60.0
_WORDS = {"ok": "nothing stands out", "note": "remarks", "caution": "look at it", "serious": "in doubt"}
_FLAG_FIELDS = {"code", "message"}


@dataclass(frozen=True, slots=True)
class InspectedRecording:
    """One recording as the page needs it; its samples are thinned already."""

    document: Mapping[str, Any]  # one trial of ``schemas/inspect.schema.json``
    drawn: DrawnRecording
    decisions: tuple[Decision, ...]
    reader: str  # which reader read it, and why
    #: What the user decided: value and reason by key of study.toml.
    standing: Mapping[str, tuple[Any, str]] = field(default_factory=dict)

    @property
    def level(self) -> str:
        """The gravest level among its flags."""
        levels = [flag_level(flag["code"]) for flag in self.document["flags"]]
        return max(levels, key=LEVELS.index, default="ok")


def inspected_recording(
    trial: Trial,
    segmentation: Segmentation,
    document: Mapping[str, Any],
    *,
    file: str,
    reader: str,
    standing: Mapping[str, tuple[Any, str]] | None = None,
) -> InspectedRecording:
    """Keep of a recording what the page needs.

    ``document``: what ``tissueid inspect --json`` says of it; ``file``: its path relative to the folder of
    study.toml; ``reader``: which reader read it, and why; ``standing``: what the user decided of it: value
    and reason by key of study.toml.
    """
    drawn = drawn_recording(trial, segmentation)
    return InspectedRecording(document, drawn, decisions(document, file=file), reader, standing or {})


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
    entries belong; ``created``: time stamp to print; without it equal input gives an equal page; ``served``:
    a server hears what is decided on the page.  Returns HTML, UTF-8.
    """
    order = sorted(range(len(recordings)), key=lambda i: (-_gravity(recordings[i]), i))
    drawn = set(order[:MOST_DRAWN])
    share = max(MOST_SAMPLES // max(len(drawn), 1), FEWEST_OF_ONE)
    names = _names([one.document for one in recordings])
    views = [_view(i, recordings[i], names[i], drawn=i in drawn) for i in order]
    payload = {
        view["id"]: packed_recording(recordings[view["position"]].drawn, share)
        for view in views
        if view["drawn"]
    }
    template = page_environment().get_template("inspect.html.j2")
    return template.render(
        title=_title(recordings, refused),
        views=views,
        refused=refused,
        counts=_counts(recordings),
        codes=sorted({flag["code"] for one in recordings for flag in one.document["flags"]}),
        payload=payload,
        study=study,
        created=created,
        served=served,
        style=asset("page.css") + asset("inspect.css"),
        script=asset("inspect.js") + (asset("inspect_served.js") if served else ""),
        plotly=plotly_script(),
    )


def _gravity(recording: InspectedRecording) -> int:
    levels = [flag_level(flag["code"]) for flag in recording.document["flags"]]
    worst = LEVELS.index(recording.level)
    # among equals, the one with more to say
    return worst * 1000 + min(sum(level in {"caution", "serious"} for level in levels), 999)


def _counts(recordings: Sequence[InspectedRecording]) -> list[tuple[str, str, int]]:
    tally = Counter(one.level for one in recordings)
    return [(level, _WORDS[level], tally[level]) for level in reversed(LEVELS) if tally[level]]


def _title(recordings: Sequence[InspectedRecording], refused: Sequence[Refusal]) -> str:
    if len(recordings) == 1 and not refused:
        return f"Inspection of {trial_label(recordings[0].document)}"
    return f"Inspection of {len(recordings)} recordings" if recordings else "Nothing could be read"


def _names(documents: Sequence[Mapping[str, Any]]) -> list[str]:
    """The sheet alone where that says which recording it is, else file and sheet, else the whole path."""
    short = [document["sheet"] or trial_label(document) for document in documents]
    whole = [trial_label(document) for document in documents]
    count, count_whole = Counter(short), Counter(whole)
    return [
        name if count[name] == 1 else label if count_whole[label] == 1 else _path(document)
        for name, label, document in zip(short, whole, documents, strict=True)
    ]


def _path(document: Mapping[str, Any]) -> str:
    return document["path"] if document["sheet"] is None else f"{document['path']} [{document['sheet']}]"


def _view(position: int, recording: InspectedRecording, name: str, *, drawn: bool) -> dict[str, Any]:
    document = recording.document
    flags = [
        {
            "level": flag_level(flag["code"]),
            "code": flag["code"],
            "title": remark_title(flag["code"]),
            "message": flag["message"],
            "values": [(key, _value(value)) for key, value in flag.items() if key not in _FLAG_FIELDS],
        }
        for flag in document["flags"]
    ]
    flags.sort(key=lambda flag: -LEVELS.index(flag["level"]))
    holds = [phase for phase in document["phases"] if phase["kind"] == "hold"]
    return {
        "position": position,
        "id": f"recording-{position + 1}",
        "name": name,
        "path": _path(document),
        "data": document,
        "level": recording.level,
        "words": _WORDS[recording.level],
        "flags": flags,
        "codes": " ".join(flag["code"] for flag in flags),
        "phases": [_phase(phase) for phase in document["phases"]],
        "program": _program(document["phases"]),
        "hold_s": max((phase["end_s"] - phase["start_s"] for phase in holds), default=None),
        "reader": recording.reader,
        "decisions": recording.decisions,
        "corrections": corrections(document, recording.standing),
        "drawn": drawn,
        "alternative": _alternative(document),
    }


def _phase(phase: Mapping[str, Any]) -> dict[str, str]:
    still = phase["speed_mm_s"] == 0.0
    return {
        "kind": phase["kind"],
        "start": number(phase["start_s"]),
        "end": number(phase["end_s"]),
        "length": number(phase["end_s"] - phase["start_s"], 3),
        "speed": "0" if still else number(phase["speed_mm_s"], 4),
        "speed_min": "0" if still else number(phase["speed_mm_s"] * _S_PER_MIN, 4),
    }


def _program(phases: Sequence[Mapping[str, Any]]) -> str:
    """The phases in a few words: ``approach, ramp, hold`` or ``3 × cycle``."""
    words: list[list[Any]] = []
    for phase in phases:
        if words and words[-1][0] == phase["kind"]:
            words[-1][1] += 1
        else:
            words.append([phase["kind"], 1])
    shown = [kind if count == 1 else f"{count} × {kind}" for kind, count in words[:6]]
    return ", ".join(shown) + (" ..." if len(words) > len(shown) else "")


def _value(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    if isinstance(value, float):
        return number(value)
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _alternative(document: Mapping[str, Any]) -> str:
    """The picture in words, for those who do not see it."""
    peak, contact = document["peak_force"], document["contact"]
    touched = "no contact found" if contact is None else f"contact at {number(contact['displacement_mm'])} mm"
    length = number(document["last"]["time_s"] - document["first"]["time_s"])
    return (
        f"Force and displacement of {trial_label(document)} against time: {document['n_samples']} samples"
        f" over {length} s, {_program(document['phases'])}; {touched}; largest force"
        f" {number(peak['force_N'])} N at {number(peak['time_s'])} s."
    )
