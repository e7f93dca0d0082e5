"""The weight of a grip, pose by pose: found behind friction, kept, and carried in a guided session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tissueid.errors import DeviceError
from tissueid.haptics.device import Capabilities, DetectedDevice, DeviceSample, HapticDevice
from tissueid.haptics.falcon.calibration import Calibration, load_calibration, save_calibration
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.measure.gravity import MIDDLE_M, POSES_M, fitted, weigh_poses
from tissueid.rendering.plan import _carried
from tissueid.rendering.scene import load_scene

HANDS_OFF = replace(GuardLimits(), dead_man=False, frozen_s=5.0)
TICK_S = 1e-3
WEIGHT_N = np.array([0.05, 0.7, -0.1])
SLOPE = np.array([[2.0, 0.0, 0.5], [0.0, 4.0, 0.0], [0.5, 0.0, -3.0]])


class HeavyGrip(HapticDevice):
    """A grip whose weight changes with its place, with friction; in virtual time."""

    name = "heavy"

    def __init__(self) -> None:
        super().__init__(HANDS_OFF)
        self._time, self._force = 0.0, np.zeros(3)
        self._place, self._speed = np.array(MIDDLE_M), np.zeros(3)

    @classmethod
    def detect(cls) -> list[DetectedDevice]:
        return []

    @property
    def capabilities(self) -> Capabilities:
        raise NotImplementedError

    def _open(self) -> None:
        pass

    def _close(self) -> None:
        pass

    def _read(self) -> DeviceSample:
        held = WEIGHT_N + SLOPE @ (self._place - MIDDLE_M)
        push = self._speed + TICK_S * (self._force - held - 0.5 * self._speed) / 0.25
        # Coulomb friction takes speed away, never turns it round
        size = float(np.linalg.norm(push))
        self._speed = push * max(size - TICK_S * 0.1 / 0.25, 0.0) / max(size, 1e-12)
        self._place = self._place + TICK_S * self._speed
        self._time += TICK_S
        counts = np.floor(self._place / 45e-6)
        return DeviceSample(self._time, 45e-6 * counts, counts.astype(int), 0, homed=True, valid=True)

    def _write(self, force_N: NDArray[np.float64]) -> None:
        self._force = np.array(force_N)


@pytest.mark.needs_jit
@pytest.mark.slow
def test_the_weight_is_found_behind_friction_and_encoders() -> None:
    device = HeavyGrip()
    device.open()
    for _ in range(60):
        device.read()
        device.write_force([0.0, 0.0, 0.0], TICK_S)
    found = weigh_poses(device, lambda _until: None)
    device.close()
    # friction of 0.1 N is in every force; to and fro it cancels to a tenth of that
    np.testing.assert_allclose(found.weight_N, WEIGHT_N, atol=0.01)
    np.testing.assert_allclose(found.slope_N_per_m, SLOPE, atol=0.5)
    assert found.residual_N < 0.02
    assert found.poses == len(POSES_M) == 9


def test_a_plane_through_exact_forces_is_the_plane() -> None:
    places = np.array(POSES_M)
    found = fitted(places, WEIGHT_N + (places - MIDDLE_M) @ SLOPE.T)
    np.testing.assert_allclose(found.weight_N, WEIGHT_N, atol=1e-12)
    np.testing.assert_allclose(found.slope_N_per_m, SLOPE, atol=1e-10)
    assert found.residual_N < 1e-12


def test_noise_of_the_forces_is_the_standard_error() -> None:
    places, chance = np.array(POSES_M), np.random.default_rng(1)
    clean = WEIGHT_N + (places - MIDDLE_M) @ SLOPE.T
    found = [fitted(places, clean + 0.05 * chance.standard_normal(clean.shape)) for _ in range(300)]
    spread = np.std([one.weight_N[1] for one in found])
    # nine poses around the middle: a third of the noise of one; 300 draws know a spread to 4 %
    assert spread == pytest.approx(0.05 / 3.0, rel=0.15)
    assert np.sqrt(np.mean([one.stderr_N**2 for one in found])) == pytest.approx(0.05 / 3.0, rel=0.1)


def test_a_kept_weight_is_read_again_and_a_wrong_one_refused(tmp_path: Path) -> None:
    known = Calibration(
        weight_N=tuple(WEIGHT_N.tolist()), weight_slope_N_per_m=tuple(SLOPE.ravel()), weight_measured=True
    )
    path = save_calibration(known, tmp_path / "falcon.toml")
    assert load_calibration(path) == known
    path.write_text("weight_N = [0.0, 0.7]\n")
    with pytest.raises(DeviceError, match="not 3 numbers"):
        load_calibration(path)
    path.write_text("weight_N = [0.0, 70.0, 0.0]\n")
    with pytest.raises(DeviceError, match="weight_N"):
        load_calibration(path)
    with pytest.raises(DeviceError, match="not kept"):
        save_calibration(replace(known, weight_N=(0.0, 9.0, 0.0)), path)


def test_a_guided_session_carries_what_was_measured_unless_the_scene_says_otherwise() -> None:
    known = Calibration(
        weight_N=tuple(WEIGHT_N.tolist()), weight_slope_N_per_m=tuple(SLOPE.ravel()), weight_measured=True
    )
    device = FalconDevice(calibration=known)
    plan = replace(
        load_scene("hip-resurfacing").guidance,
        weight_N=(0.0, 0.0, 0.0),
        weight_slope_N_per_m=((0.0,) * 3,) * 3,
    )
    carried = _carried(plan, device, assumed=False)
    there = WEIGHT_N + SLOPE @ (np.array(plan.entry_m) - MIDDLE_M)
    np.testing.assert_allclose(carried.weight_N, there, atol=1e-12)
    np.testing.assert_allclose(carried.weight_slope_N_per_m, SLOPE)
    stated = replace(plan, weight_N=(0.0, 1.0, 0.0))
    assert _carried(stated, device, assumed=False) == stated
    assert _carried(stated, device, assumed=True) == carried
    unknown = FalconDevice(calibration=replace(known, weight_measured=False))
    assert _carried(plan, unknown, assumed=True) == plan
