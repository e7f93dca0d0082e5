"""Tables by spaces, clock times, coarse clocks, held readings, and a rate where no column is a time."""

import datetime as dt
from pathlib import Path

import numpy as np
import pytest
from ingest_files import codes, put, read, refusal, workbook, zipped

from tissueid.errors import InputError
from tissueid.ingest import ReadOptions, read_trials
from tissueid.ingest.text import by_spaces, with_seconds
from tissueid.segment import segment
from tissueid.signal_noise import between_ticks

TIME = np.arange(0.0, 4.0, 0.01)
DEPTH = np.clip(2.0 * (TIME - 0.5), -1.0, 4.0)
FORCE = 3.0 * np.maximum(DEPTH, 0.0)


def table(row, head: str = "") -> str:
    return head + "".join(row(*one) for one in zip(TIME, DEPTH, FORCE, strict=True))


def read_text(path: Path, text: str, **options):
    path.write_text(text, encoding="utf-8")
    (trial,) = read_trials(path, ReadOptions(**options))
    return trial


@pytest.mark.parametrize(
    "head",
    [
        "Time (s)  Displacement (mm)  Force (N)\n",
        "Time(s) Disp(mm) Force(N)\n",
        "Operator: A B\n\n  Time   Displacement   Force\n  (s)    (mm)    (N)\n",
        "Time (s) Displ. (mm) Force (N)\n",
        "# Time (s) Displacement (mm) Force (N)\n",
        "# time_s displacement_mm force_N\n",
        "#  Time_s  Travel_mm  Load_N\n",
        "% Time(s) Disp(mm) Force(N)\n",
        "Time(s) Disp(mm) Force(N) " + " ".join(f"channel{k}" for k in range(24)) + "\n",
    ],
)
def test_columns_by_spaces_are_columns_under_their_names(head: str, tmp_path: Path) -> None:
    # a minus need not be a hyphen
    more = " ".join(f"{k}.12345678" for k in range(24)) if "channel" in head else ""
    text = table(lambda t, x, f: f"  {t:8.3f}  {x:9.4f} {f:10.4f}  {more}\n".replace("-", "\u2212"), head)
    trial = read_text(tmp_path / "a.txt", text)
    assert trial.time_s == pytest.approx(TIME, abs=1e-9)
    assert trial.displacement_mm == pytest.approx(DEPTH, abs=1e-4)
    assert trial.force_N == pytest.approx(FORCE, abs=1e-4)


@pytest.mark.parametrize(
    "form", ["   {:.7e}   {:.7e}   {:.7e}\n", "{:.7f},\t{:.7f},\t{:.7f}\n", "{};\t{};\t{}\n"]
)
def test_a_matrix_saved_as_text_is_read_by_column_numbers(tmp_path: Path, form: str) -> None:
    text = table(form.format)
    named = {"time": "#1", "displacement": "#2", "force": "#3"}
    trial = read_text(tmp_path / "a.dat", text, columns=named)
    assert trial.force_N == pytest.approx(FORCE, abs=1e-6)
    counted = read_text(tmp_path / "b.dat", f"{len(FORCE)}\n{text}", columns=named)
    assert (counted.source.columns, counted.time_s.size) == (named, len(FORCE))
    with pytest.raises(InputError, match="name them by their numbers, as in --columns time=#1"):
        read_text(tmp_path / "a.dat", text)


def test_a_damaged_row_by_spaces_is_named_by_its_line(tmp_path: Path) -> None:
    lines = table(lambda t, x, f: f"{t:.3f} {x:.4f} {f:.4f}\n", "Time(s) Disp(mm) Force(N)\n").splitlines()
    for damaged in (350, 120):
        rows = [*lines[:damaged], "3.490 4.0000", *lines[damaged + 1 :]]
        with pytest.raises(InputError) as caught:
            read_text(tmp_path / "a.txt", "\n".join(rows) + "\n")
        assert caught.value.line == damaged + 1
    assert "cut_row" in codes(read_text(tmp_path / "a.txt", "\n".join([*lines, "4.000 4.0"])))


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"a b c\n1 2\n3 4 5\n", "ragged"),
        (b"t;x;f\n" + b"1;2;3\n" * 9, "semicolons"),
        (b"1, 2, 3\n" * 9, "commas"),
        (b"Test of 3 4 5\n" * 9, "words"),
    ],
)
def test_other_texts_stay_as_they_are(data: bytes, why: str) -> None:
    assert by_spaces(data) == data, why
    assert with_seconds(data) == data, why


@pytest.mark.parametrize(
    ("clock", "delimiter", "decimal"),
    [
        ("2026-03-04 {h:02d}:{m:02d}:{s:06.3f}", ",", "."),
        ("2026-03-04T{h:02d}:{m:02d}:{s:06.3f}Z", "\t", "."),
        ("04.03.2026 {h:02d}:{m:02d}:{s:06.3f}", ";", ","),
        ("04-Mar-2026 {h:02d}:{m:02d}:{s:06.3f}", ",", "."),
        ("{h:02d}:{m:02d}:{s:06.3f}", ",", "."),
    ],
)
def test_clock_times_are_seconds_even_past_midnight(clock, delimiter, decimal, tmp_path) -> None:
    def row(t: float, x: float, f: float) -> str:
        whole = (86398.0 + t) % 86400.0
        stamp = clock.format(h=int(whole // 3600), m=int(whole // 60 % 60), s=whole % 60)
        cells = [stamp, *(f"{one:.4f}".replace(".", decimal) for one in (x, f))]
        return delimiter.join(cells) + "\n"

    head = delimiter.join(["Timestamp", "Displacement (mm)", "Force (N)"]) + "\n"
    trial = read_text(tmp_path / "a.csv", table(row, head))

    # a stamp prints milliseconds
    assert trial.time_s - trial.time_s[0] == pytest.approx(TIME, abs=1.1e-3)
    assert trial.force_N == pytest.approx(FORCE, abs=1e-4)


def test_halves_of_a_day_are_told_apart(tmp_path: Path) -> None:
    def row(t: float, x: float, f: float) -> str:
        second = 58.0 + t
        hour, half = (11, "AM") if second < 60.0 else (12, "PM")
        return f'"{hour}:{59 if half == "AM" else 0:02d}:{second % 60.0:06.3f} {half}",{x:.4f},{f:.4f}\n'

    trial = read_text(tmp_path / "a.csv", table(row, "Time,Extension (mm),Load (N)\n"))
    assert trial.time_s[0] == pytest.approx(43198.0)
    assert np.ptp(trial.time_s) == pytest.approx(np.ptp(TIME), abs=2e-3)


def test_the_time_of_the_test_wins_over_a_stamp(tmp_path: Path) -> None:
    text = table(
        lambda t, x, f: f"10:00:{t:06.3f},{t:.2f},{x:.4f},{f:.4f}\n",
        "Timestamp,Time (s),Displacement (mm),Force (N)\n",
    )
    trial = read_text(tmp_path / "a.csv", text)
    assert trial.time_s[0] == 0.0
    assert "column_choice" in {flag.code for flag in trial.flags}


def test_a_labview_measurement_is_read_with_its_names(tmp_path: Path) -> None:
    head = (
        "LabVIEW Measurement\t\nSeparator\tTab\nDate\t2026/03/04\nTime\t10:00:00.123\n***End_of_Header***\t\n"
        "\t\n"
        "Channels\t2\t\nSamples\t400\t400\nTime\t10:00:00.1\t10:00:00.1\nX0\t0.0\t0.0\nDelta_X\t0.01\t0.01\n"
        "***End_of_Header***\t\nX_Value\tDisplacement (mm)\tForce (N)\tComment\n"
    )
    trial = read_text(tmp_path / "a.lvm", table(lambda t, x, f: f"{t:.6f}\t{x:.6f}\t{f:.6f}\n", head))
    assert trial.time_s == pytest.approx(TIME, abs=1e-9)
    assert trial.source.columns["force"] == "Force (N)"
    # an archive holds what a folder may hold
    packed = {"day one/a.lvm": (tmp_path / "a.lvm").read_bytes()}
    (packed,) = read_trials(put(tmp_path / "b.zip", zipped(packed)))
    np.testing.assert_array_equal(packed.force_N, trial.force_N)


def test_a_remark_amid_columns_by_spaces_is_left_out(tmp_path: Path) -> None:
    rows = table(lambda t, x, f: f"{t:.2f} {x:.4f} {f:.4f}\n", "").splitlines(keepends=True)
    rows.insert(200, '# segment: 1 of "two" 2\n')
    trial = read_text(tmp_path / "a.txt", "time_s z_mm force_N\n" + "".join(rows))
    assert trial.time_s == pytest.approx(TIME, abs=6e-3)
    assert "rows_skipped" in codes(trial)


def test_a_serial_monitor_stamps_every_line(tmp_path: Path) -> None:
    rows = table(lambda t, x, f: f"10:00:{t:06.3f} -> {1000 * t:.0f},{x:.4f},{f:.4f}\n", "")
    head = "09:59:59.100 -> scale ready\n09:59:59.200 -> time_ms,position_mm,force_N\n"
    trial = read_text(tmp_path / "a.txt", head + rows)
    assert trial.source.columns["time"] == "time_ms"
    assert trial.force_N == pytest.approx(FORCE, abs=1e-4)


@pytest.mark.parametrize("steps", [0, 3])
def test_a_table_of_volts_is_refused_as_one(tmp_path: Path, steps: int) -> None:
    program = "0.200000\tRamp\tForce Out\t100, 0.013\t\n" * steps
    head = f"Units\tmm\tmN\nScale (units/V)\t0.5\t0.3\n{program}\nTest Data in Volts:\n"
    head += "Time (s)\tAI0 (mm)\tForce (mN)\n"
    error = refusal(put(tmp_path / "a.ddf", table(lambda t, x, f: f"{t:.2f}\t{x:.4f}\t{f:.4f}\n", head)))
    assert (error.code, error.line) == ("wrong_unit", 4 + steps)
    assert "calibrated units" in error.message


@pytest.mark.parametrize("kind", ["date", "clock", "span"])
def test_dates_and_clocks_of_a_sheet_are_seconds(kind: str, tmp_path: Path) -> None:
    rows: list[list[object]] = [["Time", "Extension (mm)", "Load (N)"]]
    for t, x, f in zip(TIME.tolist(), DEPTH.tolist(), FORCE.tolist(), strict=True):
        span = dt.timedelta(seconds=t)
        at = dt.datetime(2026, 3, 4, 10) + span
        rows.append([{"date": at, "clock": at.time(), "span": span}[kind], x, f])
    (trial,) = read_trials(workbook(tmp_path / "a.xlsx", {"A": rows}))

    # a sheet keeps days as a number of fifteen digits
    assert trial.time_s - trial.time_s[0] == pytest.approx(TIME, abs=2e-3)


def test_a_number_that_a_spreadsheet_made_a_date_is_refused(tmp_path: Path) -> None:
    rows: list[list[object]] = [["Time (s)", "Extension (mm)", "Load (N)"]]
    rows += map(list, zip(TIME.tolist(), DEPTH.tolist(), FORCE.tolist(), strict=True))
    rows[151][0] = dt.datetime(2026, 5, 1)
    error = refusal(workbook(tmp_path / "a.xlsx", {"A": rows}))
    assert "stored as text or date" in error.message
    assert error.line == 152


def test_whole_numbers_whose_marks_are_printed_have_lost_none(tmp_path: Path) -> None:
    head = "Time (s),Position (um),Force (mN)\n"
    text = table(lambda t, x, f: f'{t:.2f},"{1e3 * x:,.2f}","{1e3 * f:,.1f}"\n', head)
    bare = table(lambda t, x, f: f"{t:.2f},{1e3 * x:.0f},{1e3 * f:.1f}\n", head)
    powers = table(lambda t, x, f: f"{t:.2f},{100 * round(10 * x):.2E},{1e3 * f:.1f}\n", head)
    assert not {"no_decimals"} & {
        *codes(read_text(tmp_path / "a.csv", text)),
        *codes(read_text(tmp_path / "c.csv", powers)),
    }
    assert "no_decimals" in codes(read_text(tmp_path / "b.csv", bare))


@pytest.mark.parametrize(
    "line",
    [
        b"1" * 60_000, b"1 " + b"1" * 60_000 + b" x", b"1 2" + b" " * 60_000 + b"x", b"a(" * 30_000,
        b" " * 60_000,
    ],
    ids=["digits", "more digits", "spaces", "brackets", "blank"],
)  # fmt: skip
def test_lines_of_one_kind_are_looked_at_once(line: bytes) -> None:
    # a pattern that tries every division of such a line would not come to an end
    rows = b"".join(b"%d.5 %d.25 3.5\n" % (k, k) for k in range(9))
    text = line + b"\n" + rows + line + b"\n" + rows
    assert by_spaces(text).count(b"\n") == text.count(b"\n")
    assert with_seconds(text) == text


@pytest.mark.parametrize(
    ("name", "form", "delimiter"),
    [
        ("Time", "{m:02d}:{s:02d}.{ms:03d}", ","),
        ("Time", "{m:d}:{s:02d}.{ms:03d}", "\t"),
        ("Time (mm:ss.0)", "{m:02d}:{s:02d},{ms:03d}", ";"),
        ("Time", "14:{m:02d}:{s:02d}:{ms:03d}", ","),
        ("Time (hh:mm:ss.fff)", "00:{m:02d}:{s:02d}.{ms:03d}", ","),
    ],
)
def test_clocks_without_hours_and_with_milliseconds_behind_a_colon(tmp_path, name, form, delimiter) -> None:
    mark = "," if delimiter == ";" else "."

    def row(t: float, x: float, f: float) -> str:
        ms = 58_000 + round(1e3 * t)
        stamp = form.format(m=ms // 60_000, s=ms // 1000 % 60, ms=ms % 1000)
        return delimiter.join([stamp, *(f"{one:.4f}".replace(".", mark) for one in (x, f))]) + "\n"

    text = table(row, delimiter.join([name, "Displacement (mm)", "Force (N)"]) + "\n")
    trial = read_text(tmp_path / "a.csv", text)
    assert trial.time_s - trial.time_s[0] == pytest.approx(TIME, abs=1e-9)
    assert trial.force_N == pytest.approx(FORCE, abs=1e-4)
    assert trial.flags == ()  # the unit of a clock is its own
    # but not of another column
    head, *rows = text.replace(name, f"t{delimiter}Uhr", 1).splitlines(keepends=True)
    counted = (f"{0.01 * k:.2f}{delimiter}".replace(".", mark) + row for k, row in enumerate(rows))
    other = read_text(tmp_path / "b.csv", head + "".join(counted))
    assert [flag.code for flag in other.flags][:1] == ["units_assumed"]
    # nor are its seconds the minutes of a name
    assert refusal(put(tmp_path / "c.csv", text.replace(name, "Time (min)", 1))).code == "unit_conflict"


def test_whole_numbers_behind_a_clock_among_commas_are_no_fraction_of_it(tmp_path: Path) -> None:
    text = table(lambda t, x, f: f"10:00:{t:06.3f},{100 * t:.0f},{x:.4f},{f:.4f}\n").replace(".000,", ",")
    trial = read_text(tmp_path / "a.csv", "Time,Count,Displacement (mm),Force (N)\n" + text)
    assert trial.time_s[-1] - trial.time_s[0] == pytest.approx(TIME[-1])
    seconds = "".join(
        f"10:{k // 60:02d}:{k % 60:02d},{k % 7},{k * 0.1:.2f},{k * 0.3:.2f}\n" for k in range(90)
    )
    whole = read_text(tmp_path / "b.csv", "Time,Count,Displacement (mm),Force (N)\n" + seconds)
    assert whole.time_s[89] - whole.time_s[0] == 89.0


@pytest.mark.parametrize(
    ("name", "per_s"), [("millis", 1e3), ("ms", 1e3), ("Micros", 1e6), ("seconds", 1.0), ("time_msec", 1e3)]
)
def test_a_time_named_by_its_unit_has_it(tmp_path: Path, name: str, per_s: float) -> None:
    text = table(lambda t, x, f: f"{per_s * t:.2f},{x:.4f},{f:.4f}\n", f"{name},position_mm,force_N\n")
    trial = read_text(tmp_path / "a.csv", text)
    assert trial.flags == ()
    assert trial.time_s == pytest.approx(TIME, abs=1e-9)


@pytest.mark.parametrize(("first", "mark"), [(5, "."), (5, ","), (0, "."), (0, ",")])
def test_numbers_that_a_sheet_stores_as_text_are_read_where_all_are(tmp_path, first, mark) -> None:
    """A spreadsheet that took some for numbers may have lost their marks."""
    rows: list[list[object]] = [["Time (s)", "Extension (mm)", "Load (N)"]]
    for k, one in enumerate(zip(TIME.tolist(), DEPTH.tolist(), FORCE.tolist(), strict=True)):
        as_text = k == first or first == 0
        rows.append([f"{v:.4f}".replace(".", mark) for v in one] if as_text else [*one])
    path = workbook(tmp_path / "a.xlsx", {"S": rows})
    if first == 0:
        assert read_trials(path)[0].force_N == pytest.approx(FORCE, abs=5.1e-5)  # of four decimals
        return
    with pytest.raises(InputError, match="stored as text") as caught:
        read_trials(path)
    assert (caught.value.code, caught.value.line) == ("text_in_numbers", first + 2)


def recording(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A ramp of 6 mm at 1 mm/s that meets the tissue after 1 mm, and its hold."""
    rng = np.random.default_rng(3)
    x = np.minimum(time_s, 6.0) + rng.normal(0.0, 3e-4, time_s.size)
    depth = np.maximum(np.minimum(time_s, 6.0) - 1.0, 0.0)
    force = (2 * depth + 0.3 * depth**3) * np.where(
        time_s > 6.0, 0.7 + 0.3 * np.exp(-(time_s - 6.0) / 5), 1.0
    )
    return x, force + rng.normal(0.0, 0.01, time_s.size)


@pytest.mark.parametrize(
    ("rate_hz", "tick_s"), [(50.0, 0.1), (20.0, 0.1), (30.0, 0.1), (10.0, 1.0), (7.0, 1.0)]
)
@pytest.mark.parametrize("rounds", [np.floor, np.round])
def test_rows_of_one_tick_are_spread_and_divided_as_if_the_clock_were_fine(tmp_path, rate_hz, tick_s, rounds):
    true = np.arange(0.0, 66.0, 1.0 / rate_hz)
    x, force = recording(true)
    shown = rounds(true / tick_s + 1e-9) * tick_s
    lines = (f"{t:.1f},{d:.5f},{f:.5f}\n" for t, d, f in zip(shown, x, force, strict=True))
    trial = read_text(tmp_path / "a.csv", "Time (s),Extension (mm),Load (N)\n" + "".join(lines))
    assert codes(trial) == ["zero_dt"]
    assert trial.flags[0].values["tick_s"] == pytest.approx(tick_s)
    assert np.abs(trial.time_s - true).max() <= tick_s + 1.0 / rate_hz
    assert np.ptp(np.diff(trial.time_s)) < 1e-9
    found = segment(trial)
    assert [phase.kind for phase in found.phases] == ["approach", "ramp", "hold"]
    assert found.phases[2].start_s == pytest.approx(6.0, abs=1.5 * tick_s)
    assert found.contact.displacement_mm == pytest.approx(1.0, abs=0.06)


#: A tool that starts and stops within 0.2 s, at 5 mm/s: times and places.
BRAKING = (
    np.arange(0.0, 12.0, 1e-3),
    np.cumsum(np.interp(np.arange(0.0, 12.0, 1e-3), [1.0, 1.2, 2.6, 2.8], [0.0, 5.0, 5.0, 0.0])) * 1e-3 - 3.0,
)


@pytest.mark.parametrize(
    ("held", "rate_hz", "reading_s"),
    [("force", 500, 0.1), ("force", 500, 0.0125), ("displacement", 1000, 0.05), ("displacement", 200, 0.04)],
)
def test_rows_that_repeat_a_reading_are_left_out(tmp_path: Path, held: str, rate_hz: int, reading_s: float):
    """A channel read more slowly than rows are written; truth: the recording itself, at 1 kHz and more."""
    time_s = np.arange(0.0, 12.0, 1.0 / rate_hz)
    was_read_s = np.floor(time_s / reading_s + 1e-6) * reading_s
    depth = np.interp(was_read_s if held == "displacement" else time_s, *BRAKING)
    force = 3.0 * np.maximum(np.interp(was_read_s if held == "force" else time_s, *BRAKING), 0.0)
    if held == "force":
        noise = np.random.default_rng(3).normal(0.0, 0.01, 2000)
        force = force + noise[np.rint(was_read_s / reading_s).astype(int)]
    rows = "".join(f"{t:.4f},{x:.4f},{f:.4f}\n" for t, x, f in zip(time_s, depth, force, strict=True))
    trial = read_text(tmp_path / "a.csv", "Time (s),Displacement (mm),Force (N)\n" + rows)
    (flag,) = [flag for flag in trial.flags if flag.code == "held_channel"]
    assert (flag.values["channel"], flag.values["left_out"]) == (held, time_s.size - trial.time_s.size)
    assert trial.time_s.size == pytest.approx(12.0 / reading_s, rel=0.02)
    # a reading is a row old at the most, at 5 mm/s and 3 N/mm; noise of 0.01 N
    assert np.abs(trial.force_N - 3.0 * np.maximum(trial.displacement_mm, 0.0)).max() < 0.04 + 15.0 / rate_hz
    contact = segment(trial).contact
    assert abs(contact.displacement_mm) < 5.0 / rate_hz + 3.0 * contact.sd_mm


def test_a_channel_of_coarse_steps_keeps_all_its_rows(tmp_path: Path) -> None:
    """Encoders of 0.02 and 0.05 mm at 1 mm/s change each 4th and 10th row, by whole steps."""
    time_s = np.arange(0.0, 12.0, 0.005)
    for step_mm in (0.02, 0.05):
        depth = np.rint(np.clip(time_s - 4.013, -3.0, 4.0) / step_mm) * step_mm
        force = 3.0 * np.maximum(depth, 0.0) + np.random.default_rng(4).normal(0.0, 0.01, time_s.size)
        rows = "".join(f"{t:.3f},{x:.2f},{f:.4f}\n" for t, x, f in zip(time_s, depth, force, strict=True))
        trial = read_text(tmp_path / "a.csv", "Time (s),Displacement (mm),Force (N)\n" + rows)
        assert trial.time_s.size == time_s.size
        assert "held_channel" not in codes(trial)


def test_a_tool_that_moves_in_steps_keeps_all_its_rows(tmp_path: Path) -> None:
    """Twenty growing steps, each 10 s, over between two samples: the force leaps with them and relaxes."""
    time_s = np.arange(0.0, 210.0, 0.5)
    step = (time_s // 10.0).astype(int)
    depth = 0.01 * step * (step + 3)
    force = 3.0 * depth + 0.03 * step * np.exp(-np.mod(time_s, 10.0) / 3.0)
    force += np.random.default_rng(5).normal(0.0, 0.002, time_s.size)
    rows = "".join(f"{t:.1f},{x:.4f},{f:.4f}\n" for t, x, f in zip(time_s, depth, force, strict=True))
    trial = read_text(tmp_path / "a.csv", "Time (s),Displacement (mm),Force (N)\n" + rows)
    assert trial.time_s.size == time_s.size
    assert "held_channel" not in codes(trial)


def test_a_sampling_that_changes_is_spread_tick_by_tick() -> None:
    true = np.concatenate([np.arange(0.0, 10.0, 0.02), np.arange(10.0, 100.0, 0.5)])
    shown = np.floor(true / 0.1 + 1e-9) * 0.1
    spread, tick = between_ticks(shown)
    assert tick == pytest.approx(0.1)
    np.testing.assert_allclose(spread, true, atol=0.1)
    assert np.all(np.diff(spread) > 0.0)


def test_a_row_that_repeats_a_stamp_before_two_steps_in_one_is_put_between() -> None:
    true = np.arange(0.0, 20.0, 0.1)
    shown = true.copy()
    shown[[50, 120]] = shown[[49, 119]]
    spread, tick = between_ticks(shown)
    assert tick == pytest.approx(0.2)
    np.testing.assert_allclose(spread, true, atol=1e-9)


def test_a_row_more_than_the_clock_has_stays_where_it_is() -> None:
    time_s = np.insert(np.arange(0.0, 20.0, 0.1), 50, 4.9)
    same, tick = between_ticks(time_s)
    assert same is time_s
    assert tick == 0.0


ROWS = "".join(f"{0.02 * row:.2f},{0.5 * row:.1f}\n" for row in range(40))
NAMES = "Displacement (mm),Force (N)\n"
#: LabVIEW's, whose X column is empty, or not there; each channel states the interval and the unit.
LABVIEW = (
    "LabVIEW Measurement\t\nMulti_Headings\t{multi}\nX_Columns\tNo\n***End_of_Header***\t\n\t\n"
    "Channels\t2\t\t\nSamples\t40\t40\t\nDate\t2021/03/04\t2021/03/04\t\nTime\t10:11:12.1\t10:11:12.1\t\n"
    "Y_Unit_Label\tum\tmN\t\nX_Dimension\tTime\tTime\t\nX0\t0.0E+0\t0.0E+0\t\n"
    "Delta_X\t0.010000\t0.010000\t\n***End_of_Header***\t\t\t\n"
)


#: Lines that state 100 Hz, with others that thin nothing, above a table by commas or by tabs.
RATES = (
    "Sampling rate: 100 Hz", "# Sample Rate (Hz): 100", "Sampling frequency,0.1,kHz",
    "Data Acquisition Rate,100 samples/s", "sample_rate,100", "Fs = 100", "dt,0.01",
    "Sampling interval,10 ms", "Abtastrate,100 Hz", "Abtastintervall,0.01 s",
    "Fréquence d'échantillonnage,100 Hz", "Frecuencia de muestreo (Hz),100",
    "Sampling rate,100 Hz\nSampling interval,0.01 s", "Sampling rate: 100 Hz\nDecimation: 1",
    "Sampling rate: 100 Hz\nAverage width: 12 mm", "Sampling rate: 100 Hz\nSkip: no",
    "Sampling rate: 100 Hz\nRecording rate: 100 Hz", "Sampling rate: 100 Hz\nFilter: 10 Hz",
)  # fmt: skip
ABOVE_TABS = ("Sample period (ms),10", "Scan Time = 0.01 sec", "DAQ rate: 100 pts/sec")


@pytest.mark.parametrize(
    ("line", "delimiter"), [*((line, ",") for line in RATES), *((line, "\t") for line in ABOVE_TABS)]
)
def test_the_rate_of_the_header_is_the_clock(tmp_path: Path, line: str, delimiter: str) -> None:
    table = f"{NAMES}{ROWS}".replace(",", delimiter)
    trial = read(put(tmp_path / "a.csv", f"{line}\n{table}"))
    assert trial.time_s == pytest.approx(0.01 * np.arange(40))
    assert trial.force_N[-1] == 19.5
    assert "time_counted" in codes(trial)


@pytest.mark.parametrize(
    "line",
    [
        "Sample height,10 mm", "Sample,100", "Samples,40", "Test rate,100 mm/min", "Sampling time,12 s",
        "Sampling rate,100 Hz\nSampling interval,0.02 s", "Sampling rate,0 Hz", "Sampling rate,fast",
        # 1000 Hz a sample and 50 samples a row: nobody but the user knows which is the rate of the rows
        *(
            f"Sampling rate: 1000 Hz\n{thinned}"
            for thinned in (
                "Decimation: 50", "Oversampling: 50", "Save every: 50 samples", "Export: every 50th point",
                "Data reduction factor: 50", "Logging ratio: 1:50", "Averaging: 50", "Mittelung: 50 Werte",
                "Decimated to: 20 Hz", "Output rate: 20 Hz", "Speicherrate: 20 Hz",
                "Recording interval: 50 ms",
            )
        ),
    ],
)  # fmt: skip
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
