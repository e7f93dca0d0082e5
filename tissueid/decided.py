"""Decisions of a study on one recording: its name, protocol, signs, contact, and whether it counts."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from tissueid.errors import refuse
from tissueid.flags import Flag
from tissueid.ingest.quality import below_cell_range
from tissueid.manifest import Decision, Study
from tissueid.result import Refusal
from tissueid.segment import SegmentOptions
from tissueid.trial import Trial

#: Options of the segmenter, and keys of [[override]] that stand for one of another name.
_OPTIONS = frozenset(one.name for one in fields(SegmentOptions))
_NAMES = {"contact_mm": "contact_displacement_mm", "compression": "compression_sign", "force": "force_sign"}
_SIGNS = {"positive": 1, "negative": -1}


def arithmetic_refusal(path: str, sheet: str | None, done: str, error: Exception) -> Refusal:
    """The refusal of a trial whose numbers defeat the arithmetic while it is ``done``."""
    message = (
        f"the samples defeat the arithmetic and could not be {done} ({type(error).__name__}: {error}); are "
        "their units and magnitudes right? `tissueid inspect` shows them"
    )
    return Refusal(path=path, sheet=sheet, code="fit_failed", message=message)


def _decided_options(options: SegmentOptions, decision: Decision) -> SegmentOptions:
    """The run's options with what the study decides for this trial.

    Raises UsageError: both together leave no window of time.
    """
    said: dict[str, Any] = {}
    for key, value in decision.override.items():
        name = _NAMES.get(key, key)
        if name in _OPTIONS:
            said[name] = _SIGNS[value] if name.endswith("_sign") else value
    try:
        return replace(options, **said)
    except ValueError as error:
        because = decision.override.get("because", "")
        refuse(
            f"the study file and the command line contradict each other: {error} (in the study because: "
            f"{because}); leave the option out, or --no-study"
        )


def decided_trial(trial: Trial, decision: Decision, study: Study) -> Trial:
    """The trial under the name, the protocol and the load cell that the study states."""
    flags = list(trial.flags)
    stated = {key: value for key, value in decision.override.items() if key != "because"}
    if stated:
        words = ", ".join(f"{key} = {_words(value)}" for key, value in stated.items())
        because = decision.override["because"]
        values = {"keys": list(stated), "because": because}
        flags.append(Flag("decision_overridden", f"{words}, because: {because}", values))
    calibration = study.calibration
    capacity = calibration.values.get("load_cell_capacity_N")
    if capacity is not None or calibration.verified_from_N is not None:
        flags = [flag for flag in flags if flag.code != "below_cell_range"]
        flag = below_cell_range(trial.force_N, capacity, verified_from_N=calibration.verified_from_N)
        flags += [] if flag is None else [flag]
    return replace(
        trial,
        specimen=decision.trial.get("specimen", trial.specimen),
        protocol=study.protocol(decision, trial.protocol),
        flags=tuple(flags),
    )


def _words(value: Any) -> str:
    """A value as study.toml writes it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_words(one)}" for key, one in value.items()) + "}"
    return f'"{value}"' if isinstance(value, str) else f"{value:g}"


def as_decided(
    trial: Trial, options: SegmentOptions | None, study: Study | None, decision: Decision | None = None
) -> tuple[Trial, SegmentOptions, str | None]:
    """The trial, its options, and why it is excluded, after what a study says of it.

    ``decision``: of the study, where it was asked before.
    """
    own = asked = options or SegmentOptions()
    decided = trial
    if study is not None:
        decision = decision or study.decision(trial.source.path, trial.source.sheet)
        decided, own = decided_trial(trial, decision, study), _decided_options(asked, decision)
    # by the name that the study gives
    pattern = asked.excludes(decided)
    by_hand = None if pattern is None else f"--exclude {pattern}"
    return decided, own, _why_excluded(trial, decision, study) or by_hand


def _why_excluded(trial: Trial, decision: Decision | None, study: Study | None) -> str | None:
    """The user's reason, or that the recording calibrated the frame, or is no specimen and not listed."""
    if decision is not None and decision.excluded is not None:
        return decision.excluded
    frame = None if study is None else study.calibration.frame
    if frame is not None and trial.source.sha256 in frame.sources:
        return f"a rigid block: {frame.path} was made from it"
    if decision is not None and decision.listed:
        return None
    return next((flag.message for flag in trial.flags if flag.code == "not_a_specimen"), None)
