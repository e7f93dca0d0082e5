"""The [priors] and [population] tables of study.toml: what they mean, and how they are refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from command_line import run, write_study
from study_folder import fit, lab, specimen

from tissueid import FitOptions, IdentifyOptions, identify
from tissueid.documents.base import typed
from tissueid.documents.study import Priors as Recorded
from tissueid.errors import InputError, UsageError
from tissueid.ingest.manifest import read_study
from tissueid.manifest import Study
from tissueid.model import grammar
from tissueid.model.laws.static import Power
from tissueid.priors import PopulationPriors, Priors, SpreadPrior
from tissueid.store.schema import first_problem


def study_in(folder: Path, text: str) -> Study:
    return read_study(write_study(folder, text))


def priors_in(folder: Path, text: str) -> Priors:
    return study_in(folder, text).priors


WHOLE = """
[priors]
static_1_N_per_mm = {mean = 20.0, sd = 5.0}
stiffness_0_N_per_mm_b2 = {mean = 3, sd = 2}
relaxation_time_s = [{median = 0.02, sd_ln = 0.5}, {median = 4, sd_ln = 0.7}]
sigma_N = {median = 0.5, sd_ln = 0.3}
phi = {low = 0.2, high = 0.95}
gain_sd = {scale = 0.05}
"""


def test_every_prior_that_is_stated_is_kept_and_recorded_as_a_valid_table(tmp_path):
    found = priors_in(tmp_path, WHOLE)
    assert dict(found.linear) == {"static_1_N_per_mm": (20.0, 5.0), "stiffness_0_N_per_mm_b2": (3, 2)}
    assert found.relaxation_time_s == (SpreadPrior(0.02, 0.5), SpreadPrior(4, 0.7))
    assert found.sigma_N == SpreadPrior(0.5, 0.3)
    assert found.phi == (0.2, 0.95)
    assert found.gain_sd == 0.05
    for nothing in ("", "[priors]\n"):
        assert priors_in(tmp_path, nothing) == Priors()
    found = priors_in(tmp_path, WHOLE)
    document = {"schema": "tissueid/study/1", "priors": found.as_json()}
    assert first_problem(document, "study") is None
    assert document["priors"]["relaxation_time_s"][1] == {"median": 4, "sd_ln": 0.7}
    assert document["priors"]["static_1_N_per_mm"] == {"mean": 20.0, "sd": 5.0}
    # a default that is in use is recorded as well
    assert Priors().as_json() == {"phi": {"low": 0.0, "high": 1.0}, "gain_sd": {"scale": 0.3}}


def test_numbers_may_carry_another_unit(tmp_path):
    stated = {
        "static_1_N_per_mm": ("'0.02 kN/mm'", "'5 N/mm'", (20, 5)),
        "static_2_N_per_mm2": ("'2 N/mm^2'", "'1 N/mm2'", (2, 1)),
        "static_3_N_per_mm3": ("'1 kN/cm3'", "'1 N/cm^3'", (1, 1e-3)),
        "stiffness_1_N_per_mm2_b3": ("'1e6 N/m2'", "1", (1, 1)),
    }
    text = "".join(f"[priors.{name}]\nmean = {mean}\nsd = {sd}\n" for name, (mean, sd, _) in stated.items())
    times = "[[priors.relaxation_time_s]]\nmedian = '20 ms'\nsd_ln = 0.5\n"
    noise = "[priors.sigma_N]\nmedian = '500 mN'\nsd_ln = 1\n"
    found = priors_in(tmp_path, text + times + noise)
    # a conversion through base units is good to a few units in the last place
    for name, (_, _, expected) in stated.items():
        assert found.linear[name] == pytest.approx(expected, rel=1e-12)
    assert found.relaxation_time_s[0].median == pytest.approx(0.02, rel=1e-12)
    assert found.sigma_N.median == pytest.approx(0.5, rel=1e-12)


def test_priors_of_the_population_are_read_and_the_rest_keeps_its_default(tmp_path):
    found = study_in(
        tmp_path,
        "[population]\nmean_sd = 8\n[population.between]\nmedian = 0.15\nsd_ln = 0.3\n"
        "[population.tails]\nshape = 3\nrate = 0.2\n",
    )
    stated = PopulationPriors(mean_sd=8, between=SpreadPrior(0.15, 0.3), tail_shape=3, tail_rate=0.2)
    assert found.population == stated
    assert study_in(tmp_path, "").population is None
    with pytest.raises(InputError, match="sd_ln is missing") as refused:
        study_in(tmp_path, "[population]\n[population.between]\nmedian = 0.15\n")
    assert refused.value.line == 3


STATED = (
    "[priors]\nstatic_1_N_per_mm = {mean = 30.0, sd = 0.5}\n"
    "relaxation_time_s = [{median = '21 ms', sd_ln = 0.02}]\n[calibration]\nload_cell_class = 0.5\n"
)


def test_a_stated_prior_enters_the_posterior_and_is_shown_with_its_shrinkage(tmp_path):
    folder = lab(tmp_path / "lab", STATED, a=1.0)
    sample = ("--sampler", "emcee", "--draws", "400")
    _, document = fit(folder, *sample, out=tmp_path / "out")
    assert document["study"]["priors"]["static_1_N_per_mm"] == {"mean": 30.0, "sd": 0.5}
    assert document["provenance"]["study"]["priors"] == document["study"]["priors"]
    (found,) = document["specimens"]
    rows = {row["name"]: row for row in found["priors"]}
    assert rows["static_1_N_per_mm"]["stated"] is True
    assert "30" in rows["static_1_N_per_mm"]["prior"]
    assert rows["force_gain"]["stated"] is True
    assert rows["displacement_gain"]["stated"] is False
    # a relaxation time that is known to 2 % before can't be known worse after: sd of 400 draws, 3.5 % each
    time = next(one for one in specimen(document, "a")["parameters"] if one["name"] == "relaxation_time_s")
    sampled = time["detail"].get("posterior") or time
    assert sampled["sd"] <= 1.15 * 0.02 * 0.021
    run("validate", tmp_path / "out", code=0)


def test_parameters_of_any_law_have_priors_and_are_recorded(tmp_path):
    found = priors_in(
        tmp_path,
        "[priors.static_N_per_mm]\nmean = '2 N/mm'\nsd = 1\n"
        "[priors.static_exponent]\nmedian = 1.5\nsd_ln = 0.1\n"
        "[priors.relaxation_ratio_b2]\nmedian = 0.5\nsd_ln = 1\n",
    )
    linear = {"static_N_per_mm": (2.0, 1.0)}
    shapes = {"static_exponent": SpreadPrior(1.5, 0.1), "relaxation_ratio_b2": SpreadPrior(0.5, 1)}
    assert (dict(found.linear), dict(found.shapes)) == (linear, shapes)
    recorded = found.as_json()
    assert typed(recorded, Recorded) is not None
    assert {*linear, *shapes} <= set(recorded)


def test_a_prior_that_the_fitted_law_has_no_parameter_for_is_refused(tmp_path):
    study = study_in(tmp_path, "[priors.static_exponent]\nmedian = 1.5\nsd_ln = 0.1\n")
    with pytest.raises(UsageError, match=r"static_exponent\] is of no parameter of kelvin-voigt"):
        identify([], study=study)
    options = IdentifyOptions(fit=FitOptions(model="power * prony:2"))
    assert identify([], study=study, options=options).exit.code == 3


def test_a_law_that_is_registered_later_has_its_priors(tmp_path, monkeypatch):
    text = "[priors.static_own]\nmedian = 1.5\nsd_ln = 0.1\n"
    with pytest.raises(InputError, match="no prior of 'static_own'"):
        priors_in(tmp_path, text)
    spec = replace(Power.shapes[0].spec, name="static_own")
    own = type("Own", (Power,), {
        "about": replace(Power.about, key="own"),
        "shapes": (replace(Power.shapes[0], spec=spec),),
    })  # fmt: skip
    monkeypatch.setitem(grammar._OWN, "own", own)
    assert priors_in(tmp_path, text).shapes["static_own"] == SpreadPrior(1.5, 0.1)
