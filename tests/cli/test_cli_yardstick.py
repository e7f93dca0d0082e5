"""The yardstick reaches what it is the mark of, and is fitted, kept and felt without being quoted."""

from __future__ import annotations

import json

import numpy as np
import pytest
from command_line import run

import tissueid as ti
from tissueid.model.grammar import rebuilt


def pushed(stiffness, tau, *, noise=0.0, depth_mm=8.0, speed=25.0 / 6.0):
    """Table 1's cubic with a branch beside it, in closed form."""
    time = np.arange(0.0, 12.0, 0.01)
    begin, end = 0.5, 0.5 + depth_mm / speed
    x = np.clip(speed * (time - begin), 0.0, depth_mm)
    state = -speed * tau * np.expm1(-np.clip(time - begin, 0.0, end - begin) / tau)
    state = state * np.exp(-np.maximum(time - end, 0.0) / tau)
    force = 20.06 * x - 1.174 * x**2 + 0.3451 * x**3 + stiffness(x) * state
    force = force + np.random.default_rng(0).normal(0.0, noise, time.size) if noise else force
    return ti.Trial(time_s=time, displacement_mm=x, force_N=force)


@pytest.mark.parametrize(
    ("stiffness", "tau"), [(lambda x: 63.62 + 0.0 * x, 0.021), (lambda x: 20.0 * x, 2.0)], ids=["K", "20x"]
)
def test_laws_of_the_paper_are_reached_to_a_thousandth(stiffness, tau):
    trial = pushed(stiffness, tau)
    fit = ti.fit(trial, "yardstick")
    assert fit.result.nrmsd.range < 1e-4
    assert np.nanmax(np.abs(fit.residual(trial))) < 1e-3 * np.ptp(trial.force_N)
    model = fit.result.model
    assert model.branches == len(model.inside_s) + len(model.outside_s) <= 12
    assert rebuilt(model, fit.result.depth_mm).is_passive(fit.result.theta)


def test_noise_is_not_followed():
    fit = ti.fit(pushed(lambda x: 20.0 * x, 2.0, noise=1.0), "yardstick")
    # 17 to 30 weights of 1,200 samples
    assert 0.97 < fit.result.nrmsd.rmse_N < 1.05
    assert fit.result.parameters == ()
    assert fit.result.quoted is None
    assert "nothing to quote" in str(fit)


def test_the_choice_says_how_far_the_mark_is():
    fit = ti.fit(pushed(lambda x: 63.62 + 0.0 * x, 0.3, noise=0.5), "auto")
    assert fit.result.model.name != "yardstick"
    assert [row["chosen"] for row in fit.selection if row.get("model") == "yardstick"] == [False]
    assert "the yardstick misses" in str(fit)


@pytest.mark.system
def test_it_goes_from_a_recording_to_the_hand(tmp_path):
    trial = pushed(lambda x: 20.0 * x, 2.0, noise=0.3)
    rows = zip(trial.time_s, trial.displacement_mm, trial.force_N, strict=True)
    lines = ["time (s),displacement (mm),force (N)", *(f"{t:.3f},{x:.5f},{f:.5f}" for t, x, f in rows)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n", encoding="ascii")
    out = tmp_path / "out"
    ended = run("fit", tmp_path / "log.csv", "--model", "yardstick", "--json", "-o", out)
    assert ended.code == 0, ended.stderr
    document = json.loads(ended.stdout)["specimens"][0]
    assert document["model"]["name"] == "yardstick"
    assert document["parameters"] == []
    assert run("validate", out).code == 0
    assert (out / "report.html").stat().st_size > 10_000
    script = ("--script", "indent 4 mm at 250 mm/min; hold 1 s", "--virtual")
    assert run("render", out / "bundle.h5", "--device", "sim", *script).code == 0


def test_a_study_names_the_model(tmp_path, datasets):
    (tmp_path / "log.csv").write_bytes((datasets / "paper-a-hold-100Hz" / "hold-8-1.csv").read_bytes())
    study = tmp_path / "study.toml"
    said = 'schema = "tissueid/study/1"\n[model]\n{}\n'
    quick = ("--sampler", "none", "--json", "-o", tmp_path / "out")
    for line, name in (
        ('name = "power * prony"', "power * prony"),
        ('candidates = ["polynomial * prony:1", "power * fung"]', "polynomial * prony:1"),
    ):
        study.write_text(said.format(line), encoding="utf-8")
        ended = run("fit", tmp_path, *quick)
        assert ended.code in (0, 4), ended.stderr
        document = json.loads(ended.stdout)
        assert document["specimens"][0]["model"]["name"] == name
    # the command's word comes first
    ended = run("fit", tmp_path, "--model", "kelvin-voigt", *quick)
    assert json.loads(ended.stdout)["provenance"]["options"]["model"] == "kelvin-voigt"
    for line, words in (
        ('name = "hooke"', "'hooke' is no model"),
        ('name = "auto"\ncandidates = ["auto"]', "one of them"),
    ):
        study.write_text(said.format(line), encoding="utf-8")
        ended = run("fit", tmp_path, *quick)
        assert ended.code == 3
        assert words in ended.stderr
        assert "study.toml" in ended.stderr
