"""Beside the machine: files come late, half written, renamed, replaced, deleted; the verdicts stay right."""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from closed_forms import ramp_hold_state
from command_line import log_text, run, start, until, write_log, write_study
from msgspec import structs

from tissueid.documents import plain
from tissueid.documents.inspect import Fit, Watch
from tissueid.ingest import find_inputs, read_each
from tissueid.inspection import describe_segmented
from tissueid.segment import segment
from tissueid.store.schema import first_problem
from tissueid.trial import Source, Trial
from tissueid.watch import FolderWatch, WatchSession, judge, load_log, quick_fit

ONCE = ("--once", "--interval", "0.05")


def ramp_hold(
    name: str = "a.csv", *, rate_Hz: float = 100.0, tau_s: float = 0.5, hold_s: float = 10.0,
    gain: float = 1.0, specimen: str = "kidney", speed: float = 2.0,
) -> Trial:  # fmt: skip
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


def test_a_quick_fit_finds_the_parameters_of_the_truth():
    found = quick_fit(ramp_hold(), None)
    assert found is not None
    viscosity = {one.name: one.value for one in found.parameters}["viscosity_N_s_per_mm"]
    # of a machine of which nothing was stated, whose filter and frame may be anything
    assert viscosity == pytest.approx(20.0 * 0.5, rel=0.01)
    assert valid(structs.replace(judge(ramp_hold()), fit=found))


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
