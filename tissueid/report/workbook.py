"""The tables of a report as one workbook: parameters, what was measured, logs, loops, quoted numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from tissueid.documents.identification import Identification
from tissueid.documents.measured import Measured, MeasuredHold, MeasuredPush
from tissueid.report.measured_words import measured_name
from tissueid.report.uncertainty_words import reported_order
from tissueid.report.wording import parameter_words, trial_label
from tissueid.store.tidy import tidy_table
from tissueid.store.xlsx import Cell, Sheet, xlsx_bytes

_FORCES = {
    "after_stop_N": "F({}) [N]",
    "over_10s": "F({})/F(10 s)",
    "over_peak": "F({})/F_peak, depends on the ramp",
}
_TIDY = {"trials": "Logs", "cycles": "Loops", "quantities": "Quoted"}
_Row = tuple[int | None, MeasuredHold | None, MeasuredPush | None]


def report_workbook(document: Identification, digest: str | None = None) -> bytes:
    """A workbook of the document of identification.json, whose SHA-256 is ``digest``."""
    sheets = [_parameters(document), _measured(document), _pushes(document)]
    sheets += [_tidy(document, name, title, digest) for name, title in _TIDY.items()]
    return xlsx_bytes([sheet for sheet in sheets if sheet.rows] or sheets[:1])


def _parameters(document: Identification) -> Sheet:
    head = (
        *("specimen", "parameter", "name", "symbol", "unit", "identified", "value", "standard error"),
        *("95 % statistical, low", "95 % statistical, high", "95 % total, low", "95 % total, high"),
    )
    rows: list[list[Cell]] = [
        [
            *(specimen.specimen, parameter_words(one.name), one.name, one.symbol, one.unit),
            *(one.identified, one.value, one.stderr),
            *(end for key in ("ci95", "ci95_total") for end in getattr(one, key) or (None, None)),
        ]
        for specimen in document.specimens
        for one in reported_order(specimen.parameters)
    ]
    return Sheet("Parameters", head, rows)


def _measured(document: Identification) -> Sheet:
    head = (
        *("specimen", "quantity", "program", "hold", "unit", "time after the stop [s]", "shortest ramp [s]"),
        *("longest ramp [s]", "logs", "mean", "SD between logs", "why there is none"),
    )
    rows: list[list[Cell]] = [
        [
            *(specimen.specimen, measured_name(row), row.program, row.hold or None, row.unit),
            row.time_s,
            *(row.ramp_time_s or (None, None)),
            *(row.count, row.mean, row.sd, row.reason),
        ]
        for specimen in document.specimens
        for row in specimen.measured or ()
    ]
    return Sheet("Measured", head, rows)


def _pushes(document: Identification) -> Sheet:
    """A row a hold of each log, or its push where nothing was held."""
    times = sorted(
        {
            one.time_s
            for specimen in document.specimens
            for trial in specimen.trials
            for hold in (trial.measured.holds if trial.measured else ())
            for one in hold.forces
        }
    )
    head = [
        *("specimen", "log", "hold", "speed [mm/s]", "depth [mm]", "ramp time [s]", "peak force [N]"),
        *(name.format(f"{time:g} s") for name in _FORCES.values() for time in times),
        *("one relaxation time [s]", "of a window of [s]"),
    ]
    rows = [
        [specimen.specimen, trial_label(trial), *_push(number, hold, push, times)]
        for specimen in document.specimens
        for trial in specimen.trials
        for number, hold, push in _held(trial.measured)
    ]
    return Sheet("Measured logs", tuple(head), rows)


def _held(measured: Measured | None) -> list[_Row]:
    """Number, hold and push of each row of a log."""
    if measured is None:
        return []
    holds: list[_Row] = [(number, hold, hold.push) for number, hold in enumerate(measured.holds, 1)]
    return holds or [(None, None, measured.push)] * (measured.push is not None)


def _push(
    number: int | None, hold: MeasuredHold | None, push: MeasuredPush | None, times: Sequence[float]
) -> list[Cell]:
    forces = {} if hold is None else {one.time_s: one for one in hold.forces}
    tau = None if hold is None else hold.tau

    return [
        number,
        *((None,) * 3 if push is None else (push.speed_mm_s, push.depth_mm, push.ramp_time_s)),
        None if push is None else push.peak.force_N,
        *(getattr(forces[time], key) if time in forces else None for key in _FORCES for time in times),
        *((None, None) if tau is None else (tau.single_s, tau.window_s[1] - tau.window_s[0])),
    ]


def _tidy(document: Identification, name: str, title: str, digest: str | None) -> Sheet:
    """One of the tidy tables, without columns in which nothing stands."""
    table = tidy_table(document, name, digest=digest)
    kept = [
        column for column in table.columns if any(row.get(column) not in (None, [], "") for row in table.rows)
    ]
    return Sheet(title, tuple(kept), [[_cell(row.get(column)) for column in kept] for row in table.rows])


def _cell(value: Any) -> Cell:
    if isinstance(value, list | tuple):
        return "; ".join(map(str, value))
    return value if isinstance(value, str | int | float | bool | None) else str(value)
