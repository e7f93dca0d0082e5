"""The page of ``tissueid fit --contact-law``: the numbers of the law, how well it fits, its curves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tissueid.digits import NOT_IDENTIFIED, number, with_error
from tissueid.report.plain_page import Figure, Section, Table, render_plain

__all__ = ["render_contact_law"]

#: Points of a drawn curve, and speeds over that at contact it is drawn for, with their words.
POINTS = 60
SPEEDS = ((1.0, "as fast as it began", "model"), (0.0, "held", "data"))


def render_contact_law(document: Mapping[str, Any], *, created: str | None = None) -> str:
    """Write the page.

    Parameters
    ----------
    document : mapping
        Of ``schemas/contact-law.schema.json``.
    created : str, optional
        Time stamp to print.

    Returns
    -------
    str
        HTML, UTF-8.
    """
    sections = [_section(one) for one in document["specimens"]]
    if document["refused"]:
        rows = [(one["path"], one["error"]["message"]) for one in document["refused"]]
        sections.append(Section("Left out", tables=[Table(("Recording", "Why"), rows)]))
    return render_plain("Contact law", sections, created=created)


def _section(one: Mapping[str, Any]) -> Section:
    rows = [
        (
            f"{entry['symbol']} [{entry['unit']}]" if entry["unit"] != "1" else entry["symbol"],
            NOT_IDENTIFIED if entry["value"] is None else with_error(entry["value"], entry["stderr"]),
            "" if entry["ci95"] is None else " to ".join(number(end, 4) for end in entry["ci95"]),
            entry["reason"] or "",
        )
        for entry in one["parameters"]
    ]
    logs = [
        (log["path"], f"{log['speed_mm_s']:.3g}", f"{log['contact_offset_mm']:+.3f}", str(log["n_samples"]))
        for log in one["logs"]
    ]
    returned = one["returned_speed"]
    text = (
        "F = k d\u207f (1 + 8 (1 \u2212 e) / (5 e) \u00b7 d\u2032/v\u2080), "
        "after Pires et al., equation (1). "
        f"NRMSD {100.0 * one['nrmsd']:.2f} % of the range of force; neighbouring residuals correlate by "
        f"{one['residual_correlation']:.2f}, after whitening by {one['whitened_correlation']:.2f}. "
        "Intervals hold for this law and say nothing of another. "
        + (
            ""
            if returned is None
            else f"A free mass returns with {returned:.3f} of its speed, which is not e. "
        )
        + f"While it loads, k (1 + \u03c7) is {number(one['loading_N_per_mm_n'], 4)} N/mm\u207f."
    )
    return Section(
        one["specimen"],
        text,
        tables=[
            Table(("Number", "Value", "95 %", "Why not"), rows),
            Table(("Recording", "Speed at contact [mm/s]", "Contact moved [mm]", "Samples"), logs),
        ],
        figures=_figures(one),
    )


def _figures(one: Mapping[str, Any]) -> list[Figure]:
    values = {entry["symbol"]: entry["value"] for entry in one["parameters"]}
    if any(value is None for value in values.values()):
        return []
    depth = np.linspace(0.0, one["depth_mm"], POINTS)
    chi = 8.0 * (1.0 - values["e"]) / (5.0 * values["e"])
    traces = [
        {
            "x": depth.round(4).tolist(),
            "y": (values["k"] * depth ** values["n"] * (1.0 + chi * ratio)).round(5).tolist(),
            "name": words,
            "mode": "lines",
            "line": {"ink": ink},
        }
        for ratio, words, ink in SPEEDS
    ]
    caption = f"Force of the law over depth for {one['specimen']}, at the speed of the contact and held."
    return [Figure(caption, "Depth [mm]", "Force [N]", traces)]
