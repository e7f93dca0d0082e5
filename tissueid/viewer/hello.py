"""The first message to a page: what the session holds, so that the page draws no more and no less.

One JSON object, ``{"type": "hello", "v": 1, ...}``:

``session``
    title, device, scale, tissues, whether it is hardware, blind, a replay, and may be led by a pointer.
``scene``
    ``objects``, each with a ``kind`` the page knows how to draw (``surface``, ``tool``, ``workspace``), in
    metres of the device's frame; a page leaves out kinds it does not know.
``strips``
    what is drawn over time, or over another field: an id, a title, a unit, and ``traces``.
``hint``
    what a hand on the mouse does.
``digits``
    what the second and the third of the big numbers are.
``lamps``
    an id, a word, what it means, and the bits of ``lamps`` (or ``fault``) that light it.
``band``, ``beside``
    :mod:`tissueid.viewer.showing`.
``sample``
    layout of a sample (:mod:`tissueid.viewer.frames`).

Another scene is another list of objects, strips and lamps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from tissueid.haptics.sim import CENTRE_M, WORKING_RADIUS_M
from tissueid.haptics.states import FAULT_WORDS, Lamp, State
from tissueid.rendering import guidance as gd
from tissueid.rendering.environment import GUIDED
from tissueid.rendering.guidance import CONE, PRINTED_ONE_M
from tissueid.trial import TipShape
from tissueid.viewer.frames import SAMPLE, layout

#: Height above the entry point up to which axis and funnel are drawn [m].
DRAWN_M = 0.04
#: Points of the funnel's profile.
POINTS = 40


def guided_objects(block: Sequence[float]) -> list[dict[str, Any]]:
    """Objects of a scene, in metres of the device's frame.

    ``block``: of the log's head: an environment that is a guided axis.  Returns ``axis`` (from the end of the
    drilling outward), ``funnel`` (points (r, z) of its profile about the axis) and, where there is one,
    ``bone``.
    """
    numbers = np.asarray(block, dtype=np.float64)[GUIDED : GUIDED + gd.GUIDANCE_SIZE]
    entry, axis = numbers[gd.ORIGIN : gd.ORIGIN + 3], numbers[gd.AXIS : gd.AXIS + 3]
    drilled_m = float(numbers[gd.DRILL_END])
    place = {"entry_m": entry.tolist(), "axis": axis.tolist()}
    objects: list[dict[str, Any]] = [
        {"kind": "axis", **place, "from_m": -drilled_m, "to_m": DRAWN_M},
        {"kind": "funnel", **place, "profile_m": _profile(numbers[gd.FUNNEL : gd.CONTACT])},
    ]
    radius_m = float(numbers[gd.RADIUS])
    if radius_m > 0.0:
        hole_m = float(numbers[gd.HOLE])
        objects.append(
            {"kind": "bone", **place, "radius_m": radius_m, "hole_radius_m": hole_m, "drill_m": drilled_m}
        )
    return objects


def _profile(funnel: np.ndarray) -> list[list[float]]:
    """Points (r, z) of the surface, from its lowest place that is felt."""
    kind, a, b, c = funnel
    if int(kind) == CONE:
        z = np.linspace(-PRINTED_ONE_M - b, DRAWN_M, POINTS)
        radius = a * (z + PRINTED_ONE_M + b) / c
    else:
        z = np.linspace(-b, DRAWN_M, POINTS)
        radius = a * np.sqrt(1.0 + ((z + b) / c) ** 2)
    return [[float(one), float(height)] for one, height in zip(radius, z, strict=True)]


PROTOCOL = 1
Workspace = Sequence[tuple[float, float]]
#: Kinds of surfaces by the number in their block.
SURFACES = ("plane", "sphere", "box")

#: id, word, meaning, bits.
LAMPS = (
    ("saturation", "Saturated", "the force is cut at the device's clamp", Lamp.CLIPPED | Lamp.RMS_LIMITED),
    ("passivity", "Passivity control", "the controller brakes: energy would be made", Lamp.PASSIVITY),
    (
        "outside",
        "Outside validity",
        "deeper or faster than the tissue was identified",
        Lamp.OUTSIDE_DEPTH | Lamp.OUTSIDE_SPEED,
    ),
    ("rupture", "Ruptured", "the tissue broke: what is left resists until it is put back", Lamp.RUPTURED),
    ("timing", "Late tick", "the servo's tick began late, or stalled", Lamp.LATE | Lamp.STALLED),
    (
        "wire",
        "Late wire",
        "the device is silent, or answers late: less force, or none, until it answers in time",
        Lamp.SILENT | Lamp.LATENCY,
    ),
)
#: Those that only a tissue can light.
TISSUE_LAMPS = ("outside", "rupture")
#: What a hand on the mouse does.
HINT = "Drag the tool down into the tissue"
GUIDED_HINT = "Drag the wire down to the bone, and drill"
#: What the second and the third of the big numbers are.
DIGITS = {"tissue": "N of tissue", "depth": "mm deep"}
GUIDED_DIGITS = {"tissue": "N of the bone", "depth": "mm below the entry"}
#: Traces: a sample's ``field`` (of a vector its length), less the period where ``minus_period`` is set, times
#: ``factor``; ``over`` another field instead of the time; ``axis`` right where the unit is another.
STRIPS: tuple[dict[str, Any], ...] = (
    {
        "id": "force",
        "title": "Force",
        "unit": "N",
        "traces": [
            {"id": "device_N", "label": "device", "field": "force_N"},
            {"id": "tissue_N", "label": "tissue", "field": "tissue_force_N", "axis": "right"},
        ],
    },
    {
        "id": "depth",
        "title": "Depth in tissue",
        "unit": "mm",
        "traces": [{"id": "depth_mm", "label": "depth", "field": "depth_mm"}],
    },
    {
        "id": "loop",
        "title": "Tissue force over depth",
        "unit": "N over mm",
        "traces": [{"id": "loop_N", "label": "felt", "field": "tissue_force_N", "over": "depth_mm"}],
    },
    {
        "id": "energy",
        "title": "Energy taken from the hand",
        "unit": "mJ",
        "traces": [{"id": "energy_mJ", "label": "energy", "field": "energy_J", "factor": 1e3}],
    },
    {
        "id": "period",
        "title": "Error of the servo's period",
        "unit": "\u00b5s",
        "traces": [
            {"id": "period_us", "label": "error", "field": "dt_s", "factor": 1e6, "minus_period": True}
        ],
    },
)


def hello(
    head: Mapping[str, Any],
    *,
    workspace_m: Workspace | None = None,
    pointer: bool = False,
    band: Mapping[str, Any] | None = None,
    replay_s: float | None = None,
    beside: Mapping[str, list[float]] | None = None,
) -> dict[str, Any]:
    """The hello of a session.

    ``head``: of its log, ``schemas/session.schema.json``; ``workspace_m``: range along x, y and z; a Falcon's
    where a log does not say; ``pointer``: whether a page may lead the hand; ``replay_s``: length of a log
    that is replayed [s]; ``beside``: a recording that is drawn beside it: ``time_s``, in the log's time,
    ``depth_mm``, ``force_N``.
    """
    if workspace_m is None:
        workspace_m = [(middle - WORKING_RADIUS_M, middle + WORKING_RADIUS_M) for middle in CENTRE_M]
    device, tissues = head["device"], head["tissues"]
    return {
        "type": "hello",
        "v": PROTOCOL,
        "session": {
            "title": _title(head),
            "started": head["started"],
            "device": {key: device[key] for key in ("name", "hardware", "calibrated", "clamp_N")},
            "scale": head["scale"],
            "tissues": [
                {key: tissue[key] for key in ("label", "name", "depth_mm", "fastest_mm_s")}
                for tissue in tissues
            ],
            "blind": bool(head["blind"]),
            "period_s": head["servo"]["period_s"],
            "pointer": pointer,
            "replay_s": replay_s,
        },
        "scene": {"kind": str(head["environment"]), "objects": _objects(head, workspace_m)},
        "strips": _strips(head) if beside is None else _beside(_strips(head)),
        "digits": GUIDED_DIGITS if head["environment"] == "guidance" else DIGITS,
        "hint": GUIDED_HINT if head["environment"] == "guidance" else HINT,
        "lamps": [
            {"id": name, "word": word, "meaning": meaning, "bits": int(bits)}
            for name, word, meaning, bits in LAMPS
            if name not in TISSUE_LAMPS or head["environment"] == "tissue"
        ],
        "states": {int(state): state.name.lower() for state in State},
        "faults": {int(fault): words for fault, words in FAULT_WORDS.items()},
        "band": band,
        "beside": beside,
        "sample": {"bytes": SAMPLE.itemsize, "fields": layout()},
    }


def _strips(head: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The strips, in the words of what is felt."""
    if head["environment"] != "guidance":
        return list(STRIPS)
    titles = {"depth": "Below the entry point", "loop": "Force of the bone over depth"}
    strips = [{**strip, "title": titles.get(strip["id"], strip["title"])} for strip in STRIPS]
    strips[0] = {**strips[0], "traces": [strips[0]["traces"][0], {**strips[0]["traces"][1], "label": "bone"}]}
    return strips


def _beside(strips: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The strips with a trace of a recording in that of the force and in that of the depth."""
    more: dict[str, dict[str, Any]] = {
        "force": {"id": "recording_N", "label": "recording", "beside": "force_N", "axis": "right"},
        "depth": {"id": "recording_mm", "label": "recording", "beside": "depth_mm"},
    }
    return [
        {**strip, "traces": [*strip["traces"], more[strip["id"]]]} if strip["id"] in more else strip
        for strip in strips
    ]


def _title(head: Mapping[str, Any]) -> str:
    if head["blind"]:
        return "blind comparison"
    if "scene" in head:
        return str(head["scene"])
    if head["environment"] != "tissue":
        return str(head["environment"])
    return " against ".join(str(tissue["name"]) for tissue in head["tissues"])


def _objects(head: Mapping[str, Any], workspace_m: Workspace) -> list[dict[str, Any]]:
    """Surface, tool and workspace [m, device frame]."""
    kind, numbers = int(head["surface"][0]), [float(value) for value in head["surface"]]
    radius_m = numbers[10]
    objects: list[dict[str, Any]] = [
        {"kind": "workspace", "ranges_m": [[float(low), float(high)] for low, high in workspace_m]},
        {
            "kind": "tool",
            "radius_m": radius_m,
            "force_field": "force_N",
            "position_field": "position_m",
            **head["tissues"][0].get("tip", TipShape("sphere").as_json()),
        },
    ]
    if head["environment"] == "guidance":
        guided = guided_objects(head["tissues"][0]["block"])
        objects[-1] |= {"shape": "wire", "axis": guided[0]["axis"]}
        return objects + guided
    if head["environment"] != "tissue":
        return objects
    scale = head["scale"]
    objects.append(
        {
            "kind": "surface",
            "shape": SURFACES[kind],
            "point_m": numbers[1:4],
            "normal": numbers[4:7] if kind == 0 else [0.0, 0.0, 1.0],
            "size_m": numbers[7:10],
            "motion_scale": 1.0 if scale is None else float(scale["motion_scale"]),
        }
    )
    return objects
