"""The document of ``schemas/rupture.schema.json``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from tissueid.rupture.evidence import Threshold
from tissueid.rupture.failures import Failure
from tissueid.rupture.run import RuptureRun
from tissueid.rupture.speeds import AtSpeed
from tissueid.rupture.words import sentences
from tissueid.rupture_law import THRESHOLD_UNITS


def as_document(run: RuptureRun, bundles: Mapping[str, str]) -> dict[str, Any]:
    """Write the document.

    ``bundles``: file name of each specimen's bundle.
    """
    study, hardening = run.study, run.study.hardening
    return {
        "schema": "tissueid/rupture/1",
        "asked": study.asked,
        "taken": study.taken,
        "weight": study.weight,
        "decision": asdict(study.decision) | {"probability": dict(study.decision.probability)},
        "criteria": [_threshold(one) for one in study.thresholds],
        "confounding": study.confounding.as_json(),
        "speeds": [_at_speed(one, study.failures) for one in study.speeds],
        "changes": [asdict(one) | {"direction": one.direction} for one in study.changes],
        "hardening": None if hardening is None else asdict(hardening) | {"direction": hardening.direction},
        "tests": [_test(one) for one in study.failures],
        "laws": [
            {"specimen": name, "bundle": bundles[name], "law": law.as_json()}
            for name, law in study.laws.items()
        ],
        "sentences": sentences(study),
        "left_out": [
            *(
                {"path": path, "sheet": sheet or None, "reason": reason}
                for path, sheet, reason in run.left_out
            ),
            *(
                {"path": one.path, "sheet": one.sheet, "reason": one.message}
                for one in run.identification.refused
            ),
        ],
        "flags": [flag.as_json() for flag in study.flags],
        "provenance": dict(run.identification.provenance),
    }


def _threshold(one: Threshold) -> dict[str, Any]:
    return {
        "criterion": one.criterion,
        "unit": THRESHOLD_UNITS[one.criterion],
        "median": one.median,
        "ci95": list(one.ci95),
        "sd_ln": one.sd_ln,
        "specimen_sd_ln": one.specimen_sd_ln,
        "ln_evidence": one.ln_evidence,
        "growth": one.growth,
        "trend": one.trend,
        "trend_p": one.trend_p,
        "specimens": dict(one.specimens),
    }


def _at_speed(one: AtSpeed, failures: tuple[Failure, ...]) -> dict[str, Any]:
    """One speed; how much of the force relaxes there, and the tangent over the secant, are means too."""
    near = [
        each
        for each in failures
        if each.ruptured and abs(np.log(each.test.speed_mm_s / one.speed_mm_s)) < SAME_SPEED
    ]
    return asdict(one) | {
        "mean": dict(one.mean),
        "sd": dict(one.sd),
        "hardening": float(np.mean([each.hardening for each in near])) if near else None,
        "dynamic_share": float(np.mean([each.dynamic_share for each in near])) if near else None,
    }


#: Speeds that differ by less than this in ln are one.
SAME_SPEED = 0.05


def _test(one: Failure) -> dict[str, Any]:
    test = one.test
    return {
        "path": test.path,
        "sheet": test.sheet,
        "specimen": one.specimen,
        "ruptured": one.ruptured,
        "speed_mm_s": test.speed_mm_s,
        "force_N": test.force_N,
        "force_sd_N": one.force_sd_N,
        "depth_mm": one.depth_mm,
        "depth_sd_mm": one.depth_sd_mm,
        "work_N_mm": test.work_N_mm,
        "work_sd_N_mm": one.work_sd_N_mm,
        "dynamic_share": one.dynamic_share,
        "hardening": one.hardening,
        "hardening_sd": one.hardening_sd,
        "settled": one.settled,
        "residual": test.residual,
        "measures": {name: asdict(measure) for name, measure in one.measures.items()},
    }
