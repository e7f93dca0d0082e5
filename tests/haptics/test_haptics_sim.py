"""The simulated device: what its docstring guarantees."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.errors import DeviceError
from tissueid.haptics import sim as k
from tissueid.haptics.arm import TIME, Arm
from tissueid.haptics.hand import Hand, preset
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.registry import open_device
from tissueid.haptics.shared_hand import PHASE, POINTER_ON
from tissueid.haptics.sim import (
    CENTRE_M,
    SimulatedDevice,
    simulated_advance,
    simulated_command,
    simulated_sample,
)
from tissueid.haptics.states import State

SURFACE = np.array(CENTRE_M)
INWARD = np.array([0.0, 0.0, -1.0])
FREE = Hand((0.0,), (CENTRE_M,), (0.0,))
SLIPPERY = Arm(mass_kg=0.25, damping_N_s_per_m=0.0, friction_N=0.0)
QUIET = np.zeros(3)


def session(device: SimulatedDevice, ticks: int) -> np.ndarray:
    """Positions that a loop reads while it renders a spring of 400 N/m, shape (ticks, 3)."""
    with device:
        for _ in range(60):
            device.read()
            device.write_force(QUIET, 1e-3)
        device.engage()
        seen = np.zeros((ticks, 3))
        for tick in range(ticks):
            sample = device.read()
            seen[tick] = sample.position_m
            pushed = max(0.0, SURFACE[2] - sample.position_m[2])
            device.write_force([0.0, 0.0, 400.0 * pushed], 1e-3)
    return seen


def pressing() -> Hand:
    return preset("hold", surface_m=SURFACE, inward=INWARD, depth_m=0.008, rest_s=0.1)


@pytest.mark.needs_jit
def test_equal_settings_and_forces_give_equal_samples_bit_for_bit():
    first = session(SimulatedDevice(hand=pressing(), seed=5), 600)
    assert (first == session(SimulatedDevice(hand=pressing(), seed=5), 600)).all()
    assert (first != session(SimulatedDevice(hand=pressing(), seed=6), 600)).any()


def test_in_virtual_time_no_clock_is_read():
    def forbidden() -> float:
        msg = "a clock was read"
        raise AssertionError(msg)

    device = SimulatedDevice(hand=pressing(), clock=forbidden, period_s=5e-4)
    session(device, 100)
    # 160 written forces and the twenty zero forces of closing
    assert device.time_s == pytest.approx(180 * 5e-4, abs=1e-12)


@pytest.mark.parametrize("delay_ticks", [0.0, 1.0, 1.5, 2.3])
def test_a_force_is_felt_after_its_delay_and_not_before(delay_ticks):
    device = SimulatedDevice(hand=FREE, arm=SLIPPERY, delay_ticks=delay_ticks)
    simulated_command(device.memory, device.parameters, np.array([0.0, 0.0, 2.0]))
    ticks = 5
    for _ in range(ticks):
        simulated_advance(device.memory, device.parameters, 1e-3)
    fell = device.true_position_m[2] - CENTRE_M[2]
    # a constant force is integrated exactly by the midpoint rule
    assert fell == pytest.approx(0.5 * 2.0 / 0.25 * ((ticks - delay_ticks) * 1e-3) ** 2, rel=1e-9)


def test_forces_take_over_from_each_other_within_a_tick():
    device = SimulatedDevice(hand=FREE, arm=SLIPPERY, delay_ticks=1.5)
    for force in (1.0, -3.0, 0.0, 0.0, 0.0):
        simulated_command(device.memory, device.parameters, np.array([force, 0.0, 0.0]))
        simulated_advance(device.memory, device.parameters, 1e-3)
    # 1 N from 1.5 to 2.5 ms, -3 N from 2.5 to 3.5 ms, then free flight to 5 ms
    speed = (1.0 - 3.0) / 0.25 * 1e-3
    way = (0.5 * 1.0 * 1.0**2 + 1.0 * 1.0 - 0.5 * 3.0 * 1.0**2) / 0.25 * 1e-6 + speed * 1.5e-3
    assert device.true_position_m[0] == pytest.approx(way, rel=1e-9)
    assert (device.felt_force_N == 0.0).all()


def test_a_stall_neither_loses_nor_repeats_a_force():
    device = SimulatedDevice(hand=FREE, arm=SLIPPERY, delay_ticks=1.5)
    simulated_command(device.memory, device.parameters, np.array([1.0, 0.0, 0.0]))
    simulated_advance(device.memory, device.parameters, 0.1)
    assert device.true_position_m[0] == pytest.approx(0.5 / 0.25 * (0.1 - 1.5e-3) ** 2, rel=1e-9)
    assert device.memory[k.LOST] == 0.0


@pytest.mark.needs_jit
def test_positions_are_rounded_to_counts_without_a_mean_error():
    device = SimulatedDevice(hand=FREE, arm=SLIPPERY, quantum_m=60e-6, seed=3)
    place, counts = np.zeros(3), np.zeros(3, np.int64)
    errors = []
    for _ in range(2000):
        simulated_command(device.memory, device.parameters, np.array([0.01, -0.013, 0.007]))
        simulated_advance(device.memory, device.parameters, 1e-3)
        simulated_sample(device.memory, device.parameters, place, counts)
        errors.append(place - device.true_position_m)
    assert np.abs(errors).max() <= 30e-6 * (1.0 + 1e-9)
    # evenly spread over a count of 60 um: sd of the mean of at least some 300 counts passed is 1 um
    assert np.abs(np.mean(errors, axis=0)).max() < 4e-6


def test_the_compiled_blocks_are_the_device():
    device = SimulatedDevice(hand=pressing(), seed=9)
    io = device.compiled()
    assert io.kind == "tissueid.haptics.sim:SIMULATED"
    place, counts = np.zeros(3), np.zeros(3, np.int64)
    device.open()
    for _ in range(50):
        said = simulated_sample(io.memory, io.constants, place, counts)
        assert said == k.VALID | k.HOMED
        simulated_command(io.memory, io.constants, QUIET)
        simulated_advance(io.memory, io.constants, 1e-3)
    assert device.time_s == pytest.approx(0.05, abs=1e-12)
    assert (
        device.read().counts == np.floor(device.true_position_m / 45e-6 + io.constants[PHASE : PHASE + 3])
    ).all()


def test_in_real_time_the_arm_moves_with_the_clock():
    now = [100.0]
    device = SimulatedDevice(hand=pressing(), real_time=True, clock=lambda: now[0])
    with device:
        device.read()
        for step in (1e-3, 3e-3, 0.05):
            now[0] += step
            device.read()
            device.write_force(QUIET, step)
    assert device.time_s == pytest.approx(0.054, abs=1e-12)


def test_the_hand_follows_a_pointer_smoothly_and_gives_it_back():
    device = SimulatedDevice()
    device.set_pointer(SURFACE + np.array([0.02, 0.0, -0.01]))
    path = session(device, 600)
    steps = np.abs(np.diff(path, axis=0)).max()
    assert np.abs(path[-1] - SURFACE - [0.02, 0.0, 0.0])[0] < 5e-4
    assert steps < 1e-3  # 1 m/s
    device.set_pointer(None)
    assert device.parameters[POINTER_ON] == 0.0


@pytest.mark.parametrize("point", [[0.0, 0.0], [0.0, 0.0, np.nan], "x"])
def test_a_pointer_that_is_no_point_is_refused(point):
    with pytest.raises(ValueError, match=r"three finite|could not convert"):
        SimulatedDevice().set_pointer(point)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (k.FAULT_SILENT, 0),
        (k.FAULT_GONE, -1),
        (k.FAULT_UNHOMED, k.VALID),
        (k.FAULT_FROZEN, k.VALID | k.HOMED),
    ],
)
def test_scripted_faults_begin_at_their_time(kind, said):
    device = SimulatedDevice(hand=FREE, arm=SLIPPERY)
    device.parameters[[k.FAULT_KIND, k.FAULT_AT]] = kind, 0.010
    place, counts = np.zeros(3), np.zeros(3, np.int64)
    answers, seen = [], []
    for _ in range(40):
        answers.append(simulated_sample(device.memory, device.parameters, place, counts))
        seen.append(counts.copy())
        simulated_command(device.memory, device.parameters, np.array([5.0, 0.0, 0.0]))
        simulated_advance(device.memory, device.parameters, 1e-3)
    assert set(answers[:10]) == {k.VALID | k.HOMED}
    assert set(answers[11:]) == {said}
    still = len({int(count[0]) for count in seen[12:]}) == 1
    assert still == (kind != k.FAULT_UNHOMED)


def test_a_jump_is_one_encoder_off_by_its_size():
    device = SimulatedDevice(hand=FREE)
    device.parameters[[k.FAULT_KIND, k.FAULT_AT, k.FAULT_SIZE]] = k.FAULT_JUMP, 0.0, 300.0
    place, counts = np.zeros(3), np.zeros(3, np.int64)
    simulated_sample(device.memory, device.parameters, place, counts)
    np.testing.assert_allclose(place - device.true_position_m, [300 * 45e-6, 0.0, 0.0], atol=22.6e-6)


def test_a_device_that_is_gone_ends_in_fault():
    device = SimulatedDevice()
    device.parameters[[k.FAULT_KIND, k.FAULT_AT]] = k.FAULT_GONE, 0.005
    with device:
        for _ in range(3):
            device.read()
            device.write_force(QUIET, 1e-3)
        device.memory[TIME] = 0.01
        with pytest.raises(DeviceError, match="unplugged"):
            device.read()
        assert device.state is State.FAULT


@pytest.mark.parametrize(
    "wrong", [{"quantum_m": 0.0}, {"delay_ticks": -1.0}, {"delay_ticks": 40.0}, {"period_s": 0.0}]
)
def test_impossible_devices_are_refused(wrong):
    with pytest.raises(ValueError, match="needs a positive quantum"):
        SimulatedDevice(**wrong)


def test_it_is_found_by_name_without_any_device():
    device = open_device("sim", limits=GuardLimits.simulated())
    assert isinstance(device, SimulatedDevice)
    assert SimulatedDevice.detect()[0].note == ""
    assert not device.capabilities.hardware
    assert device.capabilities.delay_ticks == 1.5
