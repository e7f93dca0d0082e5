"""From a study to its population on the command line."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_line import read_json, run, write_log, write_study

from tissueid.population.members import thawed_among_fresh
from tissueid.store.bundle import load_bundle

#: One branch, constant K, few draws: what is tested is the way from a study to its population.
SMALL = ("--branches", "1", "--stiffness-degree", "0", "--draws", "400")
#: Forces of the specimens, in those of the first.
TIMES = (0.8, 0.9, 1.0, 1.1, 1.25)


def a_study(folder: Path, times: tuple[float, ...], storage: tuple[str, ...] = ()) -> Path:
    """One log a specimen, the same but for its force (and its storage)."""
    tables = []
    for number, factor in enumerate(times, 1):
        write_log(folder / f"{number}.csv", label=None, force_times=factor)
        tables += [
            f'[[specimen]]\nname = "head {number}"\nage_years = {50 + number}',
            *([f'storage = "{storage[number - 1]}"'] if storage else []),
            f'[[trial]]\nfile = "{number}.csv"\nspecimen = "head {number}"',
        ]
    write_study(folder, *tables)
    return folder


@pytest.fixture(scope="module")
def cohort(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cohort")
    ended = run("fit", a_study(folder / "heads", TIMES), "-o", folder / "out", *SMALL)
    return folder / "out", ended


def files_of(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in out.iterdir() if path.suffix in {".h5", ".json", ".csv"}}


def test_a_study_of_five_gets_its_population(cohort):
    out, ended = cohort
    document: dict[str, Any] = read_json(out / "population.json")
    assert "population of 5 specimens" in ended.stdout
    assert sorted(document["specimens_used"]) == [f"head {number}" for number in range(1, 6)]
    assert (out / "cohort.html").is_file()
    assert run("validate", out).code == 0


def test_its_typical_tissue_and_its_spread_are_those_of_the_forces(cohort):
    out, _ = cohort
    rows = read_json(out / "population.json")["population"]["quantities"]
    own = load_bundle(out / "bundle-head_3.h5")
    typical = load_bundle(out / "population.h5")
    geometric_mean = float(np.exp(np.mean(np.log(TIMES))))
    depth = float(typical.depth_mm)
    powers = depth ** np.arange(1.0, 4.0)
    force_N = float(own.theta[:3] @ powers)
    # the factors' own mean, within the noise of one log each
    assert rows[2]["median"] == pytest.approx(force_N * geometric_mean, rel=0.05)
    assert float(typical.theta[:3] @ powers) == pytest.approx(force_N * geometric_mean, rel=0.05)
    low, high = rows[2]["cv_ci95"]
    assert low < float(np.std(np.log(TIMES), ddof=1)) < high


def test_a_cohort_is_drawn_again_without_touching_the_fit(cohort):
    out, _ = cohort
    before = files_of(out)
    ended = run("cohort", out, "--tails", "normal", "--covariate", "age_years", "--no-held-out", "--json")
    after = files_of(out)
    changed = {name for name in after if after[name] != before.get(name)}
    assert ended.code in {0, 4}, ended.stderr
    assert ended.json()["population"]["held_out"] is None
    assert changed <= {"population.json", "population.h5"}
    assert "population.json" in changed


def test_a_folder_without_a_run_has_no_cohort(tmp_path):
    (tmp_path / "empty").mkdir()
    run("cohort", tmp_path / "empty", code=6, said="tissueid fit")


def test_thawed_specimens_among_fresh_ones_are_named_and_not_pooled_unasked(tmp_path):
    folder = a_study(tmp_path / "heads", TIMES[:3], ("fresh, 4 C", "frozen at -20 C", "fresh"))
    ended = run("fit", folder, "-o", tmp_path / "out", *SMALL, "--population", "yes", code=4)
    assert "head 2 thawed among 2 fresh" in ended.stderr
    assert "--mix-states" in ended.stderr
    assert not (tmp_path / "out" / "population.json").exists()
    run("cohort", tmp_path / "out", "--mix-states")
    assert (tmp_path / "out" / "population.json").is_file()


@pytest.mark.parametrize(
    ("covariates", "state"),
    [
        ({"storage": "frozen"}, "thawed"),
        ({"freeze_thaw_cycles": 1}, "thawed"),
        ({"storage": "-80 C, thawed overnight"}, "thawed"),
        ({"storage": "never frozen"}, "fresh"),
        ({"storage": "saline, 4 C"}, "fresh"),
        ({"freeze_thaw_cycles": 0, "storage": "frozen gel pack"}, "fresh"),
        ({}, None),
    ],
)
def test_the_state_is_read_from_storage_and_cycles(covariates, state):
    one: Any = SimpleNamespace(specimen="a", covariates=covariates)
    found = dict(zip(("thawed", "fresh"), thawed_among_fresh([one]), strict=True))
    assert found == {name: ["a"] if name == state else [] for name in ("thawed", "fresh")}
