"""``tissueid cohort``: one set with the fit it was made from, refusals, specimens to feel."""

from __future__ import annotations

import pytest
from cohort_outputs import cohort_folder
from command_line import read_json, run

from tissueid.store.bundle import load_bundle
from tissueid.store.results import validate_outputs
from tissueid.store.schema import check

# chains of thousands of sweeps
pytestmark = [pytest.mark.needs_jit, pytest.mark.slow]


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return cohort_folder(tmp_path_factory.mktemp("cohort") / "out", 6)


@pytest.fixture(scope="module")
def ended(out):
    return run("cohort", out, "--group-by", "sex", "--no-held-out", "--json")


def test_the_population_joins_the_set_of_the_fit(ended, out):
    assert ended.code == 0, ended.stderr
    validate_outputs(out)
    assert {"population.json", "population.h5", "cohort.html", "identification.json", "report.html"} - {
        "report.html"
    } <= {path.name for path in out.iterdir()}
    assert ended.json() == read_json(out / "population.json")
    check(ended.json(), "population", where="stdout")


def test_the_numbers_are_those_of_the_specimens(ended):
    rows = {row["name"]: row for row in ended.json()["population"]["quantities"]}

    # F_s(6) = 4*6 + 0.8*36 + 0.05*216 = 63.6 N, specimens differ by 12 %: three errors of 4.9 %
    assert rows["static_force_3_N"]["median"] == pytest.approx(63.6, rel=0.15)
    assert rows["relaxation_time_s"]["median"] == pytest.approx(1.5, rel=0.08)
    assert 0.04 < rows["static_force_3_N"]["cv"] < 0.35
    assert "donor" in rows["static_force_3_N"]["levels"]


def test_running_it_again_gives_the_same_numbers(ended, out):
    again = run("cohort", out, "--group-by", "sex", "--no-held-out", "--json")

    assert again.json() == ended.json()


def test_a_specimen_of_the_population_is_rendered(ended, out):
    bundle = load_bundle(out / "population.h5")
    assert bundle.draws is not None

    felt = run(
        "render", out / "population.h5", "--draw-specimen", "7", "--device", "sim", "--virtual",
        "--script", "indent 1 mm at 500 mm/min; retract at 500 mm/min", "--json",
    )  # fmt: skip

    assert felt.code == 0, felt.stderr
    assert f"of {len(bundle.draws)} drawn from the population of 6 specimens" in felt.stderr + felt.stdout


def test_a_bundle_of_one_specimen_has_none_to_draw(out):
    felt = run("render", out / "bundle-head_1.h5", "--draw-specimen", "--device", "sim", "--virtual", code=2)
    assert "tissueid cohort OUT" in felt.stderr


def test_a_seed_that_is_no_number_is_refused(ended, out):
    felt = run("render", out / "population.h5", "--draw-specimen", "seven", "--device", "sim", "--virtual")

    assert felt.code == 2
    assert "the seed is a whole number" in felt.stderr


def test_two_specimens_are_refused_and_the_set_stays(tmp_path):
    folder = cohort_folder(tmp_path / "two", 2, study=False)

    run("cohort", folder, "-q", code=4, said="a population takes 3 at least")
    assert not (folder / "population.json").exists()
    validate_outputs(folder)


def test_an_unknown_covariate_names_those_there_are(out):
    run("cohort", out, "--covariate", "weight", code=2, said="stated are donor, sex")
