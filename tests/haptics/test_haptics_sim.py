"""The simulated device, and a recorded motion played again: what their docstrings guarantee."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tissueid.errors import BundleError, DeviceError, UsageError
from tissueid.haptics import sim as k
from tissueid.haptics.arm import Arm
from tissueid.haptics.hand import Hand, preset
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.ring import RECORD
from tissueid.haptics.shared_hand import PHASE
from tissueid.store import session_log

SURFACE = np.array(k.CENTRE_M)
INWARD = np.array([0.0, 0.0, -1.0])
FREE = Hand((0.0,), (k.CENTRE_M,), (0.0,))
SLIPPERY = Arm(mass_kg=0.25, damping_N_s_per_m=0.0, friction_N=0.0)
QUIET = np.zeros(3)


def session(device: k.SimulatedDevice, ticks: int) -> np.ndarray:
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


def pushed(device: k.SimulatedDevice, force_N: list[float]) -> None:
    """A tick under a force."""
    k.simulated_command(device.memory, device.parameters, np.array(force_N))
    k.simulated_advance(device.memory, device.parameters, 1e-3)


def pressing() -> Hand:
    return preset("hold", surface_m=SURFACE, inward=INWARD, depth_m=0.008, rest_s=0.1)


@pytest.mark.needs_jit
def test_equal_settings_and_forces_give_equal_samples_bit_for_bit():
    first = session(k.SimulatedDevice(hand=pressing(), seed=5), 600)
    assert (first == session(k.SimulatedDevice(hand=pressing(), seed=5), 600)).all()
    assert (first != session(k.SimulatedDevice(hand=pressing(), seed=6), 600)).any()


def test_in_virtual_time_no_clock_is_read():
    device = k.SimulatedDevice(hand=pressing(), clock=lambda: pytest.fail("a clock was read"), period_s=5e-4)
    session(device, 100)
    # 160 written forces and the twenty zero forces of closing
    assert device.time_s == pytest.approx(180 * 5e-4, abs=1e-12)


@pytest.mark.parametrize("dt", [1e-3, 0.1])
@pytest.mark.parametrize("delay_ticks", [0.0, 1.0, 1.5, 2.3])
def test_a_force_is_felt_after_its_delay_and_not_before_also_in_a_stall(delay_ticks, dt):
    device = k.SimulatedDevice(hand=FREE, arm=SLIPPERY, delay_ticks=delay_ticks)
    k.simulated_command(device.memory, device.parameters, np.array([0.0, 0.0, 2.0]))
    for _ in range(5):
        k.simulated_advance(device.memory, device.parameters, dt)
    fell = device.true_position_m[2] - k.CENTRE_M[2]
    # a constant force is integrated exactly by the midpoint rule
    assert fell == pytest.approx(0.5 * 2.0 / 0.25 * (5 * dt - delay_ticks * 1e-3) ** 2, rel=1e-9)
    assert device.memory[k.LOST] == 0.0


def test_forces_take_over_from_each_other_within_a_tick():
    device = k.SimulatedDevice(hand=FREE, arm=SLIPPERY, delay_ticks=1.5)
    for force in (1.0, -3.0, 0.0, 0.0, 0.0):
        pushed(device, [force, 0.0, 0.0])
    # 1 N from 1.5 to 2.5 ms, -3 N from 2.5 to 3.5 ms, then free flight to 5 ms
    speed = (1.0 - 3.0) / 0.25 * 1e-3
    way = (0.5 * 1.0 * 1.0**2 + 1.0 * 1.0 - 0.5 * 3.0 * 1.0**2) / 0.25 * 1e-6 + speed * 1.5e-3
    assert device.true_position_m[0] == pytest.approx(way, rel=1e-9)
    assert (device.memory[k.FELT : k.FELT + 3] == 0.0).all()


@pytest.mark.needs_jit
def test_positions_are_rounded_to_counts_without_a_mean_error():
    device = k.SimulatedDevice(hand=FREE, arm=SLIPPERY, quantum_m=60e-6, seed=3)
    errors, place, counts = [], np.zeros(3), np.zeros(3, np.int64)
    for _ in range(2000):
        pushed(device, [0.01, -0.013, 0.007])
        k.simulated_sample(device.memory, device.parameters, place, counts)
        errors.append(place - device.true_position_m)
    assert np.abs(errors).max() <= 30e-6 * (1.0 + 1e-9)
    # evenly spread over a count of 60 um: sd of the mean of at least some 300 counts passed is 1 um
    assert np.abs(np.mean(errors, axis=0)).max() < 4e-6


def test_the_compiled_blocks_are_the_device():
    device = k.SimulatedDevice(hand=pressing(), seed=9)
    io = device.compiled()
    assert io.kind == "tissueid.haptics.sim:SIMULATED"
    with device:
        for _ in range(50):
            k.simulated_command(io.memory, io.constants, QUIET)
            k.simulated_advance(io.memory, io.constants, 1e-3)
        assert device.time_s == pytest.approx(0.05, abs=1e-12)
        there = device.true_position_m / 45e-6 + io.constants[PHASE : PHASE + 3]
        assert (device.read().counts == np.floor(there)).all()


def test_in_real_time_the_arm_moves_with_the_clock():
    now = [100.0]
    device = k.SimulatedDevice(hand=pressing(), real_time=True, clock=lambda: now[0])
    with device:
        device.read()
        for step in (1e-3, 3e-3, 0.05):
            now[0] += step
            device.read()
            device.write_force(QUIET, step)
    assert device.time_s == pytest.approx(0.054, abs=1e-12)


def test_it_is_always_there_and_has_no_motors_and_impossible_ones_are_refused():
    for wrong in ({"quantum_m": 0.0}, {"delay_ticks": -1.0}, {"delay_ticks": 40.0}, {"period_s": 0.0}):
        with pytest.raises(ValueError, match="needs a positive quantum"):
            k.SimulatedDevice(**wrong)
    assert k.SimulatedDevice.detect()[0].note == ""
    capabilities = k.SimulatedDevice(GuardLimits.simulated()).capabilities
    assert (capabilities.hardware, capabilities.delay_ticks) == (False, 1.5)


def motion(count: int = 200) -> np.ndarray:
    """Records of a motion on an uneven time base."""
    rng = np.random.default_rng(4)
    records = np.zeros(count, RECORD)
    records["time_s"] = 17.0 + np.cumsum(rng.uniform(5e-4, 2e-3, count))
    records["position_m"] = [0.0, 0.01, 0.13] + 0.01 * rng.normal(size=(count, 3)).cumsum(axis=0) / count
    records["buttons"] = np.arange(count) // 50
    return records


def player(monkeypatch: pytest.MonkeyPatch, records: np.ndarray, **options: object) -> k.ReplayDevice:
    """A replay device of records that need no file."""
    log = session_log.SessionLog(head={}, records=records, summary=None)
    monkeypatch.setattr(session_log, "read_session_log", lambda _path: log)
    return k.ReplayDevice(log="motion.h5", **options)


def test_it_is_where_the_log_says_and_between_records_on_their_line(monkeypatch):
    records = motion()
    now = [3.0]
    device = player(monkeypatch, records, clock=lambda: now[0])
    own = records["time_s"] - records["time_s"][0]
    with device:
        first = device.read()
        np.testing.assert_array_equal(first.position_m, records["position_m"][0])
        for at in (20, 77, 150):
            now[0] = 3.0 + own[at]
            np.testing.assert_allclose(device.read().position_m, records["position_m"][at], atol=1e-15)
            now[0] = 3.0 + 0.5 * (own[at] + own[at + 1])
            between = 0.5 * (records["position_m"][at] + records["position_m"][at + 1])
            sample = device.read()
            np.testing.assert_allclose(sample.position_m, between, atol=1e-15)
            assert sample.buttons == at // 50
        now[0] = 3.0 + own[-1] + 10.0
        np.testing.assert_array_equal(device.read().position_m, records["position_m"][-1])


def test_no_force_changes_the_motion(monkeypatch):
    records, now = motion(), [7.0]
    with player(monkeypatch, records, clock=lambda: now[0]) as device:
        device.engage()
        path = []
        for tick in range(150):
            now[0] = 7.0 + 1e-3 * tick
            path.append(device.read().position_m)
            device.write_force([0.0, 0.0, 3.0], 1e-3)
    time, own = 1e-3 * np.arange(150), records["time_s"] - records["time_s"][0]
    expected = np.column_stack([np.interp(time, own, records["position_m"][:, axis]) for axis in range(3)])
    np.testing.assert_allclose(path, expected, atol=1e-15)


def test_records_that_are_no_numbers_are_left_out(monkeypatch):
    records = motion()
    records["position_m"][60, 1] = np.nan
    device = player(monkeypatch, records)
    assert np.isfinite(device._position_m).all()
    gap = records["time_s"][61] - records["time_s"][59]
    assert device._time_s[60] - device._time_s[59] == pytest.approx(gap, abs=1e-12)


def test_a_log_without_motion_is_refused(monkeypatch):
    backward = motion()
    backward["time_s"][100] = 0.0
    for records in (motion()[:1], backward):
        with pytest.raises(DeviceError, match="hold no motion"):
            player(monkeypatch, records)


def test_a_log_that_is_none_is_refused_and_a_missing_one_asked_for(tmp_path: Path):
    file = tmp_path / "log.h5"
    file.write_bytes(b"something else")
    with pytest.raises(BundleError, match=r"log\.h5"):
        k.ReplayDevice(log=file)
    with pytest.raises(UsageError, match="give one with --replay"):
        k.ReplayDevice().open()
    assert "needs the log" in k.ReplayDevice.detect()[0].note
    assert not k.ReplayDevice().capabilities.hardware
