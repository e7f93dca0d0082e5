"""The shared hand: a pointer leads the simulated device and no other."""

from __future__ import annotations

import os

import numpy as np
import pytest

from tissueid.errors import DeviceError
from tissueid.haptics.shared_hand import SharedHand
from tissueid.haptics.sim import CENTRE_M, SimulatedDevice
from tissueid.haptics.sim_kernels import simulated_advance
from tissueid.haptics.simulated_layout import SIM_PARAMETERS
from tissueid.rendering.servo import ServoPlan
from tissueid.rendering.servo_process import _share_hand


def test_a_hand_that_is_led_from_another_mapping_arrives_and_no_faster_than_it_may() -> None:
    hand = SharedHand.create()
    elsewhere = SharedHand.attach(os.dup(hand.descriptor))
    device = SimulatedDevice()
    device.share(hand)
    assert elsewhere.parameters.shape == (SIM_PARAMETERS,)
    assert (elsewhere.parameters == device.parameters).all()
    elsewhere.point_at((0.02, 0.0, CENTRE_M[2]))
    furthest = 0.0
    for _ in range(1000):
        before = device.true_position_m
        simulated_advance(device.memory, device.parameters, 1e-3)
        furthest = max(furthest, float(np.abs(device.true_position_m - before).max()))
    # within Coulomb friction over the hand's stiffness: 0.1 N / 300 N/m
    assert device.true_position_m == pytest.approx([0.02, 0.0, CENTRE_M[2]], abs=4e-4)
    # 0.5 m/s of the target, and what half-critical damping overshoots
    assert furthest < 1e-3
    for one in (hand, elsewhere):
        one.close()


@pytest.mark.parametrize("point", [(0.0, 0.0), (0.0, float("nan"), 0.0), (float("inf"), 0.0, 0.0)])
def test_a_pointer_that_is_no_point_is_refused(point: tuple[float, ...]) -> None:
    hand = SharedHand.create()
    with pytest.raises(ValueError, match="three finite coordinates"):
        hand.point_at(point)
    hand.close()


def test_another_memory_is_no_hand() -> None:
    descriptor = os.memfd_create("other")
    os.ftruncate(descriptor, 64)
    with pytest.raises(DeviceError, match="no hand"):
        SharedHand.attach(descriptor)
    os.close(descriptor)


def test_no_device_but_the_simulated_one_can_be_led() -> None:
    from tissueid.haptics.falcon.device import FalconDevice

    hand = SharedHand.create()
    with pytest.raises(DeviceError, match="the simulated device alone"):
        _share_hand(FalconDevice(), hand)
    device = SimulatedDevice()
    _share_hand(device, hand)
    assert device.parameters is hand.parameters
    assert not ServoPlan("falcon").shared_hand
    hand.close()
