"""The page of ``tissueid control``: tracking, force, estimates and V of the loops, with all their numbers.

Self-contained like the report.  What is published, read, derived, assumed or stated is told apart by words.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tissueid.digits import number
from tissueid.report.page import asset, page_environment, plotly_script
from tissueid.report.wording import Verdict

__all__ = ["control_remarks", "render_control"]

_NAMES = {
    "adaptive": "Adapting",
    "frozen": "Frozen: the estimates stay",
    "unscaled": "The same at the tissue's own stiffness",
}
_LEGEND = {"adaptive": "adapting", "frozen": "frozen", "unscaled": "own stiffness"}
_ESTIMATES = {
    "mass_kg": "Mass [kg]",
    "damping_N_s_per_m": "Damping [N s/m]",
    "stiffness_N_per_m": "Stiffness [N/m]",
}
#: Figure -> heading, what it shows, the curves of each run with their words, the title of the axis.
_FIGURES: dict[str, tuple[str, str, dict[str, str], str]] = {
    "position": ("Position", "Virtual tool and device; 0 is the surface, positive is inside.",
                 {"tool_position_mm": "tool", "position_mm": "device"}, "Position [mm]"),
    "error": ("Error of the position", "Tool less device.", {"error_mm": ""}, "Error [mm]"),
    "velocity": ("Velocity", "Of the virtual tool and of the device.",
                 {"tool_velocity_mm_s": "tool", "velocity_mm_s": "device"}, "Velocity [mm/s]"),
    "velocity-error": ("Error of the velocity", "Tool less device.", {"velocity_error_mm_s": ""},
                       "Error [mm/s]"),
    "force": ("Forces", "Of the tissue on the virtual tool, and of the hand as the sensor says it.",
              {"environment_force_N": "tissue", "hand_force_N": "hand"}, "Force [N]"),
    "control": ("Control force", "u of equation (20), after saturation.", {"control_force_N": ""},
                "Force [N]"),
    "mass": ("Estimate of the mass", "Dashed: true.", {"mass_kg": ""}, "Mass [kg]"),
    "damping": ("Estimate of the damping", "Dashed: true.", {"damping_N_s_per_m": ""}, "Damping [N s/m]"),
    "stiffness": ("Estimate of the stiffness", "Dashed: true.", {"stiffness_N_per_m": ""}, "Stiffness [N/m]"),
    "lyapunov": ("Lyapunov function", "V of (I-1): what tracking and estimates are off, in one number.",
                 {"lyapunov": ""}, "V"),
}  # fmt: skip


def _verdict(document: Mapping[str, Any]) -> Verdict:
    asked = document["runs"][0]
    one = asked["measures"]
    if one["diverged_s"] is not None:
        return Verdict(
            "serious",
            "Diverged",
            f"The loop left all bounds after {number(one['diverged_s'], 4)} s; its numbers are of the time "
            "before.",
        )
    errors = f"{number(one['error_rms_mm'], 3)} mm rms ({number(one['error_max_mm'], 3)} mm at most)"
    span, scale = number(one["over_s"], 3), f"{document['stiffness_scale']:g}"
    said = (
        f"The device followed the virtual tool to {errors} over the last {span} s, against a tissue {scale} "
        "times as stiff as identified. A simulation of stated masses and gains: it shows nothing of a device "
        "or a hand that are otherwise."
    )
    return Verdict("ok", "Bounded", said)


def control_remarks(document: Mapping[str, Any]) -> list[str]:
    """Sentences that a reader must not miss."""
    found = []
    runs = {run["name"]: run for run in document["runs"]}
    errors = {name: run["measures"]["error_rms_mm"] for name, run in runs.items()}
    if runs["adaptive"]["measures"]["diverged_s"] is None and errors["frozen"] > 0.0:
        ratio = errors["adaptive"] / errors["frozen"]
        meaning = (
            "adaptation changes next to nothing here: the robust term works as a stiff gain"
            if 0.9 < ratio < 1.1
            else "that is what adaptation does here"
        )
        found.append(
            f"The adapting controller has {number(ratio, 3)} times the error of the frozen one; {meaning}."
        )
    asked = document["runs"][0]["measures"]
    if asked["violated_share"] > 0.0:
        share, excess = 100.0 * asked["violated_share"], number(asked["violation_max_W"], 3)
        why = (
            "its proof needs the adaptation"
            if document["runs"][0]["name"] == "frozen"
            else "its proof knows neither sampling nor a force that is one sample old"
        )
        found.append(
            f"After {share:.2g} % of the samples V rose faster than (I-6) allows, by {excess} W at most: "
            f"{why}."
        )
    if asked["outside_share"] > 0.0:
        found.append(
            f"{100.0 * asked['outside_share']:.2g} % of the time it was deeper than the "
            f"{number(document['tissue']['depth_mm'], 3)} mm that were identified, where the law goes on."
        )
    mass = document["virtual_mass"]
    if not mass["enough"]:
        found.append(
            f"The virtual mass of {number(mass['given_kg'], 3)} kg is less than 1.5 times its bound of "
            f"{number(mass['bound_kg'], 3)} kg: wrong estimates have no margin."
        )
    if document["environment"] == "impedance":
        found.append("An impedance-type loop leads by velocity alone: its error of position means nothing.")
    return found


def _figures() -> list[dict[str, str]]:
    return [{"kind": kind, "title": row[0], "words": row[1]} for kind, row in _FIGURES.items()]


def render_control(
    document: Mapping[str, Any],
    series: Mapping[str, Mapping[str, Any]],
    *,
    created: str | None = None,
) -> str:
    """Write the page.

    Parameters
    ----------
    document : mapping
        The document of ``schemas/control.schema.json``.
    series : mapping
        Run -> curve -> [times, values].
    created : str, optional
        Time stamp to print; without it equal input gives an equal page.

    Returns
    -------
    str
        HTML, UTF-8.
    """
    truth = {row["name"]: row["true"] for row in document["runs"][0]["estimates"]}
    payload = {
        "runs": [{"name": name, "words": _LEGEND[name], "curves": curves} for name, curves in series.items()],
        "figures": {kind: {"curves": list(row[2].items()), "axis": row[3]} for kind, row in _FIGURES.items()},
        "truth": truth,
    }
    template = page_environment().get_template("control.html.j2")
    return template.render(
        title=f"Adaptive controller on {document['tissue']['name'] or 'a tissue'}",
        run=document,
        names=_NAMES,
        estimate_names=_ESTIMATES,
        verdict=_verdict(document),
        remarks=control_remarks(document),
        figures=_figures(),
        payload=payload,
        created=created,
        style=asset("page.css") + asset("selfcheck.css"),
        scripts=[asset("boxes.js"), asset("control.js")],
        plotly=plotly_script(),
    )
