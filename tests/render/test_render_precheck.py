"""The scale is computed from the guard's clamp and lowered, or refused, by the damping the device lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from felt_block import preset_check
from rendered_tissues import PAPER_A

from tissueid.errors import DeviceError, UsageError
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.passivity import required_damping
from tissueid.rendering.options import ASSUMED_DEVICE, PRESETS, preset_tissue
from tissueid.rendering.precheck import Demands, check_before_force, scaling_at
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
    kept = check_before_force(PAPER_A, FALCON_LIKE, force_scale=0.01)
    assert kept.scaling.force == 0.01
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
    assert any(
        "can't be reached" in remark
        for remark in check_before_force(PAPER_A, replace(STRONG, travel_m=0.02)).remarks
    )


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
    needed = required_damping(
        tissue.model, tissue.theta, check.scaling, period_s=0.001, delay_ticks=ASSUMED_DEVICE.delay_ticks
    )
    assert needed <= ASSUMED_DEVICE.damping_N_s_per_m == 0.5
    assert check.scaling.peak_force_N <= 0.9 * 5.0
    assert tissue.model.is_passive(tissue.theta)
    assert tissue.model.contact_loss_is_unique(tissue.theta)


def test_an_unknown_preset_is_answered_with_those_there_are() -> None:
    with pytest.raises(UsageError, match="paper-a"):
        preset_tissue("papr-a")
