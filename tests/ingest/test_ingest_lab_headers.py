"""Clocks and units as laboratories write them: thinned rates, split seconds, counters, units of a header."""

from pathlib import Path

import numpy as np
import pytest
from ingest_files import codes, put, read, refusal

from tissueid.ingest import ReadOptions
from tissueid.segment import segment
from tissueid.signal_noise import bridged, dropouts
from tissueid.trial import Trial

NAMES = "Displacement (mm),Force (N)\n"
TIMED = "".join(f"{0.1 * row:.2f}\t{20.0 * row:.0f}\t{0.5 * row:.1f}\n" for row in range(40))


@pytest.mark.parametrize(
    ("names", "unit_s"),
    [
        ("sec,nanosec", 1e-9),
        ("header.stamp.secs,header.stamp.nsecs", 1e-9),
        ("Seconds,Milliseconds", 1e-3),
        ("Sekunden,Millisekunden", 1e-3),
        ("s,µs", 1e-6),
    ],
)
def test_a_part_of_a_second_in_a_column_of_its_own_is_added(tmp_path, names, unit_s) -> None:
    """Sampled at 100 Hz and then at 4 Hz, as a logger that adapts its rate."""
    time = 20.37 + np.concatenate([0.01 * np.arange(100), 1.0 + 0.25 * np.arange(100)])
    whole = np.floor(np.round(time, 9))
    parts = np.rint((time - whole) / unit_s)
    rows = zip(whole, parts, np.linspace(0.0, 2.0, 200), np.linspace(0.0, 5.0, 200), strict=True)
    lines = "".join(f"{a:.0f},{b:.0f},{x:.3f},{f:.3f}\n" for a, b, x, f in rows)
    trial = read(put(tmp_path / "a.csv", f"{names},Position (mm),Load (N)\n{lines}"))
    np.testing.assert_allclose(trial.time_s - trial.time_s[0], time - time[0], atol=1e-6)
    assert set(codes(trial)) <= {"column_choice", "units_assumed"}


@pytest.mark.parametrize(("begins_s", "leap"), [(36705.0, 0.0), (50.0, 40.0)])
def test_a_clock_in_one_number_is_taken_apart_at_its_minutes(tmp_path, begins_s, leap) -> None:
    time = begins_s + np.arange(0.0, 20.0, 0.02)
    glued = 1e4 * (time // 3600) + 100.0 * (time // 60 % 60) + time % 60
    depth = np.clip(time - begins_s, 0.0, 5.0)
    lines = "".join(f"{t:.3f},{x:.4f},{2.0 * x:.4f}\n" for t, x in zip(glued, depth, strict=True))
    trial = read(put(tmp_path / "a.csv", f"Time,Position (mm),Load (N)\n{lines}"))
    # just after midnight they could be seconds as well: what they leap by is told as a gap
    assert np.diff(trial.time_s).max() == pytest.approx(0.02 + leap, abs=1e-3)
    assert ("column_choice" in codes(trial)) == (leap == 0.0)


def test_milliseconds_since_the_start_are_no_part_of_the_seconds(tmp_path: Path) -> None:
    lines = "".join(f"{0.1 * k:.1f},{100 * k},{0.02 * k:.2f},{0.5 * k:.1f}\n" for k in range(40))
    trial = read(put(tmp_path / "a.csv", f"Seconds,Milliseconds,Position (mm),Load (N)\n{lines}"))
    np.testing.assert_allclose(trial.time_s, 0.1 * np.arange(40))


def test_a_counter_that_leaves_samples_out_is_the_clock(tmp_path: Path) -> None:
    number = np.concatenate([np.arange(30), np.arange(90, 120)])
    lines = "".join(f"{k},{0.02 * k:.2f},{0.5 * k:.1f}\n" for k in number)
    trial = read(put(tmp_path / "a.csv", f"Sampling rate: 20 Hz\nSample,{NAMES}{lines}"))
    np.testing.assert_allclose(trial.time_s, 0.05 * number)
    assert {"time_counted", "column_choice", "gap"} <= set(codes(trial))


@pytest.mark.parametrize("names", ["time_s\tdisp_mm\tforce_N", "X\tt_s\tx_mm\tF_N"])
def test_names_stand_behind_the_row_numbers_of_r(tmp_path: Path, names: str) -> None:
    lines = "".join(f"{k + 1}\t{0.1 * k:.1f}\t{0.02 * k:.2f}\t{0.5 * k:.1f}\n" for k in range(40))
    trial = read(put(tmp_path / "a.txt", f"{names}\n{lines}"))
    assert trial.flags == ()
    assert (trial.time_s[2], trial.displacement_mm[2], trial.force_N[2]) == pytest.approx((0.2, 0.04, 1.0))


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("No,Time (s),Depth (mm),Force (N),", "{0},{1},{2},{3},"),  # a mark at the end of each line
        ("Nr;Zeit [s];Weg [mm];Kraft [N];", "{0};{1};{2};{3};"),
        ("time_s,depth_mm,force_N", "{0},{1},{2},{3},"),  # behind the row numbers of R
        ("time_s;depth_mm;force_N;state", "{0};{1};{2};{3};run"),
        (",Time (s),Depth (mm),Force (N),Comment", "{0},{1},{2},{3},"),  # behind those of pandas
        ("No Time Depth Force\n- (s) (mm) (N)\n", "{0} {1} {2} {3}"),  # a blank line under the units
        ("#  Time_s  Depth_mm  Force_N", "{0}  {1}  {2}  {3}"),  # a # that is a name
        ('"No", "Time (s)", "Depth (mm)", "Force (N)"', '"{0}", "{1}", "{2}", "{3}"'),
        (' "No"; "Time (s)"; "Depth (mm)"; "Force (N)"; "Comment" ', ' "{0}"; "{1}"; "{2}" ; "{3}"; ""  '),
        ("Sample rate=10\nTime;Depth;Force\ns;mm;N\n", "{1};{2};{3}"),
        ("Idő;Extensie;Force Z", "{1};{2};{3}"),
        ("Run Time;Actuator Displacement;Actuator Force (N)", "{1};{2};{3}"),
    ],
)
def test_tables_that_say_the_same_are_read_alike(tmp_path: Path, head: str, row: str) -> None:
    cells = ((k + 1, f"{0.1 * k:.1f}", f"{0.02 * k:.2f}", f"{0.5 * k:.1f}") for k in range(40))
    trial = read(put(tmp_path / "a.txt", head + "\n" + "".join(row.format(*one) + "\n" for one in cells)))
    assert set(codes(trial)) <= {"units_assumed"}
    assert (trial.time_s[2], trial.displacement_mm[2], trial.force_N[2]) == pytest.approx((0.2, 0.04, 1.0))


def test_a_mark_of_remarks_names_no_column_that_does_not_count(tmp_path: Path) -> None:
    rows = "".join(f"{0.1 * k:.1f} {0.02 * k:.2f} {0.5 * k:.1f} {k}.5\n" for k in range(40))
    assert refusal(put(tmp_path / "a.txt", f"# time depth force\n{rows}")).code == "ragged_rows"


def test_a_unit_behind_a_stroke_tells_the_code_page(tmp_path: Path) -> None:
    lines = "".join(f"{20.0 * k:.1f}; {0.1 * k:.1f}; {0.5 * k:.1f}\n" for k in range(40))
    file = put(tmp_path / "a.csv", f"Displacement / µm; Time / s; Load / N\n{lines}", "cp1252")
    assert read(file).displacement_mm[2] == pytest.approx(0.04)


def test_a_name_that_matlab_numbers_is_another_column_of_that_name(tmp_path: Path) -> None:
    lines = "".join(f"{0.1 * k:.1f},{0.5 * k:.1f},{0.02 * k:.2f},{k}.5\n" for k in range(40))
    trial = read(put(tmp_path / "a.csv", f"Time_s_,Force_N_,Displacement_mm_,Force_N__1\n{lines}"))
    assert (trial.source.columns["force"], codes(trial)) == ("Force_N_", ["column_choice"])


def test_a_first_column_x_that_is_the_only_travel_is_no_row_number(tmp_path: Path) -> None:
    lines = "".join(f"{k + 1},{0.1 * k:.1f},{0.5 * k:.1f}\n" for k in range(40))
    assert read(put(tmp_path / "a.csv", f"X,t,F\n{lines}")).displacement_mm[2] == 3.0


@pytest.mark.parametrize(
    ("start", "clock"),
    [
        (55.0, lambda t: f"{t:.2f}" if t < 60 else f"{int(t // 60)}:{t % 60:05.2f}"),
        (
            3595.0,
            lambda t: (f"{t // 3600:.0f}:" if t >= 3600 else "") + f"{t % 3600 // 60:02.0f}:{t % 60:05.2f}",
        ),
        (0.0, lambda t: f"00:00:{int(t):02d}" + (f".{100 * t % 100:02.0f}" if t > 8 else "")),
    ],
)
def test_a_clock_that_changes_its_form_far_below_the_head_goes_on(tmp_path: Path, start, clock) -> None:
    """The form changes behind the 400th row; of the last, whole seconds are printed before."""
    time = start + np.concatenate([0.02 * np.arange(400), 8.5 + 0.25 * np.arange(40)])
    lines = "".join(f"{clock(t)},{0.02 * k:.2f},{0.5 * k:.1f}\n" for k, t in enumerate(np.round(time, 9)))
    trial = read(put(tmp_path / "a.csv", f"Time,{NAMES}{lines}"))
    np.testing.assert_allclose(trial.time_s[400:], time[400:], atol=0.0051)
    assert trial.time_s.size == 440
    seconds = "".join(f"{0.1 * k:.2f},{0.02 * k:.2f},{0.5 * k:.1f}\n" for k in range(400))
    noon = put(
        tmp_path / "b.csv", f"Time,{NAMES}{seconds}" + "".join(f"12:01:{k}.00,8,9\n" for k in range(10, 40))
    )
    assert refusal(noon).code == "text_in_numbers"


@pytest.mark.parametrize("delimiter", [",", "  "])
def test_exponents_of_fortran_are_read(tmp_path: Path, delimiter: str) -> None:
    rows = ([0.1 * k, 0.02 * k, -0.5 * k] for k in range(40))
    lines = "".join(delimiter.join(f"{v:.4E}" for v in row).replace("E", "D") + "\n" for row in rows)
    trial = read(put(tmp_path / "a.dat", delimiter.join(("time_s", "disp_mm", "force_N")) + f"\n{lines}"))
    assert (trial.displacement_mm[2], trial.force_N[2]) == pytest.approx((0.04, -1.0))


@pytest.mark.parametrize(("rows", "zeros"), [(40, 1), (40, 3000), (40, 200_000), (9000, 4096)])
def test_a_file_that_its_logger_had_filled_ahead_is_read_and_said(tmp_path, rows: int, zeros: int) -> None:
    lines = "".join(f"{0.1 * k:.1f},{0.02 * k:.2f},{0.5 * k:.1f}\n" for k in range(rows))
    trial = read(put(tmp_path / "a.csv", f"Time (s),{NAMES}{lines}".encode() + bytes(zeros)))
    assert (trial.time_s.size, codes(trial)) == (rows, ["cut_row"])


@pytest.mark.parametrize(
    "head",
    [
        "Units: s, um, gf",
        "Units,s,um,gf",
        "Einheiten: s; um; gf",
        "Display units: um, gf, s",
        "Unit system: own (um, gf, s)",
        "Displacement unit: um\nForce unit: gf",
        "force_unit: gf\ndisplacement_unit=um",
        "Unit of force = gf\nUnit of length = um",
        "Units (force): gf\nUnits (displacement): um",
        "Krafteinheit: gf\nWegeinheit: um",
        "Force in gf\nDisplacement in um",
        '# {"force_unit": "gf", "displacement_unit": "um"}',
    ],
)
def test_units_of_the_header_are_those_of_columns_that_state_none(tmp_path: Path, head: str) -> None:
    trial = read(put(tmp_path / "a.txt", f"{head}\nTime\tDisp\tForce\n{TIMED}"))
    assert trial.displacement_mm[1] == pytest.approx(0.02)
    assert trial.force_N[1] == pytest.approx(0.5 * 9.80665e-3)


@pytest.mark.parametrize(
    ("head", "behind"),
    [
        ("Time,s,Disp,um,Force,gf", ""),
        ("Time, s, Disp, um, Force, gf", ""),
        ("Time,s,Disp,um,Force,gf", ","),
        ("Sample 12, liver\ns,um,gf", ""),
    ],
)
def test_units_between_names_or_alone_under_a_title_are_taken(tmp_path: Path, head: str, behind: str) -> None:
    rows = TIMED.replace("\t", f"{behind},").replace("\n", f"{behind}\n")
    trial = read(put(tmp_path / "a.csv", f"{head}\n{rows}"))
    assert trial.displacement_mm[1] == pytest.approx(0.02)
    assert trial.force_N[1] == pytest.approx(0.5 * 9.80665e-3)
    assert "units_assumed" not in codes(trial)


def test_a_lone_unit_of_a_header_is_that_of_the_force_but_no_length(tmp_path: Path) -> None:
    """A length may be that of the specimen."""
    table = f"Time\tTravel\tLoad\n{TIMED}"
    gauge = read(put(tmp_path / "a.txt", f"Units: gF\nReadings: All\nTravel Unit: um\n{table}"))
    assert (gauge.displacement_mm[1], gauge.force_N[1]) == pytest.approx((0.02, 0.5 * 9.80665e-3))
    assert codes(gauge).count("units_assumed") == 1
    ruler = read(put(tmp_path / "a.txt", f"Units: in\n{table}"))
    assert (ruler.displacement_mm[1], codes(ruler).count("units_assumed")) == (20.0, 3)


def test_units_that_stand_in_the_rows_of_a_gauge_without_names_are_taken(tmp_path: Path) -> None:
    lines = "".join(f"{0.5 * k:+07.3f},gf,{20.5 * k:+09.1f},um\n" for k in range(40))
    columns = {"time": "50Hz", "displacement": "#3", "force": "#1"}
    trial = read(put(tmp_path / "a.csv", lines), ReadOptions(columns=columns))
    assert (trial.displacement_mm[2], trial.force_N[2]) == pytest.approx((0.041, 9.80665e-3))
    assert codes(trial) == ["time_counted"]


@pytest.mark.parametrize(
    "line", ["Counts per Unit Force:,1000000", "# counts/N: 1000000", "Bits per newton = 64"]
)
def test_counts_of_a_sensor_are_no_newtons(tmp_path: Path, line: str) -> None:
    """The header says their unit as well, which is that of the force they are divided into."""
    head = f"Force Units:,N\n{line}\nTime (s),Position (mm),Fz\n"
    rows = [f"{0.1 * k:.1f},{0.02 * k:.2f},{{}}\n" for k in range(40)]
    counted = put(tmp_path / "a.csv", head + "".join(row.format(-5000 * k) for k, row in enumerate(rows)))
    assert (refusal(counted).code, refusal(counted).line) == ("wrong_unit", 2)
    assert read(counted, ReadOptions(units={"force": "uN"})).force_N[2] == pytest.approx(-0.01)
    divided = put(tmp_path / "b.csv", head + "".join(row.format(0.5 * k) for k, row in enumerate(rows)))
    assert read(divided).force_N[2] == 1.0


@pytest.mark.parametrize("sign", ['"', "''", "″"])
def test_signs_of_the_inch_are_its_unit(tmp_path: Path, sign: str) -> None:
    rows = "".join(f"{0.1 * row:.2f}\t{0.02 * row:.2f}\t{0.5 * row:.1f}\n" for row in range(40))
    trial = read(put(tmp_path / "a.txt", f"Time (s)\tPosition [{sign}]\tLoad (N)\n{rows}"))
    assert trial.displacement_mm[1] == pytest.approx(0.02 * 25.4)


@pytest.mark.parametrize(
    ("head", "code", "said"),
    [
        ("Force unit: gf\nTime (s)\tDisp (um)\tForce (N)", "unit_conflict", "--units force=gf"),
        *((f"Time (s)\tPosition (mm)\tLoad ({sign})", "unknown_unit", "--units") for sign in "#?"),
    ],
)
def test_a_unit_that_contradicts_the_header_or_is_a_mere_sign_is_refused(tmp_path, head, code, said) -> None:
    error = refusal(put(tmp_path / "a.txt", f"{head}\n{TIMED}"))
    assert error.code == code
    assert said in error.message


def lossy(lost: slice, level_N: float = 0.0) -> Trial:
    """A second of air, a ramp of four seconds to 10 N and a hold that relaxes, with samples of no signal."""
    time = np.arange(1200) / 100.0
    depth = np.clip(time - 1.0, 0.0, 4.0)
    force = 2.0 * depth + 2.0 * np.where(time < 5.0, depth / 4.0, np.exp(-np.maximum(time - 5.0, 0.0)))
    force += 0.005 * np.random.default_rng(5).standard_normal(time.size)
    force[lost] = level_N
    return Trial("loin", time, depth, force)


@pytest.mark.parametrize("lost", [slice(150, 153), slice(300, 301), slice(450, 470), slice(700, 706)])
def test_a_signal_that_is_lost_for_a_moment_is_no_rupture(lost: slice) -> None:
    trial, whole = lossy(lost), lossy(slice(0, 0))
    found = dropouts(trial.force_N, trial.displacement_mm, noise=0.005)
    assert np.flatnonzero(found).tolist() == list(range(lost.start, lost.stop))
    np.testing.assert_allclose(bridged(trial.force_N, found), whole.force_N, atol=0.05)
    divided, sound = segment(trial), segment(whole)
    assert divided.events == sound.events
    assert [(one.kind, one.start, one.stop) for one in divided.phases] == [
        (one.kind, one.start, one.stop) for one in sound.phases
    ]


def test_a_force_that_goes_with_the_tool_is_not_lost() -> None:
    """A tool that lifts off for three samples and comes back, and a break that stays."""
    trial = lossy(slice(700, 703))
    away = trial.displacement_mm.copy()
    away[700:703] = 0.0
    assert not dropouts(trial.force_N, away, noise=0.005).any()
    broken = trial.force_N.copy()
    broken[700:] *= 0.3
    assert not dropouts(broken, trial.displacement_mm, noise=0.005).any()
