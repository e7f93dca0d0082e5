"""``tissueid training``: a table of attempts, their learning, and the logs that hold none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import run

from tissueid.haptics.ring import RECORD
from tissueid.haptics.states import State
from tissueid.rendering.options import RenderOptions
from tissueid.rendering.plan import plan_session
from tissueid.rendering.recorder import Recorder, SessionSummary
from tissueid.rendering.scene import load_scene

#: The shipped plan: 10 mm below the middle of the workspace.
ENTRY_M = np.array([0.0, 0.0, 0.12])


def session(path: Path, *, error_mm: float, seconds: float, deep_mm: float = 21.0) -> Path:
    """A log of a tip that comes down beside the axis."""
    scene = load_scene("hip-resurfacing")
    head = plan_session(RenderOptions(device="sim", seconds=1.0, scene=scene, pseudonym="P7")).head
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


def test_attempts_are_measured_and_learning_is_found(tmp_path):
    for number in range(1, 6):
        session(tmp_path / f"{number}.h5", error_mm=4.0 / number, seconds=3.0)
    document = run("training", tmp_path, "--json", code=0).json("training")
    errors = [row["end_error_mm"] for row in document["attempts"]]
    # all began in the same second: then by the name of the file
    assert errors == pytest.approx([4.0 / number for number in range(1, 6)], abs=1e-6)
    assert {row["pseudonym"] for row in document["attempts"]} == {"P7"}
    assert all(row["complete"] for row in document["attempts"])
    (curve,) = [one for one in document["learning"] if one["measure"] == "end_error_mm"]
    assert curve["exponent"] == pytest.approx(-1.0, abs=1e-6)
    run("training", tmp_path, shown=("P7", "attempt^-1.00"))


def test_a_log_without_an_attempt_does_not_stop_the_others(tmp_path):
    good = session(tmp_path / "good.h5", error_mm=1.0, seconds=2.0)
    short = session(tmp_path / "short.h5", error_mm=1.0, seconds=2.0, deep_mm=-45.0)
    torn = tmp_path / "torn.h5"
    torn.write_bytes(good.read_bytes()[:2000])
    ended = run("training", good, short, torn, "--json", code=7, said="never came")
    document = ended.json()
    assert [Path(row["file"]).name for row in document["attempts"]] == ["good.h5"]
    assert {Path(one["file"]).name for one in document["refused"]} == {"short.h5", "torn.h5"}
    assert ended.stderr.count(str(torn)) == 1
    assert all(one["file"] not in one["reason"] for one in document["refused"])


def test_a_session_of_tissue_is_named_as_such(tmp_path):
    log = tmp_path / "meat.h5"
    run("render", "--preset", "meat", "--device", "sim", "--script", "indent 1 mm at 72 mm/min", "--virtual",
        "--log", log)  # fmt: skip
    ended = run("training", log, code=7, said="not guided")
    assert ended.stdout == ""


def test_a_folder_without_logs_and_a_name_are_refused(tmp_path):
    run("training", tmp_path, code=2)
    named = ("--device", "sim", "--pseudonym", "Anna Smith")
    run("render", "--scene", "hip-resurfacing", *named, code=2, said="could be a name")


def test_the_page_shows_attempts_ways_and_learning(tmp_path):
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
