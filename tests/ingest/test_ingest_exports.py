"""Every export that can be written reads back as printed; force curves of microscopes too."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from ingest_files import (
    DEPTH_MM,
    HOLD_S,
    SPEED_MM_S,
    assert_equal,
    expected,
    log_of,
    put,
    read,
    refusal,
    zipped,
)
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.errors import InputError
from tissueid.ingest import RECIPES, find_inputs, read_each, read_one, read_trials
from tissueid.segment import segment
from tissueid.synth import DIALECTS, EXPORTS
from tissueid.synth.machines import mach1_text, mts793_text, shimadzu_text, xlsx
from tissueid.trial import Trial

#: What a reader says of a variant beside its numbers.
SAID = {
    "no-units": ["units_assumed"] * 3,
    "bluehill-workbook": ["rows_skipped"],
    **{name: ["rows_skipped"] for name, dialect in DIALECTS.items() if dialect.results},
    **{name: ["column_choice"] for name in EXPORTS if name.startswith("testxpert")},
}
#: Export -> the reader whose key its name begins with.
READ_BY = {name: next((key for key in RECIPES if name.startswith(key)), "bluehill-csv") for name in EXPORTS}
READ_BY["bluehill-workbook"] = "workbook"


def test_every_reader_is_told_of():
    page = (Path(__file__).parents[2] / "docs" / "reading.md").read_text(encoding="utf-8")
    assert [key for key in RECIPES if f"`{key}`" not in page] == []


@pytest.mark.parametrize("count", [12, 260], ids=["short", "long"])
@pytest.mark.parametrize("name", EXPORTS)
def test_each_export_reads_back_exactly(tmp_path: Path, name: str, count: int) -> None:
    log = log_of(count)
    trial = read(put(tmp_path / f"synthetic {name}{EXPORTS[name].suffix}", EXPORTS[name].write(log)))
    assert_equal(trial, name, log)
    assert trial.source.recipe == READ_BY[name]
    assert [flag.code for flag in trial.flags if flag.code != "commanded_displacement"] == SAID.get(name, [])
    assert not {"Mean", "1", "Mittelwert", "Média", "Średnia", "平均值"} & set(trial.source.metadata)
    # its header states its protocol
    if name in {"headless", "shimadzu"}:
        return
    if not name.startswith(("mts", "testxpert-workbook")):
        assert trial.protocol.speed_mm_s == pytest.approx(SPEED_MM_S, rel=1e-12)
    if name == "mach-1" or (name in DIALECTS and DIALECTS[name].language != "en"):
        assert (trial.protocol.depth_mm, trial.protocol.hold_s) == (DEPTH_MM, HOLD_S)
    if name.startswith("chiaro"):
        assert trial.protocol.tip_radius_mm == pytest.approx(0.0275, rel=1e-12)
    if name in DIALECTS or name.startswith(("mts", "bluehill")):
        assert trial.specimen == "22L.3"


def test_mach1_refusals_point_at_the_line_of_the_file_and_spare_the_other_blocks(tmp_path: Path) -> None:
    logs = [log_of(30, start_s=0.0), log_of(50, start_s=0.0)]
    lines = mach1_text(logs).decode().split("\r\n")
    spoilt = next(i for i, line in enumerate(lines) if line.startswith("1.25000"))
    lines[spoilt] = lines[spoilt].replace("1.25000", "1.2.5")
    refusal, trial = read_each(put(tmp_path / "synthetic.txt", "\r\n".join(lines).encode()))
    assert (refusal.code, refusal.line, refusal.column) == ("damaged_number", spoilt + 1, 1)
    assert (refusal.sheet, trial.source.sheet) == ("2: Stress Relaxation", "3: Stress Relaxation")
    assert trial.protocol.kind == "stress relaxation"
    assert_equal(trial, "mach-1", logs[1])
    assert_equal(read_one(tmp_path / "synthetic.txt", "3: Stress Relaxation"), "mach-1", logs[1])


def test_mach1_time_that_starts_again_behind_a_divider_makes_two_trials(tmp_path: Path) -> None:
    first, second = mach1_text([log_of(30, start_s=0.0)], divided=False), log_of(20, start_s=0.0)
    rows = mach1_text([second], divided=False).split(b"Fz, gf\r\n")[1].split(b"<END DATA>")[0]
    text = first.replace(b"<END DATA>\r\n", b"", 1)
    joined = text[: text.rindex(b"<END DATA>")] + b"<divider>\r\n" + rows + b"<END DATA>\r\n"
    path = put(tmp_path / "synthetic.txt", joined.replace(b"0.0\t0.0\r\n", b"0.0\t0.0\r\n<END DATA>\r\n", 1))
    trials = read_trials(path)
    assert [t.source.sheet for t in trials] == ["2: Stress Relaxation (1)", "2: Stress Relaxation (2)"]
    assert [t.time_s.size for t in trials] == [30, 20]


def test_mach1_cut_before_its_end_is_flagged(tmp_path: Path) -> None:
    data = mach1_text([log_of(30, start_s=0.0)])
    trial = read(put(tmp_path / "synthetic.txt", data[: data.rindex(b"<END DATA>")]))
    assert_equal(trial, "mach-1", log_of(30, start_s=0.0))
    assert "cut_row" in [flag.code for flag in trial.flags]


def test_mach1_relative_move_states_its_depth_and_wait_its_hold(tmp_path: Path) -> None:
    data = mach1_text([log_of(30, start_s=0.0)]).decode()
    start, stop = data.index("<Stress Relaxation>"), data.rindex("<DATA>")
    head = "<Move Relative>\r\nPosition, mm:\t0.400\r\nVelocity, mm/s:\t0.200\r\nWait:\t00:01:30\r\n"
    trial = read(put(tmp_path / "synthetic.txt", data[:start] + head + data[stop:]))
    assert trial.protocol.kind == "move relative"
    assert (trial.protocol.depth_mm, trial.protocol.speed_mm_s, trial.protocol.hold_s) == (0.4, 0.2, 90.0)


def test_mach1_without_force_is_refused_and_names_its_blocks(tmp_path: Path) -> None:
    error = refusal(put(tmp_path / "synthetic.txt", mach1_text([])))
    assert error.code == "no_columns"
    assert "1: Find Contact (Time, s, Position (z), mm)" in error.message


def test_mts_numbers_against_the_stated_mark_are_refused_with_their_line(tmp_path: Path) -> None:
    data = mts793_text([log_of(20)]).replace(b"|2|.|/|", b"|2|,|.|")
    error = refusal(put(tmp_path / "synthetic.dat", data))
    assert (error.code, error.line) == ("inconsistent_decimal", 10)


def test_mts_blocks_are_trials_and_rows_behind_a_blank_line_are_not_lost(tmp_path: Path) -> None:
    logs = [log_of(20), log_of(35)]
    path = tmp_path / "synthetic.dat"
    lines = mts793_text(logs).split(b"\r\n")
    lines.insert(len(lines) - 10, b"")
    path.write_bytes(b"\r\n".join(lines))
    trials = read_trials(path)
    assert [trial.source.sheet for trial in trials] == [f"{k}: Data Acquisition: Timed" for k in (1, 2)]
    for trial, log in zip(trials, logs, strict=True):
        assert_equal(trial, "mts-793", log)


def test_shimadzu_gives_one_trial_a_specimen_with_ragged_ends(tmp_path: Path) -> None:
    logs = [log_of(count, name=f"a-{count}") for count in (25, 60, 12)]
    path = put(tmp_path / "synthetic.csv", shimadzu_text(logs))
    trials = read_trials(path)
    assert [trial.source.sheet for trial in trials] == [f"synthetic {log.name}" for log in logs]
    for trial, log in zip(trials, logs, strict=True):
        assert_equal(trial, "shimadzu", log)
    # without the empty cells at the ends of its lines
    path.write_bytes(
        b"".join(line.rstrip(b'",\r\n') + b'"\r\n' for line in shimadzu_text(logs).splitlines()[3:])
    )
    head = b"".join(line + b"\r\n" for line in shimadzu_text(logs).splitlines()[:3])
    path.write_bytes(head + path.read_bytes())
    assert [trial.time_s.size for trial in read_trials(path)] == [25, 60, 12]


def test_the_same_columns_twice_without_names_above_are_two_specimens(tmp_path: Path) -> None:
    logs = [log_of(25, name="a"), log_of(25, name="b", start_s=10.0)]
    path = put(tmp_path / "synthetic.csv", b"\r\n".join(shimadzu_text(logs).split(b"\r\n")[1:]))
    trials = read_trials(path)
    assert [trial.source.sheet for trial in trials] == ["1", "2"]
    for trial, log in zip(trials, logs, strict=True):
        assert_equal(trial, "shimadzu", log)


def test_specimens_side_by_side_in_a_workbook_are_trials_too(tmp_path: Path) -> None:
    logs = [log_of(count, name=f"a-{count}") for count in (25, 60, 12)]
    cells = [line.split(",") for line in shimadzu_text(logs).decode().replace('"', "").splitlines()]
    rows = [[float(c) if c and i > 2 else c for c in row] for i, row in enumerate(cells)]
    rows[40][5] = "damaged"
    first, damaged, last = read_each(put(tmp_path / "synthetic.xlsx", xlsx([("Data", rows)])))
    assert [first.source.sheet, last.source.sheet] == ["Data::synthetic a-25", "Data::synthetic a-12"]
    assert_equal(first, "shimadzu", logs[0])
    assert_equal(last, "shimadzu", logs[2])
    assert (damaged.code, damaged.line, damaged.column) == ("text_in_numbers", 41, 6)


def test_mach1_rows_may_end_in_a_tab_and_blocks_may_be_empty(tmp_path: Path) -> None:
    data = mach1_text([log_of(30, start_s=0.0)], divided=False).decode()
    head, rows = data.split("Fz, gf\r\n")
    rows = rows.replace("\r\n", "\t\r\n").replace("<END DATA>\t", "<END DATA>")
    empty = "<Wait>\r\n<DATA>\r\nTime, s\tPosition (z), mm\tFz, gf\r\n<END DATA>\r\n"
    trial = read(put(tmp_path / "synthetic.txt", head + "Fz, gf\r\n" + rows + empty))
    assert_equal(trial, "mach-1", log_of(30, start_s=0.0))


def test_a_folder_in_an_archive_says_the_kind_of_test(tmp_path: Path) -> None:
    parts = {"meat.is_trelax_RawData/Specimen_RawData_1.csv": EXPORTS["bare"].write(log_of(20))}
    trial = read(put(tmp_path / "synthetic.zip", zipped(parts)))
    assert (trial.protocol.kind, trial.protocol.speed_mm_s) == ("trelax", SPEED_MM_S)


def test_shimadzu_refusals_point_at_the_column_of_the_file(tmp_path: Path) -> None:
    logs = [log_of(25, name="a"), log_of(60, name="b")]
    lines = shimadzu_text(logs).decode().split("\r\n")
    cells = lines[20].split(",")
    cells[4] = '"1.2.3"'
    lines[20] = ",".join(cells)
    cells = lines[10].split(",")
    cells[:3] = ['""'] * 3
    lines[10] = ",".join(cells)
    gone, damaged = read_each(put(tmp_path / "synthetic.csv", "\r\n".join(lines).encode()))
    assert (gone.code, gone.line, gone.column, gone.sheet) == ("empty_cell", 11, 1, "synthetic a")
    assert (damaged.code, damaged.line, damaged.column) == ("damaged_number", 21, 5)


def test_a_zip_archive_of_several_exports_gives_their_trials_and_refusals(tmp_path: Path) -> None:
    log = log_of(40)
    names = ("semicolon", "mach-1", "shimadzu", "testxpert-workbook", "utf-16")
    bare = EXPORTS["bare"].write(log)
    parts = {f"folder/{name}{EXPORTS[name].suffix}": EXPORTS[name].write(log) for name in names}
    parts |= {"folder/readme.txt": b"no table", "folder/.hidden.csv": bare}
    parts["folder/damaged.csv"] = bare.replace(b"993.25000", b"99.325.000")
    path = put(tmp_path / "synthetic.zip", zipped(parts))
    items = list(read_each(path))
    sheets = [item.sheet if isinstance(item, InputError) else item.source.sheet for item in items]
    assert sheets == [
        "folder/semicolon.csv", "folder/mach-1.txt::2: Stress Relaxation",
        "folder/shimadzu.csv::synthetic hold-1", "folder/testxpert-workbook.xlsx::synthetic hold-1",
        "folder/utf-16.csv", "folder/damaged.csv",
    ]  # fmt: skip
    for item, name in zip(items, names, strict=False):
        assert_equal(item, name, log)
        assert item.source.recipe == READ_BY[name]
    assert isinstance(items[-1], InputError)
    assert (items[-1].code, items[-1].line, items[-1].path) == ("damaged_number", 20, str(path))


def test_archives_in_archives_and_empty_ones_are_refused(tmp_path: Path) -> None:
    inner = zipped({"a.csv": EXPORTS["bare"].write(log_of(10))})
    for name, code in (("nested.csv", "unreadable_archive"), ("photo.png", "no_recording")):
        assert refusal(put(tmp_path / "outer.zip", zipped({name: inner}))).code == code


def test_an_xls_workbook_reads_back_exactly(tmp_path: Path) -> None:
    xlwt = pytest.importorskip("xlwt")
    log = log_of(60)
    book = xlwt.Workbook()
    sheet = book.add_sheet("synthetic")
    names = ("Time", "Extension", "Load", "Cycle Count")
    head = (("Text Inputs : Specimen label", "22L.3"), (), names, ("(sec)", "(mm)", "(N)", ""))
    rows = zip(*expected("bare", log), strict=True)
    for i, row in enumerate([*head, *((*row, 0.5 * (k // 30)) for k, row in enumerate(rows))]):
        for j, cell in enumerate(row):
            sheet.write(i, j, cell)
    path = tmp_path / "synthetic.xls"
    book.save(str(path))
    trial = read(path)
    assert_equal(trial, "bare", log)
    assert trial.specimen == "22L.3"


def test_a_folder_takes_every_kind_of_export_once(tmp_path: Path) -> None:
    log = log_of(40)
    wanted = ["a.csv", "b.txt", "c.dat", "d.TRA", "e.xlsx", "f.zip"]
    for name, export in zip(
        wanted, ("bare", "mach-1", "mts-793", "testxpert-tra", "bluehill-workbook", "chiaro-zip"), strict=True
    ):
        (tmp_path / name).write_bytes(EXPORTS[export].write(log))
    (tmp_path / "notes.txt").write_text("prose")
    (tmp_path / "blob.dat").write_bytes(bytes(range(256)))
    put(tmp_path / "backup.zip", zipped({"a.csv": (tmp_path / "a.csv").read_bytes()}))
    assert [path.name for path in find_inputs([tmp_path])] == sorted(wanted)


STIFFNESS_N_PER_M, SENSITIVITY_M_PER_V = 0.05, 5e-8
VOLTS_PER_COUNT, HEIGHT_PER_COUNT, HEIGHT_FACTOR, HEIGHT_ZERO_M = 1e-7, 1e-12, 2.0, 1e-6
RATE_HZ = 250.0


def _properties(values: Mapping[str, object]) -> bytes:
    return ("#Tue\n" + "\n".join(f"{key}={value}" for key, value in values.items())).encode()


def _slot(head: str, slot: str, base: str, multiplier: float, offset: float = 0.0) -> dict[str, object]:
    conversion = f"{head}.conversion-set.conversion.{slot}"
    return {
        f"{head}.conversion-set.conversions.base": "volts",
        f"{conversion}.base-calibration-slot": base,
        f"{conversion}.scaling.multiplier": multiplier,
        f"{conversion}.scaling.offset": offset,
    }


def _encoder(head: str, kind: str, multiplier: float) -> dict[str, object]:
    scaling = f"{head}.encoder.scaling"
    return {f"{head}.encoder.type": kind, f"{scaling}.multiplier": multiplier, f"{scaling}.offset": 0.0}


SHARED: dict[str, object] = {
    **_encoder("lcd-info.0", "signedinteger", VOLTS_PER_COUNT),
    **_slot("lcd-info.0", "distance", "volts", SENSITIVITY_M_PER_V),
    **_slot("lcd-info.0", "force", "distance", STIFFNESS_N_PER_M),
    **_encoder("lcd-info.10", "signedlong-limited", HEIGHT_PER_COUNT),
    **_slot("lcd-info.10", "nominal", "volts", HEIGHT_FACTOR, HEIGHT_ZERO_M),
}


@dataclass(frozen=True)
class Curve:
    """An approach, a hold at constant height and a retract; channels to the last count [s, mm, N]."""

    shared: dict[str, object] = field(default_factory=lambda: dict(SHARED))

    def parts(self) -> list[tuple[FloatArray, FloatArray]]:
        """Height [m] and force [N] of each segment."""
        down, held = 20e-6 - 10e-6 * np.arange(500) / 500, np.full(2000, 10e-6)
        relaxing = 0.5 + 0.5 * np.exp(-np.arange(2000) / 500)
        pressed = 10e-9 * np.maximum(15e-6 - down, 0.0) / 1e-6
        return [(down, pressed), (held, 50e-9 * relaxing), (down[::-1], 0.5 * pressed[::-1])]

    def counts(self) -> list[tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """The stored integers."""
        per_count = STIFFNESS_N_PER_M * SENSITIVITY_M_PER_V * VOLTS_PER_COUNT
        return [
            (
                np.rint((height - HEIGHT_ZERO_M) / HEIGHT_FACTOR / HEIGHT_PER_COUNT).astype(np.int64),
                np.rint(force / per_count).astype(np.int64),
            )
            for height, force in self.parts()
        ]

    def expected(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Time, travel and force of the whole curve, by the arithmetic of the format."""
        height = np.concatenate([one for one, _ in self.counts()])
        force = np.concatenate([one for _, one in self.counts()])
        travel = HEIGHT_FACTOR * (HEIGHT_PER_COUNT * height) + HEIGHT_ZERO_M
        volts = VOLTS_PER_COUNT * force
        return (
            np.arange(height.size) / RATE_HZ,
            travel * 1e3,
            STIFFNESS_N_PER_M * (SENSITIVITY_M_PER_V * volts),
        )

    def files(self, folder: str = "") -> dict[str, bytes]:
        """Members of the archive."""
        found = {"shared-data/header.properties": _properties(self.shared), "header.properties": b"a=b\n"}
        for number, (height, force) in enumerate(self.counts()):
            segment = f"{folder}segments/{number}/"
            head = {
                "force-segment-header.duration": height.size / RATE_HZ,
                "channel.vDeflection.lcd-info.*": 0,
                "channel.measuredHeight.lcd-info.*": 10,
            }
            found[f"{segment}segment-header.properties"] = _properties(head)
            found[f"{segment}channels/measuredHeight.dat"] = height.astype(">i8").tobytes()
            found[f"{segment}channels/vDeflection.dat"] = force.astype(">i4").tobytes()
        return found


def assert_is(trial: Trial, curve: Curve) -> None:
    for channel, wanted in zip(
        (trial.time_s, trial.displacement_mm, trial.force_N), curve.expected(), strict=True
    ):
        np.testing.assert_allclose(channel, wanted, rtol=1e-12, atol=1e-18)


def test_a_force_curve_is_decoded_through_its_slots_and_segmented(tmp_path: Path) -> None:
    path = put(tmp_path / "cell.jpk-force", zipped(Curve().files()))
    assert find_inputs([tmp_path]) == [path]
    trial = read(path)
    assert_is(trial, Curve())
    assert (trial.source.recipe, trial.source.sheet) == ("jpk-force", None)
    assert trial.source.columns["displacement"] == "measuredHeight"
    (bending,) = (flag for flag in trial.flags if flag.code == "cantilever_bending")
    assert bending.values["stiffness_N_per_mm"] == pytest.approx(STIFFNESS_N_PER_M / 1000)
    assert bending.values["bending_mm"] == pytest.approx(1e3 * np.ptp(trial.force_N) / STIFFNESS_N_PER_M)
    found = segment(trial)
    assert found.compression_sign == -1
    (hold,) = found.of_kind("hold")
    assert (hold.start_s, hold.end_s) == (pytest.approx(2.0, abs=0.01), pytest.approx(10.0, abs=0.01))


def test_a_map_and_an_archive_of_curves_give_one_trial_a_curve(tmp_path: Path) -> None:
    files = {**Curve().files("index/0/"), **Curve().files("index/2/")}
    (tmp_path / "map.jpk-force-map").write_bytes(zipped(files))
    maps = read_trials(tmp_path / "map.jpk-force-map")
    assert [trial.source.sheet for trial in maps] == ["0", "2"]
    single = zipped(Curve().files())
    (tmp_path / "cells.zip").write_bytes(zipped({"day 1/a.jpk-force": single, "day 1/b.jpk-force": single}))
    packed = read_trials(tmp_path / "cells.zip")
    assert [trial.source.sheet for trial in packed] == ["day 1/a.jpk-force", "day 1/b.jpk-force"]
    for trial in (*maps, *packed):
        assert_is(trial, Curve())


@pytest.mark.parametrize(
    ("lacking", "word"),
    [
        ("lcd-info.0.conversion-set.conversion.force.scaling.multiplier", "vDeflection in force"),
        ("lcd-info.0.conversion-set.conversion.distance.scaling.multiplier", "distance.scaling.multiplier"),
        ("lcd-info.10.encoder.type", "measuredHeight in a known type"),
    ],
)
def test_a_curve_without_its_calibration_is_refused_by_what_it_lacks(tmp_path, lacking, word) -> None:
    shared = {key: value for key, value in SHARED.items() if key != lacking}
    error = refusal(put(tmp_path / "cell.jpk-force", zipped(Curve(shared).files())))
    assert error.code == "unreadable_archive"
    assert word in error.message


def test_segments_without_a_common_height_are_refusal(tmp_path: Path) -> None:
    files = Curve().files()
    del files["segments/1/channels/measuredHeight.dat"]
    path = put(tmp_path / "cell.jpk-force", zipped(files))
    assert refusal(path).code == "no_columns"


PIUMA = (
    "Date\t12/05/2025\tTime\t11:20:38\tStatus\tOK\nPDMS\nk (N/m)\t0{m}500\nTip radius (um)\t50{m}0\n"
    "Calibration factor\t2{m}8\n\nPiezo Indentation Sweep Settings\n"
    "D[Z1] (nm)\t10000{m}000\tt[1] (s)\t2{m}000\nD[Z2] (nm)\t10000{m}000\tt[2] (s)\t30{m}000\n"
    "D[Z3] (nm)\t0{m}000\tt[3] (s)\t2{m}000\nD[Z4] (nm)\tNaN\tt[4] (s)\tNaN\n\nE[eff] (Pa)\t1560{m}09\n\n"
    "Time (s)\tLoad (uN)\tIndentation (nm)\tCantilever (nm)\tPiezo (nm)\tAuxiliary\n"
)


@pytest.mark.parametrize("mark", [".", ","])
def test_a_piuma_header_gives_tip_speed_and_hold(tmp_path: Path, mark: str) -> None:
    rows = "".join(
        "\t".join(f"{value:.6f}" for value in (k / 100, k / 7, k * 10.5, k * 2.0, k * 12.5, 0.0)) + "\n"
        for k in range(40)
    )
    path = tmp_path / "sample Indentation_001.txt"
    path.write_text(PIUMA.replace("{m}", mark) + rows.replace(".", mark), encoding="cp1252")
    trial = read(path)
    assert trial.source.recipe == "chiaro"
    assert trial.protocol.tip_radius_mm == pytest.approx(0.05)
    assert trial.protocol.speed_mm_s == pytest.approx(0.005)
    assert trial.protocol.hold_s == pytest.approx(30.0)
    assert trial.source.metadata["k (N/m)"] == f"0{mark}500"
    assert trial.source.metadata["E[eff] (Pa)"] == f"1560{mark}09"
    assert trial.displacement_mm[-1] == pytest.approx(39 * 10.5e-6)
