"""Tidy tables from identification.json alone: a row is a specimen, a trial, a loop, a quoted number.

CSV after RFC 4180 in UTF-8: comma, decimal point, CRLF, quotes where needed; an empty cell is "not known",
and a parameter that the data do not determine is empty with ``FALSE`` beside it.  Units stand in the column
names.  Columns and their order do not depend on the data, but for the parameters of further branches and of
other laws.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from msgspec.structs import fields

from tissueid.documents.base import Placed
from tissueid.documents.identification import (
    Exclusion,
    Identification,
    Relaxation,
    Specimen,
    StatedSpecimen,
    Trial,
)
from tissueid.documents.inspect import Refusal
from tissueid.documents.quantities import Cycle, Measure
from tissueid.flags import Flag

_PARAMETERS = (
    *("static_1_N_per_mm", "static_2_N_per_mm2", "static_3_N_per_mm3"),
    *("stiffness_0_N_per_mm", "stiffness_1_N_per_mm2", "stiffness_2_N_per_mm3"),
    *("relaxation_time_s", "viscosity_N_s_per_mm"),
)
_BRANCH_PARAMETERS = tuple(name for name in _PARAMETERS if not name.startswith("static"))
#: Intervals of an estimate; a column for each end.
_INTERVALS = ("ci95", "ci95_total")
_PLAIN_PARTS = ("stderr", "identified", "mean", "sd")
_PARTS = (*_PLAIN_PARTS, *(f"{interval}_{end}" for interval in _INTERVALS for end in ("low", "high")))
_MODEL = ("branches", "static_degree", "stiffness_degree", "static_pooling")
_SAMPLED = ("sampler", "converged", "draws", "noise", "phi", "misfit")

_TRIAL_COVARIATES = ("site", "protocol", "run", "rest_s", "listed", "overridden", "notes")
#: Columns of ``study.specimens``; the two that a trial has as well are told apart.
_SPECIMEN_COVARIATES: Mapping[str, str] = {
    field.name: f"specimen_{field.name}" if field.name in _TRIAL_COVARIATES else field.name
    for field in fields(StatedSpecimen)
    if field.name != "specimen"
}
_TRIAL_FIT = (
    *("n_samples", "speed_mm_s", "depth_mm", "gain", "contact_offset_mm", "time_ratio"),
    *("nrmsd", "nrmsd_mean", "rmse_N", "max_residual_fraction", "residual_acf1"),
)
_HOLD = (
    *("holds", "hold_start_s", "hold_end_s", "hold_peak_force_N", "tau_single_s", "nrmsd_single"),
    *("tau_double_1_s", "tau_double_2_s", "tau_triple_1_s", "tau_triple_2_s", "tau_triple_3_s"),
)
_LOOP_PLAIN = ("number", "kind", "start_s", "peak_s", "end_s", "floor_mm", "peak_depth_mm")
_LOOP_MEASURES = tuple(field.name for field in fields(Cycle) if field.type is Measure)
_CONDITIONS = ("time_s", "frequency_Hz", "depth_mm", "amplitude_mm", "speed_mm_s", "formula", "path")
_QUOTED = ("program", "hold", "value", "stderr", "sd", "logs", "reason")
_MEASURED = ("name", "unit", "time_s", "depth_mm", "program", "hold", "sd", "reason")

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class TidyTable:
    """A table in memory."""

    columns: tuple[str, ...]
    rows: tuple[Mapping[str, Any], ...]  # column -> value; a column that is missing is empty


def tidy_table(document: Identification, name: str, *, digest: str | None = None) -> TidyTable:
    """One of :data:`TABLES`, from the document of identification.json, whose SHA-256 is ``digest``."""
    columns, rows = TABLES[name]
    if name == "specimens":
        columns = _specimen_columns(document)
    provenance = {"tissueid": document.provenance.tissueid, "identification_sha256": digest}
    return TidyTable((*columns, *provenance), tuple({**row, **provenance} for row in rows(document)))


def csv_bytes(table: TidyTable) -> bytes:
    """The table as CSV (RFC 4180, UTF-8)."""
    stream = io.StringIO(newline="")
    writer = csv.writer(stream, lineterminator="\r\n")
    writer.writerow(table.columns)
    writer.writerows([_cell(row.get(column)) for column in table.columns] for row in table.rows)
    return stream.getvalue().encode("utf-8")


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "TRUE" if value else "FALSE"
    if isinstance(value, (list, tuple)):
        return ";".join(map(str, value))
    return repr(value) if isinstance(value, float) else str(value)


def _codes(*parts: Iterable[Flag]) -> list[str]:
    """Codes of flags, each once, in their order."""
    return list(dict.fromkeys(flag.code for part in parts for flag in part))


def _specimen_columns(document: Identification) -> tuple[str, ...]:
    most = min(max((specimen.model.branches for specimen in document.specimens), default=1), 3)
    branches = [f"{name}_b{branch}" for branch in range(2, most + 1) for name in _BRANCH_PARAMETERS]
    seen = (one.name for specimen in document.specimens for one in specimen.parameters)
    names = dict.fromkeys([*_PARAMETERS, *branches, *seen])
    estimates = (part for name in names for part in (name, *(f"{name}_{part}" for part in _PARTS)))
    return (
        *("specimen", "status", "trials", "excluded_trials", *_SPECIMEN_COVARIATES.values()),
        *("length_unit", "force_unit", "tip_radius_mm", "model", *_MODEL, *estimates),
        *("valid_depth_mm", "slowest_mm_s", "fastest_mm_s"),
        *("n_samples", "sigma_N", "nrmsd", "nrmsd_mean", "rmse_N", "optimisers_agree", *_SAMPLED),
        *("flags", "trial_flags"),
    )


def _specimen_rows(document: Identification) -> Iterator[Row]:
    known = _specimen_covariates(document)
    gone = [one.specimen for one in document.study.exclusions] if document.study else []
    fitted = {one.specimen: _fit_of(one) for one in document.specimens}
    for name in dict.fromkeys([*fitted, *known, *(one for one in gone if one is not None)]):
        fit = (
            {"status": "fitted", **fitted[name]} if name in fitted else {"status": "not fitted", "trials": 0}
        )
        yield {"specimen": name, "excluded_trials": gone.count(name), **known.get(name, {}), **fit}


def _fit_of(specimen: Specimen) -> Row:
    model, validity, units = specimen.model, specimen.validity, specimen.units
    slowest, fastest = validity.speeds_mm_s
    sampler, noise, misfit = specimen.sampler, specimen.noise, specimen.misfit
    row: Row = {
        "trials": len(specimen.trials),
        "length_unit": units.length,
        "force_unit": units.force,
        "tip_radius_mm": validity.tip_radius_mm,
        "model": model.key,
        **{key: getattr(model, key) for key in _MODEL},
        "valid_depth_mm": validity.depth_mm,
        "slowest_mm_s": slowest,
        "fastest_mm_s": fastest,
        "n_samples": specimen.n_samples,
        "sigma_N": specimen.sigma_N,
        "nrmsd": specimen.nrmsd.range,
        "nrmsd_mean": specimen.nrmsd.mean,
        "rmse_N": specimen.nrmsd.rmse_N,
        "optimisers_agree": specimen.optimisers.agree,
        "sampler": sampler and sampler.name,
        "converged": sampler and sampler.converged,
        "draws": sampler and sampler.draws,
        "noise": noise and noise.model,
        "phi": noise and noise.phi,
        "misfit": misfit and misfit.raised,
        "flags": _codes(specimen.flags),
        "trial_flags": _codes(*(trial.flags for trial in specimen.trials)),
    }
    for estimate in specimen.parameters:
        row[estimate.name] = estimate.value
        row |= {f"{estimate.name}_{part}": getattr(estimate, part) for part in _PLAIN_PARTS}
        for interval in _INTERVALS:
            low, high = getattr(estimate, interval) or (None, None)
            row |= {f"{estimate.name}_{interval}_low": low, f"{estimate.name}_{interval}_high": high}
    return row


def _specimen_covariates(document: Identification) -> dict[str, Row]:
    return {
        one.specimen: {column: getattr(one, key) for key, column in _SPECIMEN_COVARIATES.items()}
        for one in (document.study.specimens if document.study else ())
    }


_TRIAL_COLUMNS = (
    *("specimen", "path", "sheet", "status", "reason", *_TRIAL_COVARIATES),
    *(*_SPECIMEN_COVARIATES.values(), *_TRIAL_FIT, *_HOLD),
    *("cycles", "flags", "recipe", "input_sha256"),
)


def _place(part: Placed) -> tuple[str, str | None]:
    return part.path, part.sheet


def _trial_rows(document: Identification) -> Iterator[Row]:
    covariates = _specimen_covariates(document)
    said = {_place(one): one for one in (document.study.trials if document.study else ())}
    inputs = {_place(one): one for one in document.provenance.inputs}

    def row(part: Exclusion | Trial | Refusal, specimen: str | None, status: str) -> Row:
        known = said.get(_place(part))
        source = inputs.get(_place(part))
        return {
            "specimen": specimen,
            "path": part.path,
            "sheet": part.sheet,
            "status": status,
            "reason": known and known.because,
            **{key: known and getattr(known, key) for key in _TRIAL_COVARIATES},
            **covariates.get(specimen or "", {}),
            "recipe": source and source.recipe,
            "input_sha256": (source and source.sha256) or None,
        }

    for specimen in document.specimens:
        for trial in specimen.trials:
            own = [hold for hold in specimen.relaxation if _place(hold) == _place(trial)]
            yield {
                **row(trial, specimen.specimen, "fitted"),
                **{key: getattr(trial, key) for key in _TRIAL_FIT},
                **_longest_hold(own),
                "cycles": sum(_place(loop) == _place(trial) for loop in specimen.cycles),
                "flags": _codes(trial.flags, *(hold.flags for hold in own)),
            }
    for one in document.study.exclusions if document.study else ():
        yield {**row(one, one.specimen, "excluded"), "reason": one.because}
    for refused in document.refused:
        error = refused.error
        line = "" if error.line is None else f"line {error.line}: "
        yield {**row(refused, None, "refused"), "reason": f"{error.code}: {line}{error.message}"}


def _longest_hold(rows: Sequence[Relaxation]) -> Row:
    if not rows:
        return {"holds": 0}
    one = max(rows, key=lambda row: row.window_s[1] - row.window_s[0])
    double, triple = (*one.tau_double_s, None, None)[:2], (*one.tau_triple_s, None, None, None)[:3]
    numbers = (len(rows), *one.window_s, one.peak_force_N, one.tau_single_s, one.nrmsd_single)
    return dict(zip(_HOLD, (*numbers, *double, *triple), strict=True))


def _cycle_rows(document: Identification) -> Iterator[Row]:
    found: list[tuple[str | None, Cycle]]
    found = [(one.specimen, loop) for one in document.specimens for loop in one.cycles]
    # loops of recordings that could not be fitted have no specimen here
    found += [(None, loop) for loop in document.unfitted_cycles]
    for specimen, loop in found:
        row: Row = {"specimen": specimen, "path": loop.path, "sheet": loop.sheet}
        row |= {key: getattr(loop, key) for key in _LOOP_PLAIN}
        for name in _LOOP_MEASURES:
            measure: Measure = getattr(loop, name)
            row |= {name: measure.value, f"{name}_stderr": measure.stderr}
        yield row


def _quantity_rows(document: Identification) -> Iterator[Row]:
    for specimen in document.specimens:
        quoted = specimen.quoted
        for kind, numbers in (("model", quoted.model), ("moduli", quoted.moduli)) if quoted else ():
            for one in numbers:
                plain: Row = {key: getattr(one, key) for key in ("name", "unit", "value", "stderr", "reason")}
                at: Row = {key: getattr(one.at, key) for key in _CONDITIONS}
                yield {"specimen": specimen.specimen, "kind": kind, **plain, **at}
        for row in specimen.measured or ():
            plain = {key: getattr(row, key) for key in _MEASURED}
            more: Row = {"kind": "measured", "value": row.mean, "logs": row.count}
            yield {"specimen": specimen.specimen, **plain, **more}


_LOOP_NUMBERS = tuple(column for name in _LOOP_MEASURES for column in (name, f"{name}_stderr"))
#: Name -> its columns, of specimens found in the document, and its rows.
TABLES: Mapping[str, tuple[tuple[str, ...], Callable[[Identification], Iterator[Row]]]] = {
    "specimens": ((), _specimen_rows),
    "trials": (_TRIAL_COLUMNS, _trial_rows),
    "cycles": (("specimen", "path", "sheet", *_LOOP_PLAIN, *_LOOP_NUMBERS), _cycle_rows),
    "quantities": (("specimen", "kind", "name", "unit", *_CONDITIONS, *_QUOTED), _quantity_rows),
}
