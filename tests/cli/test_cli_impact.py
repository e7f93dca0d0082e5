"""``tissueid fit --model "power * impact"``: from CSV to a bundle, and to a scene that is felt."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import run, write_csv
from impact_logs import impact_logs

from tissueid.errors import BundleError, UsageError
from tissueid.rendering.scene import load_scene
from tissueid.store.bundle import load_bundle
from tissueid.store.session_log import read_session_log
from tissueid.synth.recipe import Hold, Log, Move, Recipe

RAMP = (Move(4.0, 100.0),)
WHOLE = (*RAMP, Hold(2.0), Move(0.0, 100.0))
IMPACT = ("--model", "power * impact")
SCENE = (
    'schema = "tissueid/scene/1"\nname = "wall"\n[plan]\nentry_mm = [0, 0, 0]\naxis = [0, 0, 1]\n'
    '[guidance.funnel]\ncontact_law = "wall/bundle.h5"\n'
)


def recordings(folder: Path, moves: tuple[Move | Hold, ...]) -> Path:
    """Plain CSV of a body with k = 4, n = 1.5, e = 0.7."""
    plan = Recipe("wall", (Log("a", moves, repeats=2),), rate_Hz=100.0, sigma_N=0.1, contact_offset_mm=1.0)
    rng = np.random.default_rng(2)
    for log in impact_logs(plan, stiffness=4.0, exponent=1.5, restitution=0.7, rng=rng):
        write_csv(folder / f"{log.name}.csv", log.time_s, log.displacement_mm, log.force_N)
    return folder


@pytest.fixture(scope="module")
def wall(tmp_path_factory):
    """Output folder of a fit of one recording."""
    folder = tmp_path_factory.mktemp("wall")
    quick = ("--sampler", "none", "--no-study", "-q", "-o", folder / "out")
    run("fit", recordings(folder, WHOLE) / "a-1.csv", *IMPACT, *quick, code=0)
    return folder / "out"


def pushed_wall(folder: Path, moves: tuple[Move | Hold, ...], model: str, *, code: int) -> Any:
    """The specimen of a fit of recordings into ``wall``, beside a scene that names it."""
    (folder / "rig").mkdir()
    (folder / "scene.toml").write_text(SCENE)
    options = ("--model", model, "--sampler", "none", "--specimen-by", "(rig)", "--json")
    ended = run("fit", recordings(folder / "rig", moves), *options, "-o", folder / "wall", code=code)
    (specimen,) = ended.json()["specimens"]
    assert (code == 4) == any("damping_restitution" in one for one in ended.json()["exit"]["reasons"])
    return specimen


def test_the_simulated_device_gives_the_force_of_the_law(wall, tmp_path):
    ended = run(
        "render", wall / "bundle.h5", "--device", "sim", "--virtual", "--log", tmp_path / "felt.h5",
        "--script", "indent 3 mm at 12000 mm/min; hold 0.3 s; retract at 12000 mm/min; hold 0.2 s", code=0,
    )  # fmt: skip
    assert "below 50 mm/s is damped as one that began at it" in ended.stdout + ended.stderr
    felt, bundle = read_session_log(tmp_path / "felt.h5").records, load_bundle(wall / "bundle.h5")
    model, depth = bundle.contact_model(), felt["depth_mm"]
    static = model.static_force(bundle.theta, np.maximum(depth, 0.0))
    ratio = np.divide(felt["tissue_force_N"], static, out=np.zeros(depth.size), where=depth > 1.0)
    moving = np.gradient(depth, 1e-3)
    # 200 mm/s; the filter of 10 ms has seen the speed since air
    fast_in = (depth > 1.5) & (moving > 150.0)
    assert ratio[fast_in].size >= 5
    np.testing.assert_allclose(ratio[fast_in], 1.0 + model.factor(bundle.theta), rtol=0.02)
    # 0.1 s after the stop e^-10 of the damping is left; 1,000 ticks in all
    stands = np.flatnonzero(depth > 2.9)[100:250]
    np.testing.assert_allclose(ratio[stands], 1.0, rtol=2e-3)
    assert felt.size >= 700


@pytest.mark.parametrize("variant", ["flores", "exact"])
def test_the_law_of_recordings_is_written_and_felt_in_a_scene(tmp_path, variant):
    model = "power * impact" if variant == "flores" else "power * impact-exact"
    specimen = pushed_wall(tmp_path, WHOLE, model, code=0)
    found = {one["symbol"]: one for one in specimen["parameters"]}
    # the printed damping of e = 0.7 returns 0.683 of the speed
    for symbol, truth in {"c": 4.0, "n": 1.5, "e": 0.7 if variant == "flores" else 0.683}.items():
        assert abs(found[symbol]["value"] - truth) <= max(4.0 * found[symbol]["stderr"], 5e-4)
    funnel = load_scene(str(tmp_path / "scene.toml")).guidance.funnel
    assert (funnel.exponent, funnel.restitution) == (found["n"]["value"], found["e"]["value"])
    assert funnel.law == variant
    # k d^n is the same force whatever d is measured in
    there = funnel.stiffness_N_per_m_n * 0.002**funnel.exponent
    assert there == pytest.approx(found["c"]["value"] * 2.0 ** found["n"]["value"], rel=1e-12)


def test_what_ramps_do_not_determine_is_null_and_is_not_felt(tmp_path):
    specimen = pushed_wall(tmp_path, RAMP, "power * impact", code=4)
    values = {one["symbol"]: one["value"] for one in specimen["parameters"]}
    assert (values["c"], values["e"]) == (None, None)
    assert values["n"] == pytest.approx(1.5, abs=0.05)
    (flag,) = [one for one in specimen["flags"] if one["code"] == "one_speed_ratio"]
    # 4 (1 + 8 * 0.3 / 3.5) = 6.74
    told = re.search(r"only c \(1 \+ chi\) = ([0-9.]+) N/mm", flag["message"])
    assert float(told[1]) == pytest.approx(6.74, rel=0.05)
    with pytest.raises(UsageError, match="c, e not identified"):
        load_scene(str(tmp_path / "scene.toml"))


def test_a_law_that_is_none_is_refused_with_its_file(tmp_path):
    (tmp_path / "scene.toml").write_text(SCENE)
    with pytest.raises(BundleError, match=r"bundle\.h5"):
        load_scene(str(tmp_path / "scene.toml"))


def test_formats_of_exponentials_refuse_a_speed_ratio(wall, tmp_path):
    for form in ("c-header", "abaqus", "febio"):
        run(
            "export", wall, "--format", form, "-o", tmp_path / form, code=2, said="speed over that at contact"
        )
    run("export", wall, "--format", "mat", "-o", tmp_path / "mat", code=0)


def test_the_option_that_it_was_names_the_model(tmp_path):
    ended = run("fit", tmp_path, "--contact-law", "hertz-impact", code=2, said='--model "power * impact"')
    assert len(ended.stderr.strip().splitlines()) == 1
