"""The document of ``tissueid design``: what was asked, found and ranked, as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from tissueid.design.machine import Machine
from tissueid.design.plan import Against, Judged, Plan
from tissueid.design.precision import Asked
from tissueid.design.remarks import remarks_on
from tissueid.design.tissues import Tissues

DESIGN_SCHEMA = "tissueid/design/1"


def _setting(judged: Judged) -> dict[str, Any]:
    setting = judged.setting
    return {
        "words": setting.words,
        "rate_Hz": setting.rate_Hz,
        "noise_N": setting.noise_N,
        "noise_correlation_s": setting.noise_correlation_s,
        "filter_s": setting.filter_s,
    }


def _protocol(one: Judged, asked: Asked, specimens: int) -> dict[str, Any]:
    rows = zip(one.protocol.items(), one.log_seconds, one.peak_N, strict=True)
    found = zip(asked.wants, one.median, one.assured, strict=True)
    return {
        "reached": one.reached,
        "seconds": one.seconds,
        "total_seconds": specimens * one.seconds,
        "logs": one.logs,
        "setting": _setting(one),
        "indentations": [
            {
                "words": test.words,
                "speed_mm_min": test.speed_mm_min,
                "depth_mm": test.depth_mm,
                "hold_s": test.hold_s,
                "repeats": count,
                "seconds": seconds,
                "peak_force_N": peak,
            }
            for (test, count), seconds, peak in rows
        ],
        "precision": [
            {"name": want.name, "wanted": want.share, "median": median, "assured": assured}
            for want, median, assured in found
        ],
        "worst": one.worst,
    }


def _against(given: Against | None, asked: Asked, specimens: int) -> dict[str, Any] | None:
    if given is None:
        return None
    found = given.judged
    return {
        "name": given.name,
        "obstacle": given.obstacle or None,
        "protocol": None if found is None else _protocol(found, asked, specimens),
    }


def _tissue(tissues: Tissues) -> dict[str, Any]:
    numbers = []
    for name, values in tissues.numbers().items():
        low, middle, high = np.quantile(values, (0.025, 0.5, 0.975))
        numbers.append({"name": name, "median": middle, "low": low, "high": high})
    return {
        "name": tissues.name,
        "words": tissues.words,
        "draws": tissues.theta.shape[0],
        "branches": tissues.model.branches,
        "stiffness_degree": tissues.model.stiffness_degree,
        "depth_mm": tissues.model.depth_mm,
        "numbers": numbers,
    }


def _verdict(plan: Plan, machine: Machine, tissues: Tissues, asked: Asked) -> dict[str, Any]:
    limits = [
        {"name": one.name, "words": one.words, "factor": one.factor, "enough": one.enough}
        for one in plan.limits
    ]
    return {
        "reached": plan.best.reached,
        "limits": limits,
        "remarks": remarks_on(plan.best, machine, tissues, asked),
    }


def design_document(
    plan: Plan,
    machine: Machine,
    tissues: Tissues,
    asked: Asked,
    *,
    given: Against | None = None,
    specimens: int = 1,
) -> dict[str, Any]:
    """The document of ``schemas/design.schema.json``.

    ``given``: a protocol to compare with; ``specimens``: how many will be tested.
    """
    return {
        "schema": DESIGN_SCHEMA,
        "tissue": _tissue(tissues),
        "machine": machine.as_json(),
        "asked": {
            "wants": [{"name": want.name, "share": want.share} for want in asked.wants],
            "interval": "total" if asked.total else "statistical",
            "assurance": asked.assurance,
            "max_depth_mm": asked.max_depth_mm,
            "max_force_N": asked.max_force_N,
            "budget_s": asked.budget_s,
            "recovery_s": asked.recovery_s,
            "setup_s": asked.setup_s,
            "repeats": asked.repeats,
            "max_logs": asked.max_logs,
            "gain_sd": asked.gain_sd,
            "specimens": specimens,
        },
        "verdict": _verdict(plan, machine, tissues, asked),
        "protocols": [_protocol(one, asked, specimens) for one in plan.ranked],
        "against": _against(given, asked, specimens),
        "front": [{"factor": factor, **_protocol(one, asked, specimens)} for factor, one in plan.front],
        "work": {"paths": plan.paths, "protocols": plan.protocols},
    }
