"""Measurements of a device on itself, against simulated devices whose numbers are known."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fake_device import FakeDevice
from numpy.typing import NDArray

from tissueid.errors import DeviceError
from tissueid.haptics import measure
from tissueid.haptics.arm import Arm
from tissueid.haptics.device import DeviceSample, HapticDevice
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.hand import Hand
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.sim import SimulatedDevice
from tissueid.rendering.plan import _carried
from tissueid.rendering.scene import load_scene

#: Seconds of a device in virtual time, a millisecond each.
pytestmark = pytest.mark.needs_jit

#: No hand on the grip, and time for it to leave its stop.
HANDS_OFF = replace(GuardLimits(), dead_man=False, frozen_s=5.0)
TICK_S = 1e-3
UP, NO_SLOPE = np.array([0.0, 1.0, 0.0]), np.zeros((3, 3))
Vector = NDArray[np.float64]


@pytest.fixture(autouse=True)
def _no_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    """A device in virtual time is never waited for."""
    monkeypatch.setattr(measure, "wait_for", lambda _until: None)


class Grip(FakeDevice):
    """A free grip in virtual time: a weight that changes with the place, friction, a stop below."""

    def __init__(
        self, weight_N: Vector = 0.06 * measure.GRAVITY * UP, slope: Vector = NO_SLOPE, truth: float = 1.0
    ) -> None:
        super().__init__(HANDS_OFF)
        self.hung_kg = 0.0
        self._truth, self._slope, self._weight_N = truth, slope, weight_N
        self._force, self._speed, self._place = np.zeros(3), np.zeros(3), np.array(measure.MIDDLE_M)

    def _read(self) -> DeviceSample:
        inertia = 0.25 + self.hung_kg
        held = self._weight_N + self._slope @ (self._place - measure.MIDDLE_M)
        held = held + self.hung_kg * measure.GRAVITY * UP
        push = self._speed + TICK_S * (self._truth * self._force - held - 0.5 * self._speed) / inertia
        if self._place[1] <= -0.07:
            push[1] = max(push[1], 0.0)
        # Coulomb friction of 0.1 N takes speed away, never turns it round
        size = float(np.linalg.norm(push))
        self._speed = push * max(size - TICK_S * 0.1 / inertia, 0.0) / max(size, 1e-12)
        self._place = self._place + TICK_S * self._speed
        self._place[1] = max(self._place[1], -0.07)
        self.counts = np.floor(self._place / 45e-6).astype(int)
        self.position = 45e-6 * self.counts
        return super()._read()

    def _write(self, force_N: Vector) -> None:
        self._force = np.array(force_N)


def homed(device: HapticDevice) -> None:
    device.open()
    for _ in range(60):
        device.read()
        device.write_force([0.0, 0.0, 0.0], TICK_S)


@pytest.fixture
def hanging(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Grip]]:
    """Makes a homed grip; two periods of weighing are enough."""
    monkeypatch.setattr(measure, "PERIODS", 2)
    made = []

    def make(*options: Any, **more: Any) -> Grip:
        made.append(Grip(*options, **more))
        homed(made[-1])
        return made[-1]

    yield make
    for device in made:
        device.close()


@pytest.mark.parametrize(("truth", "grams"), [(1.9, 150.0), (0.7, 50.0)])
def test_weighing_finds_the_newton_of_a_device(hanging, truth, grams):
    device = hanging(truth=truth)
    hang = lambda: setattr(device, "hung_kg", grams / 1000)  # noqa: E731
    found = measure.weigh(device, grams / 1000, hang)
    # friction of 0.1 N is in every force; up and down it cancels to a tenth of a per cent
    assert found.ratio == pytest.approx(1.0 / truth, rel=2e-3)
    assert found.empty_N == pytest.approx(0.06 * measure.GRAVITY / truth, rel=5e-3)
    assert found.weight_N == pytest.approx(grams / 1000 * 9.80665, rel=1e-12)


@pytest.mark.parametrize(
    ("own_kg", "reason"),
    [
        (0.06, r"the mass was not felt: .* 0\.59 N without it and 0\.59 N with it"),
        # 2 N of clamp at a truth of 1: 190 g are 1.86 N, and friction and swing need more; 300 g are 2.9 N
        (0.19, "needs the whole.*smaller mass"),
        (0.30, "did not lift the grip.*smaller mass"),
    ],
)
def test_a_mass_that_was_not_hung_or_is_too_heavy_for_the_clamp_is_told(hanging, own_kg, reason):
    with pytest.raises(DeviceError, match=reason):
        measure.weigh(hanging(own_kg * measure.GRAVITY * UP), 0.1, lambda: None)


@pytest.mark.parametrize(("arm", "delay_ticks"), [(Arm(0.25, 0.5, 0.1), 1.5), (Arm(0.20, 1.5, 0.0), 2.5)])
def test_a_swing_tells_mass_damping_and_friction(arm, delay_ticks):
    free = Hand((0.0,), ((0.0, 0.0, 0.13),), (0.0,))
    device = SimulatedDevice(HANDS_OFF, arm=arm, hand=free, delay_ticks=delay_ticks)
    homed(device)
    found = measure.ring_down(device, delay_ticks * TICK_S)
    # counts of 45 um and windows of 30 ms; the bars hold for seeds and arms tried beside these
    assert found.mass_kg == pytest.approx(arm.mass_kg, rel=0.02)
    assert found.damping_N_s_per_m == pytest.approx(arm.damping_N_s_per_m, abs=0.02)
    assert found.friction_N == pytest.approx(arm.friction_N, abs=0.005)
    assert found.safe_damping < arm.damping_N_s_per_m
    assert found.safe_damping > arm.damping_N_s_per_m - 0.1
    device.close()


def test_a_grip_that_is_held_gives_no_damping():
    time_s = np.arange(0.0, 14.0, 1e-3)
    place = np.tile([0.0, 0.0, 0.13], (len(time_s), 1))
    with pytest.raises(DeviceError, match="hardly moved"):
        measure.estimate_arm(measure.Motion(time_s, place, np.zeros_like(place)), 1.5e-3)


class Clocked(SimulatedDevice):
    """A simulated device whose answer takes a set time on a set clock, and sometimes does not come."""

    answer_s = 0.0
    now_s = 0.0
    lost_every = 0
    _asked = 0

    def _read(self) -> DeviceSample:
        self._asked += 1
        type(self).now_s += self.answer_s
        sample = super()._read()
        lost = bool(self.lost_every) and self._asked % self.lost_every == 0
        return replace(sample, valid=not lost, damaged=int(lost))


@pytest.fixture
def clocked(monkeypatch: pytest.MonkeyPatch) -> Iterator[Clocked]:
    Clocked.now_s = 0.0
    monkeypatch.setattr(measure.time, "monotonic", lambda: Clocked.now_s)
    with Clocked() as device:
        yield device


@pytest.mark.parametrize(("answer_ms", "ticks"), [(0.3, 1.5), (0.9, 1.5), (1.4, 2.5)])
def test_delay_is_whole_ticks_until_the_answer_and_half_a_tick(clocked, answer_ms, ticks):
    clocked.answer_s, clocked.lost_every = answer_ms * 1e-3, 10
    report = measure.measure_link(clocked, 1.0)
    assert report.delay_ticks == pytest.approx(ticks, abs=1e-9)
    assert report.round_trip_ms == pytest.approx((answer_ms,) * 3, rel=1e-6)
    assert report.rate_hz == pytest.approx(0.9 * 1e3 / answer_ms, rel=0.01)
    # one in ten was lost
    assert report.commands - report.replies == pytest.approx(report.commands / 10, abs=1)
    assert report.damaged == report.commands - report.replies


def test_a_device_that_never_answers_is_told(clocked):
    clocked.answer_s, clocked.lost_every = 0.002, 1
    with pytest.raises(DeviceError, match="answered none of 50 commands"):
        measure.measure_link(clocked, 0.1)


WEIGHT_N = np.array([0.05, 0.7, -0.1])
SLOPE = np.array([[2.0, 0.0, 0.5], [0.0, 4.0, 0.0], [0.5, 0.0, -3.0]])
KNOWN = Calibration(
    weight_N=tuple(WEIGHT_N.tolist()), weight_slope_N_per_m=tuple(SLOPE.ravel()), weight_measured=True
)


@pytest.mark.slow
def test_the_weight_is_found_behind_friction_and_encoders():
    device = Grip(weight_N=WEIGHT_N, slope=SLOPE)
    homed(device)
    found = measure.weigh_poses(device)
    device.close()
    # friction of 0.1 N is in every force; to and fro it cancels to a tenth of that
    np.testing.assert_allclose(found.weight_N, WEIGHT_N, atol=0.01)
    np.testing.assert_allclose(found.slope_N_per_m, SLOPE, atol=0.5)
    assert found.residual_N < 0.02
    assert found.poses == len(measure.POSES_M) == 9


def test_a_plane_is_fitted_exactly_and_noise_of_the_forces_is_its_standard_error():
    places, chance = np.array(measure.POSES_M), np.random.default_rng(1)
    clean = WEIGHT_N + (places - measure.MIDDLE_M) @ SLOPE.T
    exact = measure.fitted(places, clean)
    np.testing.assert_allclose(exact.weight_N, WEIGHT_N, atol=1e-12)
    np.testing.assert_allclose(exact.slope_N_per_m, SLOPE, atol=1e-10)
    assert exact.residual_N < 1e-12
    found = [measure.fitted(places, clean + 0.05 * chance.standard_normal(clean.shape)) for _ in range(300)]
    # nine poses around the middle: a third of the noise of one; 300 draws know a spread to 4 %
    assert np.std([one.weight_N[1] for one in found]) == pytest.approx(0.05 / 3.0, rel=0.15)
    assert np.sqrt(np.mean([one.stderr_N**2 for one in found])) == pytest.approx(0.05 / 3.0, rel=0.1)


def test_a_guided_session_carries_what_was_measured_unless_the_scene_says_otherwise():
    device = FalconDevice(calibration=KNOWN)
    hip = load_scene("hip-resurfacing").guidance
    plan = replace(hip, weight_N=(0.0,) * 3, weight_slope_N_per_m=((0.0,) * 3,) * 3)
    carried = _carried(plan, device, assumed=False)
    there = WEIGHT_N + SLOPE @ (np.array(plan.entry_m) - measure.MIDDLE_M)
    np.testing.assert_allclose(carried.weight_N, there, atol=1e-12)
    np.testing.assert_allclose(carried.weight_slope_N_per_m, SLOPE)
    stated = replace(plan, weight_N=(0.0, 1.0, 0.0))
    assert _carried(stated, device, assumed=False) == stated
    assert _carried(stated, device, assumed=True) == carried
    unknown = FalconDevice(calibration=replace(KNOWN, weight_measured=False))
    assert _carried(plan, unknown, assumed=True) == plan
