"""``inspect --csv`` and ``--xlsx``: one row a hold, or a push where there is none."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

from tissueid.documents.inspect import Trial
from tissueid.documents.measured import MeasuredHold, MeasuredPush

TIMES_S = (0.1, 1.0, 10.0, 100.0)
_PUSH = ("ramp_time_s", "speed_mm_s", "travel_mm", "depth_mm", "braking_s")
_MODULUS = ("formula", "loading_kPa", "held_kPa", "refused")

HEAD = (
    "path", "sheet", "specimen", "excluded", "verdict", "reason", "hold", "control", "start_s", "end_s",
    *_PUSH, "peak_N", "peak_time_s", "base_N", "base_source",
    *(f"force_{time:g}s_N" for time in TIMES_S),
    *(f"force_{time:g}s_over_10s" for time in TIMES_S if time != 10.0),
    *(f"force_{time:g}s_after_peak_N" for time in TIMES_S),
    *(f"force_{time:g}s_over_peak_depends_on_ramp" for time in TIMES_S),
    "relaxation_time_s", "relaxation_window_start_s", "relaxation_window_end_s",
    *(f"modulus_{name}" for name in _MODULUS),
    "loop_areas_mJ", "force_unit", "length_unit", "flags",
)  # fmt: skip

Cell = str | float | bool | None


def measured_rows(described: Sequence[Trial]) -> list[list[Cell]]:
    """Rows in the order of :data:`HEAD`.

    ``described``: recordings of ``inspect --json``.
    """
    return [[row.get(name) for name in HEAD] for one in described for row in _rows(one)]


def _rows(one: Trial) -> Iterator[dict[str, Cell]]:
    measured = one.measured
    areas = [loop.area_mJ for loop in measured.loops if loop.area_mJ is not None]
    common: dict[str, Cell] = {
        "path": one.path,
        "sheet": one.sheet,
        "specimen": one.specimen,
        "excluded": one.excluded,
        "verdict": one.verdict.level,
        "reason": one.verdict.reason,
        "base_N": measured.base.recorded_N,
        "base_source": measured.base.source,
        "loop_areas_mJ": "; ".join(f"{area:.6g}" for area in areas) or None,
        "force_unit": one.units.force,
        "length_unit": one.units.length,
        "flags": " ".join(dict.fromkeys(flag.code for flag in one.flags)) or None,
    }
    for number, hold in enumerate(measured.holds, start=1):
        yield common | {"hold": number} | _of_hold(hold) | _of_push(hold.push)
    if not measured.holds:
        yield common | _of_push(measured.push)


def _of_push(push: MeasuredPush | None) -> dict[str, Cell]:
    if push is None:
        return {}
    row: dict[str, Cell] = {name: getattr(push, name) for name in _PUSH}
    row |= {"peak_N": push.peak.force_N, "peak_time_s": push.peak.time_s}
    return row | {f"modulus_{name}": getattr(push.modulus, name, None) for name in _MODULUS}


def _of_hold(hold: MeasuredHold) -> dict[str, Cell]:
    row: dict[str, Cell] = {"control": hold.control, "start_s": hold.start_s, "end_s": hold.end_s}
    for force in hold.forces:
        at = f"force_{force.time_s:g}s"
        row |= {
            f"{at}_N": force.after_stop_N,
            f"{at}_over_10s": force.over_10s,
            f"{at}_after_peak_N": force.after_peak_N,
            f"{at}_over_peak_depends_on_ramp": force.over_peak,
        }
    tau = hold.tau
    if tau is not None:
        row["relaxation_time_s"] = tau.single_s
        row["relaxation_window_start_s"], row["relaxation_window_end_s"] = tau.window_s
    return row


def measured_csv(described: Sequence[Trial]) -> bytes:
    """The table as CSV in UTF-8: numbers to their last digit, text without what could steer a reader."""
    from tissueid.errors import printable

    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(HEAD)
    for row in measured_rows(described):
        writer.writerow([printable(cell) if isinstance(cell, str) else cell for cell in row])
    return stream.getvalue().encode("utf-8")


def measured_xlsx(described: Sequence[Trial]) -> bytes:
    """The table as a workbook."""
    from tissueid.store.xlsx import Sheet, xlsx_bytes

    return xlsx_bytes([Sheet("measured", HEAD, measured_rows(described))])
