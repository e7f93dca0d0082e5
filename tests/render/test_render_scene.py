"""Scenes: files that say what is felt, with everything refused that can't be."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tissueid.errors import DeviceError, UsageError
from tissueid.rendering import guidance as gd
from tissueid.rendering.environment import GUIDANCE, GUIDED, KIND
from tissueid.rendering.guidance_block import (
    Bone,
    Funnel,
    Guidance,
    Pull,
    check_guidance,
    needed_damping,
    weaker,
)
from tissueid.rendering.options import ASSUMED_DEVICE, RenderOptions
from tissueid.rendering.plan import plan_session
from tissueid.rendering.scene import load_scene, scene_names

HEAD = 'schema = "tissueid/scene/1"\nname = "a scene"\n'
GUIDED_BODY = (
    "[plan]\nentry_mm = [1.0, 2.0, -3.0]\naxis = [0.0, 3.0, 4.0]\n[guidance.pull]\nreach_mm = 15.0\n"
)


def written(folder: Path, text: str) -> str:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_the_scenes_that_come_along_are_rendered_as_they_are_planned() -> None:
    assert scene_names() == ("hip-resurfacing", "meat", "orbital-floor")
    for name in ("meat", "orbital-floor"):
        scene = load_scene(name)
        plan = plan_session(RenderOptions(device="sim", seconds=1.0, scene=scene, **scene.tissue))
        assert plan.check is not None
        assert any("assumed" in line for line in plan.lines)
    hip = load_scene("hip-resurfacing")
    assert hip.guidance is not None
    # what the file says is what is assumed where nothing is said
    assert replace(hip.guidance, entry_m=(0.0, 0.0, 0.0)) == Guidance((0.0, 0.0, 0.0))
    guided, check = check_guidance(hip.guidance, ASSUMED_DEVICE)
    assert guided == hip.guidance
    assert check.strength == 1.0


def test_a_guided_session_has_its_block_and_says_what_is_assumed() -> None:
    plan = plan_session(RenderOptions(device="sim", seconds=1.0, scene=load_scene("hip-resurfacing")))
    block = plan.blocks[0]
    assert block[KIND] == GUIDANCE
    assert block[GUIDED + gd.TAU] == 0.05
    assert plan.check is None
    assert plan.head["environment"] == "guidance"
    assert plan.head["tissues"][0]["block"] == block.tolist()
    text = "\n".join(plan.lines)
    assert "pull.near_N_per_m" in text
    assert "N s/m of damping" in text
    json.dumps(dict(plan.head))


def test_lengths_are_in_millimetres_from_the_middle_of_the_workspace(tmp_path: Path) -> None:
    scene = load_scene(written(tmp_path, HEAD + GUIDED_BODY))
    np.testing.assert_allclose(scene.guidance.entry_m, [0.001, 0.002, 0.127])
    np.testing.assert_allclose(scene.guidance.unit_axis(), [0.0, 0.6, 0.8])
    assert scene.guidance.pull.reach_m == pytest.approx(0.015)
    assert scene.guidance.funnel == Funnel()


def test_the_plan_of_a_patient_takes_the_place_of_the_scene_s(tmp_path: Path) -> None:
    plan = tmp_path / "patient.toml"
    plan.write_text("entry_mm = [5.0, 0.0, 0.0]\naxis = [0.0, 0.0, 2.0]\n", encoding="utf-8")
    scene = load_scene("hip-resurfacing", plan=plan)
    np.testing.assert_allclose(scene.guidance.entry_m, [0.005, 0.0, 0.13])
    with pytest.raises(UsageError, match="no guidance"):
        load_scene("meat", plan=plan)
    plan.write_text("entry_mm = [5.0, 0.0]\naxis = [0.0, 0.0, 1.0]\n", encoding="utf-8")
    with pytest.raises(UsageError, match="entry_mm"):
        load_scene("hip-resurfacing", plan=plan)


def test_a_bundle_lies_beside_its_scene(tmp_path: Path) -> None:
    scene = load_scene(written(tmp_path, HEAD + '[tissue]\nbundle = "one.h5"\nmotion_scale = 3.0\n'))
    assert scene.tissue == {"bundle": tmp_path / "one.h5", "motion_scale": 3.0}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("schema = ", "no TOML"),
        (HEAD, "guidance|tissue"),
        (HEAD + '[tissue]\npreset = "meat"\n[guidance]\n', "guidance|tissue"),
        (HEAD + '[tissue]\npreset = "meat"\nbundle = "a.h5"\n', "tissue"),
        (HEAD + GUIDED_BODY + "[guidance.funnel]\nradius_mm = -4.0\n", "radius_mm"),
        (HEAD + GUIDED_BODY + "[guidance.funnel]\nwidth_mm = 4.0\n", "width_mm"),
        (HEAD + GUIDED_BODY + "[guidance.funnel]\nslope = 5.0\n", "closes a funnel"),
        (HEAD + GUIDED_BODY.replace("[0.0, 3.0, 4.0]", "[0.0, 0.0, 0.0]"), "direction"),
        (HEAD + GUIDED_BODY.replace("-3.0", "nan"), "finite"),
    ],
)
def test_a_scene_that_can_t_be_is_refused_with_its_place(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        load_scene(written(tmp_path, text))


def test_no_such_scene(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="hip-resurfacing, meat, orbital-floor"):
        load_scene(str(tmp_path / "none.toml"))


def test_guidance_takes_the_place_of_a_tissue() -> None:
    with pytest.raises(UsageError, match="takes the place of a tissue"):
        plan_session(RenderOptions(device="sim", preset="meat", scene=load_scene("hip-resurfacing")))


def test_a_stiff_plan_is_weakened_as_a_whole_until_the_device_bears_it() -> None:
    stiff = Guidance((0.0, 0.0, 0.13), pull=Pull(50.0, 400.0), funnel=Funnel(stiffness_N_per_m_n=2000.0))
    lowered, check = check_guidance(stiff, ASSUMED_DEVICE)
    assert check.planned_damping_N_s_per_m == needed_damping(stiff, ASSUMED_DEVICE) > 0.5
    assert 0.0 < check.strength < 1.0
    assert lowered == weaker(stiff, check.strength)
    assert lowered.pull.near_N_per_m / lowered.pull.far_N_per_m == pytest.approx(8.0)
    # as much as may be counted on, and no less than that
    assert check.required_damping_N_s_per_m == pytest.approx(0.95 * 0.5, rel=1e-3)
    assert f"{check.strength:.3g} of the plan" in check.lines()[1]
    # feed and times stay: resistance and stiffness of the bone go together
    assert lowered.bone.resistance_N_s_per_m / lowered.bone.stiffness_N_per_m == pytest.approx(1.5)


def test_the_need_is_that_of_the_pull_where_there_is_no_wall() -> None:
    from tissueid.model.passivity import damping_bound

    soft = Funnel(stiffness_N_per_m_n=1e-9)
    plan = Guidance((0.0, 0.0, 0.0), pull=Pull(0.0, 100.0), funnel=soft, bone=Bone(radius_m=0.0))
    # K (1 + tau s / (1 + t_f s)): a branch of K tau / t_f that relaxes in t_f
    expected = damping_bound(100.0, np.array([100.0]), np.array([0.05]), period_s=1e-3, delay_ticks=1.5)
    assert needed_damping(plan, ASSUMED_DEVICE) == pytest.approx(expected, rel=1e-6)


def test_guidance_that_could_not_be_felt_is_refused() -> None:
    hard = Guidance((0.0, 0.0, 0.13), funnel=Funnel(stiffness_N_per_m_n=1e6, restitution=0.1))
    with pytest.raises(DeviceError, match="can't be rendered on this device"):
        check_guidance(hard, ASSUMED_DEVICE)
