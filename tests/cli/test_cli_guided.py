"""``render --scene``, ``training`` and ``control``: scenes that are felt, attempts in them, and loops."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run
from rendered_tissues import PAPER_A, bundle_of

from tissueid.haptics.ring import RECORD
from tissueid.haptics.states import State
from tissueid.rendering.options import RenderOptions
from tissueid.rendering.plan import plan_session
from tissueid.rendering.recorder import Recorder, SessionSummary
from tissueid.rendering.scene import load_scene
from tissueid.store.bundle import write_bundle
from tissueid.store.session_log import read_session_log

SIM = ("--device", "sim", "--yes")


def test_a_scene_with_a_tissue_is_that_tissue(tmp_path):
    log = tmp_path / "meat.h5"
    asked = ("--script", "indent 2 mm at 72 mm/min", "--virtual", "--log", log)
    ended = run("render", "--scene", "meat", *SIM, *asked, code=0)
    assert "A cut of meat" in ended.stderr + ended.stdout
    assert "assumed" in ended.stderr + ended.stdout
    assert read_session_log(log).head["tissues"][0]["name"] == "meat"


@pytest.mark.needs_jit
def test_a_guided_session_pulls_to_the_axis_and_its_log_says_by_what(tmp_path):
    plan, log = tmp_path / "patient.toml", tmp_path / "hip.h5"
    # the simulated hand rests in the middle of the workspace, 4 mm beside this axis
    plan.write_text("entry_mm = [4.0, 0.0, -15.0]\naxis = [0.0, 0.0, 1.0]\n", encoding="utf-8")
    ended = run(
        "render", "--scene", "hip-resurfacing", "--plan", plan, *SIM, "--seconds", "2.5", "--log", log, code=0
    )
    shown = ended.stderr + ended.stdout
    for words in ("Guide wire", "assumed", "N s/m of damping", "conservative"):
        assert words in shown
    found = read_session_log(log)
    assert found.head["environment"] == "guidance"
    assert found.head["tissues"][0]["block"][10:13] == pytest.approx([0.004, 0.0, 0.115])
    felt = found.records[found.records["state"] == State.ENGAGED]
    force = felt["force_N"]
    strongest = int(np.argmax(np.abs(force[:, 0])))
    # toward the axis, and upward by the axial force that keeps the pull conservative; a busy machine
    # skips ticks, after which the force rises again from zero, but it never pushes away from the axis
    assert force[strongest, 0] > 0.05
    assert force[strongest, 2] > 0.0
    assert force[:, 0].min() > -0.02
    np.testing.assert_allclose(felt["depth_mm"], 1e3 * (0.115 - felt["position_m"][:, 2]), atol=0.2)


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("--scene", "nothing"), "orbital-floor"),
        (("--plan", "PLAN"), "add --scene"),
        (("--scene", "hip-resurfacing", "--preset", "meat"), "brings what is felt"),
        (
            ("--scene", "hip-resurfacing", "--script", "indent 2 mm at 60 mm/min"),
            "takes the place of a tissue",
        ),
        (("--scene", "hip-resurfacing", "--virtual"), "--virtual"),
        (("--scene", "meat", "--plan", "PLAN"), "no guidance"),
    ],
)
def test_what_does_not_belong_together_is_refused(tmp_path, args, said):
    plan = tmp_path / "plan.toml"
    plan.write_text("entry_mm = [0.0, 0.0, 0.0]\naxis = [0.0, 0.0, 1.0]\n", encoding="utf-8")
    run("render", *(str(plan) if one == "PLAN" else one for one in args), *SIM, code=2, said=said)


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


PRESET = ("control", "--preset", "paper-a")


def numbers(document: Any) -> dict[str, tuple[Any, str]]:
    return {row["name"]: (row["value"], row["kind"]) for row in document["numbers"]}


@pytest.mark.needs_jit
def test_a_bundle_runs_beside_the_frozen_controller_and_its_own_stiffness(tmp_path):
    path = tmp_path / "bundle.h5"
    write_bundle(bundle_of(PAPER_A), path)
    given = "--stiffness-scale 100 --json --seconds 4"
    document = run("control", path, *given.split(), code=0).json("control")
    assert [one["name"] for one in document["runs"]] == ["adaptive", "frozen", "unscaled"]
    assert [one["stiffness_scale"] for one in document["runs"]] == [100.0, 100.0, 1.0]
    assert document["runs"][0]["measures"]["error_rms_mm"] < 0.01
    for estimate in document["runs"][1]["estimates"]:
        assert estimate["start"] == estimate["end"]
    table = numbers(document)
    assert table["operator mass"] == (1.25, "reading")
    assert table["device damping"] == (115.4, "reading")
    assert table["virtual mass"] == (2.0, "assumed")
    assert table["saturation"] == (None, "assumed")


@pytest.mark.needs_jit
def test_what_the_user_states_is_called_stated():
    stated = "--operator 2 5 100 --virtual-mass 3 --gamma 1 2 3 --saturation 50 --frozen --start zero"
    document = run(*PRESET, "--json", "--seconds", "2", *stated.split()).json()
    table = numbers(document)
    assert table["operator damping"] == (5.0, "stated")
    assert table["device mass"] == (1.158, "reading")
    assert table["virtual mass"] == (3.0, "stated")
    assert table["Gamma of stiffness"] == (3.0, "stated")
    assert table["saturation"] == (50.0, "stated")
    assert [one["name"] for one in document["runs"]] == ["frozen", "adaptive"]
    assert [one["start"] for one in document["runs"][0]["estimates"]] == [0.0, 0.0, 0.0]


@pytest.mark.needs_jit
def test_a_loop_that_diverges_is_said_and_ends_with_4():
    given = "--variant A --stiffness-scale 100 --task impacts --seconds 20 --noise 0.05 --seed 3"
    kept = run(*PRESET, *given.split(), code=0)
    lost = run(*PRESET, *given.split(), "--no-projection", code=4)
    assert "DIVERGED" not in kept.stdout.splitlines()[3]
    assert re.search(r"^adaptive .*; DIVERGED at \d+\.\d+ s$", lost.stdout, re.MULTILINE)


@pytest.mark.needs_jit
def test_a_device_with_a_force_sensor_is_rendered_on_and_another_refused():
    ended = run(*PRESET, "--device", "sim", "--seconds", "2", code=0, shown="shaped by the guard")
    assert re.search(r"^on sim    error 0\.[12]\d\d mm rms", ended.stdout, re.MULTILINE)
    run(*PRESET, "--device", "falcon", code=5, said="falcon has no force sensor")


@pytest.mark.needs_jit
def test_too_little_margin_and_a_tissue_left_behind_are_said():
    said = ("less than 1.5 times it", "deeper than the 8 mm that were identified")
    run(*PRESET, "--virtual-mass", "0.5", "--stiffness-scale", "0.02", shown=said)


@pytest.mark.needs_jit
def test_the_document_is_json_whatever_happens():
    given = "--environment impedance --stiffness-scale 100 --seconds 2 --json --device sim"
    ended = run(*PRESET, *given.split())
    document = ended.json("control")
    assert document["device"]["error_rms_mm"] < 0.3
    assert ended.code == (0 if document["runs"][0]["measures"]["diverged_s"] is None else 4)
