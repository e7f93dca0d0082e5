"""``tissueid design`` and ``calibrate``: what a study to come can tell, and whether its intervals cover."""

import csv
import re
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import QUICK, REPOSITORY, read_json, run, write_log, write_study
from identify_stand_ins import of_prior, too_sure
from rendered_tissues import PAPER_A, bundle_of

from tissueid.store.bundle import write_bundle
from tissueid.store.schema import first_problem

pytestmark = pytest.mark.needs_jit

PAGE = (REPOSITORY / "docs" / "design.md").read_text(encoding="utf-8")
GUESSES = ("--tissue", "tau=0.5~30%", "--tissue", "eta=1.3", "--tissue", "static_1_N_per_mm=5")


def test_a_recipe_is_planned_for_and_all_files_are_written(tmp_path):
    out = tmp_path / "plan"
    asked = ("--machine", "paper-a", "-o", out)
    ended = run("design", "paper-a-30", *asked, code=0, shown="paper-a-30", said="looked at")
    document = read_json(out / "design.json")
    assert first_problem(document, "design") is None
    names = {"design.json", "design.html", "study.toml", "test-sheet.csv", "recipe.toml"}
    assert {path.name for path in out.iterdir()} == names
    best, given = document["protocols"][0], document["against"]["protocol"]
    # wants nobody stated are what the recipe's own protocol reaches
    assert [one["share"] for one in document["asked"]["wants"]] == [
        one["assured"] for one in given["precision"]
    ]
    assert best["reached"]
    assert best["seconds"] < given["seconds"]
    assert f"recommended: {best['logs']} logs" in ended.stdout
    with (out / "test-sheet.csv").open(newline="") as stream:
        assert len(list(csv.DictReader(stream))) == best["logs"]
    # a second plan takes the place of the first
    run("design", "paper-a-30", "--machine", "bench", "-o", out, "-q", code=0)


def test_json_is_the_document_and_nothing_else(tmp_path):
    wanted = ("--want", "tau=8%", "--want", "eta=5%", "--specimens", "4")
    asked = (*GUESSES, "--max-depth", "6", "--machine", "bench", *wanted)
    document = run("design", *asked, "--json", code=0).json("design")
    assert document["asked"]["wants"] == [
        {"name": "relaxation_time_s", "share": 0.08},
        {"name": "viscosity_N_s_per_mm", "share": 0.05},
    ]
    assert document["against"] is None
    assert document["tissue"]["draws"] == 16
    best = document["protocols"][0]
    assert best["total_seconds"] == pytest.approx(4 * best["seconds"])
    assert max(row["depth_mm"] for row in best["indentations"]) <= 6.0


def test_a_machine_on_which_none_can_is_told_so(tmp_path):
    shown = ("NONE on this machine reaches that; the nearest: tau to ", "limited by noise")
    run(
        "design", "paper-a-30", "--machine", "slow-logger", "-o", tmp_path / "plan", code=4,
        said="no protocol on 'slow-logger' reaches what is wanted",
        shown=(*shown, "paper-a-30 can't be run here"),
    )  # fmt: skip
    assert "None on this machine." in (tmp_path / "plan" / "design.html").read_text(encoding="utf-8")


def test_a_bundle_is_planned_for_within_its_depth(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path / "lab" / "a.csv", label="liver")
    run("fit", "lab", "-o", "fitted", *QUICK, "-q", code=0)
    asked = ("--machine", "bench", "--want", "eta=5%", "--json")
    for source in ("fitted", "fitted/bundle.h5"):
        document = run("design", source, *asked, code=0).json()
        assert document["tissue"]["name"] == "liver"
        assert document["tissue"]["words"].startswith("the optimum of fitted")
        deepest = max(row["depth_mm"] for row in document["protocols"][0]["indentations"])
        assert deepest <= document["tissue"]["depth_mm"]
    deeper = run("design", "fitted", *asked, "--max-depth", "20").json()
    assert any("beyond that its law is a continuation" in said for said in deeper["verdict"]["remarks"])


def test_every_draw_of_a_bundle_counts(tmp_path):
    spread = np.exp(0.3 * np.random.default_rng(5).standard_normal((200, 1)))
    draws = np.repeat(PAPER_A.theta[None], 200, axis=0)
    draws[:, -1:] *= spread
    write_bundle(bundle_of(replace(PAPER_A, name="head"), draws=draws), tmp_path / "head.h5")
    wanted = ("--machine", "paper-a", "--want", "tau=4%", "--json")
    half, document = (
        run("design", tmp_path / "head.h5", *wanted, "--assurance", share, code=0).json()
        for share in ("0.5", "1.0")
    )
    assert document["tissue"]["words"].startswith("posterior draws of ")
    assert document["tissue"]["draws"] == 16
    (tau,) = [one for one in document["tissue"]["numbers"] if one["name"] == "relaxation_time_s"]
    assert tau["low"] < 0.7 * tau["median"] < tau["high"]
    (reached,) = document["protocols"][0]["precision"]
    # the shortest relaxation times are the hardest
    assert reached["median"] < reached["assured"] <= 0.04
    assert document["protocols"][0]["seconds"] >= half["protocols"][0]["seconds"]


@pytest.mark.parametrize(
    ("args", "code", "says"),
    [
        ((), 2, "nothing is said of the tissue"),
        (("paper-a-30", "--tissue", "tau=1"), 2, "both SOURCE and --tissue are given"),
        (("paper-a-30",), 2, "which machine? give --machine machine.toml, or one of paper-a"),
        (("paper-z", "--machine", "bench"), 2, "no such recipe or file; recipes are paper-a-22"),
        (("paper-a-30", "--machine", "none"), 2, "no such file or preset"),
        (("paper-a-30", "--machine", "bench", "--want", "tau=3"), 2, "write NAME=PERCENT%"),
        (("paper-a-30", "--machine", "bench", "--want", "tau=90%"), 2, "not identified"),
        (("paper-a-30", "--machine", "bench", "--want", "tau=3%", "--want", "tau=2%"), 2, "a number twice"),
        (("paper-a-30", "--machine", "bench", "--budget", "soon"), 2, "as 90min or 2h"),
        (("paper-a-30", "--machine", "bench", "--budget", "1.2.3h"), 2, "as 90min or 2h"),
        (("paper-a-30", "--machine", "bench", "--budget", "11min"), 2, "allow a larger --budget"),
        (("paper-a-30", "--machine", "bench", "--max-force", "0"), 2, "--max-force is 0.0, must be above 0"),
        (("paper-a-30", "--machine", "bench", "--recovery", "-1"), 2, "--recovery is -1.0"),
        (("paper-a-30", "--machine", "bench", "--against", "rupture-18"), 0, ""),
        ((*GUESSES, "--machine", "bench"), 2, "add --max-depth"),
    ],
)
def test_what_makes_no_sense_is_refused_with_the_way_out(args, code, says):
    ended = run("design", *args, code=code, said=says)
    assert code == 0 or len(ended.stderr.strip().splitlines()) == 1


def test_files_that_no_plan_wrote_stay(tmp_path):
    (tmp_path / "study.toml").write_text("mine", encoding="utf-8")
    asked = ("paper-a-30", "--machine", "paper-a", "-o", tmp_path)
    run("design", *asked, code=2, said="study.toml that no plan wrote")
    assert (tmp_path / "study.toml").read_text(encoding="utf-8") == "mine"


def blocks(language: str) -> list[str]:
    """Fenced blocks of one language; fences open and close in turn."""
    parts = re.split(r"^```(\w*)\n", PAGE, flags=re.MULTILINE)
    return [text for name, text in zip(parts[1::4], parts[2::4], strict=False) if name == language]


@pytest.mark.slow
def test_the_page_of_documentation_runs_as_printed(tmp_path, monkeypatch):
    """Every command block, with the files the page gives; what it prints of their output is in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "140")
    for text in blocks("toml"):
        name = re.match(r"# (\S+\.toml)\n", text)
        assert name is not None, text
        (tmp_path / name.group(1)).write_text(text, encoding="utf-8")
    typed = "".join(blocks("")).replace("\\\n", " ").splitlines()
    lines = [shlex.split(line, comments=True)[1:] for line in typed if line.startswith("tissueid ")]
    assert len(lines) >= 5
    # 4: none on this machine, which the page shows as well
    told = [run(*words, code={0, 4} if words[0] == "design" else 0).stdout for words in lines]
    said = " ".join("".join(told).split())
    quoted = [line for block in blocks("text") for line in block.splitlines() if line.strip()]
    assert quoted
    for line in quoted:
        assert " ".join(line.split()) in said, line


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


def test_json_is_the_calibration_and_nothing_else(tmp_path, recipe, instant):
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
