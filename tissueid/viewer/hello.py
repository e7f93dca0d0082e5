"""The first message to a page: what the session holds, so that the page draws no more and no less.

One JSON object; objects of its scene are in metres of the device's frame, each of a ``kind`` that the page
knows how to draw, and words go by the id of what they stand in.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents import plain
from tissueid.documents.identification import TipGeometry
from tissueid.errors import BundleError, refuse
from tissueid.haptics.sim import CENTRE_M, WORKING_RADIUS_M
from tissueid.haptics.states import FAULT_WORDS, Lamp, State
from tissueid.model.channels import loading_force
from tissueid.rendering import guidance as gd
from tissueid.rendering.environment import GUIDED
from tissueid.rendering.session_plan import SessionPlan
from tissueid.rendering.tissue_block import Tissue
from tissueid.store.bundle import load_bundle
from tissueid.store.session_log import SessionLog, read_session_log
from tissueid.viewer.frames import SAMPLE, layout
from tissueid.viewer.serving import ServedViewer

if TYPE_CHECKING:
    from tissueid.rendering.servo import ServoProcess

#: Height above the entry point up to which axis and funnel are drawn [m].
DRAWN_M = 0.04
#: Points of the funnel's profile.
POINTS = 40


def guided_objects(block: Sequence[float]) -> list[dict[str, Any]]:
    """Axis, funnel and, where there is one, bone of a guided axis' block, in metres of the device's frame."""
    numbers = np.asarray(block, dtype=np.float64)[GUIDED : GUIDED + gd.GUIDANCE_SIZE]
    entry, axis = numbers[gd.ORIGIN : gd.ORIGIN + 3], numbers[gd.AXIS : gd.AXIS + 3]
    drilled_m = float(numbers[gd.DRILL_END])
    place = {"entry_m": entry.tolist(), "axis": axis.tolist()}
    funnel = numbers[gd.FUNNEL : gd.CONTACT]
    # points (r, z) from the lowest place that is felt
    lowest_m = funnel[gd.B] + (gd.PRINTED_ONE_M if int(funnel[gd.KIND]) == gd.CONE else 0.0)
    z = np.linspace(-lowest_m, DRAWN_M, POINTS)
    profile = np.column_stack([gd.funnel_radius(funnel, z), z]).tolist()
    objects: list[dict[str, Any]] = [
        {"kind": "axis", **place, "from_m": -drilled_m, "to_m": DRAWN_M},
        {"kind": "funnel", **place, "profile_m": profile},
    ]
    radius_m = float(numbers[gd.RADIUS])
    if radius_m > 0.0:
        hole_m = float(numbers[gd.HOLE])
        objects.append(
            {"kind": "bone", **place, "radius_m": radius_m, "hole_radius_m": hole_m, "drill_m": drilled_m}
        )
    return objects


PROTOCOL = 1
Workspace = Sequence[tuple[float, float]]
#: Kinds of surfaces by the number in their block.
SURFACES = ("plane", "sphere", "box")

#: id, word, meaning, bits; none of those that the page lights itself.
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
    ("stale", "Stale", "nothing new has come", 0),
    ("fault", "Fault", "the device is off", 0),
    ("recording", "Recording stopped", "the session goes on unrecorded", 0),
)
#: Those that only a tissue can light.
TISSUE_LAMPS = ("outside", "rupture")
#: What a hand on the mouse does.
HINT = "Drag the tool down into the tissue"
GUIDED_HINT = "Drag the wire down to the bone, and drill"
KEYS_HINT = " \u00b7 arrow keys: press, lift, slide \u00b7 right button: turn \u00b7 wheel: zoom"
#: Where no hand is led.
STILL_HINT = "Drag: turn \u00b7 wheel: zoom"
#: What the second and the third of the big numbers are.
DIGITS = {"tissue-words": "N of tissue", "depth-words": "mm deep"}
GUIDED_DIGITS = {"tissue-words": "N of the bone", "depth-words": "mm below the entry"}


def _strip(name: str, title: str, unit: str, *traces: dict[str, Any]) -> dict[str, Any]:
    return {"id": name, "title": title, "unit": unit, "traces": list(traces)}


#: Traces: a sample's ``field`` (of a vector its length), less the period where ``minus_period`` is set, times
#: ``factor``; ``over`` another field instead of the time; ``axis`` right where the unit is another.
STRIPS = (
    _strip(
        "force",
        "Force",
        "N",
        {"id": "device_N", "label": "device", "field": "force_N"},
        {"id": "tissue_N", "label": "tissue", "field": "tissue_force_N", "axis": "right"},
    ),
    _strip("depth", "Depth in tissue", "mm", {"id": "depth_mm", "label": "depth", "field": "depth_mm"}),
    _strip(
        "loop",
        "Tissue force over depth",
        "N over mm",
        {"id": "loop_N", "label": "felt", "field": "tissue_force_N", "over": "depth_mm"},
    ),
    _strip(
        "energy",
        "Energy taken from the hand",
        "mJ",
        {"id": "energy_mJ", "label": "energy", "field": "energy_J", "factor": 1e3},
    ),
    _strip(
        "period",
        "Error of the servo's period",
        "\u00b5s",
        {"id": "period_us", "label": "error", "field": "dt_s", "factor": 1e6, "minus_period": True},
    ),
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
    """The hello of a session, by the head of its log (``schemas/session.schema.json``).

    ``workspace_m``: range along x, y and z; a Falcon's where a log does not say; ``replay_s``: length of a
    log that is replayed; ``beside``: a recording drawn beside it: ``time_s``, ``depth_mm``, ``force_N``.
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
        "words": _words(head, replayed=replay_s is not None, pointer=pointer),
        "lamps": [
            {"id": name, "word": word, "meaning": meaning, "bits": int(bits)}
            for name, word, meaning, bits in LAMPS
            if name not in TISSUE_LAMPS or head["environment"] == "tissue"
        ],
        "states": {int(state): state.name.lower() for state in State},
        "faults": {int(fault): words for fault, words in FAULT_WORDS.items()},
        "band": band,
        "beside": beside,
        "sample": {"bytes": SAMPLE.itemsize, "columns": layout()},
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


def _words(head: Mapping[str, Any], *, replayed: bool, pointer: bool) -> dict[str, str]:
    """Words of the page that stay, by the id of what they stand in."""
    device, scale = head["device"], head["scale"]
    guided = head["environment"] == "guidance"
    facts = [
        f"log of {head['started']}" * replayed,
        f"device {device['name']}{', simulated: no motors' * (not device['hardware'])}",
        "not calibrated" * (not device["calibrated"]),
        "blind" * bool(head["blind"]),
    ]
    known = (
        "forces and motion are the device's own" if guided else "a force law of its own: no scale is known"
    )
    felt = [known] if scale is None else _scale_words(scale, device["clamp_N"])
    said = {"facts": " \u00b7 ".join(filter(None, facts)), "scale": " \u00b7 ".join(filter(None, felt))}
    hint = f"{GUIDED_HINT if guided else HINT}{KEYS_HINT}" if pointer else STILL_HINT
    return {"title": _title(head), **(GUIDED_DIGITS if guided else DIGITS), **said, "hint": hint}


def _scale_words(scale: Mapping[str, Any], clamp_N: float) -> list[str]:
    stiffness = scale.get("device_stiffness_N_per_m")
    return [
        f"felt force = tissue force \u00d7 {_short(scale['force_scale'])}",
        f"motion \u00d7 {_short(scale['motion_scale'])}",
        "" if stiffness is None else f"device stiffness up to {_short(stiffness)} N/m",
        f"clamp {_short(clamp_N)} N",
        f"{_short(100.0 * (scale.get('clipped_share_expected') or 0.0))} % of the depth clipped",
    ]


def _short(value: float) -> str:
    """A number with three significant digits."""
    return f"{float(f'{value:.3g}'):g}"


def _objects(head: Mapping[str, Any], workspace_m: Workspace) -> list[dict[str, Any]]:
    """Surface, tool and workspace [m, device frame]."""
    kind, numbers = int(head["surface"][0]), [float(value) for value in head["surface"]]
    objects: list[dict[str, Any]] = [
        {"kind": "workspace", "ranges_m": [[float(low), float(high)] for low, high in workspace_m]},
        {
            "kind": "tool",
            "radius_m": numbers[10],
            "force_field": "force_N",
            "position_field": "position_m",
            **head["tissues"][0].get("tip", plain(TipGeometry("sphere", None))),
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


#: Depths of a curve.
CURVE_POINTS = 41
LOW, HIGH = 0.025, 0.975
#: Draws the band is made of: the 2.5 % quantile of 400 has a standard error of 0.8 % of them.
MOST_DRAWS = 400
#: Samples of a recording that is drawn beside a log.
MOST_BESIDE = 4_000


def band_of(tissue: Tissue, draws: FloatArray | None) -> dict[str, Any]:
    """Force over depth at the slowest and fastest speed, with pointwise 95 % quantiles of draws (m, p)."""
    depth = np.linspace(0.0, tissue.model.depth_mm, CURVE_POINTS)
    used = np.zeros((0, tissue.theta.size)) if draws is None else draws[:: max(1, len(draws) // MOST_DRAWS)]
    curves = []
    for speed in sorted(set(tissue.speeds_mm_s)):
        curve = {
            "speed_mm_s": float(speed),
            "depth_mm": depth.tolist(),
            "force_N": loading_force(tissue.model, tissue.theta, depth, speed_mm_s=speed).tolist(),
        }
        if len(used):
            forces = [loading_force(tissue.model, draw, depth, speed_mm_s=speed) for draw in used]
            low, high = np.quantile(forces, [LOW, HIGH], axis=0)
            curve |= {"low_N": low.tolist(), "high_N": high.tolist()}
        curves.append(curve)
    speeds = [f"{_short(curve['speed_mm_s'])} mm/s" for curve in curves]
    if len(speeds) > 1:
        speeds[0] += " (dashed)"
    band = f"95 % band of {len(used)} draws" if len(used) else "no draws, no band"
    words = f"fitted at {', '.join(speeds)}{',' if len(used) else ';'} {band}"
    return {"draws": len(used), "curves": curves, "words": words}


def show_session(viewer: ServedViewer, plan: SessionPlan, servo: ServoProcess, bundle: Path | None) -> None:
    """Show what a servo renders, with its hand where a pointer may lead it, and the bundle's band."""
    band = None
    if plan.picked and plan.order is None:
        band = band_of(plan.picked[0].tissue, None if bundle is None else load_bundle(bundle).draws)
    workspace_m = [[float(low), float(high)] for low, high in plan.capabilities.workspace_m]
    words = hello(plan.head, workspace_m=plan.capabilities.workspace_m, pointer=plan.led, band=band)
    reading = servo.ring.read_only()
    try:
        descriptors, rest_m = [reading], None
        if servo.hand is not None:
            descriptors.append(servo.hand.descriptor)
            rest_m = [float(value) for value in plan.device_options["hand"].start_m]
            viewer.let_go = partial(servo.hand.point_at, rest_m)
            viewer.silent_s = servo.hand.silent_s
        viewer.show_live(words, descriptors, rest_m=rest_m, workspace_m=workspace_m)
    finally:
        os.close(reading)


def check_log(path: Path) -> SessionLog:
    """A log with something in it; BundleError: it can't be read, or holds no two ticks."""
    log = read_session_log(path)
    if log.records.size < 2:
        raise BundleError(f"{path}: the log holds {log.records.size} ticks, there is nothing to see")
    return log


def recording_beside(log: SessionLog, path: Path) -> dict[str, list[float]]:
    """A recording in a log's time: both cross the surface at once; UsageError where one never touches it."""
    # what the first picture of a session need not wait for
    from tissueid.ingest import read_trials
    from tissueid.segment import segment
    from tissueid.trial import contact_frame

    trial = read_trials(path)[0]
    found = segment(trial)
    inside = np.flatnonzero(log.records["depth_mm"] > 0.0)
    if found.contact is None or not inside.size:
        whose = path if found.contact is None else "the log"
        refuse(f"{whose}: there is no contact in it, by which the two could be laid beside each other")
    depth, force = contact_frame(trial, found)
    met_s = float(log.records["time_s"][inside[0]])
    time_s = trial.time_s - trial.time_s[found.contact.index] + met_s
    every = max(1, time_s.size // MOST_BESIDE)
    return {
        "time_s": time_s[::every].tolist(),
        "depth_mm": depth[::every].tolist(),
        "force_N": force[::every].tolist(),
    }


def show_log(
    viewer: ServedViewer, log: SessionLog, path: Path, beside: Mapping[str, list[float]] | None = None
) -> None:
    """Play a log of :func:`check_log`, which the server reads again, ``beside`` a recording."""
    times = log.records["time_s"]
    viewer.show_log(hello(log.head, replay_s=float(times[-1] - times[0]), beside=beside), path)
