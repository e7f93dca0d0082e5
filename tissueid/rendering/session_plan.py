"""A session that is ready to begin, its script, and what its log says of it first.

A script of a session: strokes of the simulated grip, and switches between tissues at their ends.

::

    indent 4 mm at 250 mm/min; hold 1 s; retract at 250 mm/min; switch; indent 4 mm at 250 mm/min

Strokes are those of :mod:`tissueid.haptics.hand`, in tissue units.  ``switch`` goes to the next tissue; the
servo takes it when nothing is touched, so it must stand where the tool is out of the tissue.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np

from tissueid import __version__
from tissueid.arrays import FloatArray
from tissueid.errors import UsageError
from tissueid.haptics.device import Capabilities
from tissueid.haptics.hand import Hand, Stroke, parse_script, scripted_hand
from tissueid.rendering.blind import BlindOrder
from tissueid.rendering.choice import Picked
from tissueid.rendering.precheck import MOST_DAMPING, Precheck

SWITCH = "switch"
#: Start-up ramp of the simulated device under a script [s]: the shortest that the guard knows.
RAMP_S = 0.5
#: Rest above the tissue before the first stroke [s]: homing (0.05 s) and the ramp are over by then.
REST_S = 0.6
#: Time after the last stroke that is still recorded [s].
TAIL_S = 0.05


@dataclass(frozen=True, slots=True)
class Script:
    """Strokes of a scripted session."""

    text: str  # as the user wrote it
    strokes_text: str  # the strokes alone, for the hand
    strokes: tuple[Stroke, ...]
    switches_s: tuple[float, ...]  # when to go to the next tissue, from the start of the device's time [s]
    #: From the start of the device's time to the end of the last stroke, and a moment more [s].
    duration_s: float

    def hand(self, *, motion_scale: float, surface_m: FloatArray, inward: FloatArray) -> Hand:
        """The machine that carries the simulated grip through the strokes."""
        return scripted_hand(
            self.strokes_text,
            motion_scale=motion_scale,
            surface_m=surface_m,
            inward=inward,
            rest_s=REST_S,
        )


def read_script(text: str) -> Script:
    """Read a script.

    Raises UsageError: a part is no stroke, leads nowhere, or switches inside the tissue.
    """
    parts = [" ".join(part.split()) for part in text.split(";") if part.strip()]
    stroke_texts = [part for part in parts if part != SWITCH]
    strokes = parse_script("; ".join(stroke_texts))
    ends = REST_S + np.cumsum([stroke.duration_s for stroke in strokes])
    switches, done = [], 0
    for part in parts:
        if part != SWITCH:
            done += 1
            continue
        if done and strokes[done - 1].depth_mm >= 0.0:
            msg = (
                f"script: 'switch' after {stroke_texts[done - 1]!r} would change the tissue under the tool; "
                "retract first"
            )
            raise UsageError(msg)
        switches.append(float(ends[done - 1]) if done else 0.5 * REST_S)
    return Script(text, "; ".join(stroke_texts), strokes, tuple(switches), float(ends[-1]) + TAIL_S)


#: The servo runs at 1 kHz.
PERIOD_S = 0.001


@dataclass(frozen=True, slots=True, eq=False)
class SessionPlan:
    """A session, ready to begin."""

    device: str
    device_options: Mapping[str, Any]
    why: str  # why this device
    capabilities: Capabilities
    #: Parameter blocks (environment, then passivity controller), in the order of presentation.
    blocks: tuple[FloatArray, ...]
    picked: tuple[Picked, ...]  # the tissues, first and second
    check: Precheck | None  # none for an installed force law
    order: BlindOrder | None
    head: Mapping[str, Any]  # of the log
    script: Script | None
    seconds: float | None  # when the session ends by itself
    environment: str | None
    virtual: bool
    lines: tuple[str, ...]  # what is printed before force
    led: bool = False  # whether a pointer on a screen leads the hand of the simulated device
    guided: bool = False  # whether the block is a guided axis
    pseudonym: str | None = None  # of the person who is guided; a blind order has its own
    scene: str | None = None  # name of the scene it comes from


def session_head(plan: SessionPlan, surface: FloatArray, hashes: tuple[str | None, ...]) -> dict[str, Any]:
    """Head of the log; in a blind session it knows numbers of presentations alone.

    ``surface`` (SURFACE_SIZE,); ``hashes``: SHA-256 of the bundle of each tissue, or None.
    """
    capabilities = plan.capabilities
    return {
        "tissueid": __version__,
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "pseudonym": plan.pseudonym if plan.order is None else plan.order.pseudonym,
        "blind": plan.order is not None,
        "tissues": _tissue_entries(plan, hashes),
        "environment": plan.environment or ("guidance" if plan.guided else "tissue"),
        "surface": [float(value) for value in surface],
        "device": {
            "name": plan.device,
            "why": plan.why,
            "hardware": capabilities.hardware,
            "calibrated": capabilities.calibrated,
            "clamp_N": float(capabilities.clamp_N),
            "damping_N_s_per_m": min(float(capabilities.damping_N_s_per_m), MOST_DAMPING),
            "delay_ticks": float(capabilities.delay_ticks),
        },
        "scale": None if plan.check is None else plan.check.as_json(),
        "script": None if plan.script is None else plan.script.text,
        "servo": {"period_s": PERIOD_S, "virtual_time": plan.virtual},
        **({} if plan.scene is None or plan.order is not None else {"scene": plan.scene}),
    }


def _tissue_entries(plan: SessionPlan, hashes: tuple[str | None, ...]) -> list[dict[str, Any]]:
    nothing: dict[str, Any] = {"content_sha256": None, "draw": None, "tip_radius_mm": None, "block": []}
    nothing |= {"depth_mm": None, "fastest_mm_s": None}
    if plan.order is not None:
        return [
            {**nothing, "label": number, "name": f"presentation {number}"}
            for number in range(1, len(plan.order.tissues) + 1)
        ]
    if not plan.picked:
        # what was felt can be computed again from the block; of an installed law nothing is known
        known = {"name": "guidance", "block": plan.blocks[0].tolist()} if plan.guided else {}
        return [{**nothing, "label": 0, "name": str(plan.environment), **known}]
    return [
        {
            "label": label,
            "name": each.tissue.name,
            "content_sha256": digest,
            "draw": each.draw,
            "depth_mm": each.tissue.model.depth_mm,
            "fastest_mm_s": each.tissue.speeds_mm_s[1],
            "tip_radius_mm": each.tissue.tip_radius_mm,
            **({} if each.tissue.tip is None else {"tip": each.tissue.tip.as_json()}),
            "block": plan.blocks[label].tolist(),
        }
        for label, (each, digest) in enumerate(zip(plan.picked, hashes, strict=True))
    ]
