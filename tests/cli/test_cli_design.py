"""``tissueid design``: sources in; ranked table, files and exit codes out; its documentation as printed."""

from __future__ import annotations

import csv
import re
import shlex
from dataclasses import replace

import numpy as np
import pytest
from command_line import QUICK, REPOSITORY, read_json, run, write_log
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
