"""The simulated device and a recorded motion; the arm against closed forms; hands and scripts."""

import math
from pathlib import Path

import numpy as np
import pytest

from tissueid.errors import BundleError, DeviceError, UsageError
from tissueid.haptics import arm as a
from tissueid.haptics import shared_hand as layout
from tissueid.haptics import sim as k
from tissueid.haptics.arm import Arm, arm_step, new_arm
from tissueid.haptics.hand import PRESETS, Hand, parse_script, preset, scripted_hand
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
        np.testing.assert_array_equal(device.read().position_m, records["position_m"][0])
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


TICK = 1e-3
ORIGIN = np.zeros(3)
PLACE, SPEED = slice(a.POSITION, a.POSITION + 3), slice(a.VELOCITY, a.VELOCITY + 3)


def held(arm: Arm, stiffness: float, damping: float = 0.0) -> np.ndarray:
    """Block of an arm in a hand that holds where its target is."""
    block = arm.block()
    block[[layout.HAND_STIFFNESS, layout.HAND_DAMPING]] = stiffness, damping
    return block


def moved(block: np.ndarray, ticks: int, *, force=ORIGIN, place=ORIGIN, speed=ORIGIN):
    """Memory of an arm after some ticks, and all its places; the target of its hand is the origin."""
    memory, seen = new_arm(ORIGIN), np.zeros((ticks, 3))
    memory[PLACE], memory[SPEED] = place, speed
    for tick in range(ticks):
        arm_step(memory, block, np.array(force), TICK)
        seen[tick] = memory[PLACE]
    return memory, seen


def kinetic(memory: np.ndarray, arm: Arm) -> float:
    return float(0.5 * arm.mass_kg * (memory[SPEED] ** 2).sum())


def test_a_damped_oscillation_follows_its_closed_form():
    arm = Arm(mass_kg=0.2, damping_N_s_per_m=1.5, friction_N=0.0)
    start = np.array([0.01, -0.02, 0.005])
    memory, _ = moved(held(arm, 500.0, damping=3.0), 250, place=start)
    decay, t = (1.5 + 3.0) / (2.0 * 0.2), 0.25
    omega = math.sqrt(500.0 / 0.2 - decay**2)
    share = math.exp(-decay * t) * (math.cos(omega * t) + decay / omega * math.sin(omega * t))
    assert memory[PLACE] == pytest.approx(share * start, abs=2e-9)  # second order in h = 50 us


@pytest.mark.needs_jit
@pytest.mark.parametrize("force", [np.array([1.0, 0.0, 0.0]), np.array([0.6, -2.0, 0.5])])
def test_a_pushed_arm_ends_at_its_terminal_speed(force):
    arm = Arm(mass_kg=0.1, damping_N_s_per_m=2.0, friction_N=0.3)
    memory, _ = moved(arm.block(), 1000, force=force)  # twenty time constants m/b of 50 ms
    size = float(np.linalg.norm(force))
    np.testing.assert_allclose(memory[SPEED], force / size * (size - 0.3) / 2.0, rtol=1e-7)


def test_friction_stops_a_sliding_arm_where_its_energy_is_spent():
    arm = Arm(mass_kg=0.25, damping_N_s_per_m=0.0, friction_N=0.2)
    memory, _ = moved(arm.block(), 200, speed=(0.06, -0.08, 0.0))
    way = 0.5 * 0.25 * 0.1**2 / 0.2
    # the last sub-step of 50 us may end at rest inside it: at most fc/m h^2 = 2 nm
    np.testing.assert_allclose(memory[PLACE], way * np.array([0.6, -0.8, 0.0]), atol=2e-9)
    assert kinetic(memory, arm) == 0.0


def test_an_arm_that_sticks_does_not_move_at_all():
    block, force = held(Arm(friction_N=0.1), 300.0, 5.0), np.array([0.05, 0.05, 0.05])  # 0.087 N in all
    memory, _ = moved(block, 300, force=force)
    assert (memory[PLACE] == 0.0).all()
    assert (memory[SPEED] == 0.0).all()
    arm_step(memory, block, force * 1.2, TICK)  # 0.104 N
    assert (memory[PLACE] > 0.0).all()


@pytest.mark.needs_jit
def test_an_arm_comes_to_rest_in_the_band_of_friction_without_chatter():
    memory, seen = moved(held(Arm(friction_N=0.1), 300.0, 2.0), 1500, place=(0.004, 0.0, 0.0))
    assert (np.diff(seen[-1001:], axis=0) == 0.0).all()
    assert (memory[SPEED] == 0.0).all()
    assert abs(memory[a.POSITION]) <= 0.1 / 300.0


@pytest.mark.needs_jit
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_energies_close_to_rounding(seed):
    rng = np.random.default_rng(seed)
    arm = Arm(mass_kg=0.25, damping_N_s_per_m=0.5, friction_N=0.1)
    memory, block = new_arm(ORIGIN), held(arm, 800.0, 8.0)
    block[layout.POINTER_ON] = 1.0
    throughput = 0.0
    for tick in range(400):
        if tick % 40 == 0:
            block[layout.POINTER : layout.POINTER + 3] = rng.normal(0.0, 0.02, 3)
        force, before = rng.normal(0.0, 2.0, 3), memory[PLACE].copy()
        arm_step(memory, block, force, rng.uniform(2e-4, 2e-3))
        throughput += float(force @ (memory[PLACE] - before))
    losses = memory[a.DAMPING_LOSS] + memory[a.FRICTION_LOSS]
    assert memory[a.MOTOR_WORK] == pytest.approx(throughput, rel=1e-9)
    # friction that reverses within a sub-step counts by the mean speed, not by the one it acts at: < 1e-9 J
    work = memory[a.MOTOR_WORK] + memory[a.HAND_WORK]
    assert work - losses == pytest.approx(kinetic(memory, arm), abs=2e-9)
    assert (memory[[a.DAMPING_LOSS, a.FRICTION_LOSS]] > 0.0).all()


@pytest.mark.parametrize("dt", [0.0, -1e-3, math.nan])
def test_no_time_moves_nothing(dt):
    memory, _ = moved(held(Arm(), 300.0), 1, place=(0.01, 0.0, 0.0))
    before = memory.copy()
    arm_step(memory, held(Arm(), 300.0), np.ones(3), dt)
    assert (memory == before).all()


ARM_SURFACE = np.array([0.01, -0.02, 0.13])


def test_a_script_moves_the_grip_in_tissue_units_whatever_the_force():
    strokes = parse_script("indent 8 mm at 250 mm/min; hold 0.1 s; retract to 3 mm at 10 mm/s")
    hand = scripted_hand(strokes, motion_scale=5.0, surface_m=ARM_SURFACE, inward=INWARD, rest_s=0.2)
    memory, block = new_arm(hand.start_m), hand.write(Arm().block())
    speed = 250.0 / 60.0
    corner = 0.2 + 8.5 / speed  # from half a millimetre above the tissue
    assert hand.duration_s == pytest.approx(corner + 0.1 + 0.5, abs=1e-12)
    depths, times = [], []
    push = np.array([0.3, 0.0, 7.0])
    while memory[a.TIME] < hand.duration_s:
        arm_step(memory, block, push, 5e-3)
        times.append(memory[a.TIME])
        depths.append((ARM_SURFACE[2] - memory[a.POSITION + 2]) * 1e3 / 5.0)
    time = np.array(times)
    expected = np.interp(time, [0.2, corner, corner + 0.1, corner + 0.6], [-0.5, 8.0, 8.0, 3.0])
    np.testing.assert_allclose(depths, expected, atol=1e-9)
    np.testing.assert_allclose(memory[a.POSITION : a.POSITION + 2], ARM_SURFACE[:2], atol=1e-15)
    # the machine's work is what the motors took, and what damping, friction and motion took
    work = memory[a.HAND_WORK] + memory[a.MOTOR_WORK] - memory[a.DAMPING_LOSS] - memory[a.FRICTION_LOSS]
    assert work == pytest.approx(kinetic(memory, Arm()), abs=1e-9)


@pytest.mark.parametrize(
    ("text", "strokes"),
    [
        (
            " indent 2mm at 1 mm/s;;hold .5s; indent 4 mm at 60mm/min; retract at 5 mm/s; hold 2 s ;",
            [("indent", 2.0), ("hold", 2.0), ("indent", 4.0), ("retract", -0.5), ("hold", -0.5)],
        ),
        *((text, "1 to 62 strokes") for text in ("", "hold 1 s;" * 63)),
        *(
            (text, "is no stroke")
            for text in ("press 8 mm", "indent 8 at 250 mm/min", "hold 0 s", "hold 1e9 s")
        ),
        *((f"indent 8 mm at {speed} mm/min", "speed of") for speed in (0, 20000)),
        ("indent 4 mm at 5 mm/s; indent 3 mm at 5 mm/s", "does not go deeper"),
        ("indent 4 mm at 5 mm/s; retract to 5 mm at 5 mm/s", "does not go back"),
        ("indent 8 mm at 250 mm/min\x1b[2J", "is no stroke"),
    ],
)
def test_scripts_are_read_and_those_that_make_no_sense_refused(text, strokes):
    if not isinstance(strokes, str):
        assert [(stroke.kind, stroke.depth_mm) for stroke in parse_script(text)] == strokes
        return
    with pytest.raises(UsageError, match=strokes) as caught:
        parse_script(text)
    assert "\x1b" not in caught.value.message


@pytest.mark.parametrize("name", PRESETS)
def test_presets_start_in_air_reach_their_depth_and_move_no_faster_than_a_hand(name):
    hand = preset(
        name, surface_m=ARM_SURFACE, inward=INWARD, depth_m=0.003, speed_m_per_s=2e-3, rest_s=0.1, stay_s=0.5
    )
    knots = hand.knots()
    depth = ARM_SURFACE[2] - knots[:, 3]
    speed = np.abs(np.diff(depth) / np.diff(knots[:, 0]))
    assert depth[0] < 0.0
    assert depth.max() == pytest.approx(0.003, abs=1e-12)
    assert speed.max() < 0.5
    if name == "slow press":
        assert speed.max() == pytest.approx(2e-3, rel=1e-9)
    assert (knots[-1, 4] == 0.0) == (name == "release")
    assert (hand.tremor_m > 0.0) == (name == "tremor")


def test_a_tremor_swings_by_its_amplitude_at_its_frequency():
    hand = Hand(
        (0.0,), ((0.0, 0.0, 0.1),), (1.0,), rigid=True, tremor_m=3e-4, tremor_hz=8.0, tremor_phase=0.4
    )
    _, seen = moved(hand.write(Arm().block()), 500, place=hand.start_m)
    time = 1e-3 * np.arange(1, 501)
    expected = 3e-4 * np.minimum(time / a.TREMOR_RISE_S, 1.0) * np.sin(2.0 * np.pi * 8.0 * time + 0.4)
    np.testing.assert_allclose(seen[:, 2] - 0.1, expected, atol=1e-12)


def test_a_released_grip_flies_free():
    hand = Hand((0.0, 0.05), ((0.0, 0.0, 0.1),) * 2, (1.0, 0.0), stiffness_N_per_m=500.0)
    memory, block = new_arm(hand.start_m), hand.write(Arm(damping_N_s_per_m=0.0, friction_N=0.0).block())
    arm_step(memory, block, ORIGIN, 0.05)
    start = memory[a.POSITION + 2]
    arm_step(memory, block, np.array([0.0, 0.0, 1.0]), 0.1)
    assert memory[a.POSITION + 2] - start == pytest.approx(0.5 * 1.0 / 0.25 * 0.1**2, rel=1e-9)


def test_impossible_arms_and_hands_and_unknown_ones_are_refused():
    impossible = {"mass_kg": 0.0, "substep_s": 0.0, "damping_N_s_per_m": -1.0, "friction_N": math.nan}
    for name, value in impossible.items():
        with pytest.raises(ValueError, match=r"must be positive|can't be negative"):
            Arm(**{name: value})
    for times, reason in (((0.0, 0.0), "must rise"), ((0.0, math.nan), "finite"), ((), "1 to 64 knots")):
        with pytest.raises(ValueError, match=reason):
            Hand(times, ((0.0, 0.0, 0.1),) * len(times), (1.0,) * len(times))
    with pytest.raises(UsageError, match="hands are step, slow press"):
        preset("punch", surface_m=ARM_SURFACE, inward=INWARD, depth_m=0.01)
