"""A session that is ready to begin: its script, its blind order, and what its log says of it first."""

from __future__ import annotations

import json
import os
import re
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from tissueid import __version__
from tissueid.arrays import FloatArray
from tissueid.documents import plain
from tissueid.errors import printable, refuse
from tissueid.haptics.device import Capabilities
from tissueid.haptics.hand import Hand, Stroke, parse_script, scripted_hand
from tissueid.rendering.options import Picked
from tissueid.rendering.precheck import MOST_DAMPING, PERIOD_S, Precheck

#: Read and agreed to before a motor moves.
CONSENT_HARDWARE = """\
This moves the grip of a haptic device with force. No real unit has confirmed this software.
 - Keep hair, cables and fingers away from the arms; hold the grip, and nothing else.
 - The force acts only while the dead-man button is held; let go of the button to end it.
 - Whatever happens: pull the device's power plug. It always ends the force.
 - Do not take part with a pacemaker, or with an injury of hand or arm.
 - tissueid is not a medical device; nothing felt here is a finding about a patient."""

#: Read and agreed to before a blind comparison.
CONSENT_BLIND = """\
You will feel several tissues without being told which is which. Recorded are the movement of the grip and the
forces, under a pseudonym; no name is asked for or stored, and your answers stay on the sheet of whoever asks.
You may stop at any time, without giving a reason, and have the recording deleted. The order of the tissues is
kept in a file apart."""

_PSEUDONYM = re.compile(r"[A-Za-z]{1,3}-?\d{1,5}")
MOST_PRESENTATIONS = 200


@dataclass(frozen=True, slots=True)
class BlindOrder:
    """The order of one session."""

    pseudonym: str
    tissues: tuple[int, ...]  # index of the tissue of each presentation
    seed: int  # it was drawn with


def check_pseudonym(text: str | None) -> str:
    """A pseudonym that is no name, as P17; drawn where none is given, UsageError for anything else."""
    if text is None:
        return f"P{secrets.randbelow(90000) + 10000}"
    if _PSEUDONYM.fullmatch(text) is None:
        refuse(f"--pseudonym {printable(text)!r} could be a name; use letters and a number as in P17")
    return text


def draw_order(count: int, presentations: int, *, pseudonym: str, seed: int | None = None) -> BlindOrder:
    """A random order in which every tissue comes equally often; UsageError where it can't be balanced."""
    if count < 2:
        refuse(
            "--blind compares tissues: give a second one with --against, --against-draw or --against-quantile"
        )
    if not (count <= presentations <= MOST_PRESENTATIONS and presentations % count == 0):
        refuse(
            f"--presentations is {presentations}: {count} tissues come equally often, so it must be a "
            f"multiple of {count}, at most {MOST_PRESENTATIONS}"
        )
    seed = secrets.randbits(63) if seed is None else seed
    order = np.random.default_rng(seed).permutation(np.repeat(np.arange(count), presentations // count))
    return BlindOrder(pseudonym, tuple(int(value) for value in order), seed)


def write_key(path: Path, order: BlindOrder, tissues: Sequence[dict[str, Any]]) -> None:
    """Write what each presentation is, readable by the owner only; UsageError where it can't be."""
    document = {
        "pseudonym": order.pseudonym,
        "seed": order.seed,
        "tissues": list(tissues),
        "presentations": [
            {"number": number, "tissue": tissue} for number, tissue in enumerate(order.tissues, 1)
        ],
    }
    text = json.dumps(document, ensure_ascii=False, indent=2) + "\n"
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError:
        refuse(f"{path}: exists already; an answer key is never overwritten, choose another --key")
    except OSError as error:
        refuse(f"{path}: the answer key can't be written ({error.strerror}); choose another --key")


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
    strokes: tuple[Stroke, ...]
    switches_s: tuple[float, ...]  # when to go to the next tissue, from the start of the device's time [s]
    #: From the start of the device's time to the end of the last stroke, and a moment more [s].
    duration_s: float

    @property
    def depth_mm(self) -> float:
        """Depth of the deepest stroke."""
        return max(stroke.depth_mm for stroke in self.strokes)

    def hand(self, *, motion_scale: float, surface_m: FloatArray, inward: FloatArray) -> Hand:
        """The machine that carries the simulated grip through the strokes."""
        return scripted_hand(
            self.strokes, motion_scale=motion_scale, surface_m=surface_m, inward=inward, rest_s=REST_S
        )


def read_script(text: str) -> Script:
    """Read a script; UsageError where a part is no stroke, leads nowhere, or switches inside the tissue."""
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
            refuse(
                f"script: 'switch' after {stroke_texts[done - 1]!r} would change the tissue under the tool; "
                "retract first"
            )
        switches.append(float(ends[done - 1]) if done else 0.5 * REST_S)
    return Script(text, strokes, tuple(switches), float(ends[-1]) + TAIL_S)


@dataclass(frozen=True, slots=True, eq=False)
class SessionPlan:
    """A session, ready to begin."""

    device: str
    why: str  # why this device
    capabilities: Capabilities
    device_options: Mapping[str, Any]
    #: Parameter blocks (environment, then passivity controller), in the order of presentation.
    blocks: tuple[FloatArray, ...]
    lines: tuple[str, ...]  # what is printed before force
    seconds: float | None  # when the session ends by itself
    picked: tuple[Picked, ...] = ()  # the tissues, first and second
    check: Precheck | None = None  # none for an installed force law
    order: BlindOrder | None = None
    head: Mapping[str, Any] = field(default_factory=dict)  # of the log
    script: Script | None = None
    environment: str | None = None
    virtual: bool = False
    led: bool = False  # whether a pointer on a screen leads the hand of the simulated device
    guided: bool = False  # whether the block is a guided axis
    pseudonym: str | None = None  # of the person who is guided; a blind order has its own
    scene: str | None = None  # name of the scene it comes from


def session_head(plan: SessionPlan, surface: FloatArray, hashes: tuple[str | None, ...]) -> dict[str, Any]:
    """Head of the log; in a blind session it knows numbers of presentations alone."""
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
            **({} if each.tissue.tip is None else {"tip": plain(each.tissue.tip)}),
            "block": plan.blocks[label].tolist(),
        }
        for label, (each, digest) in enumerate(zip(plan.picked, hashes, strict=True))
    ]
