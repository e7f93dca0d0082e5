"""What is drawn of a guided axis lies where it is felt."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tissueid.rendering.guidance import funnel_touch
from tissueid.rendering.guidance_block import Bone, Funnel, Guidance, guidance_block
from tissueid.rendering.options import RenderOptions
from tissueid.rendering.plan import plan_session
from tissueid.rendering.scene import load_scene
from tissueid.viewer.hello import guided_objects, hello


@pytest.mark.parametrize("kind", ["hyperboloid", "cone"])
def test_the_drawn_funnel_is_the_one_that_is_felt(kind: str) -> None:
    funnel = Funnel(kind=kind)  # type: ignore[arg-type]
    plan = Guidance((0.01, 0.0, 0.12), (0.0, 0.6, 0.8), funnel=funnel)
    axis, drawn, bone = guided_objects(guidance_block(plan).tolist())
    json.dumps([axis, drawn, bone])
    assert [one["kind"] for one in (axis, drawn, bone)] == ["axis", "funnel", "bone"]
    np.testing.assert_allclose(drawn["entry_m"], plan.entry_m)
    np.testing.assert_allclose(drawn["axis"], [0.0, 0.6, 0.8])
    for r, z in drawn["profile_m"]:
        assert abs(funnel_touch(funnel.numbers(), 0, r, z, np.zeros(2), 0)) < 1e-9
    assert axis["from_m"] == -plan.bone.drill_depth_m
    assert bone["radius_m"] == plan.bone.radius_m


def test_where_there_is_no_bone_none_is_drawn() -> None:
    plan = Guidance((0.0, 0.0, 0.13), bone=Bone(radius_m=0.0))
    assert [one["kind"] for one in guided_objects(guidance_block(plan))] == ["axis", "funnel"]


def test_a_guided_session_has_its_scenes_title_a_wire_and_no_lamp_of_a_tissue() -> None:
    scene = load_scene("hip-resurfacing")
    words = hello(plan_session(RenderOptions(device="sim", seconds=1.0, scene=scene)).head)
    assert words["session"]["title"] == scene.name
    assert "bone" in words["hint"]
    assert not {"rupture", "outside"} & {lamp["id"] for lamp in words["lamps"]}
    (tool,) = [one for one in words["scene"]["objects"] if one["kind"] == "tool"]
    assert tool["shape"] == "wire"
    np.testing.assert_allclose(tool["axis"], scene.guidance.unit_axis())


def test_a_tissue_of_a_scene_has_its_title_and_all_lamps() -> None:
    scene = load_scene("orbital-floor")
    asked = RenderOptions(device="sim", seconds=1.0, scene=scene, **{"surface": "plane", **scene.tissue})
    words = hello(plan_session(asked).head)
    assert words["session"]["title"] == scene.name
    assert {"rupture", "outside"} <= {lamp["id"] for lamp in words["lamps"]}
