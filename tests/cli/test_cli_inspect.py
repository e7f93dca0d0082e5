"""What a look at recordings says, with and without a study or a command: lines, tables, corrections."""

from __future__ import annotations

import csv
import io
import re
import shutil
import signal
import tomllib
import urllib.request
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pytest
from command_line import LOG, python, run, start, write_csv, write_log, write_study


def page_entries(page: Path) -> list[dict[str, Any]]:
    texts = re.findall(r"<textarea[^>]*>(.*?)</textarea>", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    return [table[0] for text in texts for table in tomllib.loads(unescape(text)).values()]


def test_text_gives_speeds_in_both_units_and_the_stop(tmp_path):
    text = run("inspect", write_log(tmp_path / "log.csv"), "-v").stdout
    (ramp,) = re.findall(r"ramp +\S+ to \S+ s, (\S+) mm/s \((\S+) mm/min\)", text)
    # the log's ramp goes 8 mm at 250 mm/min: 48 samples, its ends known to one
    assert float(ramp[1]) == pytest.approx(250.0, rel=0.03)
    assert float(ramp[0]) == pytest.approx(float(ramp[1]) / 60.0, rel=1e-3)
    (stop,) = re.findall(r"stop +at (\S+) s", text)
    assert float(stop) == pytest.approx(8.0 / (250.0 / 60.0), abs=0.05)
    assert "read as bluehill-csv" in text
    assert "because " in text


def test_times_of_an_epoch_are_printed_from_the_start_of_the_record(tmp_path):
    rows = [(0.1 * k, min(0.1 * k, 4.0)) for k in range(200)]
    text = "".join(f"{1724331633.5 + t:.2f},{x:.3f},{3 * x + 0.5 * x * x:.3f}\n" for t, x in rows)
    path = tmp_path / "a.csv"
    path.write_text("Timestamp (s),Position (mm),Force (N)\n" + text, encoding="utf-8")
    said = run("inspect", path, "-v").stdout
    assert "clock       times below are from 1724331633.5 s on" in said
    assert "  ramp        0 to 4 s" in said
    assert "times run from 1724331634 to 1724331653 s" in run("inspect", path, "--hold-to", "4").stdout


def test_page_and_json_of_one_run_agree(tmp_path):
    write_log(tmp_path / "data" / "one log.csv")
    page = tmp_path / "out.html"
    ended = run("inspect", tmp_path / "data", "--html", page, "--json", code=0, said="wrote ")
    (document,) = ended.json("inspect")
    html = page.read_text(encoding="utf-8")
    assert f"{document['n_samples']:,} samples" in html
    assert document["recipe_reason"] in unescape(html)


def test_entries_name_files_as_seen_from_the_folder_of_the_study(tmp_path):
    write_log(tmp_path / "data" / "pig 1" / "läuft [3].csv")
    page = tmp_path / "out.html"
    run("inspect", tmp_path / "data", "--html", page, "-q")
    assert {entry["file"] for entry in page_entries(page)} == {"pig 1/läuft [3].csv"}
    # a study above the folder is the one that is meant
    write_study(tmp_path)
    run("inspect", tmp_path / "data" / "pig 1", "--html", page, "-q")
    assert {entry["file"] for entry in page_entries(page)} == {"data/pig 1/läuft [3].csv"}


def inspected(*args: str | Path) -> dict[str, Any]:
    (document,) = run("inspect", *args, "--json", code=0).json()
    return dict(document)


def test_the_study_of_the_folder_is_followed_unless_it_is_left_aside(tmp_path):
    write_log(tmp_path / "läuft [3].csv")
    write_study(
        tmp_path,
        '[[override]]\nfile = "läuft [3].csv"\ncontact_mm = 0.5\nbecause = "seen by eye"',
        '[[exclude]]\nfile = "läuft [3].csv"\nbecause = "slipped"',
    )
    followed = inspected(tmp_path)
    assert followed["contact"]["displacement_mm"] == 0.5
    assert followed["excluded"] == "slipped"
    assert "decision_overridden" in [flag["code"] for flag in followed["flags"]]
    assert "excluded    because: slipped" in run("inspect", tmp_path, "-v").stdout
    aside = inspected(tmp_path, "--no-study")
    assert aside["contact"]["displacement_mm"] != 0.5
    assert aside["excluded"] is None
    for named in ((), ("--study", tmp_path / "study.toml")):
        assert inspected(tmp_path / "läuft [3].csv", *named)["contact"] == followed["contact"]


def test_refused_files_stand_on_the_page_and_decide_the_exit_code(tmp_path):
    write_log(tmp_path / "data" / "good.csv")
    (tmp_path / "data" / "bad.csv").write_text("no table here\n", encoding="ascii")
    page = tmp_path / "out.html"
    for path, code, said in (("data", 7, "bad.csv"), ("data/bad.csv", 3, "Nothing could be read")):
        run("inspect", tmp_path / path, "--html", page, "-q", code=code)
        assert said in page.read_text(encoding="utf-8")


def test_loops_are_measured(shared_data):
    text = run("inspect", shared_data / "instron-bluehill-cyclic-cc0", "-v").stdout
    assert len(re.findall(r"^  loop \d", text, flags=re.MULTILINE)) == 3


def test_no_command_is_inspect(tmp_path, monkeypatch):
    log = write_log(tmp_path / "one.csv")
    named, plain = run("inspect", log), run(log)
    assert (plain.code, plain.stdout) == (0, named.stdout)
    assert "F(1 s)" in plain.stdout
    assert "keep" in plain.stdout
    assert all(len(line) <= 100 for line in plain.stdout.splitlines()[1:])
    # options before the file, a folder, and a sheet's mark
    assert run("--json", log).json() == run("inspect", log, "--json").json()
    assert run(tmp_path).stdout == run("inspect", tmp_path).stdout
    monkeypatch.chdir(tmp_path)
    assert run("one.csv").code == 0
    # what is written as a file is one, also where it is missing
    assert "No such command" not in run("missing.csv", said="missing.csv").stderr


def test_a_command_goes_before_a_file_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_log(Path("doctor"))
    assert "F(1 s)" not in run("doctor").stdout
    assert "F(1 s)" in run("./doctor").stdout
    assert "No such command" in run("inspct").stderr


def test_a_look_at_a_file_loads_no_compiler(tmp_path):
    log = write_log(tmp_path / "one.csv")
    code = (
        "import sys; from tissueid.cli.main import main; "
        f"code = main([{str(log)!r}, '-q']); "
        "print(code, sorted({'numba', 'scipy.optimize', 'lmfit', 'emcee'} & set(sys.modules)))"
    )
    assert python("-c", code).stdout.strip() == "0 []"


def test_every_recording_has_a_line_and_all_a_summary(tmp_path):
    for name in ("a.csv", "b.csv"):
        write_log(tmp_path / name)
    (tmp_path / "bad.csv").write_text("no table here\n", encoding="ascii")
    ended = run(tmp_path)
    lines = ended.stdout.splitlines()
    assert ended.code == 7
    assert [line.split("  ")[0] for line in lines[:2]] == ["a.csv", "b.csv"]
    assert lines[2:] == ["2 read, 1 refused", "2 start in contact; -v lists flags"]
    assert all(len(line) <= 100 for line in lines)
    assert "read as bluehill-csv" in run(tmp_path, "-v").stdout


def test_tables_hold_what_the_json_says(tmp_path):
    log = write_log(tmp_path / "one.csv")
    table, book = tmp_path / "m.csv", tmp_path / "m.xlsx"
    (document,) = run(log, "--json", "--csv", table, "--xlsx", book).json("inspect")
    (hold,) = document["measured"]["holds"]
    (row,) = csv.DictReader(io.StringIO(table.read_text(encoding="utf-8")))
    at = {one["time_s"]: one for one in hold["forces"]}
    assert float(row["force_1s_N"]) == at[1.0]["after_stop_N"]
    assert float(row["peak_N"]) == hold["push"]["peak"]["force_N"]
    assert row["force_100s_N"] == ""
    assert row["verdict"] == document["verdict"]["level"]
    head, cells = openpyxl.load_workbook(book).active.iter_rows(values_only=True)
    assert dict(zip(head, cells, strict=True))["force_1s_N"] == pytest.approx(at[1.0]["after_stop_N"])


def test_a_softer_push_is_said(tmp_path):
    for number, times in enumerate((1.0, 1.01, 0.99, 0.8)):
        write_log(tmp_path / f"{number}.csv", label="liver", force_times=times)
    verdicts = [one["verdict"] for one in run(tmp_path, "--json").json()]
    assert [one["level"] for one in verdicts] == ["good", "good", "good", "look"]
    assert "19 % softer than the last push, spread 1 %" in verdicts[-1]["reason"]


def test_sheets_stand_below_their_file(shared_data):
    book = shared_data / "zwick-meat-gpl3" / "230403_C_Indentation_relaxation_500N_force.xlsx"
    lines = run(book).stdout.splitlines()
    assert lines[0] == book.name
    assert lines[1].startswith("  230403-FF1A  0.8575 N at 1.84 mm, 1.5 mm/s in 1.4 s; F(1 s) ")
    assert all(len(line) <= 100 for line in lines[1:])
    assert "start in contact" in lines[-2] + lines[-1]


def test_the_command_line_takes_them_and_says_so(tmp_path):
    time = np.arange(0.0, 14.0, 0.02)
    depth = np.minimum(time, 4.0)
    force = 2.0 * depth + 3.0 * np.where(time < 4.0, depth, 4.0 * np.exp(-(time - 4.0) / 2.0))
    for name in ("one.csv", "two.csv"):
        write_csv(tmp_path / name, time, depth, force)
    one, two = run("inspect", tmp_path, "--hold-from", "4.5", "--exclude", "two.csv", "--json").json()
    assert [phase["start_s"] for phase in one["phases"] if phase["kind"] == "hold"] == [pytest.approx(4.5)]
    assert one["excluded"] is None
    assert two["excluded"] == "--exclude two.csv"
    # by the name that a study gives, as a fit leaves it out
    write_study(tmp_path, '[[trial]]\nfile = "one.csv"\nspecimen = "knee"')
    one, two = run("inspect", tmp_path, "--exclude", "knee", "--json").json()
    assert (one["excluded"], two["excluded"]) == ("--exclude knee", None)
    run("inspect", tmp_path, "--hold-from", "5", "--hold-to", "4", code=2)


@pytest.mark.parametrize("other", [("--json",), ("--html", "x.html"), ("--no-study",)])
def test_a_served_page_takes_no_other_output(tmp_path, other):
    (tmp_path / "one.csv").write_text("x", encoding="ascii")
    run("inspect", str(tmp_path), "--serve", *other, code=2, said=other[0])


def test_the_served_page_is_told_and_ends_by_ctrl_c(tmp_path):
    shutil.copy(LOG, tmp_path / "one.csv")
    serving = start("inspect", tmp_path / "one.csv", "--serve", "--no-browser")
    try:
        assert serving.stderr is not None
        url = serving.stderr.readline().split()[-1]
        assert f"corrections go into {tmp_path / 'study.toml'}" in serving.stderr.readline()
        with urllib.request.urlopen(url, timeout=60) as answer:
            page = answer.read().decode("utf-8")
        assert url.startswith("http://127.0.0.1:")
        assert page.count('<form class="correct"') == 5
        serving.send_signal(signal.SIGINT)
        _, rest = serving.communicate(timeout=30)
    finally:
        serving.kill()
    assert serving.returncode == 0
    assert "Traceback" not in rest
    assert not (tmp_path / "study.toml").exists()
