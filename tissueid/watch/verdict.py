"""The verdict on one test: contact, hold, relaxation, flags, advice, and how it differs from earlier tests.

A verdict is a plain JSON object (``schemas/watch.schema.json``), so that a watch that was stopped goes on
from its own log.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from tissueid.fit.specimen import FitOptions
from tissueid.inspection import segmented
from tissueid.measured.relaxation import relaxation_rows
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.result import Refusal, RelaxationRow, SpecimenFit
from tissueid.segment import SegmentOptions
from tissueid.trial import FloatArray, Segmentation, Trial, contact_frame
from tissueid.watch.advice import advice_of

__all__ = ["judge", "refused_verdict", "samples_digest"]

Verdict = dict[str, Any]

#: Points of the ramp kept for the comparison with later tests.
RAMP_POINTS = 24
#: Tests are equal in speed within this share.
SAME_SPEED = 0.2
#: Shares of the common depth between which forces are compared: away from contact and corner.
COMPARED = (0.5, 0.95)
#: A hold shows a relaxation time that is shorter than this share of it.
HOLD_SHARE = 1.0 / 3.0
#: Samples that a relaxation time should have.
SAMPLES_IN_TAU = 5.0


def samples_digest(trial: Trial) -> str:
    """SHA-256 of the samples: tells a sheet that changed from one that was only saved again."""
    digest = hashlib.sha256()
    for channel in (trial.time_s, trial.displacement_mm, trial.force_N):
        digest.update(np.ascontiguousarray(channel, dtype="<f8").tobytes())
    return digest.hexdigest()


def refused_verdict(refusal: Refusal) -> Verdict:
    """The verdict on a file that can't be read."""
    return {
        **_nothing(refusal.path, refusal.sheet, None),
        "level": "refused",
        "advice": [f"this file can't be used: {refusal}"],
        "error": refusal.as_json()["error"],
    }


def _nothing(path: str, sheet: str | None, specimen: str | None) -> Verdict:
    return {
        "path": path, "sheet": sheet, "specimen": specimen, "digest": None, "level": "repeat", "advice": [],
        "error": None, "contact": None, "speed_mm_s": None, "depth_mm": None, "peak_force_N": None,
        "hold_s": None,
        "tau": {"value_s": None, "window_s": None, "resolvable": False, "why": None, "advice": None},
        "fit": None, "ramp": None, "drift": None, "flags": [],
    }  # fmt: skip


def judge(
    trial: Trial,
    earlier: Iterable[Mapping[str, Any]] = (),
    *,
    options: SegmentOptions | None = None,
    fit: bool = True,
) -> Verdict:
    """Judge one test.

    Parameters
    ----------
    trial : Trial
    earlier : iterable of mapping
        Verdicts on earlier tests, in their order; those of the same specimen are compared.
    options : SegmentOptions, optional
    fit : bool
        Whether to fit the test alone, one branch, constant stiffness.

    Returns
    -------
    dict
        The object of ``schemas/watch.schema.json``.
    """
    options = options or SegmentOptions()
    divided = segmented(trial, options=options)
    if isinstance(divided, Refusal):
        return refused_verdict(divided) | {"specimen": trial.specimen, "digest": samples_digest(trial)}
    flags = [*trial.flags, *divided.flags]
    rows = relaxation_rows(trial, divided)
    found = _nothing(trial.source.path, trial.source.sheet, trial.specimen) | {
        "digest": samples_digest(trial),
        "tau": _tau(trial, divided, rows),
        "fit": _quick_fit(trial, options) if fit and divided.contact is not None else None,
        "flags": [flag.as_json() for flag in (*flags, *(flag for row in rows for flag in row.flags))],
        **_numbers(trial, divided),
    }
    found["drift"] = _drift(found, earlier)
    found["level"], found["advice"] = advice_of(flags, tau=found["tau"], drift=found["drift"])
    return found


def _numbers(trial: Trial, divided: Segmentation) -> Verdict:
    """Contact, ramp and hold in numbers."""
    if divided.contact is None:
        return {}
    depth, force = contact_frame(trial, divided)
    holds = divided.of_kind("hold")
    moves = divided.of_kind("ramp") or divided.of_kind("cycle")
    numbers: Verdict = {
        "contact": {"displacement_mm": divided.contact.displacement_mm, "sd_mm": divided.contact.sd_mm},
        "depth_mm": float(depth.max()),
        "peak_force_N": float(force.max()),
        "hold_s": max((hold.end_s - hold.start_s for hold in holds), default=None),
    }
    if moves:
        first = moves[0]
        numbers["speed_mm_s"] = abs(first.speed_mm_s)
        stop = first.stop if first.peak is None else first.peak + 1
        numbers["ramp"] = _ramp(depth[first.start : stop], force[first.start : stop])
    return numbers


def _ramp(depth: FloatArray, force: FloatArray) -> dict[str, list[float]] | None:
    """Mean force in equal steps of depth."""
    inside = depth >= 0.0
    depth, force = depth[inside], force[inside]
    if depth.size < 2 or depth.max() <= 0.0:
        return None
    bins = np.minimum((depth / depth.max() * RAMP_POINTS).astype(int), RAMP_POINTS - 1)
    count = np.bincount(bins, minlength=RAMP_POINTS)
    used = count > 0
    mean_depth, mean_force = (
        np.bincount(bins, weights=values, minlength=RAMP_POINTS)[used] / count[used]
        for values in (depth, force)
    )
    return {"depth_mm": mean_depth.tolist(), "force_N": mean_force.tolist()}


def _tau(trial: Trial, divided: Segmentation, rows: Sequence[RelaxationRow]) -> Verdict:
    """Whether the longest hold times a relaxation, and what would."""
    none: Verdict = {"value_s": None, "window_s": None, "resolvable": False, "advice": None}
    if not rows:
        return none | {"why": f"{_unused_hold(divided)}: no relaxation time from this test"}
    row = max(rows, key=lambda one: one.window_s[1] - one.window_s[0])
    window = row.window_s[1] - row.window_s[0]
    if row.tau_single_s is None:
        return none | {"window_s": window, "why": "the force does not relax in the hold"}
    found = none | {"value_s": row.tau_single_s, "window_s": window}
    steps = np.diff(trial.time_s)
    step = float(np.median(steps[steps > 0.0]))
    codes = {flag.code for flag in row.flags}
    if "tau_below_resolution" in codes:
        rate = SAMPLES_IN_TAU / row.tau_single_s
        why = f"tau is about {row.tau_single_s:.2g} s, samples are {step:.2g} s apart"
        return found | {
            "why": why,
            "advice": f"before the next test: sample at {rate:.2g} Hz or more to time tau",
        }
    if "tau_exceeds_window" in codes:
        longer = row.tau_single_s / HOLD_SHARE
        why = f"tau is about {row.tau_single_s:.2g} s, the hold lasts {window:.3g} s"
        return found | {
            "why": why,
            "advice": f"before the next test: hold for {longer:.2g} s or longer to time tau",
        }
    doubt = "one exponential does not describe the hold; quote tau with its window"
    return found | {"resolvable": True, "why": doubt if codes else None}


def _unused_hold(divided: Segmentation) -> str:
    """Why no hold times a relaxation."""
    holds = divided.of_kind("hold")
    if not holds:
        return "no hold"
    longest = max(holds, key=lambda hold: hold.end_s - hold.start_s)
    broken = min((one.time_s for one in divided.events if one.kind == "rupture"), default=None)
    length = f"{longest.end_s - longest.start_s:.4g} s"
    if broken is None or broken > longest.end_s:
        return f"the hold of {length} can't be used"
    where = "follows the rupture" if broken <= longest.start_s else "ends in a rupture"
    return f"the hold of {length} {where} and is not used"


def _quick_fit(trial: Trial, options: SegmentOptions) -> Verdict | None:
    """Parameters of the test alone: one branch, constant stiffness; ``None`` where nothing can be fitted."""
    quick = IdentifyOptions(fit=FitOptions(branches=1, stiffness_degree=0), segment=options)
    fits: Sequence[SpecimenFit] = identify([trial], options=quick).specimens
    if not fits:
        return None
    return {
        "nrmsd": fits[0].nrmsd.range,
        "parameters": [
            {"name": one.name, "unit": one.unit, "value": one.value, "stderr": one.stderr}
            for one in fits[0].parameters
        ],
    }


def _drift(found: Verdict, earlier: Iterable[Mapping[str, Any]]) -> Verdict | None:
    """Force against that of earlier tests of the specimen at equal speed, over the depths both reached."""
    equal = [one for one in earlier if _comparable(found, one)]
    if not equal:
        return None
    first, last = (_force_ratio(found["ramp"], one["ramp"]) for one in (equal[0], equal[-1]))
    if first is None or last is None:
        return None
    return {
        "tests": len(equal),
        "from_first": first - 1.0,
        "from_last": last - 1.0,
        "contact_moved_mm": found["contact"]["displacement_mm"] - equal[0]["contact"]["displacement_mm"],
    }


def _comparable(found: Mapping[str, Any], one: Mapping[str, Any]) -> bool:
    if found["specimen"] != one["specimen"] or None in (found["ramp"], one["ramp"]):
        return False
    slow, fast = sorted((found["speed_mm_s"], one["speed_mm_s"]))
    return bool(fast <= (1.0 + SAME_SPEED) * slow)


def _force_ratio(now: Mapping[str, Any], then: Mapping[str, Any]) -> float | None:
    common = min(now["depth_mm"][-1], then["depth_mm"][-1])
    depth = np.linspace(COMPARED[0] * common, COMPARED[1] * common, RAMP_POINTS)
    now_N, then_N = (np.interp(depth, ramp["depth_mm"], ramp["force_N"]).sum() for ramp in (now, then))
    return float(now_N / then_N) if then_N > 0.0 else None
