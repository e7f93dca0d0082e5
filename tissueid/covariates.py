"""Additions of a study to the result: covariates, exclusions with their effect, and flags that need both.

The record is flat, so that a table can be joined to it on path and sheet, and on specimen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissueid.collection import Collected, Excluded
from tissueid.decided import arithmetic_refusal
from tissueid.documents.identification import Calibration, StatedSpecimen, StatedTrial
from tissueid.inference.frame_effect import frame_flags
from tissueid.inference.specimen import FitOptions, LogHandle
from tissueid.inference.verdict import gain_spread, order_effect, repeated_sites
from tissueid.manifest import Study, TomlTable
from tissueid.result import Estimate, Refusal, SpecimenFit


@dataclass(frozen=True, slots=True)
class Refit:
    """Fits a specimen again: name, logs, options, and why, for the progress line."""

    fit: Callable[[str, Sequence[LogHandle], FitOptions, str], SpecimenFit]


def study_flags(fit: SpecimenFit, collected: Collected, study: Study | None) -> SpecimenFit:
    """The fit with the flags that need its trials together, the study, or both.

    ``collected``: with the study's decision on every trial.
    """
    said = [collected.decisions.get((trial.path, trial.sheet)) for trial in fit.trials]
    rows: list[TomlTable] = [{} if one is None else one.trial for one in said]
    frame = None if study is None else study.calibration.frame
    values = {} if study is None else study.calibration.values
    flags = [
        *frame_flags(fit, frame, values),
        *gain_spread(fit.trials),
        *order_effect(fit.trials, [row.get("run") for row in rows]),
        *repeated_sites(fit.trials, rows),
    ]
    return replace(fit, flags=tuple(flags))


def study_record(
    study: Study, collected: Collected, names: Mapping[str, str], exclusions: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    """The ``study`` object of ``schemas/identification.schema.json``.

    ``names``: names of specimens as shown; ``exclusions``: from :func:`exclusion_rows`.
    """
    shown = [names[name] for name in collected.groups]
    trials = [_trial_row(collected, entry, names) for entry in collected.inputs]
    return study_document(study, shown, trials, list(exclusions))


def study_document(study: Study, fitted: Iterable[str], trials: Any, exclusions: Any) -> dict[str, Any]:
    """The ``study`` object from rows that are there.

    ``fitted``: specimens as shown; those that the study names come after them; ``trials``, ``exclusions``:
    rows, gathered from wherever they were made.
    """
    shown = dict.fromkeys([*fitted, *study.specimens])
    frame = study.calibration.frame
    calibration = {key: study.calibration.values.get(key) for key in Calibration.__struct_fields__}
    return {
        "path": study.path,
        "sha256": study.sha256,
        "study": dict(study.about),
        "tip": dict(study.tip),
        "calibration": calibration | {"frame": None if frame is None else frame.as_json()},
        "priors": study.priors.as_json(),
        **({} if study.population is None else {"population": study.population.as_json()}),
        "specimens": [_specimen_row(study, name) for name in shown],
        "trials": trials,
        "exclusions": exclusions,
    }


def _specimen_row(study: Study, name: str) -> dict[str, Any]:
    """Covariates of one specimen: its own, else the study's."""
    own = study.specimens.get(name, {})
    keys = [key for key in StatedSpecimen.__struct_fields__ if key not in {"specimen", "notes"}]
    row = {key: own.get(key, study.about.get(key)) for key in keys}
    return {"specimen": name, **row, "notes": own.get("notes")}


def _trial_row(collected: Collected, entry: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Covariates of one fitted trial."""
    decision = collected.decisions[entry["path"], entry["sheet"]]
    override = decision.override
    row = {key: decision.trial.get(key) for key in StatedTrial.__struct_fields__}
    return row | {
        "path": entry["path"],
        "sheet": entry["sheet"],
        "specimen": names[entry["specimen"]],
        "listed": decision.listed,
        "overridden": [key for key in override if key != "because"],
        "because": override.get("because"),
    }


def exclusion_rows(
    collected: Collected,
    names: Mapping[str, str],
    fits: Sequence[SpecimenFit],
    options: FitOptions,
    again: Refit,
) -> list[dict[str, Any]]:
    """Every excluded trial with its reason, and its specimen's numbers with and without it.

    The model chosen without the trial is kept, so that the difference is the trial's and not the choice's.
    """
    fitted = {fit.specimen: fit for fit in fits}
    rows = []
    for one in collected.excluded:
        name = names.get(one.specimen, one.specimen)
        without = fitted.get(name)
        note, with_it = _with_it(one, name, collected, without, options, again)
        rows.append(
            {
                "path": one.path,
                "sheet": one.sheet,
                "specimen": name,
                "because": one.because,
                "note": note,
                "with_it": with_it,
            }
        )
    return rows


def _with_it(
    one: Excluded,
    name: str,
    collected: Collected,
    without: SpecimenFit | None,
    options: FitOptions,
    again: Refit,
) -> tuple[str | None, list[dict[str, Any]]]:
    """A remark, and a row a parameter; no rows where the fit with the trial is not possible."""
    if one.no_specimen:
        return None, []
    if isinstance(one.handle, Refusal):
        return f"it could not be fitted anyway: {one.handle.message}", []
    if without is not None:
        model = without.model
        options = replace(options, branches=model.branches, stiffness_degree=model.stiffness_degree)
    handles = [*collected.groups.get(one.specimen, ()), one.handle]
    try:
        fit = again.fit(name, handles, options, f"again, with {one.path}")
    except (ArithmeticError, np.linalg.LinAlgError) as error:
        return arithmetic_refusal(one.path, one.sheet, "fitted", error).message, []
    note = None if without is not None else "the specimen has no other trial"
    before = {} if without is None else {estimate.name: estimate for estimate in without.parameters}
    return note, [_difference(before.get(after.name), after) for after in fit.parameters]


def _difference(before: Estimate | None, after: Estimate) -> dict[str, Any]:
    return {
        "name": after.name,
        "symbol": after.symbol,
        "unit": after.unit,
        "without": None if before is None else before.value,
        "without_stderr": None if before is None else before.stderr,
        "with": after.value,
        "with_stderr": after.stderr,
    }


def without_excluded(refused: Sequence[Refusal], collected: Collected, study: Study | None) -> list[Refusal]:
    """The refusals that are not of recordings the user took out; those join the exclusions."""
    kept = []
    for one in refused:
        decision = None if study is None else study.decision(one.path, one.sheet)
        if decision is None or decision.excluded is None:
            kept.append(one)
            continue
        specimen = decision.trial.get("specimen", one.path)
        collected.excluded.append(
            Excluded(one.path, one.sheet, specimen, decision.excluded, one, no_specimen=False)
        )
    return kept


def unmatched_sheets(study: Study | None, collected: Collected, refused: Sequence[Refusal]) -> list[Refusal]:
    """Sheets that the study names in files that were read, and that are not there."""
    if study is None:
        return []
    found: dict[str, set[str | None]] = {}
    for path, sheet in [*collected.decisions, *((one.path, one.sheet) for one in refused)]:
        found.setdefault(study.real_path(path), set()).add(sheet)
    missing = []
    for entry in study.entries:
        sheets = [sheet for file in entry.files for sheet in found.get(file, ())]
        if entry.sheet is not None and sheets and entry.sheet not in sheets:
            there = ", ".join(sorted(f'"{sheet}"' for sheet in sheets if sheet is not None)) or "none"
            message = f'there is no sheet "{entry.sheet}" in {entry.values["file"]}; it has {there}'
            missing.append(Refusal(study.path, None, "study_unmatched", message, entry.line))
    return missing
