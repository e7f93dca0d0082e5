"""Heads, records and summaries of made-up sessions."""

from typing import Any

import numpy as np
from rendered_tissues import PAPER_A, pressed, walk

from tissueid.documents import plain
from tissueid.documents.session import Device, Scale, Servo, Tissue
from tissueid.haptics.ring import RECORD
from tissueid.haptics.states import State
from tissueid.rendering import environment as env
from tissueid.rendering.recorder import SessionSummary
from tissueid.rendering.tissue_block import Plane, tissue_block

FORCE_SCALE = 0.0125
MOTION_SCALE = 5.0
PERIOD_S = 0.001


def head_of(**changes: Any) -> dict[str, Any]:
    """Head of a session on the simulated device, paper A's tissue behind a plane."""
    head: dict[str, Any] = {
        "tissueid": "0.1.0",
        "started": "2026-01-01T00:00:00Z",
        "pseudonym": None,
        "blind": False,
        "tissues": plain([Tissue(0, "paper-a", None, None, 8.0, 500.0 / 60.0, 2.0, ())]),
        "environment": "tissue",
        "surface": Plane().numbers(0.0).tolist(),
        "device": plain(Device("sim", "asked for by name", False, True, 5.0, 0.5, 1.5)),
        "scale": plain(Scale(FORCE_SCALE, MOTION_SCALE)),
        "script": None,
        "servo": plain(Servo(PERIOD_S, virtual_time=True)),
    }
    return {**head, **changes}


def records_of(depth_mm: np.ndarray) -> np.ndarray:
    """Records of an engaged session in which the depth was as given, 1 kHz."""
    times = PERIOD_S * np.arange(len(depth_mm))
    positions = pressed(depth_mm, motion=MOTION_SCALE)
    block = tissue_block(PAPER_A, Plane(), force_scale=FORCE_SCALE, motion_scale=MOTION_SCALE)
    forces, infos = walk(block, positions, times)
    records = np.zeros(len(depth_mm), RECORD)
    records["tick"] = np.arange(len(depth_mm))
    records["time_s"] = 100.0 + times
    records["dt_s"] = PERIOD_S
    records["position_m"] = positions
    records["force_N"] = forces
    records["depth_mm"] = infos[:, env.INFO_DEPTH_MM]
    records["tissue_force_N"] = infos[:, env.INFO_TISSUE_FORCE_N]
    records["state"] = State.ENGAGED
    return records


def summary_of(records: np.ndarray) -> dict[str, Any]:
    """Summary of records in virtual time."""
    summary = SessionSummary(PERIOD_S)
    summary.add(records)
    return summary.as_json(scheduling="virtual time", virtual_time=True)


def indentation(depth_mm: float = 8.0, *, hold_s: float = 0.3) -> np.ndarray:
    """From 0.5 mm above the tissue to a depth at 250 mm/min, then a hold; 1 kHz."""
    v = 250.0 / 60.0
    times = PERIOD_S * np.arange(round(((depth_mm + 0.5) / v + hold_s) / PERIOD_S))
    return np.minimum(v * times - 0.5, depth_mm)
