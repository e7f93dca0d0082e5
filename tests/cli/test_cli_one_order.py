"""One law and order of a study: the rule over specimens, and a study whose specimens would differ."""

from __future__ import annotations

import shutil
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from command_line import run, write_csv, write_study

from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.store.index import Index
from tissueid.study.one_order import LawOrder, agreed, scores_of

KV = "kelvin-voigt"
PLAIN, TWO, BENT = LawOrder(KV, 1, 0), LawOrder(KV, 2, 0), LawOrder(KV, 2, 1)


@pytest.mark.parametrize(
    ("tables", "taken"),
    [
        # the simplest within one standard error over specimens
        ([{PLAIN: -0.5 + k, TWO: 0.0} for k in (0.1, 0.0, -0.1, 0.05)], TWO),
        # as much is gained in one specimen as is lost in another
        ([{PLAIN: 0.0, TWO: gain} for gain in (0.3, -0.2, 0.25, -0.3)], PLAIN),
        # one that is not resolved predicts as what it contains: of the last specimen two branches are one
        ([{PLAIN: -0.6, TWO: 0.0}] * 3 + [{PLAIN: 0.0}], TWO),
        # one that few were tried with is none of the study
        ([{PLAIN: -0.6, TWO: 0.0}] * 4 + [{PLAIN: -0.9, TWO: -0.8, BENT: 0.0}], TWO),
        ([{TWO: 0.0}, {LawOrder("power * fung", 1, 0): 0.0}], None),
    ],
)
def test_an_order_is_agreed_on(tables, taken):
    assert agreed(tables) == taken


def test_other_laws_are_weighed_where_one_of_them_may_be_taken():
    rows = [
        {"branches": 1, "stiffness_degree": 0, "score": -0.3},
        {"model": "power * fung", "branches": 1, "stiffness_degree": 0, "score": 0.0},
        {"model": "yardstick", "branches": 4, "stiffness_degree": 0, "score": 0.2},
    ]
    assert list(scores_of({"selection": rows}, laws=False)) == [PLAIN]
    assert list(scores_of({"selection": rows}, laws=True)) == [PLAIN, LawOrder("power * fung", 1, 0)]


def recording(path: Path, branches: int, seed: int) -> None:
    """A push to 5 mm and a hold of 12 s at 50 Hz, of one or two relaxation times."""
    rng, rate = np.random.default_rng(seed), 50.0
    model = kelvin_voigt(branches, 0, 5.0)
    theta = np.array([8.0, -0.5, 0.2, *(12.0, 0.3, *((10.0, 3.0) if branches > 1 else ()))])
    time = np.arange(0.0, 14.0, 1.0 / rate)
    depth = np.interp(time, [1.0, 2.0], [0.0, 5.0])
    force = model.force(theta, ContactPath(time, depth)) + rng.normal(0.0, 0.02, time.size)
    travel = np.interp(time, [0.0, 1.0, 2.0], [-5.0, 0.0, 5.0])
    write_csv(path, time, travel, force)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out: Path = tmp_path_factory.mktemp("study")
    for number, branches in enumerate((2, 2, 1)):
        recording(out / f"s{number}.csv", branches, number)
    write_study(out, "[study]", 'title = "orders"')
    return out


def orders(document: dict) -> list[int]:
    return [one["model"]["branches"] for one in document["specimens"]]


def flagged(document: dict) -> list[str]:
    own = {one["specimen"]: {flag["code"] for flag in one["flags"]} for one in document["specimens"]}
    return [name for name, codes in own.items() if "study_order" in codes]


ASKED = ("--sampler", "none", "--json", "--workers", "1")


@pytest.fixture(scope="module")
def own(folder, tmp_path_factory):
    """The study with the orders that its specimens take alone."""
    out = tmp_path_factory.mktemp("own") / "out"
    document = run("fit", folder, *ASKED, "--orders", "own", "-o", out).json()
    assert (orders(document), flagged(document)) == ([2, 2, 1], [])
    return out


@pytest.fixture
def out(own, tmp_path):
    """A copy of its folder."""
    return shutil.copytree(own, tmp_path / "out", symlinks=True)


def test_specimens_of_a_study_are_fitted_with_one_order_and_the_other_one_says_so(folder, out):
    document = run("fit", folder, *ASKED, "-o", out).json()
    assert (orders(document), flagged(document)) == ([2, 2, 2], ["s2"])
    run("validate", out, code=0)
    run("status", out, shown="3 of 3 done")
    # the same again computes nothing: the file of what the specimen would take alone is there
    assert run("fit", folder, *ASKED, "-o", out).json()["specimens"] == document["specimens"]
    with Index(out) as index:
        assert index.count("superseded") == 1
    # the same order asked for by name is none of the study's
    named = run("fit", folder, *ASKED, "--branches", "2", "--stiffness-degree", "0", "-o", out).json()
    assert (orders(named), flagged(named)) == ([2, 2, 2], [])


def test_files_that_are_no_study_keep_their_own_orders(folder, out):
    assert orders(run("fit", folder, *ASKED, "--no-study", "-o", out).json()) == [2, 2, 1]


def test_a_specimen_that_the_order_of_its_study_can_not_be_fitted_to_keeps_its_own(folder, out, monkeypatch):
    monkeypatch.setattr("tissueid.study.specimen_job.Flag", Mock(side_effect=ArithmeticError))
    document = run("fit", folder, *ASKED, "-o", out).json()
    assert (orders(document), document["refused"]) == ([2, 2, 1], [])
