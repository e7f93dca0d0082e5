"""Draws by quantile, the noticeable difference, blind orders, surfaces and scripts."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from rendered_tissues import PAPER_A, bundle_of

from tissueid.documents.identification import TipGeometry
from tissueid.errors import BundleError, UsageError
from tissueid.haptics.sim import SimulatedDevice
from tissueid.rendering import options, tissue_block
from tissueid.rendering import surface as srf
from tissueid.rendering.session_plan import REST_S, check_pseudonym, draw_order, read_script, write_key

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
    assert (
        "with which tip" in tissue_block.surface_remarks(replace(PAPER_A, tip_radius_mm=None), plane, None)[0]
    )
    cone = replace(PAPER_A, tip_radius_mm=None, tip=TipGeometry("cone", 30.0))
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
    hand = script.hand(
        motion_scale=5.0, surface_m=np.array([0.0, 0.0, 0.15]), inward=np.array([0.0, 0.0, -1.0])
    )
    assert hand.rigid
    assert hand.positions_m[2][2] == pytest.approx(0.15 - 0.020)
