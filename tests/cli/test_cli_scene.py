"""``tissueid render --scene``: what a file says is felt, what can't be is refused."""

from __future__ import annotations

import numpy as np
import pytest
from command_line import run

from tissueid.haptics.states import State
from tissueid.store.session_log import read_session_log

SIM = ("--device", "sim", "--yes")


def test_a_scene_with_a_tissue_is_that_tissue(tmp_path):
    log = tmp_path / "meat.h5"
    asked = ("--script", "indent 2 mm at 72 mm/min", "--virtual", "--log", log)
    ended = run("render", "--scene", "meat", *SIM, *asked, code=0)
    assert "A cut of meat" in ended.stderr + ended.stdout
    assert "assumed" in ended.stderr + ended.stdout
    assert read_session_log(log).head["tissues"][0]["name"] == "meat"


@pytest.mark.needs_jit
def test_a_guided_session_pulls_to_the_axis_and_its_log_says_by_what(tmp_path):
    plan, log = tmp_path / "patient.toml", tmp_path / "hip.h5"
    # the simulated hand rests in the middle of the workspace, 4 mm beside this axis
    plan.write_text("entry_mm = [4.0, 0.0, -15.0]\naxis = [0.0, 0.0, 1.0]\n", encoding="utf-8")
    ended = run(
        "render", "--scene", "hip-resurfacing", "--plan", plan, *SIM, "--seconds", "2.5", "--log", log, code=0
    )
    shown = ended.stderr + ended.stdout
    for words in ("Guide wire", "assumed", "N s/m of damping", "conservative"):
        assert words in shown
    found = read_session_log(log)
    assert found.head["environment"] == "guidance"
    assert found.head["tissues"][0]["block"][10:13] == pytest.approx([0.004, 0.0, 0.115])
    felt = found.records[found.records["state"] == State.ENGAGED]
    force = felt["force_N"]
    strongest = int(np.argmax(np.abs(force[:, 0])))
    # toward the axis, and upward by the axial force that keeps the pull conservative; a busy machine
    # skips ticks, after which the force rises again from zero, but it never pushes away from the axis
    assert force[strongest, 0] > 0.05
    assert force[strongest, 2] > 0.0
    assert force[:, 0].min() > -0.02
    np.testing.assert_allclose(felt["depth_mm"], 1e3 * (0.115 - felt["position_m"][:, 2]), atol=0.2)


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("--scene", "nothing"), "orbital-floor"),
        (("--plan", "PLAN"), "add --scene"),
        (("--scene", "hip-resurfacing", "--preset", "meat"), "brings what is felt"),
        (
            ("--scene", "hip-resurfacing", "--script", "indent 2 mm at 60 mm/min"),
            "takes the place of a tissue",
        ),
        (("--scene", "hip-resurfacing", "--virtual"), "--virtual"),
        (("--scene", "meat", "--plan", "PLAN"), "no guidance"),
    ],
)
def test_what_does_not_belong_together_is_refused(tmp_path, args, said):
    plan = tmp_path / "plan.toml"
    plan.write_text("entry_mm = [0.0, 0.0, 0.0]\naxis = [0.0, 0.0, 1.0]\n", encoding="utf-8")
    run("render", *(str(plan) if one == "PLAN" else one for one in args), *SIM, code=2, said=said)
