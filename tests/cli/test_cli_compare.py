"""``tissueid compare``."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from rendered_tissues import PAPER_A, bundle_of

from tissueid.store.bundle import write_bundle
from tissueid.store.schema import check


def bundle(folder: Path, name: str, *, scale: float = 1.0, draws: int = 400) -> Path:
    chance = np.random.default_rng(len(name))
    theta = PAPER_A.theta * np.array([scale, scale, scale, scale, 1.0])
    known = theta * np.exp(0.01 * chance.standard_normal((draws, 1)) * np.array([1.0, 1.0, 1.0, 1.0, 0.0]))
    path = folder / f"{name}.h5"
    tissue = replace(PAPER_A, theta=theta, name=name)
    write_bundle(bundle_of(tissue, draws=known), path)
    return path


def test_a_stiffer_tissue_differs_and_could_be_felt(tmp_path: Path) -> None:
    target = tmp_path / "contrast.json"
    ended = run("compare", bundle(tmp_path, "kidney"), bundle(tmp_path, "liver", scale=1.5), "-o", target)
    assert ended.code == 0, ended.stderr
    assert "kidney and liver: differ" in ended.stdout
    assert "a hand could tell: force" in ended.stdout
    document = json.loads(target.read_text(encoding="utf-8"))
    check(document, "contrast", where="contrast.json")
    assert document["pairs"][0]["difference"]["different"] is True


def test_a_tissue_beside_itself_is_not_shown_to_differ(tmp_path: Path) -> None:
    path = bundle(tmp_path, "kidney")
    ended = run("compare", path, path)
    assert "kidney (1) and kidney (2): not shown to differ" in ended.stdout
    assert "a hand would hardly tell" in ended.stdout


@pytest.mark.parametrize(
    ("draws", "args", "said"),
    [
        (400, (), "nothing to compare"),
        (20, ("again",), "too few"),
        (400, ("--interval", "total"), "output folder"),
    ],
)
def test_what_cannot_be_compared_is_refused(
    tmp_path: Path, draws: int, args: tuple[str, ...], said: str
) -> None:
    path = bundle(tmp_path, "kidney", draws=draws)
    ended = run("compare", path, *(path if arg == "again" else arg for arg in args))
    assert ended.code == 2
    assert said in ended.stderr
