"""``tissueid fit --contact-law hertz-impact``: from CSV to a document, a page, and a scene that is felt."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import run

from tissueid.errors import UsageError
from tissueid.rendering.scene import load_scene
from tissueid.store.schema import first_problem
from tissueid.synth.contact_law import simulate_contact_law
from tissueid.synth.recipe import Hold, Log, Move, Recipe

RAMP = (Move(4.0, 100.0),)
WHOLE = (*RAMP, Hold(2.0), Move(0.0, 100.0))


def recordings(folder: Path, moves: tuple[Move | Hold, ...]) -> Path:
    """Plain CSV of a body with k = 4, n = 1.5, e = 0.7."""
    plan = Recipe("wall", (Log("a", moves, repeats=2),), rate_Hz=100.0, sigma_N=0.1, contact_offset_mm=1.0)
    rng = np.random.default_rng(2)
    for log in simulate_contact_law(plan, stiffness=4.0, exponent=1.5, restitution=0.7, rng=rng):
        table = np.column_stack([log.time_s, log.displacement_mm, log.force_N])
        head = "Time (s),Displacement (mm),Force (N)"
        np.savetxt(folder / f"{log.name}.csv", table, "%.5f", ",", header=head, comments="")
    return folder


def test_the_law_of_recordings_is_written_and_felt_in_a_scene(tmp_path: Path) -> None:
    (tmp_path / "rig").mkdir()
    out = tmp_path / "wall"
    options = ("--contact-law", "hertz-impact", "--specimen-by", "(rig)", "-o", out, "--json")
    ended = run("fit", recordings(tmp_path / "rig", WHOLE), *options)
    document = ended.json()
    assert ended.code == 0
    assert first_problem(document, "contact-law") is None
    assert json.loads((out / "contact-law.json").read_text()) == document
    (specimen,) = document["specimens"]
    found = {one["symbol"]: one for one in specimen["parameters"]}
    for symbol, truth in {"k": 4.0, "n": 1.5, "e": 0.7}.items():
        assert abs(found[symbol]["value"] - truth) <= 4.0 * found[symbol]["stderr"]
    page = (out / "contact-law.html").read_text()
    assert "Speed at contact" in page
    assert 'aria-label="Force of the law over depth' in page

    text = (
        'schema = "tissueid/scene/1"\nname = "wall"\n[plan]\nentry_mm = [0, 0, 0]\naxis = [0, 0, 1]\n'
        '[guidance.funnel]\ncontact_law = "wall/contact-law.json"\n'
    )
    (tmp_path / "scene.toml").write_text(text)
    funnel = load_scene(str(tmp_path / "scene.toml")).guidance.funnel
    assert (funnel.exponent, funnel.restitution) == (found["n"]["value"], found["e"]["value"])
    # k d^n is the same force whatever d is measured in
    there = funnel.stiffness_N_per_m_n * 0.002**funnel.exponent
    assert there == pytest.approx(found["k"]["value"] * 2.0 ** found["n"]["value"], rel=1e-12)


@pytest.mark.slow
def test_what_ramps_do_not_determine_is_null_and_is_not_felt(tmp_path: Path) -> None:
    ended = run("fit", recordings(tmp_path, RAMP), "--contact-law", "hertz-impact", "-o", tmp_path / "out")
    assert ended.code == 4
    document = json.loads((tmp_path / "out" / "contact-law.json").read_text())
    values = {one["symbol"]: one["value"] for one in document["specimens"][0]["parameters"]}
    assert (values["k"], values["e"]) == (None, None)
    assert "not identified" in ended.stdout
    document["specimens"] = document["specimens"][:1]
    (tmp_path / "one.json").write_text(json.dumps(document))
    (tmp_path / "scene.toml").write_text(
        'schema = "tissueid/scene/1"\nname = "wall"\n[plan]\nentry_mm = [0, 0, 0]\naxis = [0, 0, 1]\n'
        '[guidance.funnel]\ncontact_law = "one.json"\n'
    )
    with pytest.raises(UsageError, match="k, e not identified"):
        load_scene(str(tmp_path / "scene.toml"))


def test_recordings_without_contact_are_refused(tmp_path: Path) -> None:
    still = np.column_stack([0.01 * np.arange(300), np.zeros(300), np.zeros(300)])
    head = "Time (s),Displacement (mm),Force (N)"
    np.savetxt(tmp_path / "still.csv", still, "%.5f", ",", header=head, comments="")
    options = ("--contact-law", "hertz-impact", "-o", tmp_path / "out")
    ended = run("fit", tmp_path / "still.csv", *options)
    assert ended.code == 3
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("content", ["{", "{}"])
def test_a_law_that_is_none_is_refused_with_its_file(tmp_path: Path, content: str) -> None:
    (tmp_path / "law.json").write_text(content)
    (tmp_path / "scene.toml").write_text(
        'schema = "tissueid/scene/1"\nname = "wall"\n[plan]\nentry_mm = [0, 0, 0]\naxis = [0, 0, 1]\n'
        '[guidance.funnel]\ncontact_law = "law.json"\n'
    )
    with pytest.raises(UsageError, match=r"law\.json"):
        load_scene(str(tmp_path / "scene.toml"))


@pytest.mark.slow
def test_a_study_names_and_excludes_and_its_decisions_are_followed(tmp_path: Path) -> None:
    folder = recordings(tmp_path, WHOLE)
    (folder / "study.toml").write_text(
        'schema = "tissueid/study/1"\n\n[[trial]]\nfile = "a-*.csv"\nspecimen = "wall"\n\n'
        '[[exclude]]\nfile = "a-2.csv"\nbecause = "the rig slipped"\n'
    )
    ended = run("fit", folder, "--contact-law", "hertz-impact", "-o", tmp_path / "out", "--json")
    assert ended.code == 0, ended.stderr
    (specimen,) = ended.json()["specimens"]
    assert specimen["specimen"] == "wall"
    assert [Path(log["path"]).name for log in specimen["logs"]] == ["a-1.csv"]


def test_options_of_a_tissue_are_refused(tmp_path: Path) -> None:
    ended = run("fit", tmp_path, "--contact-law", "hertz-impact", "--branches", "2", "--sampler", "none")
    assert ended.code == 2
    assert "--branches, --sampler" in ended.stderr
