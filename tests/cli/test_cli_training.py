"""``tissueid training``: a table of attempts, their learning, and the logs that hold none."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from command_line import run

from tissueid.haptics.ring import RECORD
from tissueid.haptics.states import State
from tissueid.rendering.options import RenderOptions
from tissueid.rendering.participation import CONSENT_TRAINING, Participation, with_consent
from tissueid.rendering.plan import plan_session
from tissueid.rendering.recorder import Recorder
from tissueid.rendering.scene import load_scene
from tissueid.rendering.summary import SessionSummary
from tissueid.store.schema import first_problem
from tissueid.store.session_log import read_session_log

#: The shipped plan: 10 mm below the middle of the workspace.
ENTRY_M = np.array([0.0, 0.0, 0.12])


def session(
    path: Path,
    *,
    error_mm: float,
    seconds: float,
    pseudonym: str = "P7",
    deep_mm: float = 21.0,
    last_day: str | None = None,
) -> Path:
    """A log of a tip that comes down beside the axis."""
    options = RenderOptions(
        device="sim",
        seconds=1.0,
        scene=load_scene("hip-resurfacing"),
        pseudonym=pseudonym,
        ethics="EK 12/2026",
    )
    plan = plan_session(options)
    head = with_consent(plan.head, how="asked")
    head["participation"]["delete_after"] = last_day
    count = int(1000 * seconds)
    records = np.zeros(count, RECORD)
    records["tick"] = np.arange(count)
    records["time_s"], records["dt_s"] = 1e-3 * np.arange(count), 1e-3
    records["state"] = State.ENGAGED
    height = np.linspace(50.0, -deep_mm, count)
    records["position_m"] = ENTRY_M + 1e-3 * np.column_stack([np.full(count, error_mm), 0.0 * height, height])
    summary = SessionSummary(0.001)
    summary.add(records, 0)
    recorder = Recorder(path, head)
    recorder.append(records)
    recorder.finish(summary.as_json(scheduling="virtual time", virtual_time=True))
    return path


def test_attempts_are_measured_and_learning_is_found(tmp_path: Path) -> None:
    for number in range(1, 6):
        session(tmp_path / f"{number}.h5", error_mm=4.0 / number, seconds=3.0)
    ended = run("training", tmp_path, "--json")
    assert ended.code == 0, ended.stderr
    document = ended.json()
    assert first_problem(document, "training") is None
    errors = [row["end_error_mm"] for row in document["attempts"]]
    # all began in the same second: then by the name of the file
    assert errors == pytest.approx([4.0 / number for number in range(1, 6)], abs=1e-6)
    assert {row["pseudonym"] for row in document["attempts"]} == {"P7"}
    assert all(row["complete"] for row in document["attempts"])
    (curve,) = [one for one in document["learning"] if one["measure"] == "end_error_mm"]
    assert curve["exponent"] == pytest.approx(-1.0, abs=1e-6)
    shown = run("training", tmp_path)
    assert "P7" in shown.stdout
    assert "attempt^-1.00" in shown.stdout


def test_a_log_without_an_attempt_does_not_stop_the_others(tmp_path: Path) -> None:
    good = session(tmp_path / "good.h5", error_mm=1.0, seconds=2.0)
    short = session(tmp_path / "short.h5", error_mm=1.0, seconds=2.0, deep_mm=-45.0)
    torn = tmp_path / "torn.h5"
    torn.write_bytes(good.read_bytes()[:2000])
    ended = run("training", good, short, torn, "--json")
    assert ended.code == 7
    document = json.loads(ended.stdout)
    assert [Path(row["file"]).name for row in document["attempts"]] == ["good.h5"]
    assert {Path(one["file"]).name for one in document["refused"]} == {"short.h5", "torn.h5"}
    assert "never came" in ended.stderr


def test_a_session_of_tissue_is_named_as_such(tmp_path: Path) -> None:
    log = tmp_path / "meat.h5"
    run("render", "--preset", "meat", "--device", "sim", "--script", "indent 1 mm at 72 mm/min", "--virtual",
        "--log", log)  # fmt: skip
    ended = run("training", log)
    assert ended.code == 7
    assert "not guided" in ended.stderr


def test_a_folder_without_logs_and_a_name_are_refused(tmp_path: Path) -> None:
    assert run("training", tmp_path).code == 2
    ended = run("render", "--scene", "hip-resurfacing", "--device", "sim", "--pseudonym", "Anna Smith")
    assert ended.code == 2
    assert "could be a name" in ended.stderr


def test_the_page_shows_attempts_ways_and_learning(tmp_path: Path) -> None:
    for number in range(1, 5):
        session(tmp_path / f"{number}.h5", error_mm=4.0 / number, seconds=2.0)
    page = tmp_path / "P7.html"
    assert run("training", tmp_path, "--html", page, "-q").code == 0
    text = page.read_text(encoding="utf-8")
    figures = json.loads(text.split('id="figures">')[1].split("</script>")[0])
    ways, error = figures[:2]
    assert [trace["name"] for trace in ways["traces"]] == [f"attempt {number}" for number in range(1, 5)]
    # the tip came down beside the axis, each time nearer
    assert [max(trace["y"]) for trace in ways["traces"]] == pytest.approx([4.0, 2.0, 4 / 3, 1.0], abs=1e-3)
    assert error["traces"][0]["y"] == pytest.approx([4.0, 2.0, 4 / 3, 1.0], abs=1e-6)
    # a power of -1 through them
    assert error["traces"][1]["y"][-1] == pytest.approx(1.0, abs=1e-6)
    assert "EK 12/2026" in text


def test_a_person_s_logs_are_deleted_and_nobody_else_s(tmp_path: Path) -> None:
    mine = session(tmp_path / "mine.h5", error_mm=1.0, seconds=1.0)
    key = tmp_path / "mine.key.json"
    key.write_text("{}")
    other = session(tmp_path / "other.h5", error_mm=1.0, seconds=1.0, pseudonym="P8")
    foreign = tmp_path / "torn.h5"
    foreign.write_bytes(b"no log")
    assert run("training", "delete", tmp_path, "--pseudonym", "p7").code == 2, "nobody was asked"
    assert run("training", "delete", tmp_path, "--pseudonym", "p7", "--dry-run").code == 7
    assert mine.exists()
    ended = run("training", "delete", tmp_path, "--pseudonym", "p7", "--yes", "--json")
    assert ended.code == 7, "a log that can't be read is said"
    assert ended.json() == {"found": [str(mine)], "deleted": [str(mine)]}
    assert sorted(path.name for path in tmp_path.iterdir()) == [other.name, foreign.name]


def test_deleting_nobody_s_logs_is_no_success(tmp_path: Path) -> None:
    log = session(tmp_path / "a.h5", error_mm=1.0, seconds=1.0)
    ended = run("training", "delete", tmp_path, "--pseudonym", "P71", "--yes")
    assert ended.code == 2
    assert "P71" in ended.stderr
    assert "spelt" in ended.stderr
    assert log.exists()
    # but where a log can't be read it may be theirs: that is what is said
    log.write_bytes(b"no log")
    assert run("training", "delete", tmp_path, "--pseudonym", "P71", "--yes").code == 7


def test_what_has_expired_is_deleted_and_the_rest_is_kept(tmp_path: Path) -> None:
    today = datetime.now(UTC).date()
    session(tmp_path / "old.h5", error_mm=1.0, seconds=1.0, last_day="2001-01-01")
    last = session(tmp_path / "last.h5", error_mm=1.0, seconds=1.0, last_day=today.isoformat())
    never = session(tmp_path / "never.h5", error_mm=1.0, seconds=1.0)
    ended = run("training", "delete", tmp_path, "--expired", "--yes")
    assert ended.code == 0
    assert "deleted 1 of 1" in ended.stderr
    assert sorted(tmp_path.iterdir()) == sorted([last, never])


def test_deleting_needs_to_know_what(tmp_path: Path) -> None:
    log = session(tmp_path / "a.h5", error_mm=1.0, seconds=1.0)
    assert run("training", "delete", log, "--yes").code == 2
    assert run("training", "delete", log, "--yes", "--expired", "--pseudonym", "P7").code == 2
    assert log.exists()


PERSON = ("render", "--scene", "hip-resurfacing", "--device", "sim", "--seconds", "0.2", "--pseudonym", "P9",
          "--ethics", "EK 7/2026", "--keep-days", "30")  # fmt: skip


def test_a_person_who_could_not_be_asked_is_not_recorded(tmp_path: Path) -> None:
    log = tmp_path / "P9.h5"
    refused = run(*PERSON, "--log", log)
    assert refused.code == 2
    assert "consent" in refused.stderr
    assert not log.exists()


@pytest.mark.slow
def test_a_person_is_recorded_with_consent_vote_and_last_day(tmp_path: Path) -> None:
    log = tmp_path / "P9.h5"
    ended = run(*PERSON, "--log", log, "--yes")
    assert ended.code == 0, ended.stderr
    assert CONSENT_TRAINING.splitlines()[0] in ended.stderr
    there = read_session_log(log).head["participation"]
    expected = Participation(keep_days=30).as_json()["delete_after"]
    assert there == {"consent": "given before", "ethics": "EK 7/2026", "delete_after": expected}


@pytest.mark.parametrize(
    "given",
    [
        ("--ethics", "EK 7/2026"),
        ("--keep-days", "30"),
        ("--pseudonym", "P9", "--ethics", "asked my uncle, he said that this is fine with him"),
        ("--pseudonym", "P9", "--keep-days", "0"),
    ],
)
def test_what_is_said_of_nobody_or_is_no_number_is_refused(given: tuple[str, ...]) -> None:
    assert (
        run("render", "--scene", "hip-resurfacing", "--device", "sim", "--seconds", "0.1", *given).code == 2
    )
