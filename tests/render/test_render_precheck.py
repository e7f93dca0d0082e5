"""Before a session: scales and the check of damping, scenes, draws, blind orders, surfaces and scripts."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from felt_block import preset_check
from rendered_tissues import PAPER_A, bundle_of

from tissueid.documents.identification import TipGeometry
from tissueid.errors import BundleError, DeviceError, UsageError
from tissueid.haptics.sim import SimulatedDevice
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.passivity import required_damping
from tissueid.rendering import guidance as gd
from tissueid.rendering import guidance_block as guiding
from tissueid.rendering import options, tissue_block
from tissueid.rendering import surface as srf
from tissueid.rendering.environment import GUIDANCE, GUIDED, KIND
from tissueid.rendering.guidance_block import Funnel, Guidance, Pull, check_guidance
from tissueid.rendering.options import ASSUMED_DEVICE, PRESETS, RenderOptions, preset_tissue
from tissueid.rendering.plan import plan_session
from tissueid.rendering.precheck import Demands, check_before_force, scaling_at
from tissueid.rendering.scene import load_scene, scene_names
from tissueid.rendering.session_plan import REST_S, check_pseudonym, draw_order, read_script, write_key
from tissueid.rendering.tissue_block import Tissue

FALCON_LIKE = Demands(clamp_N=5.0, damping_N_s_per_m=0.5, delay_ticks=1.5)
STRONG = replace(FALCON_LIKE, damping_N_s_per_m=20.0)


def forces(depth: np.ndarray | float) -> np.ndarray:
    """The tissue's force at depths that are reached at its fastest speed: closed form [N]."""
    a1, a2, a3, k, tau = PAPER_A.theta
    lag_mm = PAPER_A.speeds_mm_s[1] * tau
    return np.asarray(a1 * depth + a2 * depth**2 + a3 * depth**3 - k * lag_mm * np.expm1(-depth / lag_mm))


def test_with_damping_to_spare_the_deepest_force_takes_nine_tenths_of_the_clamp() -> None:
    check = check_before_force(PAPER_A, STRONG)
    peak = float(forces(8.0))
    assert check.scaling.force == pytest.approx(0.9 * 5.0 / peak, rel=1e-12)
    assert check.scaling.peak_force_N == pytest.approx(4.5, rel=1e-12)
    assert not check.lowered
    # 1/49.2 and 452 N/m at 5 N, for a peak of 221.4 N instead of 228.4
    assert check.force_over == pytest.approx(49.2 * peak / 221.4, rel=2e-3)
    assert check.stiffness_over == pytest.approx(5.0 * check.force_over, rel=1e-12)


def test_the_scale_is_lowered_until_the_devices_damping_bears_it() -> None:
    check = check_before_force(PAPER_A, FALCON_LIKE)
    assert check.lowered
    needed = required_damping(PAPER_A.model, PAPER_A.theta, check.scaling, period_s=0.001, delay_ticks=1.5)
    assert check.required_damping_N_s_per_m == pytest.approx(needed, rel=1e-9)
    assert needed == pytest.approx(0.95 * 0.5, rel=1e-9)
    text = "\n".join(check.lines())
    for number in (check.force_over, check.stiffness_over):
        assert f"measured/{number:.4g}" in text
    assert "lowered" in text
    assert "not measured on this unit" in text


def test_a_scale_that_was_asked_for_is_kept_or_refused_with_the_largest_that_fits() -> None:
    assert check_before_force(PAPER_A, FALCON_LIKE, force_scale=0.01).scaling.force == 0.01
    with pytest.raises(DeviceError, match="largest that fits") as refusal:
        check_before_force(PAPER_A, FALCON_LIKE, force_scale=0.02)
    assert refusal.value.exit_status == 5
    largest = float(refusal.value.message.split("motion scale 5 is ")[1].split(" ")[0])
    assert check_before_force(PAPER_A, FALCON_LIKE, force_scale=largest).scaling.force == largest
    with pytest.raises(DeviceError):
        check_before_force(PAPER_A, FALCON_LIKE, force_scale=1.02 * largest)


def test_a_tissue_that_could_not_be_felt_any_more_is_refused() -> None:
    model = kelvin_voigt(branches=0, stiffness_degree=0, depth_mm=0.05)
    stiff = Tissue(model, np.array([4000.0, 0.0, 0.0]), PAPER_A.speeds_mm_s)
    for tissue, device in ((stiff, FALCON_LIKE), (PAPER_A, replace(FALCON_LIKE, damping_N_s_per_m=0.0))):
        with pytest.raises(DeviceError, match="can't be felt on this device"):
            check_before_force(tissue, device)


def test_what_the_clamp_takes_is_told_before() -> None:
    scale = scaling_at(PAPER_A, force=0.02, motion=5.0)
    check = check_before_force(PAPER_A, replace(STRONG, clamp_N=2.0), force_scale=0.02)
    assert check.scaling == scale
    clipped = 0.02 * forces(np.linspace(0.0, 8.0, 100_001)) > 2.0
    assert check.clipped_share == pytest.approx(clipped.mean(), abs=0.003)


def test_travel_the_device_does_not_have_is_remarked() -> None:
    remarks = check_before_force(PAPER_A, replace(STRONG, travel_m=0.02)).remarks
    assert any("can't be reached" in remark for remark in remarks)


@pytest.mark.parametrize(
    "scales", [{"force_scale": 0.0}, {"force_scale": 11.0}, {"motion_scale": 0.0}, {"motion_scale": -1.0}]
)
def test_scales_that_nobody_means_are_refused(scales: dict[str, float]) -> None:
    with pytest.raises(UsageError, match="must lie within"):
        check_before_force(PAPER_A, FALCON_LIKE, **scales)


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_a_preset_needs_no_more_damping_than_is_assumed(name: str) -> None:
    check = preset_check(name)
    tissue = preset_tissue(name)
    loop = {"period_s": 0.001, "delay_ticks": ASSUMED_DEVICE.delay_ticks}
    needed = required_damping(tissue.model, tissue.theta, check.scaling, **loop)
    assert needed <= ASSUMED_DEVICE.damping_N_s_per_m == 0.5
    assert check.scaling.peak_force_N <= 0.9 * 5.0
    assert tissue.model.is_passive(tissue.theta)
    assert tissue.model.contact_loss_is_unique(tissue.theta)


def test_an_unknown_preset_is_answered_with_those_there_are() -> None:
    with pytest.raises(UsageError, match="paper-a"):
        preset_tissue("papr-a")


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
    # what the file says is what is assumed where nothing is said
    assert replace(hip.guidance, entry_m=(0.0, 0.0, 0.0)) == Guidance((0.0, 0.0, 0.0))
    guided, check = check_guidance(hip.guidance, ASSUMED_DEVICE)
    assert guided == hip.guidance
    assert check.strength == 1.0


def test_a_guided_session_has_its_block_and_says_what_is_assumed() -> None:
    plan = plan_session(RenderOptions(device="sim", seconds=1.0, scene=load_scene("hip-resurfacing")))
    block = plan.blocks[0]
    assert (block[KIND], block[GUIDED + gd.TAU]) == (GUIDANCE, 0.05)
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
    assert check.planned_damping_N_s_per_m == guiding.needed_damping(stiff, ASSUMED_DEVICE) > 0.5
    assert 0.0 < check.strength < 1.0
    assert lowered == guiding.weaker(stiff, check.strength)
    assert lowered.pull.near_N_per_m / lowered.pull.far_N_per_m == pytest.approx(8.0)
    # as much as may be counted on, and no less than that
    assert check.required_damping_N_s_per_m == pytest.approx(0.95 * 0.5, rel=1e-3)
    assert f"{check.strength:.3g} of the plan" in check.lines()[1]
    # feed and times stay: resistance and stiffness of the bone go together
    assert lowered.bone.resistance_N_s_per_m / lowered.bone.stiffness_N_per_m == pytest.approx(1.5)


def test_the_need_is_that_of_the_pull_where_there_is_no_wall() -> None:
    from tissueid.model.passivity import damping_bound

    soft = Funnel(stiffness_N_per_m_n=1e-9)
    plan = Guidance((0.0, 0.0, 0.0), pull=Pull(0.0, 100.0), funnel=soft, bone=guiding.Bone(radius_m=0.0))
    # K (1 + tau s / (1 + t_f s)): a branch of K tau / t_f that relaxes in t_f
    expected = damping_bound(100.0, np.array([100.0]), np.array([0.05]), period_s=1e-3, delay_ticks=1.5)
    assert guiding.needed_damping(plan, ASSUMED_DEVICE) == pytest.approx(expected, rel=1e-6)


def test_guidance_that_could_not_be_felt_is_refused() -> None:
    hard = Guidance((0.0, 0.0, 0.13), funnel=Funnel(stiffness_N_per_m_n=1e6, restitution=0.1))
    with pytest.raises(DeviceError, match="can't be rendered on this device"):
        check_guidance(hard, ASSUMED_DEVICE)


SIX_MM = options.Functional(6.0, 250.0 / 60.0)


def softer(share: float) -> np.ndarray:
    """Paper A's tissue with all its forces scaled."""
    return np.append(PAPER_A.theta[:4] * share, PAPER_A.theta[4])


def test_a_functional_is_read_as_it_is_said_or_refused():
    for text, depth, speed in (
        ("force at 6 mm, 250 mm/min", 6.0, 250.0 / 60.0),
        ("  force  at 2.5mm ,  4 mm/s ", 2.5, 4.0),
        ("force at .5 mm, 10 mm / min", 0.5, 10.0 / 60.0),
    ):
        assert options.parse_functional(text) == options.Functional(depth, pytest.approx(speed))
    for text in ("", "stiffness", "force at 6 mm", "force at 0 mm, 250 mm/min", "force at -1 mm, 2 mm/s"):
        with pytest.raises(UsageError):
            options.parse_functional(text)


def test_the_quantile_is_rendered_by_the_nearest_draw():
    shares = np.random.default_rng(4).uniform(0.8, 1.2, 101)
    bundle = bundle_of(PAPER_A, draws=np.array([softer(share) for share in shares]))
    picked = options.pick_quantile(bundle, 0.5, SIX_MM)
    # the functional is linear in the share, so its median is the median share, and a draw has it
    assert picked.draw == int(np.argsort(shares)[50])
    assert np.array_equal(picked.tissue.theta, softer(shares[picked.draw]))
    assert np.array_equal(options.pick_draw(bundle, 7).tissue.theta, softer(shares[7]))


def test_a_bundle_without_draws_has_no_quantile():
    for pick in (lambda b: options.pick_quantile(b, 0.5, SIX_MM), lambda b: options.pick_draw(b, 0)):
        with pytest.raises(UsageError, match="no posterior draws"):
            pick(bundle_of(PAPER_A))


def test_a_normalised_bundle_can_not_be_felt():
    with pytest.raises(BundleError, match="normalised"):
        options.as_tissue(bundle_of(PAPER_A, units={"length": "1", "force": "MPa", "time": "s"}))


def test_a_difference_of_seven_percent_is_just_noticeable():
    stiffer = replace(PAPER_A, theta=softer(1.0 / (1.0 - 0.035)))
    softened = replace(PAPER_A, theta=softer(1.0 / (1.0 + 0.035)))
    one, other, ratio = options.noticeable_ratio(stiffer, softened, SIX_MM, force_scale=0.02)
    assert one / other == pytest.approx(1.035 / 0.965, rel=1e-9)
    # (1/0.965 - 1/1.035) over 7 % of their mean
    assert ratio == pytest.approx((1 / 0.965 - 1 / 1.035) / (0.07 * 0.5 * (1 / 0.965 + 1 / 1.035)), rel=1e-9)
    # under 0.5 N the difference that is noticed no longer shrinks with the force
    _, _, faint = options.noticeable_ratio(stiffer, softened, SIX_MM, force_scale=0.0002)
    assert faint < 0.1 * ratio


def test_a_blind_order_is_balanced_random_and_repeatable():
    order = draw_order(2, 20, pseudonym="P1", seed=5)
    assert sorted(order.tissues) == [0] * 10 + [1] * 10
    assert order == draw_order(2, 20, pseudonym="P1", seed=5)
    assert len({draw_order(2, 20, pseudonym="P1").tissues for _ in range(20)}) > 15


@pytest.mark.parametrize(("count", "presentations"), [(1, 4), (2, 5), (2, 0), (2, 202)])
def test_an_order_that_can_not_be_balanced_is_refused(count, presentations):
    with pytest.raises(UsageError):
        draw_order(count, presentations, pseudonym="P1")


@pytest.mark.parametrize("name", ["Anna", "anna.smith", "P", "17", "P-123456", "P17 "])
def test_a_pseudonym_that_could_be_a_name_is_refused(name):
    with pytest.raises(UsageError, match="could be a name"):
        check_pseudonym(name)
    assert check_pseudonym("P-17") == "P-17"
    assert check_pseudonym(check_pseudonym(None))


def test_an_answer_key_is_for_its_owner_and_never_overwritten(tmp_path):
    order = draw_order(2, 4, pseudonym="P1", seed=1)
    write_key(tmp_path / "key.json", order, [{"name": "a"}, {"name": "b"}])
    document = json.loads((tmp_path / "key.json").read_text())
    assert [one["tissue"] for one in document["presentations"]] == list(order.tissues)
    assert (tmp_path / "key.json").stat().st_mode & 0o777 == 0o600
    with pytest.raises(UsageError, match="never overwritten"):
        write_key(tmp_path / "key.json", order, [])
    with pytest.raises(UsageError, match="can't be written"):
        write_key(tmp_path / "missing" / "key.json", order, [])


def test_an_unknown_tip_is_remarked_and_a_cone_that_the_bundle_states_has_no_radius():
    plane = tissue_block.parse_surface("plane")
    unknown = replace(PAPER_A, tip_radius_mm=None)
    assert "with which tip" in tissue_block.surface_remarks(unknown, plane, None)[0]
    cone = replace(unknown, tip=TipGeometry("cone", 30.0))
    assert tissue_block.surface_remarks(cone, plane, None) == []


def test_surfaces_are_read_and_refused():
    assert tissue_block.parse_surface("plane") == ("plane", ())
    assert tissue_block.parse_surface(" sphere 60 mm") == ("sphere", (60.0,))
    assert tissue_block.parse_surface("box 60 x 50.5 x 40 mm") == ("box", (60.0, 50.5, 40.0))
    for text in ("", "sphere", "sphere 0 mm", "box 1 x 2 mm", "sphere -3 mm", "ball 3 mm"):
        with pytest.raises(UsageError):
            tissue_block.parse_surface(text)


@pytest.mark.parametrize("shape", [("plane", ()), ("sphere", (60.0,)), ("box", (60.0, 60.0, 40.0))])
def test_every_surface_is_touched_at_the_same_height(shape):
    device = SimulatedDevice().capabilities
    placed = tissue_block.place_surface(shape, device, depth_mm=8.0, motion_scale=5.0, tool_radius_m=0.01)
    block, memory = placed.numbers(0.01), np.zeros(srf.TOUCH_SIZE)
    # 20 mm above the middle of the workspace, so that 40 mm of travel lie around it
    height = 0.130 + 0.020
    assert srf.touch(block, 0, np.array([0.0, 0.0, height]), memory, 0) == pytest.approx(0.0, abs=1e-12)
    assert memory[srf.OUTWARD :] == pytest.approx([0.0, 0.0, 1.0])
    assert tissue_block.travel_behind(placed, device, tool_radius_m=0.01) == pytest.approx(0.060)
    assert np.array_equal(tissue_block.surface_from(block).numbers(0.01), block)


def test_a_tip_that_was_not_identified_is_refused():
    assert tissue_block.surface_remarks(PAPER_A, ("plane", ()), 2.0) == []
    with pytest.raises(BundleError, match="identified with a tip of 2 mm"):
        tissue_block.surface_remarks(PAPER_A, ("plane", ()), 3.0)


def test_curvature_is_remarked_then_refused_by_hertz():
    # 1 - sqrt(R / (R + r)) for a tip of 2 mm: 2 % at R = 48.5 mm, 25 % at 2.57 mm
    assert tissue_block.surface_remarks(PAPER_A, ("sphere", (60.0,)), None) == []
    (remark,) = tissue_block.surface_remarks(PAPER_A, ("sphere", (30.0,)), None)
    assert "3 % softer" in remark
    with pytest.raises(BundleError, match="too small"):
        tissue_block.surface_remarks(PAPER_A, ("sphere", (10.0,)), None)
    large_tip = replace(PAPER_A, tip_radius_mm=40.0)
    with pytest.raises(BundleError, match="38 % softer"):
        tissue_block.surface_remarks(large_tip, ("sphere", (25.0,)), None)
    (edge,) = tissue_block.surface_remarks(large_tip, ("box", (60.0, 60.0, 40.0)), None)
    assert "edges" in edge


def test_a_script_knows_its_strokes_switches_and_length():
    script = read_script("indent 4 mm at 250 mm/min; retract at 5 mm/s; switch; hold 1 s")
    down, up = 4.5 / (250.0 / 60.0), 4.5 / 5.0
    assert script.switches_s == pytest.approx((REST_S + down + up,))
    assert script.duration_s == pytest.approx(REST_S + down + up + 1.0 + 0.05)
    surface, inward = np.array([0.0, 0.0, 0.15]), np.array([0.0, 0.0, -1.0])
    hand = script.hand(motion_scale=5.0, surface_m=surface, inward=inward)
    assert hand.rigid
    assert hand.positions_m[2][2] == pytest.approx(0.15 - 0.020)
