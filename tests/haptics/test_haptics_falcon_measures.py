"""What a device measures of itself, against simulated devices whose numbers are known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tissueid.errors import DeviceError
from tissueid.haptics.arm import Arm
from tissueid.haptics.device import Capabilities, DetectedDevice, DeviceSample, HapticDevice
from tissueid.haptics.hand import Hand
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.measure import motion, weighing
from tissueid.haptics.measure.motion import Motion, measure_link
from tissueid.haptics.measure.ring_down import estimate_arm, ring_down
from tissueid.haptics.measure.weighing import GRAVITY, weigh
from tissueid.haptics.sim import SimulatedDevice

#: Seconds of a device in virtual time, a millisecond each.
pytestmark = pytest.mark.needs_jit

#: No hand on the grip, and time for it to leave its stop.
HANDS_OFF = replace(GuardLimits(), dead_man=False, frozen_s=5.0)
TICK_S = 1e-3


def no_pause(_until: float) -> None:
    """A device in virtual time is never waited for."""


class HangingGrip(HapticDevice):
    """A grip that falls along y until its stop, whose newton is not one; in virtual time."""

    name = "hanging"

    def __init__(self, *, truth: float, own_kg: float = 0.06, friction_N: float = 0.1) -> None:
        super().__init__(HANDS_OFF)
        self.mass_hung_kg = 0.0
        self._truth, self._own_kg, self._friction_N = truth, own_kg, friction_N
        self._time = self._place = self._speed = self._force = 0.0

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
        step, inertia = TICK_S / 4, 0.25 + self.mass_hung_kg
        weight = (self._own_kg + self.mass_hung_kg) * GRAVITY
        for _ in range(4):
            pushed = self._speed + step * (self._truth * self._force - weight - 0.5 * self._speed) / inertia
            # Coulomb friction takes speed away, never turns it round
            slowed = max(abs(pushed) - step * self._friction_N / inertia, 0.0)
            self._speed = math.copysign(slowed, pushed)
            self._place += step * self._speed
            if self._place < -0.07:
                self._place, self._speed = -0.07, 0.0
        self._time += TICK_S
        count = math.floor(self._place / 45e-6)
        return DeviceSample(
            self._time,
            np.array([0.0, 45e-6 * count, 0.13]),
            np.array([0, count, 0]),
            0,
            homed=True,
            valid=True,
        )

    def _write(self, force_N: NDArray[np.float64]) -> None:
        self._force = float(force_N[1])


def homed(device: HapticDevice) -> None:
    device.open()
    for _ in range(60):
        device.read()
        device.write_force([0.0, 0.0, 0.0], TICK_S)


@pytest.mark.parametrize(("truth", "grams"), [(1.9, 150.0), (0.7, 50.0)])
def test_weighing_finds_the_newton_of_a_device(
    truth: float, grams: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(weighing, "PERIODS", 2)
    device = HangingGrip(truth=truth)
    homed(device)
    found = weigh(device, grams / 1000, lambda: setattr(device, "mass_hung_kg", grams / 1000), no_pause)
    # friction of 0.1 N is in every force; up and down it cancels to a tenth of a per cent
    assert found.ratio == pytest.approx(1.0 / truth, rel=2e-3)
    assert found.empty_N == pytest.approx(0.06 * GRAVITY / truth, rel=5e-3)
    assert found.weight_N == pytest.approx(grams / 1000 * 9.80665, rel=1e-12)
    device.close()


def test_a_mass_that_was_not_hung_is_not_felt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weighing, "PERIODS", 2)
    device = HangingGrip(truth=1.0)
    homed(device)
    with pytest.raises(
        DeviceError, match=r"the mass was not felt: .* 0\.59 N without it and 0\.59 N with it"
    ):
        weigh(device, 0.1, lambda: None, no_pause)
    device.close()


@pytest.mark.parametrize(("own_kg", "reason"), [(0.19, "needs the whole"), (0.30, "did not lift the grip")])
def test_a_mass_too_heavy_for_the_clamp_is_told(
    own_kg: float, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(weighing, "PERIODS", 2)
    # 2 N of clamp at a truth of 1: 190 g are 1.86 N, and friction and swing need more; 300 g are 2.9 N
    device = HangingGrip(truth=1.0, own_kg=own_kg)
    homed(device)
    with pytest.raises(DeviceError, match=rf"{reason}.*smaller mass"):
        weigh(device, 0.1, lambda: None, no_pause)
    device.close()


@pytest.mark.parametrize(("arm", "delay_ticks"), [(Arm(0.25, 0.5, 0.1), 1.5), (Arm(0.20, 1.5, 0.0), 2.5)])
def test_a_swing_tells_mass_damping_and_friction(arm: Arm, delay_ticks: float) -> None:
    free = Hand((0.0,), ((0.0, 0.0, 0.13),), (0.0,))
    device = SimulatedDevice(HANDS_OFF, arm=arm, hand=free, delay_ticks=delay_ticks)
    homed(device)
    found = ring_down(device, delay_ticks * TICK_S, no_pause)
    # counts of 45 um and windows of 30 ms; the bars hold for seeds and arms tried beside these
    assert found.mass_kg == pytest.approx(arm.mass_kg, rel=0.02)
    assert found.damping_N_s_per_m == pytest.approx(arm.damping_N_s_per_m, abs=0.02)
    assert found.friction_N == pytest.approx(arm.friction_N, abs=0.005)
    assert found.safe_damping < arm.damping_N_s_per_m
    assert found.safe_damping > arm.damping_N_s_per_m - 0.1
    device.close()


def test_a_grip_that_is_held_gives_no_damping() -> None:
    time_s = np.arange(0.0, 14.0, 1e-3)
    place = np.tile([0.0, 0.0, 0.13], (len(time_s), 1))
    with pytest.raises(DeviceError, match="hardly moved"):
        estimate_arm(Motion(time_s, place, np.zeros_like(place)), 1.5e-3)


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


@pytest.mark.parametrize(("answer_ms", "ticks"), [(0.3, 1.5), (0.9, 1.5), (1.4, 2.5)])
def test_delay_is_whole_ticks_until_the_answer_and_half_a_tick(
    answer_ms: float, ticks: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    Clocked.now_s = 0.0
    monkeypatch.setattr(motion.time, "monotonic", lambda: Clocked.now_s)
    device = Clocked()
    device.open()
    device.answer_s = answer_ms * 1e-3
    device.lost_every = 10
    report = measure_link(device, 1.0)
    device.close()
    assert report.delay_ticks == pytest.approx(ticks, abs=1e-9)
    assert report.round_trip_ms == pytest.approx((answer_ms,) * 3, rel=1e-6)
    assert report.rate_hz == pytest.approx(0.9 * 1e3 / answer_ms, rel=0.01)
    # one in ten was lost
    assert report.commands - report.replies == pytest.approx(report.commands / 10, abs=1)
    assert report.damaged == report.commands - report.replies


def test_a_device_that_never_answers_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    Clocked.now_s = 0.0
    monkeypatch.setattr(motion.time, "monotonic", lambda: Clocked.now_s)
    device = Clocked()
    device.open()
    device.answer_s = 0.002
    device.lost_every = 1
    with pytest.raises(DeviceError, match="answered none of 50 commands"):
        measure_link(device, 0.1)
    device.close()
