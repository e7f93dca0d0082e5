"""``tissueid calibrate``: recipe, study and bundle in; verdict, JSON and page out; resumed where it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from command_line import QUICK, read_json, run, write_log, write_study
from identify_stand_ins import of_prior, too_sure

from tissueid.store.schema import first_problem

pytestmark = pytest.mark.needs_jit

FEWEST = "20"
RECIPE = """\
name = "small"
specimen = "phantom"
rate_Hz = 50.0
sigma_N = 0.5
[[branches]]
stiffness = [60.0]
tau_s = 0.2
[[logs]]
name = "slow"
moves = [{to_mm = 4.0, speed_mm_min = 240.0}]
[[logs]]
name = "hold"
repeats = 2
moves = [{to_mm = 4.0, speed_mm_min = 480.0}, {hold_s = 1.0}]
"""


@pytest.fixture
def recipe(tmp_path):
    path = tmp_path / "recipe.toml"
    path.write_text(RECIPE, encoding="utf-8")
    return path


@pytest.fixture
def instant(monkeypatch):
    """Every simulation is identified in no time, by the truth's prior: calibrated by construction."""
    monkeypatch.setattr("tissueid.selfcheck.tissue.identify", of_prior)


def document_of(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = read_json(folder / "calibrate.json")
    assert first_problem(document, "selfcheck") is None
    return document


@pytest.mark.slow
def test_a_recipe_is_checked_by_what_identifies_recordings(tmp_path, recipe):
    ended = run("calibrate", recipe, "-o", tmp_path / "out", "--simulations", FEWEST, "--seed", "4", code=0)
    document = document_of(tmp_path / "out")
    assert document["verdict"] == {"calibrated": True, "reasons": []}
    assert document["source"] == {"kind": "recipe", "path": str(recipe), "specimen": "phantom"}
    assert document["simulations"]["failed"] == []
    names = [one["name"] for one in document["parameters"]]
    assert names[3:6] == ["stiffness_0_N_per_mm", "relaxation_time_s", "viscosity_N_s_per_mm"]
    assert sum(name.startswith("force_N at ") for name in names) == 3
    assert len(names) == 9
    # the data say far more of a viscosity than its prior
    viscosity = document["parameters"][5]
    assert viscosity["contraction"] > 0.8
    assert sum(viscosity["histogram"]) == 20
    page = (tmp_path / "out" / "calibrate.html").read_text(encoding="utf-8")
    assert "Calibrated." in page
    assert "relaxation_time_s: log-normal, median 0.2, sd of ln 0.4" in ended.stdout


def test_a_second_call_goes_on_and_another_check_is_refused(tmp_path, recipe, instant):
    out = tmp_path / "out"
    run("calibrate", recipe, "-o", out, "--simulations", FEWEST, code=0)
    first = (out / "calibrate.jsonl").read_bytes()
    run("calibrate", recipe, "-o", out, "--simulations", "25", code=0)
    assert (out / "calibrate.jsonl").read_bytes().startswith(first)
    assert document_of(out)["simulations"]["done"] == 25
    run("calibrate", recipe, "-o", out, "--seed", "1", code=2, said="holds the simulations of another check")
    recipe.write_text(RECIPE.replace("sigma_N = 0.5", "sigma_N = 0.6"), encoding="utf-8")
    assert run("calibrate", recipe, "-o", out).code == 2


def test_intervals_that_are_too_narrow_end_with_a_code_of_their_own(tmp_path, recipe, instant, monkeypatch):
    out = tmp_path / "out"
    monkeypatch.setattr("tissueid.selfcheck.tissue.identify", too_sure)
    ended = run("calibrate", recipe, "-o", out, "--simulations", "60", code=4)
    assert "not calibrated: relaxation_time_s: ranks leave the family-wise 99 % band" in ended.stderr
    assert not document_of(out)["verdict"]["calibrated"]
    assert "Not calibrated." in (out / "calibrate.html").read_text(encoding="utf-8")


def test_json_is_the_document_and_nothing_else(tmp_path, recipe, instant):
    asked = ("--simulations", FEWEST, "--json", "--interval", "total")
    document = run("calibrate", recipe, "-o", tmp_path / "out", *asked, code=0).json()
    assert document == document_of(tmp_path / "out")
    assert document["interval"] == "total"
    said = {row["name"]: row["prior"] for row in document["priors"]}
    assert said["frame_compliance_mm_per_N"] == "normal, 0 ± 0.004, not below 0"


def test_a_study_keeps_its_measured_motion_and_its_priors(tmp_path, instant):
    lab = tmp_path / "lab"
    write_log(lab / "a.csv", label="liver")
    write_log(lab / "b.csv", label="liver", force_times=1.02)
    write_study(lab, "[priors.sigma_N]", "median = 1.5", "sd_ln = 0.2")
    run("calibrate", lab, "-o", tmp_path / "out", "--simulations", FEWEST, code=0)
    document = document_of(tmp_path / "out")
    assert [document["source"][key] for key in ("kind", "specimen")] == ["study", "liver"]
    assert document["protocol"]["words"] == "the measured x(t) of 2 recordings"
    assert document["protocol"]["depth_mm"] == pytest.approx(8.0, abs=0.05)
    assert document["protocol"]["step_s"] == pytest.approx(0.04, rel=1e-3)
    (sigma,) = [row for row in document["priors"] if row["name"] == "sigma_N"]
    assert sigma == {"name": "sigma_N", "prior": "log-normal, median 1.5, sd of ln 0.2", "stated": True}


def test_a_bundle_takes_its_recordings_or_says_that_a_program_stands_in(tmp_path, instant, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path / "lab" / "a.csv", label="liver")
    run("fit", "lab", "-o", "fitted", *QUICK, "-q", code=0)
    run("calibrate", "fitted", "-o", "there", "--simulations", FEWEST, code=0)
    there = document_of(tmp_path / "there")
    assert there["protocol"]["words"] == "the measured x(t) of 1 recording"
    assert there["model"]["static_pooling"] == "shared"
    (tmp_path / "lab" / "a.csv").unlink()
    asked = (Path("fitted", "bundle.h5"), "-o", "gone", "--simulations", FEWEST)
    run("calibrate", *asked, code=0, said="its recordings are not there")
    gone = document_of(tmp_path / "gone")
    assert gone["protocol"]["words"].startswith("a ramp-and-hold program within the bundle's depth (8")
    assert gone["protocol"]["depth_mm"] == pytest.approx(there["protocol"]["depth_mm"], rel=0.02)


def test_rates_are_for_recipes_and_foreign_files_stay(tmp_path, recipe, instant):
    write_log(tmp_path / "a.csv")
    assert "--rate is for recipes" in run("calibrate", tmp_path / "a.csv", "--rate", "10").stderr
    out = tmp_path / "out"
    out.mkdir()
    (out / "calibrate.html").write_text("mine", encoding="utf-8")
    run("calibrate", recipe, "-o", out, code=2)
    assert (out / "calibrate.html").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("sigma_N = 0.5", "sigma_N = 0.0"), "its noise is zero"),
        (("sigma_N = 0.5", "ar1_sigma_N = 0.5\nar1_phi = -0.4"), "negative correlation is not offered"),
        (("[[branches]]\nstiffness = [60.0]\ntau_s = 0.2", "branches = []"), "its tissue has no branch"),
        (("stiffness = [60.0]", "stiffness = [60.0, 1.0, 1.0, 1.0]"), "degree 3 of K is not offered"),
    ],
)
def test_a_recipe_that_no_posterior_has_is_refused(tmp_path, recipe, change, says):
    recipe.write_text(RECIPE.replace(*change), encoding="utf-8")
    run("calibrate", recipe, "-o", tmp_path / "out", code=3, said=says)
