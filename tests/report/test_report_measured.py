"""The measured block and the workbook: numbers of one programme together, with the spread between logs."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import replace
from typing import Any

import openpyxl
import pytest
from fit_factory import specimen_fit
from report_pages import document_of, render_report, specimen_of
from typed_call import typed_call

from tissueid.documents.measured import (
    Base,
    Measured,
    MeasuredForce,
    MeasuredHold,
    MeasuredPeak,
    MeasuredPush,
    MeasuredTau,
)
from tissueid.measured import spread
from tissueid.report.measured_words import MOST_COLUMNS, measured_view
from tissueid.report.workbook import report_workbook
from tissueid.result import SpecimenFit
from tissueid.store.curves import curves_of_fits

measured_view = typed_call(measured_view)
report_workbook = typed_call(report_workbook)


def log(peak_N: float, *, depth_mm: float = 6.0, speed_mm_s: float = 4.0, holds: int = 1) -> Measured:
    """A log whose force falls to 80 % of the peak at 1 s and to half of it at 10 s."""
    ramp_s = depth_mm / speed_mm_s
    push = MeasuredPush(
        0.0, ramp_s, ramp_s, speed_mm_s, depth_mm, depth_mm, 0.1, MeasuredPeak(ramp_s, peak_N, peak_N), None
    )
    forces = tuple(
        MeasuredForce(
            t, share * peak_N, 0.01, share * peak_N, share * peak_N, share / 0.5, share, False, None
        )
        for t, share, force in ((1.0, 0.8, 0.8 * peak_N), (10.0, 0.5, 0.5 * peak_N))
    )
    tau = MeasuredTau((ramp_s, ramp_s + 12.0), 2.0, (), 0.01, None)
    hold = MeasuredHold(ramp_s, ramp_s + 12.0, "position", push, forces, 0.5 * peak_N, 0.0, tau, False)
    return Measured(Base(0.0, "air"), push, (hold,) * holds, ())


def measured_fit(*logs: Measured, speeds: tuple[float, ...] = ()) -> SpecimenFit:
    fit = specimen_fit(trials=len(logs), samples=60)
    trials = tuple(
        replace(trial, measured=one, speed_mm_s=speeds[i] if speeds else 4.0)
        for i, (trial, one) in enumerate(zip(fit.trials, logs, strict=True))
    )
    return replace(fit, trials=trials, measured=spread(logs))


def view_of(fit: SpecimenFit) -> Any:
    return measured_view(specimen_of(fit))


def cells(fit: SpecimenFit) -> dict[str, list[str]]:
    return {row["name"]: [text for text, _ in row["cells"]] for row in view_of(fit)["rows"]}


def test_logs_of_one_programme_have_a_mean_and_their_standard_deviation():
    fit = measured_fit(log(9.0), log(10.0), log(11.0))
    found = cells(fit)
    assert found["Peak force"] == ["10.0 ± 1.0"]
    assert found["F(1 s)"] == ["8.00 ± 0.80"]
    assert found["F(10 s)"] == ["5.00 ± 0.50"]
    assert found["F(1 s)/F(10 s)"] == ["1.600"]
    assert found["One τ of the hold"] == ["2.000"]
    # a share of the peak is the ramp's as much as the tissue's
    assert not [name for name in found if "F_peak" in name]
    view = view_of(fit)
    assert view["head"] == ["Value, ramp 1.50 s"]
    assert view["said"].startswith("F(t): t after the stop. Mean ± SD between logs.")


def test_one_log_says_that_its_spread_is_unknown_and_several_holds_have_a_column_each():
    fit = measured_fit(log(9.0))
    assert cells(fit)["F(1 s)"] == ["7.200"]
    assert "the spread between sites is unknown" in view_of(fit)["said"]
    view = view_of(measured_fit(log(9.0, holds=2)))
    assert view["head"] == ["Hold 1, ramp 1.50 s", "Hold 2, ramp 1.50 s"]


def test_programmes_are_not_pooled_and_those_beyond_the_first_are_counted():
    logs = (log(9.0), log(11.0), log(30.0, speed_mm_s=20.0), log(2.0, speed_mm_s=0.1))
    fit = measured_fit(*logs, speeds=(4.0, 4.0, 20.0, 0.1))
    view = view_of(fit)
    assert len(view["head"]) == MOST_COLUMNS
    assert "1 more stand in the workbook" in view["said"]
    pooled = [cell for name, row in cells(fit).items() if name == "Peak force" for cell in row]
    assert set(pooled) <= {"10.0 ± 1.4", "30.00", "2.000"}
    assert len(pooled) == MOST_COLUMNS


def test_a_folder_of_an_older_version_has_no_such_block():
    document = document_of(specimen_fit(samples=60))
    for specimen in document["specimens"]:
        del specimen["measured"]
        for trial in specimen["trials"]:
            del trial["measured"]
    assert measured_view(document["specimens"][0]) is None
    html = render_report(document, [])
    assert "Measured, no model" not in html


def test_the_block_and_the_workbook_have_the_same_numbers():
    fit = measured_fit(log(9.0), log(11.0))
    document = document_of(fit)
    html = render_report(document, curves_of_fits([fit]))
    block = html.split('<div class="measured">')[1].split("</div>")[0]
    assert "8.0 ± 1.1" in block
    raw = re.search(r'spreadsheetml\.sheet;base64,([^"]+)"', html)
    assert base64.b64decode(raw[1]) == report_workbook(document)
    book = openpyxl.load_workbook(io.BytesIO(report_workbook(document)))
    assert book.sheetnames == ["Parameters", "Measured", "Measured logs", "Logs", "Quoted"]
    head, *rows = book["Measured"].values
    force = next(row for row in rows if row[head.index("quantity")] == "F(1 s)")
    assert force[head.index("mean")] == pytest.approx(8.0)
    assert force[head.index("SD between logs")] == pytest.approx(0.8 * 2**0.5)
    assert force[head.index("shortest ramp [s]")] == 1.5
    head, *rows = book["Measured logs"].values
    assert [row[head.index("F(10 s) [N]")] for row in rows] == [4.5, 5.5]
    assert [row[head.index("F(1 s)/F_peak, depends on the ramp")] for row in rows] == [0.8, 0.8]
    # a column in which nothing stands is left out
    assert "donor" not in next(book["Logs"].values)
