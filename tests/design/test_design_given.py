"""Machines, tissues and wants as they are given, and the files of a plan read back by their own readers."""

import csv
import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from design_cases import ETA, PAPER_A, TAU, asked_for, silent
from law_cases import LAWS, law_bundle

from tissueid.design.document import has_recipe, recipe_text, session_order, study_text, test_sheet
from tissueid.design.machine import PRESETS, Setting, found_machine
from tissueid.design.plan import planned
from tissueid.design.precision import given_protocol
from tissueid.design.tissues import (
    COARSEST_WANT,
    full_name,
    given_recipe,
    of_bundle,
    of_recipe_tissue,
    parsed_guess,
    parsed_want,
    plain_guesses,
    usual_wants,
)
from tissueid.errors import InputError, UsageError
from tissueid.ingest.manifest import read_study
from tissueid.store.bundle import write_bundle
from tissueid.synth import load_recipe, recipe

MACHINE_TOML = """\
name = "ours"
max_speed_mm_min = 300
acceleration_mm_s2 = 150.0
max_force_N = 50.0
frame_stiffness_N_per_mm = 900.0
[[setting]]
rate_Hz = 500
noise_N = 0.05
noise_correlation_s = 0.01
filter_s = 0.002
filter_sd_s = 0.0005
[[setting]]
rate_Hz = 50
noise_N = 0.02
"""


def machine_file(folder: Path, text: str = MACHINE_TOML) -> str:
    path = folder / "machine.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_a_machine_file_is_read_as_it_stands(tmp_path):
    machine = found_machine(machine_file(tmp_path))
    assert (machine.name, machine.max_speed_mm_min, machine.max_force_N) == ("ours", 300.0, 50.0)
    first, second = machine.settings
    # over one step of 2 ms, with 10 ms to fall to 1/e
    assert first.phi == pytest.approx(np.exp(-0.2))
    assert second.phi == 0.0
    sd = machine.calibration_sd(first)
    assert sd["force_filter_s"] == 0.0005
    # a stated frame whose own error is not stated: a tenth
    assert sd["frame_compliance_mm_per_N"] == pytest.approx(0.1 / 900.0)
    assert machine.calibration_sd(second)["force_filter_s"] == 0.005


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("max_speed_mm_min = 300\n", ""), "max_speed_mm_min is missing"),
        (("rate_Hz = 50\n", ""), r"\[\[setting\]\] 2: rate_Hz is missing"),
        (("noise_N = 0.05", 'noise_N = "low"'), "noise_N = 'low' must be a number above 0"),
        (("max_force_N = 50.0", "max_force_N = -1"), "max_force_N = -1 must be a number above 0"),
        (("[[setting]]", "[[another]]"), "says nothing of the load channel"),
        (("name =", "colour ="), "unknown key 'colour'; known are name"),
        (("name =", "name == "), "is not TOML"),
        (("acceleration", "min_speed_mm_min = 400\nacceleration"), "is above max_speed_mm_min = 300"),
    ],
)
def test_a_machine_that_says_too_little_is_refused_with_the_way_out(tmp_path, change, says):
    with pytest.raises(InputError, match=says):
        found_machine(machine_file(tmp_path, MACHINE_TOML.replace(*change)))


def test_unknown_machines_are_answered_with_the_presets():
    for named in (None, "none.toml"):
        with pytest.raises(UsageError, match="paper-a, bench, texture-analyser, slow-logger"):
            found_machine(named)


def test_wants_have_short_names():
    model = PAPER_A.model
    assert parsed_want("tau=5%", model).name == TAU
    assert parsed_want(" viscosity = 2.5 %", model) == parsed_want("eta=2.5%", model)
    assert parsed_want("eta=2%", model).share == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("tau=5", "write NAME=PERCENT%"),
        ("tau=0%", "can be wanted"),
        (f"tau={101 * COARSEST_WANT}%", "not identified"),
        ("colour=5%", "unknown number 'colour'"),
        ("tau_b2=5%", "unknown number 'tau_b2'"),
    ],
)
def test_wants_that_cannot_be_had_are_refused(text, says):
    with pytest.raises(UsageError, match=says):
        parsed_want(text, PAPER_A.model)


def guessed(*texts: str, draws: int = 16, depth_mm: float = 8.0):
    return plain_guesses([parsed_guess(text) for text in texts], depth_mm=depth_mm, count=draws)


def test_guesses_become_draws_with_their_spread():
    tissues = guessed("tau=0.02~30%", "eta=1.3", "static_1_N_per_mm=20", draws=64)
    numbers = tissues.numbers()
    assert tissues.theta.shape == (64, 5)
    assert np.median(numbers[TAU]) == pytest.approx(0.02, rel=0.02)
    # 30 % is a factor of 1.3
    assert np.log(numbers[TAU]).std() == pytest.approx(np.log(1.3), rel=0.1)
    assert numbers[ETA] == pytest.approx(np.full(64, 1.3))
    again = guessed("tau=0.02~30%", "eta=1.3", "static_1_N_per_mm=20", draws=64)
    assert (again.theta == tissues.theta).all()


def test_guesses_of_two_branches_and_of_a_growing_stiffness():
    tissues = guessed(
        "tau=0.02", "K=60", "tau_b2=1", "eta_b2=5", "stiffness_1_N_per_mm2=10", "static_1_N_per_mm=20"
    )
    assert (tissues.model.branches, tissues.model.stiffness_degree) == (2, 1)
    numbers = tissues.numbers()
    # at half depth: 60 + 10 * 4 N/mm
    assert numbers[ETA][0] == pytest.approx(0.02 * 100.0)
    assert numbers[f"{ETA}_b2"][0] == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("texts", "says"),
    [
        (("tau=0.02", "eta=1"), "says nothing of the static force"),
        (("eta=1", "static_1_N_per_mm=2"), "relaxation_time_s=... is missing"),
        (("tau=1", "static_1_N_per_mm=2"), "and has none"),
        (("tau=1", "eta=1", "K=1", "static_1_N_per_mm=2"), "and has both"),
        (("tau=1", "tau=2", "eta=1", "static_1_N_per_mm=2"), "given twice"),
        (("tau=-1", "eta=1", "static_1_N_per_mm=2"), "must be above 0"),
        (("tau", "eta=1"), "write NAME=VALUE"),
        (("tau=1~900%",), "a spread of 0 to 200 %"),
        (("tau=x", "eta=1"), "'x' is no number"),
        (("tau=1",), "add --max-depth"),
        (("tau=1", "eta=1", "static_1_N_per_mm=2", "static_2_N_per_mm2=-1"), "a negative force"),
    ],
)
def test_guesses_that_make_no_tissue_are_refused(texts, says):
    with pytest.raises(UsageError, match=says):
        guessed(*texts, depth_mm=None if "depth" in says else 8.0)


def test_a_recipe_gives_its_protocol_and_tissue():
    plan = given_recipe("paper-a-22")
    protocol = given_protocol(plan)
    assert sum(protocol.values()) == 22
    assert sorted({test.hold_s for test in protocol}) == [0.0, 30.0]
    assert of_recipe_tissue(plan).numbers()[ETA] == pytest.approx([63.62 * 0.021])
    with pytest.raises(UsageError, match="no such recipe or file"):
        given_recipe("paper-z")
    odd = replace(recipe("paper-a-22"), logs=(replace(plan.logs[0], moves=plan.logs[0].moves * 2),))
    with pytest.raises(UsageError, match="is not one ramp"):
        given_protocol(odd)


@pytest.mark.needs_jit
def test_the_files_of_a_plan_are_read_by_their_own_readers(tmp_path):
    machine = replace(
        PRESETS["paper-a"],
        settings=(Setting(100.0, 1.0, noise_correlation_s=0.02, filter_s=0.001, filter_sd_s=0.0001),),
        frame_stiffness_N_per_mm=800.0,
        frame_stiffness_N_per_mm_sd=40.0,
    )
    asked = asked_for({TAU: 0.05, ETA: 0.02}, machine)
    best = planned(machine, PAPER_A, asked, silent).best

    (tmp_path / "study.toml").write_text(study_text(best, machine, asked, title='a "plan"'), encoding="utf-8")
    study = read_study(tmp_path)
    assert study.calibration.values["sampling_Hz"] == 100.0
    assert study.calibration.values["force_filter_s"] == 0.001
    assert study.calibration.values["frame_stiffness_N_per_mm"] == 800.0
    assert [(entry["speed_mm_s"], entry["depth_mm"]) for entry in study.protocols.values()] == [
        (pytest.approx(test.speed_mm_s), test.depth_mm) for test in best.protocol
    ]

    (tmp_path / "recipe.toml").write_text(
        recipe_text(best, machine, PAPER_A, asked, name="planned"), encoding="utf-8"
    )
    back = load_recipe(tmp_path / "recipe.toml")
    assert given_protocol(back) == best.protocol
    assert (back.rate_Hz, back.ar1_sigma_N, back.sigma_N, back.force_filter_s) == (100.0, 1.0, 0.0, 0.001)
    assert back.ar1_phi == pytest.approx(np.exp(-0.5))

    rows = list(csv.DictReader(io.StringIO(test_sheet(best, asked))))
    assert len(rows) == best.logs
    assert len({row["file"] for row in rows}) == best.logs
    assert [float(row["rest_after_s"]) for row in rows] == [60.0] * (best.logs - 1) + [0.0]

    uneven = replace(best, protocol={test: 4 + 8 * k for k, test in enumerate(best.protocol)})
    order = [test for test, _ in session_order(uneven)]
    for test, count in uneven.protocol.items():
        # half of the repeats in the first half of the session, to one log
        assert abs(order[: len(order) // 2].count(test) - count / 2) <= 1.0


@pytest.mark.needs_jit
def test_a_bundle_of_any_law_is_planned_for_with_its_own_numbers(tmp_path):
    write_bundle(law_bundle("power * stretched", LAWS["power * stretched"]), tmp_path / "bundle.h5")

    tissues = of_bundle(tmp_path / "bundle.h5", count=16)

    assert tissues.theta.shape == (16, 5)
    wanted = ["relaxation_time_s", "relaxation_exponent", "stiffness_0_N_per_mm"]
    assert usual_wants(tissues.model) == wanted
    assert tissues.longest_tau_s == pytest.approx(0.08, rel=0.1)
    assert full_name("tau", tissues.model) == "relaxation_time_s"
    with pytest.raises(UsageError, match="unknown number 'eta'; this tissue has static_N_per_mm_n"):
        full_name("eta", tissues.model)
    assert not has_recipe(tissues.model)
    write_bundle(law_bundle("hertz * impact", [12.0, 0.8]), tmp_path / "bundle.h5")
    with pytest.raises(UsageError, match="no relaxing branch"):
        of_bundle(tmp_path / "bundle.h5", count=16)
