"""Units as machines spell them and where they print them: under the names, above them, in the header.

A row of units that is not understood is asked about: taken for a remark, it would leave pounds as newtons.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from ingest_files import codes, put, read, refusal

from tissueid.ingest import ReadOptions
from tissueid.units import factor_to, quantity_of

ROWS = "".join(f"{k / 10:.1f},{k * 0.05:.3f},{1 + k * 0.25:.3f}\n" for k in range(30))
POUND_N = 4.4482216152605


@pytest.mark.parametrize(
    ("units", "factors"),
    [
        (("SEC", "MM", "KGF"), (1, 1, 9.80665)),
        (("Seconds", "Millimeters", "Newtons"), (1, 1, 1)),
        (("Minutes", "Inches", "pounds"), (60, 25.4, POUND_N)),
        (("msec", "microns", "gF"), (1e-3, 1e-3, 9.80665e-3)),
        (("mSec", "micrometer", "gram-force"), (1e-3, 1e-3, 9.80665e-3)),
        (("s", "mil", "ozf"), (1, 0.0254, POUND_N / 16)),
        (("SECS", "IN", "LBF"), (1, 25.4, POUND_N)),
        (("Sec.", "Inch", "Lbf"), (1, 25.4, POUND_N)),
        (("sec", "mm", "kp"), (1, 1, 9.80665)),
        (("s", "mm", "Kg"), (1, 1, 9.80665)),
    ],
)
@pytest.mark.parametrize("where", ["names", "row", "above", "wide"])
def test_units_are_read_however_they_are_spelled(
    tmp_path: Path, units: tuple[str, str, str], factors: tuple[float, float, float], where: str
) -> None:
    names = ("Time", "Extension", "Load")
    over, under = ",".join(names), ",".join(units)
    head = {
        "names": ",".join(f"{name} ({unit})" for name, unit in zip(names, units, strict=True)),
        "row": f"{over}\n{under}",
        "above": f"{under}\n{over}",
        "wide": ",".join(f"{name}（{unit}）" for name, unit in zip(names, units, strict=True)),
    }[where]
    trial = read(put(tmp_path / "a.csv", f"{head}\n{ROWS}"))
    assert trial.flags == ()
    found = (trial.time_s[2], trial.displacement_mm[2], trial.force_N[2])
    # parse, factor, product: a rounding each
    assert found == pytest.approx((0.2 * factors[0], 0.1 * factors[1], 1.5 * factors[2]), rel=1e-15)


@pytest.mark.parametrize("unit", ["G", "MN", "Mn", "NM"])
def test_capitals_that_may_mean_another_unit_are_not_guessed(unit: str) -> None:
    try:
        factor = factor_to(unit, "force")
    except ValueError:
        return
    assert factor not in {9.80665e-3, 1e-3}
    assert quantity_of("g") == "force"


@pytest.mark.parametrize("row", ["sek.,mm,Pond", "Sekunde,Milimeter,Newt"])
def test_words_under_the_names_that_are_no_known_units_are_asked_about(tmp_path: Path, row: str) -> None:
    path = put(tmp_path / "a.csv", f"Time,Extension,Load\n{row}\n{ROWS}")
    error = refusal(path)
    assert error.code == "unknown_unit"
    assert "--units" in error.message
    stated = ReadOptions(units={"time": "s", "displacement": "mm", "force": "lbf"})
    assert read(path, stated).force_N[2] == pytest.approx(1.5 * POUND_N)


@pytest.mark.parametrize("remark", ["Start of the test,,", "begin,,", '"","Timed",""'])
def test_a_remark_under_the_names_is_no_row_of_units(tmp_path: Path, remark: str) -> None:
    trial = read(put(tmp_path / "a.csv", f"Time (s),Extension (mm),Load (N)\n{remark}\n{ROWS}"))
    assert codes(trial) == ["rows_skipped"]


def test_a_line_of_sensors_between_names_and_units_hides_no_units(tmp_path: Path) -> None:
    head = "Time,Displacement,Force\nTimer,LVDT,Load cell\nsec,um,mN"
    trial = read(put(tmp_path / "a.csv", f"{head}\n{ROWS}"))
    assert trial.flags == ()
    assert (trial.displacement_mm[2], trial.force_N[2]) == pytest.approx((0.1e-3, 1.5e-3))


@pytest.mark.parametrize("key", ["Y_Unit_Label", "UnitName=", "Units", "Einheiten:", "单位"])
def test_units_in_a_line_of_the_header_are_those_of_the_columns_below(tmp_path: Path, key: str) -> None:
    head = f"Operator\tlab\n{key}\tmN\tum\nSamples\t30\t30\n\nX_Value\tForce\tPosition"
    rows = "".join(f"{k / 10:.1f}\t{1 + k * 0.25:.3f}\t{k * 0.05:.3f}\n" for k in range(30))
    trial = read(put(tmp_path / "a.lvm", f"{head}\n{rows}"))
    assert codes(trial) == ["units_assumed"]  # of the time alone
    assert (trial.displacement_mm[2], trial.force_N[2]) == pytest.approx((0.1e-3, 1.5e-3))


@pytest.mark.parametrize("line", ["Units: ms, um, mN", "Units,(ms),(um),(mN)"])
def test_units_behind_their_key_stand_in_the_order_of_the_columns(tmp_path: Path, line: str) -> None:
    trial = read(put(tmp_path / "a.csv", f"Operator,lab\n{line}\nTime,Position,Load\n{ROWS}"))
    assert trial.flags == ()
    assert (trial.displacement_mm[2], trial.force_N[2]) == pytest.approx((0.1e-3, 1.5e-3))


def test_units_of_another_table_are_not_those_of_the_columns(tmp_path: Path) -> None:
    above = read(put(tmp_path / "b.csv", f"Units,N,um\n\nTime,Extension,Load\n{ROWS}"))
    assert above.force_N[2] == 1.5
    assert codes(above) == ["units_assumed"] * 3


@pytest.mark.parametrize("names", ["Time,Displacement,Force", "Elapsed Time,Position,Load"])
@pytest.mark.parametrize("line", ["{name} unit: {unit}", "{name} unit,{unit}", "{name} units = {unit}"])
def test_units_that_the_header_states_column_by_column_are_read(
    tmp_path: Path, line: str, names: str
) -> None:
    stated = {"Time": "msec", "Displacement": "um", "Force": "mN"}
    header = "\n".join(line.format(name=name, unit=unit) for name, unit in stated.items())
    trial = read(put(tmp_path / "a.csv", f"{header}\n\n{names}\n{ROWS}"))
    assert trial.flags == ()
    assert (trial.time_s[2], trial.displacement_mm[2], trial.force_N[2]) == pytest.approx(
        (2e-4, 1e-4, 1.5e-3)
    )


@pytest.mark.parametrize("row", ["0.0000,NaN,NaN", "n/a,n/a,n/a"])
def test_missing_numbers_under_the_names_are_no_units(tmp_path: Path, row: str) -> None:
    head = f"Time (s),Extension (mm),Load (N)\n{row}\n"
    path = put(tmp_path / "a.csv", head + ROWS)
    if row.startswith("0"):
        error = refusal(path)
        assert (error.code, error.line) == ("not_finite", 2)
    else:
        assert codes(read(path)) == ["rows_skipped"]
