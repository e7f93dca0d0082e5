"""The page of a twin: a law that went in, beside what a machine found at the grips of its devices."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.digits import number
from tissueid.documents import twin as document
from tissueid.report.page import render_plain
from tissueid.report.parts import Figure, Section, Table, trace
from tissueid.report.wording import percent, span

if TYPE_CHECKING:
    from tissueid.twin import Twin

#: Points of a curve at the most.
POINTS = 1_500
#: Just-noticeable differences that are told at the least.
LEAST_TOLD = 0.01
HEADS = ("Number", "Unit", "Went in", "95 %", "Came out", "95 % with the machine", "Verdict")
WORDS = {
    "inside": "inside",
    "outside": "outside",
    "destroyed": "destroyed by counts and delay",
    "not identified": "not identified in the bundle",
}


def render_twin(twin: Twin) -> str:
    """Write the page."""
    first, *others = twin_sections(twin.found)
    return render_plain("Mechanical twin", [replace(first, figures=[_figure(twin)]), *others])


def twin_sections(found: document.Twin) -> list[Section]:
    """Sections of a page without its curves: the program and the unseen speed, then each device."""
    unseen, felt = found.unseen, number(1.0 / found.force_scale, 3)
    text = (
        f"{found.specimen}, {found.model}; {found.program}. A felt newton is {felt} of tissue, motion is "
        f"{number(found.motion_scale, 3)} times as large. At {number(unseen.speed_mm_s, 3)} mm/s, a speed of "
        f"no recording, the emulated Falcon is off the law by {_percent(unseen.nrmsd_model)}. No "
        "real device has confirmed this: the Falcon is emulated, its counts and delay are stated."
    )
    source = f"{found.limit.source}, doi {found.limit.doi}"
    return [Section("Force at the grips", text), *(_device(one, source) for one in found.devices)]


def _percent(share: float) -> str:
    return "less than 0.001 %" if share < 1e-5 else f"{percent(share, 2)} %"


def _device(one: document.Device, source: str) -> Section:
    recorded = (
        "" if one.nrmsd_recording is None else f", off the recording by {_percent(one.nrmsd_recording)}"
    )
    refit = "" if one.fit_nrmsd is None else f" The refit has an NRMSD of {_percent(one.fit_nrmsd)}."
    could = "could" if one.noticeable > 1.0 else "could not"
    most = number(max(one.noticeable, LEAST_TOLD), 2)
    text = (
        f"Off the law by {_percent(one.nrmsd_model)} of its range{recorded}.{refit} A hand {could} tell: "
        f"{most} just-noticeable differences of force at most ({source})."
    )
    rows = [
        (
            *(row.symbol, "" if row.unit == "1" else row.unit, number(row.went_in), span(row.went_in_ci95)),
            *(number(row.came_out), span(row.came_out_ci95), WORDS[row.verdict]),
        )
        for row in one.rows
    ]
    return Section(one.device[:1].upper() + one.device[1:], text, tables=[Table(HEADS, rows)] if rows else [])


def _figure(twin: Twin) -> Figure:
    """Law and grips against the time from contact."""
    traces: list[dict[str, Any]] = []
    for one, ink in zip(twin.curves, ("model", "ok", "aside"), strict=False):
        every = max(1, one.time_s.size // POINTS)
        shown = np.round(one.time_s[::every], 5).tolist()
        if not traces:
            law = np.round(one.law_N[::every], 5).tolist()
            traces.append(trace(shown, law, name="law of the bundle", line={"ink": "data"}))
        felt = np.round(one.force_N[::every], 5).tolist()
        traces.append(trace(shown, felt, name=one.device, line={"ink": ink, "dash": "dot"}))
    of = twin.found.specimen
    caption = f"Force of the law of {of} and at the grips of its devices over the time from contact."
    return Figure(caption, "Time from contact [s]", "Force [N of tissue]", traces)
