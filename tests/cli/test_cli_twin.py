"""The twin: what a machine finds at the grip of a device that renders a bundle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import read_json, run
from test_cli_laws import STUDY, recorded

import tissueid as ti
from tissueid.errors import UsageError
from tissueid.haptics.shared_hand import MAX_KNOTS
from tissueid.rendering.session_plan import read_script
from tissueid.twin import program_of_recording, program_of_script


def fitted(name: str, folder: Path) -> Path:
    """A recording of a law and its bundle."""
    recorded(name, folder / "log.csv")
    (folder / "study.toml").write_text(STUDY, encoding="ascii")
    asked = ("--study", folder / "study.toml", "--model", name, "--draws", "400", "-q", "-o", folder / "out")
    run("fit", folder / "log.csv", *asked, code={0, 4})
    return folder / "out" / "bundle.h5"


def felt_by_a_real_machine(document: dict[str, Any], bundle: Path, out: Path, log: Path) -> None:
    """The recording at the emulated grip, in the device's units, as a test machine would have made it."""
    time, depth, force = np.loadtxt(out / "emulated-Falcon.csv", delimiter=",", skiprows=1).T
    # another zero of travel, and a delay that was not undone
    depth = 3.0 + depth * document["motion_scale"]
    force = np.interp(time - 2e-3, time, force * document["force_scale"])
    machine = log.with_name("machine.csv")
    table = np.column_stack([time, depth, force])
    np.savetxt(machine, table, "%.6f", ",", header="time (s),displacement (mm),force (N)", comments="")
    scales = ("--motion-scale", document["motion_scale"], "--force-scale", document["force_scale"])
    asked = ("--twin", "--against", log, "--felt", machine, *scales, "--out", out.with_name("real"))
    falcon, _, real = run("render", bundle, *asked, "--json", code=0).json()["devices"]
    assert real["device"] == "test machine at the grip"
    assert real["nrmsd_model"] < 0.02
    assert [row["name"] for row in real["rows"]] == [row["name"] for row in falcon["rows"]]
    for mine, emulated in zip(real["rows"], falcon["rows"], strict=True):
        if mine["came_out"] and emulated["came_out"]:
            assert mine["came_out"] == pytest.approx(emulated["came_out"], rel=0.03)
    run("render", bundle, "--felt", machine, code=2)


@pytest.mark.system
@pytest.mark.needs_jit
@pytest.mark.parametrize(
    "name", ["polynomial * constant * prony:1", "power * tangent * prony:1", "flat * stretched", "yardstick"]
)
def test_what_went_in_comes_out(name, tmp_path):
    if name == "yardstick":
        recorded("flat * fung", tmp_path / "log.csv")
        run("fit", tmp_path / "log.csv", "--model", name, "-q", "-o", tmp_path / "out", code=0)
        bundle = tmp_path / "out" / "bundle.h5"
    else:
        bundle = fitted(name, tmp_path)
    out = bundle.parent / "twin"
    for _ in range(2):
        # a second time into the same folder
        ended = run("render", bundle, "--twin", "--against", tmp_path / "log.csv", "--json", code=0)
    document = ended.json("twin")
    assert document == read_json(out / "twin.json")
    falcon, simulated = document["devices"]
    for one in (falcon, simulated):
        assert one["nrmsd_model"] < 0.02
        assert one["nrmsd_recording"] < 0.02
        verdicts = [row["verdict"] for row in one["rows"]]
        assert ("inside" in verdicts) == (name != "yardstick")
        # half a count is no term of any interval: a number that is known to 0.2 % may be 0.3 % off
        assert verdicts.count("outside") <= 0.2 * len(verdicts)
        for row in one["rows"]:
            if row["verdict"] == "outside":
                assert abs(row["came_out"] / row["went_in"] - 1.0) < 0.01
    # only the emulated one has counts, a wire and a delay
    assert simulated["nrmsd_model"] < 0.1 * falcon["nrmsd_model"]
    assert (out / "emulated-Falcon.csv").read_text(encoding="ascii").startswith("Time (s),Displacement (mm)")
    assert document["unseen"]["nrmsd_model"] < 0.03
    if name == "power * tangent * prony:1":
        felt_by_a_real_machine(document, bundle, out, tmp_path / "log.csv")
    assert run("report", bundle.parent).code == 0
    report = (bundle.parent / "report.html").read_text(encoding="utf-8")
    assert "Mechanical twin</h2>" in report
    assert ("destroyed" in report or "inside" in report) or name == "yardstick"
    page = (out / "twin.html").read_text(encoding="utf-8")
    assert "Mechanical twin" in page
    assert "Came out" in page or name == "yardstick"
    assert (out / "twin.svg").read_text(encoding="utf-8").startswith("<svg xmlns=")
    (again,) = ti.read(out / "felt.h5")
    assert again.force_N.max() > 10.0


def test_a_script_is_a_program_from_above_the_tissue():
    program = program_of_script(read_script("indent 4 mm at 120 mm/min; hold 2 s; retract at 240 mm/min"))
    assert program.depth_mm[0] < 0.0
    assert program.speed_mm_s == pytest.approx(2.0)
    assert np.interp(program.contact_s, program.time_s, program.depth_mm) == pytest.approx(0.0, abs=1e-9)
    hand = program.hand(
        motion_scale=5.0, surface_m=np.array([0.0, 0.0, 0.1]), inward=np.array([0.0, 0.0, -1.0])
    )
    assert hand.rigid
    assert min(z for _, _, z in hand.positions_m) == pytest.approx(0.1 - 5.0 * 4e-3)


@pytest.fixture(scope="module")
def trial(tmp_path_factory):
    path = tmp_path_factory.mktemp("recording") / "log.csv"
    recorded("power * prony", path)
    return ti.read(path)[0]


def test_a_recording_is_a_program_of_few_straight_stretches(trial):
    wavy = trial.displacement_mm + 0.02 * np.sin(40.0 * trial.time_s)
    for travel in (trial.displacement_mm, wavy):
        program = program_of_recording(ti.Trial("s", trial.time_s, travel, trial.force_N), 6.5)
        assert program.time_s.size <= MAX_KNOTS
        assert program.recorded is not None
        assert program.recorded[-1, 0] == pytest.approx(program.duration_s)
        meant = np.interp(program.recorded[:, 0], program.time_s, program.depth_mm)
        assert np.abs(meant[-1] - program.depth_mm[-1]) < 1e-9


def test_a_travel_of_which_the_frame_took_a_part_is_scaled_to_the_claimed_depth(trial):
    whole, scaled = (program_of_recording(trial, depth) for depth in (6.5, 5.0))
    assert scaled.depth_mm.max() == pytest.approx(5.0, abs=0.01)
    assert scaled.duration_s == pytest.approx(whole.duration_s, abs=0.01)
    assert scaled.recorded is None
    assert scaled.words.endswith("scaled to 5 mm")
    with pytest.raises(UsageError, match="the bundle is claimed to 3 mm"):
        program_of_recording(trial, 3.0)


@pytest.mark.system
def test_what_makes_no_sense_is_refused(tmp_path):
    bundle = fitted("power * prony", tmp_path)
    deep = tmp_path / "deep.csv"
    rows = (tmp_path / "log.csv").read_text(encoding="ascii").splitlines()
    cells = [row.split(",") for row in rows[1:]]
    scaled = [f"{t},{2.0 * float(x):.5f},{f}" for t, x, f in cells]
    deep.write_text("\n".join([rows[0], *scaled]) + "\n", encoding="ascii")
    for asked, words in (
        (("--against", deep), "the bundle is claimed to"),
        (("--log", tmp_path / "x.h5"), "leave out --log"),
        (("--preset", "paper-a"), "leave out --preset"),
        (("--script", "indent 4 furlongs"), "furlongs"),
    ):
        run("render", bundle, "--twin", "--out", tmp_path / "twin", *asked, code=2, said=words)
    assert run("render", "--twin").code == 2
