"""``tissueid cohort``: from a study to its population, one set with the fit; specimens to feel."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cohort_outputs import cohort_folder
from command_line import read_json, run, write_log, write_study

from tissueid.population.members import thawed_among_fresh
from tissueid.store.bundle import load_bundle
from tissueid.store.results import validate_outputs

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
    run("validate", out, code=0)
    run("cohort", out, "--covariate", "weight", code=2, said="stated are age_years")


DRAWN = ("--device", "sim", "--virtual", "--draw-specimen")


@pytest.mark.needs_jit
def test_a_specimen_of_the_population_is_rendered(cohort):
    script = ("--script", "indent 1 mm at 500 mm/min; retract at 500 mm/min", "--json")
    felt = run("render", cohort[0] / "population.h5", *DRAWN, "7", *script, code=0)
    draws = load_bundle(cohort[0] / "population.h5").draws
    assert draws is not None
    assert f"of {len(draws)} drawn from the population of 5 specimens" in felt.stderr + felt.stdout


@pytest.mark.parametrize(
    ("bundle", "seed", "said"),
    [
        ("bundle-head_1.h5", (), "tissueid cohort OUT"),
        ("population.h5", ("seven",), "the seed is a whole number"),
    ],
)
def test_a_specimen_that_can_not_be_drawn_is_refused(cohort, bundle, seed, said):
    run("render", cohort[0] / bundle, *DRAWN, *seed, code=2, said=said)


@pytest.mark.slow
def test_the_numbers_are_those_of_the_specimens_each_time(tmp_path):
    out = cohort_folder(tmp_path / "out", 6)
    asked = ("--group-by", "sex", "--no-held-out", "--json")
    document, again = (run("cohort", out, *asked, code=0).json("population") for _ in range(2))
    assert again == document == read_json(out / "population.json")
    validate_outputs(out)
    rows = {row["name"]: row for row in document["population"]["quantities"]}
    # F_s(6) = 4*6 + 0.8*36 + 0.05*216 = 63.6 N, specimens differ by 12 %: three errors of 4.9 %
    assert rows["static_force_3_N"]["median"] == pytest.approx(63.6, rel=0.15)
    assert rows["relaxation_time_s"]["median"] == pytest.approx(1.5, rel=0.08)
    assert 0.04 < rows["static_force_3_N"]["cv"] < 0.35
    assert "donor" in rows["static_force_3_N"]["levels"]


def test_two_specimens_are_refused_and_the_set_stays(tmp_path):
    folder = cohort_folder(tmp_path / "two", 2, study=False)
    run("cohort", folder, "-q", code=4, said="a population takes 3 at least")
    assert not (folder / "population.json").exists()
    validate_outputs(folder)


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
    asked = ("--tails", "normal", "--covariate", "age_years", "--no-held-out", "--json")
    ended = run("cohort", out, *asked, code={0, 4})
    after = files_of(out)
    changed = {name for name in after if after[name] != before.get(name)}
    assert ended.json()["population"]["held_out"] is None
    assert changed <= {"population.json", "population.h5"}
    assert "population.json" in changed


def test_thawed_specimens_among_fresh_ones_are_named_and_not_pooled_unasked(tmp_path):
    folder = a_study(tmp_path / "heads", TIMES[:3], ("fresh, 4 C", "frozen at -20 C", "fresh"))
    said = ("head 2 thawed among 2 fresh", "--mix-states")
    run("fit", folder, "-o", tmp_path / "out", *SMALL, "--population", "yes", code=4, said=said)
    assert not (tmp_path / "out" / "population.json").exists()
    run("cohort", tmp_path / "out", "--mix-states")
    assert (tmp_path / "out" / "population.json").is_file()


def test_the_state_is_read_from_storage_and_cycles():
    stated = {
        "frozen": {"storage": "frozen"}, "once": {"freeze_thaw_cycles": 1},
        "overnight": {"storage": "-80 C, thawed overnight"}, "never": {"storage": "never frozen"},
        "saline": {"storage": "saline, 4 C"}, "gel": {"freeze_thaw_cycles": 0, "storage": "frozen gel pack"},
        "unstated": {},
    }  # fmt: skip
    members: Any = [SimpleNamespace(specimen=name, covariates=known) for name, known in stated.items()]
    thawed, fresh = thawed_among_fresh(members)
    assert (thawed, fresh) == (["frozen", "once", "overnight"], ["never", "saline", "gel"])
