"""Every readable real recording, against an independent plain-Python parse of the same file."""

import csv
import hashlib
import zipfile
from pathlib import Path

import numpy as np
import openpyxl
import pytest
from ingest_files import put, read

from tissueid.ingest import ReadOptions, find_inputs, read_one, read_trials
from tissueid.trial import Trial

Rows = list[tuple[float, float, float]]


def plain_rows(path: Path, columns: tuple[int, int, int], *, skip: int, encoding: str = "utf-8") -> Rows:
    """Time, displacement, force of the lines after the first ``skip``, by the standard library."""
    with path.open(encoding=encoding, newline="") as stream:
        lines = list(csv.reader(stream))[skip:]
    return [tuple(float(line[i]) for i in columns) for line in lines if line]


def assert_same(trial: Trial, rows: Rows, factors=(1.0, 1.0, 1.0), *, rtol: float = 4e-16) -> None:
    """Count, every sample, and so first, last and peak; one rounding each for parse and unit."""
    assert trial.time_s.size == len(rows)
    recorded = np.array([trial.time_s, trial.displacement_mm, trial.force_N])
    np.testing.assert_allclose(recorded, (np.array(rows) * factors).T, rtol=rtol, atol=0.0)


def test_bluehill_cyclic(shared_data):
    path = shared_data / "instron-bluehill-cyclic-cc0" / "Specimen_RawData_6.csv"
    trial = read(path)
    assert_same(trial, plain_rows(path, (0, 1, 2), skip=5))
    assert trial.specimen == "22L.3"
    assert trial.source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert (trial.source.recipe, trial.source.path) == ("bluehill-csv", str(path))
    assert [flag.code for flag in trial.flags] == ["event_rows"]


def test_bluehill_universal_sample_in_kilonewtons(shared_data):
    path = shared_data / "bluehill-universal-sample-mit" / "sample_bluehill.csv"
    trial = read(path)
    assert_same(trial, plain_rows(path, (0, 1, 2), skip=1), (1.0, 1.0, 1000.0))
    assert trial.specimen == str(path)


@pytest.mark.parametrize(
    ("name", "columns"),
    [("Allong 1.TRA", (0, 3, 2)), ("Invar_LT_05_01.TRA", (0, 2, 3)), ("mDB1pct.TRA", (0, 3, 2))],
)
def test_testxpert_tra(shared_data, name, columns):
    path = shared_data / "zwick-tra-mit" / name
    if not path.exists():
        pytest.skip(f"no {path}")
    trial = read(path)
    assert_same(trial, plain_rows(path, columns, skip=12, encoding="latin-1"))
    assert (trial.source.recipe, trial.source.encoding) == ("testxpert-tra", "latin-1")
    assert trial.protocol.speed_mm_s == pytest.approx(1 / 60, rel=1e-15)
    assert "column_choice" in [flag.code for flag in trial.flags]


def test_testxpert_workbook_every_sheet(shared_data):
    (path,) = (shared_data / "zwick-meat-gpl3").glob("230403*.xlsx")
    book = openpyxl.load_workbook(path, read_only=True)
    tables = {}
    for sheet in book.worksheets:
        rows = list(sheet.iter_rows(values_only=True))
        if len(rows) > 3 and rows[1] and rows[1][0] == "Temps d'essai":
            tables[sheet.title] = [(row[0], row[2], row[1]) for row in rows[3:] if row[0] is not None]
    trials = read_trials(path)
    assert [trial.source.sheet for trial in trials] == list(tables)
    assert len(trials) == 29
    for trial in trials:
        assert_same(trial, tables[trial.source.sheet])
        assert trial.source.recipe == "testxpert-workbook"
        assert trial.source.columns["displacement"] == "Allongement"
        assert trial.specimen == trial.source.sheet
        choice = [flag for flag in trial.flags if flag.code == "column_choice"]
        assert choice[0].values["alternatives"] == ["Ecartement entre outils"]
    assert len({trial.specimen for trial in trials}) == 29


def test_workbook_one_sheet_and_its_other_displacement(shared_data):
    (path,) = (shared_data / "zwick-meat-gpl3").glob("230403*.xlsx")
    trial = read_one(path, "230403-FF1C", ReadOptions(columns={"displacement": "Ecartement entre outils"}))
    assert trial.displacement_mm[0] == 14.391552164525592
    assert [flag.code for flag in trial.flags if flag.code == "column_choice"] == []


def test_muscle_with_a_column_map(shared_data):
    options = ReadOptions(columns={"displacement": "L", "force": "F"})
    for path in sorted((shared_data / "muscle-ramp-hold-mit").glob("*.csv")):
        trial = read(path, options)
        assert_same(trial, plain_rows(path, (0, 1, 2), skip=1))
        assert [flag.code for flag in trial.flags].count("units_assumed") == 3


def test_afm_columns_carry_their_units(shared_data):
    path = shared_data / "oocyte-afm-mit" / "cell1-0008_full.csv"
    trial = read(path)
    assert_same(trial, plain_rows(path, (0, 2, 1), skip=1), (1.0, 1000.0, 1.0))
    assert dict(trial.source.columns)["displacement"] == "height_measured_m"


#: Recordings that are compared here sample by sample, and those that nobody has read by another program yet.
COMPARED = (
    "instron-bluehill-cyclic-cc0/Specimen_RawData_6.csv", "bluehill-universal-sample-mit/sample_bluehill.csv",
    "zwick-tra-mit/*.TRA", "zwick-meat-gpl3/230403*.xlsx", "muscle-ramp-hold-mit/*.csv",
    "oocyte-afm-mit/cell1-0008_full.csv", "optics11-chiaro-mit/chiaro.zip",
)  # fmt: skip
NOT_COMPARED = (
    "mach1-pork-gpl3/09-s-1_36.04_11.85_04.68.txt",
    "shimadzu-gpl3/Exemple_*.csv",
    "zwick-meat-gpl3/230407_C_Indentation_relaxation_500N_force.xlsx",
)


def test_every_recording_there_is_is_compared_or_named(shared_data):
    known = {path for pattern in (*COMPARED, *NOT_COMPARED) for path in shared_data.glob(pattern)}
    found = set(find_inputs([shared_data]))
    assert found <= known
    # all that is compared, and nothing that tells of it
    assert {path for pattern in COMPARED for path in shared_data.glob(pattern)} <= found
    assert not {"SOURCE.txt", "LICENSE.txt"} & {path.name for path in found}


def test_chiaro_text_and_archive(shared_data, tmp_path):
    path = shared_data / "optics11-chiaro-mit" / "chiaro.zip"
    with zipfile.ZipFile(path) as archive:
        (member,) = archive.namelist()
        data = archive.read(member)
    lines = [line.split("\t") for line in data.decode("cp1252").split("Auxiliary\r\n")[1].splitlines()]
    rows = [(float(cells[0]), float(cells[2]), float(cells[1])) for cells in lines if len(cells) == 6]
    unpacked = put(tmp_path / "export.txt", data)
    for source, sheet in ((path, member), (unpacked, None)):
        trial = read(source)
        # parse, factor of the unit, product: one rounding each, twice
        assert_same(trial, rows, (1.0, 1e-6, 1e-6), rtol=6e-16)
        assert (trial.source.recipe, trial.source.sheet) == ("chiaro", sheet)
        assert trial.protocol.tip_radius_mm == pytest.approx(0.0275, rel=1e-12)
        assert trial.protocol.speed_mm_s == pytest.approx(0.007, rel=1e-12)
