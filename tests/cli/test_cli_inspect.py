"""A look at recordings, once and beside the machine: lines, tables, corrections and verdicts stay right."""

import csv
import io
import json
import os
import re
import shutil
import signal
import sys
import time
import tomllib
import urllib.request
from collections.abc import Callable, Iterable
from dataclasses import replace
from html import unescape
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import openpyxl
import pytest
from closed_forms import ramp_hold_state
from command_line import LOG, log_text, python, run, start, until, write_csv, write_log, write_study
from msgspec import structs

from tissueid.documents import plain
from tissueid.documents.inspect import Fit, Watch
from tissueid.ingest import find_inputs, read_each
from tissueid.inspection import describe_segmented
from tissueid.manifest import Calibration, Study
from tissueid.model.frame import linear_frame
from tissueid.segment import segment
from tissueid.store.schema import first_problem
from tissueid.trial import Source, Trial
from tissueid.watch import FolderWatch, WatchSession, judge, load_log, quick_fit


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


ONCE = ("--once", "--interval", "0.05")


def ramp_hold(name="a.csv", *, rate_Hz=100.0, tau_s=0.5, hold_s=10.0, gain=1.0, specimen="kidney", speed=2.0):
    """1 mm of air, 4 mm of ramp, a hold; force 10 x plus a branch of 20 N/mm that relaxes in tau."""
    time_s = np.arange(0.0, 5.0 / speed + hold_s, 1.0 / rate_Hz)
    x = np.minimum(speed * time_s, 5.0)
    in_contact = np.maximum(time_s - 1.0 / speed, 0.0)
    state = ramp_hold_state(in_contact, speed_mm_s=speed, depth_mm=4.0, tau_s=tau_s)
    noise = np.random.default_rng(17).normal(0.0, 0.05, time_s.size)
    force = gain * (10.0 * np.maximum(x - 1.0, 0.0) + 20.0 * state) + noise
    return Trial(specimen, time_s, x, force, source=Source(path=name))


# --- when a file is whole -------------------------------------------------------------------------


def looks(folder: Path) -> Callable[[], list[str] | None]:
    """Function that looks at a folder: the names that are ready; none where it is out of reach."""

    def find() -> list[Path]:
        if not folder.is_dir():
            raise OSError("gone")
        return sorted(folder.glob("*.csv"))

    watch = FolderWatch(find)

    def look() -> list[str] | None:
        found = watch.look()
        assert found.gone == ()
        return [path.name for path in found.ready] if found.reachable else None

    return look


def test_a_file_is_whole_when_it_can_be_opened_and_two_looks_find_it_the_same(tmp_path, monkeypatch):
    look, path = looks(tmp_path), tmp_path / "a.csv"
    assert look() == []
    path.touch()
    # empty as yet, however long
    assert [look() for _ in range(3)] == [[]] * 3
    path.write_text("half", encoding="ascii")
    assert look() == []
    path.write_text("half and more", encoding="ascii")
    assert look() == []
    with monkeypatch.context() as patch:
        patch.setattr(Path, "open", Mock(side_effect=PermissionError(13, "used by another process")))
        assert [look() for _ in range(3)] == [[]] * 3
    assert [look(), look()] == [["a.csv"], []]


def test_files_come_in_the_order_of_their_times_and_a_folder_out_of_reach_is_no_deletion(tmp_path):
    inside, away = tmp_path / "drive", tmp_path / "away"
    inside.mkdir()
    for age, name in ((10, "z.csv"), (30, "m.csv"), (20, "a.csv")):
        (inside / name).write_text(name, encoding="ascii")
        os.utime(inside / name, (1e9 - age, 1e9 - age))
    look = looks(inside)
    assert [look(), look()] == [[], ["m.csv", "a.csv", "z.csv"]]
    inside.rename(away)
    assert look() is None
    away.rename(inside)
    assert look() == []


# --- a session ------------------------------------------------------------------------------------


def valid(verdict: Watch) -> bool:
    return first_problem(plain(verdict), "watch") is None


class Bench:
    """A session on a folder, its judge counted."""

    def __init__(self, folder: Path, log: Path | None = None) -> None:
        self.folder, self.judged = folder, []
        earlier = [] if log is None else load_log(log)
        self.session = WatchSession(
            FolderWatch(lambda: find_inputs([folder])), read_each, self.judge, log, earlier
        )

    def judge(self, trial: Trial, earlier: Iterable[Watch]) -> Watch:
        earlier = list(earlier)
        self.judged.append((Path(trial.source.path).name, [Path(one.path).name for one in earlier]))
        return judge(trial, earlier)

    def happenings(self, looks: int = 2) -> list[str]:
        return [happening.kind for _ in range(looks) for happening in self.session.step()]


def test_a_session_judges_each_recording_once_and_compares_with_those_before(tmp_path):
    bench = Bench(tmp_path)
    write_log(tmp_path / "one.csv")
    assert bench.happenings() == ["verdict"]
    write_log(tmp_path / "two.csv", force_times=0.75)
    assert bench.happenings(4) == ["verdict"]
    assert bench.judged == [("one.csv", []), ("two.csv", ["one.csv"])]
    said = bench.session.verdicts[1].verdict
    assert said.level == "look"
    # every force is a quarter smaller
    assert said.reason.startswith("25 % softer than the last push")


def test_a_half_written_file_is_judged_again_when_it_is_whole(tmp_path):
    text = log_text()
    bench = Bench(tmp_path)
    path = tmp_path / "slow.csv"
    path.write_text(text[: len(text) // 3], encoding="ascii")
    assert bench.happenings() == ["verdict"]
    half = bench.session.verdicts[0]
    path.write_text(text, encoding="ascii")
    assert bench.happenings() == ["replaced"]
    assert len(bench.session.verdicts) == 1
    assert bench.session.verdicts[0].measured != half.measured


def test_a_renamed_file_keeps_its_verdict_and_a_copy_gets_none(tmp_path):
    bench = Bench(tmp_path)
    path = write_log(tmp_path / "one.csv")
    bench.happenings()
    path.rename(tmp_path / "kidney 1.csv")
    assert sorted(bench.happenings()) == ["gone", "renamed"]
    assert [Path(one.path).name for one in bench.session.verdicts] == ["kidney 1.csv"]
    # saved again without change
    os.utime(tmp_path / "kidney 1.csv", (2e9, 2e9))
    assert bench.happenings(3) == []
    (tmp_path / "copy.csv").write_bytes((tmp_path / "kidney 1.csv").read_bytes())
    assert bench.happenings() == ["copy"]
    assert len(bench.judged) == 1


def test_a_deleted_test_takes_no_part_in_comparisons(tmp_path):
    bench = Bench(tmp_path)
    for name, factor in (("one.csv", 1.0), ("two.csv", 1.1)):
        write_log(tmp_path / name, force_times=factor)
        bench.happenings()
    (tmp_path / "one.csv").unlink()
    assert bench.happenings() == ["gone"]
    write_log(tmp_path / "three.csv", force_times=1.2)
    bench.happenings()
    assert bench.judged[-1] == ("three.csv", ["two.csv"])


def test_a_session_goes_on_from_its_log(tmp_path):
    data, log = tmp_path / "data", tmp_path / "watch.jsonl"
    write_log(data / "one.csv")
    (data / "bad.csv").write_text("no table here\n", encoding="ascii")
    first = Bench(data, log)
    assert sorted(first.happenings()) == ["verdict", "verdict"]
    # a kill in the middle of a line, by whatever wrote it
    log.write_text(log.read_text(encoding="utf-8") + '{"path": "cut', encoding="utf-8")
    second = Bench(data, log)
    assert second.happenings() == []
    write_log(data / "two.csv", force_times=0.8)
    assert second.happenings() == ["verdict"]
    assert [(name, set(earlier)) for name, earlier in second.judged] == [("two.csv", {"one.csv", "bad.csv"})]
    assert second.session.verdicts[-1].verdict.reason.startswith("20 % softer than the last push")
    assert all(valid(one) for one in load_log(log))


def session_of(folder: Path, judge: Callable[..., Watch], **more: Any) -> WatchSession:
    """A session that has seen the only recording of its folder once."""
    write_log(folder / "one.csv")
    session = WatchSession(FolderWatch(lambda: find_inputs([folder])), read_each, judge, **more)
    assert list(session.step()) == []
    return session


def test_a_file_that_defeats_the_judge_does_not_end_the_session_and_an_interrupt_does(tmp_path):
    session = session_of(tmp_path, Mock(side_effect=ZeroDivisionError("for the test")))
    (verdict,) = [happening.verdict for happening in session.step()]
    assert verdict.verdict.level == "refused"
    assert "ZeroDivisionError" in verdict.verdict.reason
    assert valid(verdict)
    wrapped = SystemError("returned a result with an exception set")
    wrapped.__cause__ = KeyboardInterrupt()
    for error in (KeyboardInterrupt(), wrapped):
        session = session_of(tmp_path, Mock(side_effect=error))
        with pytest.raises(type(error)):
            list(session.step())


# --- the verdict ----------------------------------------------------------------------------------


def test_a_verdict_is_what_inspect_says():
    trial = ramp_hold()
    assert valid(judge(trial))
    found = plain(judge(trial))
    said = describe_segmented(trial, segment(trial))
    for name in ("measured", "verdict", "flags"):
        assert found[name] == said[name]
    assert found["verdict"] == {"level": "good", "reason": None}
    (hold,) = found["measured"]["holds"]
    assert hold["tau"]["single_s"] == pytest.approx(0.5, rel=0.02)


def test_a_fit_comes_after_the_line(tmp_path):
    fit = Mock(return_value=Fit(0.1, ()))
    session = session_of(tmp_path, judge, fit=fit)
    # one by one: the fit runs when the next is asked for
    happenings = session.step()
    assert (next(happenings).kind, fit.call_count) == ("verdict", 0)
    assert ([one.kind for one in happenings], fit.call_count) == (["fitted"], 1)
    assert plain(session.verdicts[0].fit) == {"nrmsd": 0.1, "parameters": []}


@pytest.mark.parametrize("frame_N_per_mm", [None, 100.0])
def test_a_quick_fit_finds_the_parameters_of_the_truth_behind_the_frame_that_the_study_knows(frame_N_per_mm):
    trial, study = ramp_hold(), None
    if frame_N_per_mm is not None:
        study = Study("study.toml", calibration=Calibration(frame=linear_frame(frame_N_per_mm)))
        trial = replace(trial, displacement_mm=trial.displacement_mm + trial.force_N / frame_N_per_mm)
    found = quick_fit(trial, None, study)
    viscosity = {one.name: one.value for one in found.parameters}["viscosity_N_s_per_mm"]
    # of a machine of which little was stated, whose filter may be anything
    assert viscosity == pytest.approx(20.0 * 0.5, rel=0.01)
    assert valid(structs.replace(judge(trial), fit=found))


def test_only_equal_tests_of_one_specimen_are_compared():
    first = judge(ramp_hold("a.csv"))
    softer = {"gain": 0.8}
    for other in (ramp_hold("b.csv", specimen="liver", **softer), ramp_hold("c.csv", speed=8.0, **softer)):
        assert judge(other, [first]).verdict.level == "good"
    slipped = structs.replace(first, excluded="slipped")
    assert judge(ramp_hold("d.csv", **softer), [slipped]).verdict.level == "good"
    assert "20 % softer" in judge(ramp_hold("e.csv", **softer), [first]).verdict.reason


# --- the command ----------------------------------------------------------------------------------


def verdicts(folder: Path, *args: Any, code: int | tuple[int, ...] = ()) -> list[Any]:
    """Lines that ``watch`` prints of what is in a folder."""
    ended = run("watch", folder, *ONCE, "--json", *args, code=code)
    return [json.loads(line) for line in ended.stdout.splitlines()]


def test_once_judges_what_is_there_and_ends(tmp_path):
    write_log(tmp_path / "data" / "one.csv")
    (tmp_path / "data" / "bad.csv").write_text("no table here\n", encoding="ascii")
    lines = verdicts(tmp_path / "data", "-o", tmp_path / "out", code=7)
    assert {Path(one["path"]).name: one["verdict"]["level"] for one in lines}["bad.csv"] == "refused"
    assert all(first_problem(one, "watch") is None for one in lines)
    assert [plain(one) for one in load_log(tmp_path / "out" / "watch.jsonl")] == lines
    assert verdicts(tmp_path / "data", "-o", tmp_path / "out") == []


def test_text_is_the_line_of_inspect_and_a_folder_of_refusals_alone_is_3(tmp_path):
    (tmp_path / "bad.csv").write_text("no table here\n", encoding="ascii")
    run("watch", tmp_path, *ONCE, code=3, shown="refused (")
    write_log(tmp_path / "one.csv")
    told = ("\a", "2 tests: ", "refused: ")
    run("watch", tmp_path, *ONCE, "--bell", said=told, shown=("one.csv  ", "keep", "refused ("))
    run("watch", write_log(tmp_path / "alone" / "log.csv").parent, *ONCE, said="1 test: ")
    # recordings of a session before may be passed over
    assert verdicts(tmp_path, "--new-only") == []


def test_one_specimen_for_the_folder_lets_unlabelled_files_be_compared(tmp_path):
    for name, factor in (("one.csv", 1.0), ("two.csv", 0.5)):
        path = write_log(tmp_path / name, label=None, force_times=factor)
        os.utime(path, (1e9 + factor, 1e9 + (name == "two.csv")))
    apart, together = (
        [one["verdict"]["reason"] for one in verdicts(tmp_path, *more)] for more in ((), ("--same-specimen",))
    )
    assert not any("softer" in reason for reason in (*apart, together[0]))
    assert "50 % softer" in together[1]


def test_the_study_of_the_folder_is_followed(tmp_path):
    for name in ("one.csv", "two.csv"):
        write_log(tmp_path / name, label=None, force_times=1.0 if name == "one.csv" else 1.1)
    write_study(
        tmp_path,
        '[[specimen]]\nname = "kidney"',
        '[[trial]]\nfile = "*.csv"\nspecimen = "kidney"',
        '[[override]]\nfile = "one.csv"\ncontact_mm = 0.25\nbecause = "seen by eye"',
        '[[exclude]]\nfile = "two.csv"\nbecause = "slipped"',
    )
    told = {Path(one["path"]).name: one for one in verdicts(tmp_path)}
    assert {one["specimen"] for one in told.values()} == {"kidney"}
    assert told["one.csv"]["contact"]["displacement_mm"] == 0.25
    assert "slipped" in told["two.csv"]["excluded"]


@pytest.mark.skipif(sys.platform == "win32", reason="a process can't be sent SIGINT here")
def test_a_running_watch_judges_what_arrives_and_ends_clean_at_ctrl_c(tmp_path):
    data, log = tmp_path / "data", tmp_path / "out" / "watch.jsonl"
    data.mkdir()
    arguments = ("watch", data, "-o", tmp_path / "out", "--interval", "0.1")
    with start(*arguments) as process:
        try:
            time.sleep(0.5)
            write_log(data / "one.csv")
            until(lambda: len(load_log(log)) == 1)
            write_log(data / "two.csv", force_times=1.1)
            until(lambda: len(load_log(log)) == 2)
            process.send_signal(signal.SIGINT)
            out, err = process.communicate(timeout=20)
        finally:
            if process.poll() is None:
                process.kill()
    assert process.returncode == 0, err
    assert "2 tests: " in err
    assert "Traceback" not in err
    # the log is written before the screen: the interrupt may come between the two
    assert out.count("F(1 s)") in (1, 2)
