"""Tables without a column of time: the rate of the samples, stated by the header or the user."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from ingest_files import codes, put, read, refusal, workbook

from tissueid.ingest import ReadOptions, read_trials

ROWS = "".join(f"{0.02 * row:.2f},{0.5 * row:.1f}\n" for row in range(40))
NAMES = "Displacement (mm),Force (N)\n"
#: LabVIEW's, whose X column is empty, or not there; each channel states the interval and the unit.
LABVIEW = (
    "LabVIEW Measurement\t\nMulti_Headings\t{multi}\nX_Columns\tNo\n***End_of_Header***\t\n\t\n"
    "Channels\t2\t\t\nSamples\t40\t40\t\nDate\t2021/03/04\t2021/03/04\t\nTime\t10:11:12.1\t10:11:12.1\t\n"
    "Y_Unit_Label\tum\tmN\t\nX_Dimension\tTime\tTime\t\nX0\t0.0E+0\t0.0E+0\t\n"
    "Delta_X\t0.010000\t0.010000\t\n***End_of_Header***\t\t\t\n"
)


@pytest.mark.parametrize(
    "line",
    [
        "Sampling rate: 100 Hz",
        "# Sample Rate (Hz): 100",
        "Sampling frequency,0.1,kHz",
        "Data Acquisition Rate,100 samples/s",
        "sample_rate,100",
        "Fs = 100",
        "dt,0.01",
        "Sampling interval,10 ms",
        "Abtastrate,100 Hz",
        "Abtastintervall,0.01 s",
        "Fréquence d'échantillonnage,100 Hz",
        "Frecuencia de muestreo (Hz),100",
        "Sampling rate,100 Hz\nSampling interval,0.01 s",
    ],
)
def test_the_rate_of_the_header_is_the_clock(tmp_path: Path, line: str) -> None:
    trial = read(put(tmp_path / "a.csv", f"{line}\n{NAMES}{ROWS}"))
    assert trial.time_s == pytest.approx(0.01 * np.arange(40))
    assert trial.force_N[-1] == 19.5
    assert "time_counted" in codes(trial)


@pytest.mark.parametrize(
    "line",
    [
        "Sample height,10 mm",
        "Sample,100",
        "Samples,40",
        "Test rate,100 mm/min",
        "Sampling time,12 s",
        "Sampling rate,100 Hz\nSampling interval,0.02 s",
        "Sampling rate,0 Hz",
        "Sampling rate,fast",
    ],
)
def test_no_other_line_is_taken_for_a_rate_and_the_way_out_is_named(tmp_path: Path, line: str) -> None:
    error = refusal(put(tmp_path / "a.csv", f"{line}\n{NAMES}{ROWS}"))
    assert error.code == "no_columns"
    assert "--columns time=100Hz" in str(error)


@pytest.mark.parametrize(
    ("head", "asked", "way_out"),
    [
        ("", None, "state the rate, as in --columns time=100Hz,displacement=#1,force=#2"),
        ("", "10Hz", "name them by their numbers, as in --columns time=10Hz,displacement=#1,force=#2"),
        ("x (mm),Force (N)\n", None, "state the rate, as in --columns time=100Hz"),
        ("time (s),Force (N)\n", None, "export the displacement as well"),
        ("max_force_N,Modulus (MPa),width_mm\n", None, "are results, not samples: export the raw data"),
        ("x (mm),Force (N),Strain (%)\n", None, "or state the rate by time=100Hz"),
    ],
)
def test_a_way_out_can_be_followed(tmp_path: Path, head: str, asked: str | None, way_out: str) -> None:
    more = ",1.5" * (head.count(",") - 1)
    path = put(tmp_path / "a.csv", head + "".join(f"{0.01 * k:.3f},{0.5 * k:.3f}{more}\n" for k in range(60)))
    options = ReadOptions(columns={"time": asked} if asked else {})
    message = refusal(path, options).message
    assert message.endswith(way_out)
    if "--columns" in way_out:
        columns = dict(part.split("=") for part in way_out.split()[-1].split(","))
        assert read(path, ReadOptions(columns=columns)).force_N[-1] == pytest.approx(29.5)


@pytest.mark.parametrize(("asked", "interval_s"), [("100Hz", 0.01), ("1 kHz", 1e-3), ("10 ms", 0.01)])
def test_the_user_states_a_rate_for_text_and_workbook(tmp_path: Path, asked: str, interval_s: float) -> None:
    options = ReadOptions(columns={"time": asked})
    rows = [[float(cell) for cell in row.split(",")] for row in ROWS.splitlines()]
    for path in (
        put(tmp_path / "a.csv", NAMES + ROWS),
        workbook(tmp_path / "a.xlsx", {"one": [NAMES.strip().split(","), *rows]}),
    ):
        (trial,) = read_trials(path, options)
        assert trial.time_s == pytest.approx(interval_s * np.arange(40))
        assert trial.displacement_mm[-1] == 0.78


def test_a_rate_is_no_column_where_one_has_that_name_or_the_time_is_there(tmp_path: Path) -> None:
    timed = "".join(f"{0.5 * row},{line}\n" for row, line in enumerate(ROWS.splitlines()))
    for head in ("100Hz", "Time (s)"):
        path = put(tmp_path / "a.csv", f"Sampling rate,100 Hz\n{head},{NAMES}{timed}")
        columns = {} if head == "Time (s)" else {"time": "100Hz"}
        (trial,) = read_trials(path, ReadOptions(columns=columns))
        assert trial.time_s[-1] == 19.5
        assert "time_counted" not in codes(trial)


def test_a_column_that_rises_is_asked_about_and_a_count_of_rows_is_none(tmp_path: Path) -> None:
    head = f"Sampling rate,100 Hz\nKanal,{NAMES}"
    for step, read_ in ((0.02, False), (1, True)):
        rows = "".join(f"{step * row:g},{line}\n" for row, line in enumerate(ROWS.splitlines()))
        path = put(tmp_path / "a.csv", head + rows)
        if read_:
            assert "time_counted" in codes(read(path))
        else:
            assert "'Kanal'" in str(refusal(path))


@pytest.mark.parametrize("multi", ["Yes", "No"])
def test_labview_without_x_columns_is_counted_by_its_own_interval(tmp_path: Path, multi: str) -> None:
    names, first = ("X_Value\t", "\t") if multi == "Yes" else ("", "")
    rows = "".join(first + line.replace(",", "\t") + "\n" for line in ROWS.splitlines())
    text = LABVIEW.format(multi=multi) + f"{names}Displacement\tForce\tComment\n{rows}"
    (trial,) = read_trials(put(tmp_path / "a.lvm", text))
    assert trial.time_s == pytest.approx(0.01 * np.arange(40))
    assert trial.displacement_mm[-1] == pytest.approx(0.78e-3)
    assert trial.force_N[-1] == pytest.approx(19.5e-3)
