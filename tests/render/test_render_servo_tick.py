"""One tick and the loops: virtual time, records, exchange of parameters, faults, compiled and not.

And what a tick remembers from one reading to the next: gaps, first readings, exchanged tissue, energy, wires.
"""

from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest
from fake_device import FakeDevice
from felt_block import parameters

from tissueid.errors import DeviceError
from tissueid.haptics import guard as machine
from tissueid.haptics.device import UNANSWERED, CompiledIO, compiled_io
from tissueid.haptics.guard import GAIN, transition
from tissueid.haptics.hand import Hand
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.parameter_block import COMMAND_ENGAGE, COMMAND_STOP
from tissueid.haptics.shared_hand import SharedHand
from tissueid.haptics.sim import CENTRE_M, SimulatedDevice
from tissueid.haptics.states import Fault, Lamp, State
from tissueid.rendering.environment import LAW
from tissueid.rendering.passivity_control import TOTAL_J, PassivityLimits
from tissueid.rendering.servo_loop import ENDED_FAULT, ENDED_STOPPED, ENDED_TICKS, new_watch, virtual_loop
from tissueid.rendering.servo_tick import VERSION, PythonIO, servo_here, tick
from tissueid.rendering.tissue_block import free_air_block

PERIOD = 1e-3
HAND_N_PER_M = 300.0
FORCE_SCALE, MOTION_SCALE = 0.008, 5.0
QUIET = PassivityLimits(on=False).block()
ABOVE_M = 2e-3
#: Into the tissue by 10 mm within a second, after homing and the start-up ramp; then held.
DEEP_M = (0.0, 0.0, CENTRE_M[2] - 0.010)
PRESS = Hand((0.0, 1.5, 2.5, 9.0), (CENTRE_M, CENTRE_M, DEEP_M, DEEP_M), (1.0,) * 4)


def tissue(label: int = 0, force_scale: float = FORCE_SCALE, above_m: float = -ABOVE_M) -> np.ndarray:
    """Parameters of paper A's tissue ``above_m`` over the resting tool."""
    return parameters(surface_z=CENTRE_M[2] + above_m, scales=(force_scale, MOTION_SCALE), label=label)


class Rig(ExitStack):
    """A servo on a simulated device in virtual time."""

    def __init__(self, hand: Hand = PRESS, **options: object) -> None:
        super().__init__()
        self.device = SimulatedDevice(hand=hand, **options)
        self.io, self.servo, self.ring, self.block = self.enter_context(servo_here(self.device))
        self.records = self.ring.reader()
        self.block.order(COMMAND_ENGAGE)
        self.now = 0.0

    def run(self, seconds: float, period: float = PERIOD) -> tuple[int, np.ndarray]:
        steps = np.full(round(seconds / period), period)
        ended = virtual_loop(self.io, self.servo, new_watch(), self.now, steps)
        self.now += seconds
        return ended, self.records.read_new()[0]


@pytest.fixture
def rig():
    with Rig() as made:
        yield made


class TestVirtualTime:
    @pytest.mark.needs_jit
    def test_a_session_homes_engages_and_presses(self, rig):
        rig.block.write(tissue())
        ended, records = rig.run(3.0)
        assert ended == ENDED_TICKS
        assert records["tick"].tolist() == list(range(3000))
        assert records["time_s"] == pytest.approx(PERIOD * np.arange(1, 3001), abs=1e-9)
        assert records["state"][0] == State.HOMING
        assert np.flatnonzero(records["state"] == State.ARMED)[0] == 49
        assert records["state"][-1] == State.ENGAGED
        # 8 mm below the surface less what the hand's spring gives, within Coulomb friction and a count
        given_mm = 1e3 * records["force_N"][-1, 2] / HAND_N_PER_M
        slack_mm = 1e3 * 0.1 / HAND_N_PER_M + 0.045
        assert MOTION_SCALE * records["depth_mm"][-1] == pytest.approx(8.0 - given_mm, abs=slack_mm)
        # the force on the tool is the tissue's by the scale, along the normal, as nothing limits it
        held = records[-500:]
        assert held["force_N"][:, 2] == pytest.approx(FORCE_SCALE * held["tissue_force_N"], rel=1e-12)
        assert np.all(held["force_N"][:, :2] == 0.0)
        assert np.all(held["lamps"] == 0)

    def test_the_wish_to_end_ramps_down_then_sends_zeros(self, rig):
        rig.block.write(tissue())
        rig.run(2.2)
        rig.block.order(COMMAND_STOP)
        ended, records = rig.run(3.0)
        size = np.linalg.norm(records["force_N"], axis=1)
        assert ended == ENDED_STOPPED
        assert size[0] > 0.1
        # 100 ms of ramp, then 20 commands of zero
        assert records.size == pytest.approx(120, abs=2)
        assert np.all(size[-20:] == 0.0)
        assert records["state"][-1] == State.ARMED

    @pytest.mark.needs_jit
    @pytest.mark.parametrize(
        ("event", "fault"),
        [(machine.PARENT_DIED, Fault.PARENT_DIED), (machine.TRANSPORT_LOST, Fault.TRANSPORT)],
    )
    def test_a_fault_ends_the_loop_after_twenty_zeros(self, rig, event, fault):
        rig.block.write(tissue())
        rig.run(2.5)
        transition(rig.servo.guard_memory, rig.servo.limits, event)
        ended, records = rig.run(1.0)
        size = np.linalg.norm(records["force_N"], axis=1)
        assert ended == ENDED_FAULT
        assert np.all(size[19:] == 0.0)
        assert records.size == 39
        assert set(records["fault"]) == {fault}


@pytest.mark.needs_jit
class TestExchange:
    def test_parameters_wait_until_nothing_is_touched(self, rig):
        rig.block.write(tissue(label=1))
        rig.run(2.6)
        rig.block.write(tissue(label=2, force_scale=0.5 * FORCE_SCALE))
        _, records = rig.run(0.2)
        assert set(records["version"]) == {1}
        assert set(records["label"]) == {1}
        SharedHand(-1, rig.device.parameters).point_at((0.0, 0.0, CENTRE_M[2] + 0.02))
        _, records = rig.run(1.0)
        changed = np.flatnonzero(np.diff(records["version"].astype(int)))
        assert records["version"][-1] == 2
        assert changed.size == 1
        assert records["depth_mm"][changed[0]] <= 0.0
        assert rig.servo.counters[VERSION] == rig.block.taken == 2

    @pytest.mark.parametrize("asked", [False, True])
    def test_without_parameters_or_where_it_is_asked_for_there_is_free_air(self, rig, asked):
        if asked:
            rig.block.write(np.concatenate([free_air_block(), QUIET]))
        _, records = rig.run(2.6)
        assert records["version"][-1] == asked
        assert np.all(records["tissue_force_N"] == 0.0)
        assert np.all(records["force_N"][1200:] == 0.0)


class TestPythonDevices:
    @pytest.mark.needs_jit
    def test_a_law_in_python_takes_the_place_of_the_environment(self, rig):
        asked = []

        def spring(position_m, velocity_m_per_s, dt_s):
            asked.append(dt_s)
            return -100.0 * (position_m - np.array(CENTRE_M))

        rig.block.write(np.concatenate([free_air_block(), QUIET]))
        io = PythonIO(rig.device, spring)
        for k in range(2600):
            tick(io, rig.servo, PERIOD * k, PERIOD, 0.0, 0)
        records = rig.records.read_new()[0]
        offset = records["position_m"] - np.array(CENTRE_M)
        assert asked == [PERIOD] * 2600
        assert records["force_N"][-1] == pytest.approx(-100.0 * offset[-1], rel=1e-9)
        assert np.linalg.norm(records["force_N"][-1]) > 0.5

    def test_a_device_that_is_gone_is_a_fault_after_one_tick(self, rig):
        io = PythonIO(rig.device)
        for k in range(200):
            tick(io, rig.servo, PERIOD * k, PERIOD, 0.0, 0)
        rig.device.close()
        tick(io, rig.servo, 0.2, PERIOD, 0.0, 0)
        assert rig.servo.out.tolist() == [0.0, 0.0, 0.0]

    def test_an_unknown_kind_of_device_is_told_the_way_out(self):
        with pytest.raises(DeviceError, match=r"kind 'nowhere:X'.*return None"):
            compiled_io(CompiledIO("nowhere:X"))


@pytest.mark.needs_jit
def test_a_clipped_tick_says_so():
    with Rig(limits=GuardLimits(clamp_N=0.2, rms_limit_N=0.2, dead_man=False)) as rig:
        rig.block.write(tissue())
        _, records = rig.run(2.6)
        clipped = (records["lamps"] & Lamp.CLIPPED) != 0
        size = np.linalg.norm(records["force_N"], axis=1)
        assert clipped[-1]
        assert size[clipped] == pytest.approx(0.2, rel=1e-12)


#: In contact, in the middle of the press.
FAULT_AT_S = 2.0
TICKS = 2400


def faulty_session(*, compiled: bool, fault: str) -> np.ndarray:
    """Records of a session that meets a fault."""
    with Rig(seed=11) as rig:
        rig.block.write(tissue())
        io = rig.io if compiled else PythonIO(rig.device)
        events = {"heartbeat": machine.HEARTBEAT_LOST, "owner": machine.PARENT_DIED}
        for k in range(TICKS):
            if k == round(FAULT_AT_S / PERIOD) and fault == "not a number":
                rig.servo.environment[LAW : LAW + 8] = np.nan
            elif k == round(FAULT_AT_S / PERIOD) and fault in events:
                transition(rig.servo.guard_memory, rig.servo.limits, events[fault])
            # a device in Python moves on its period when it is commanded, a compiled one when it is read
            dt = PERIOD if k or not compiled else 0.0
            tick(io, rig.servo, PERIOD * k, dt, 0.0, 0)
        return rig.records.read_new()[0]


@pytest.mark.needs_jit
@pytest.mark.parametrize(
    ("fault", "code", "state"),
    [
        ("none", Fault.NONE, State.ENGAGED),
        ("not a number", Fault.NOT_A_NUMBER, State.FAULT),
        ("heartbeat", Fault.HEARTBEAT, State.FAULT),
        ("owner", Fault.PARENT_DIED, State.FAULT),
    ],
)
def test_both_ways_to_a_device_send_the_same_forces(fault, code, state):
    compiled = faulty_session(compiled=True, fault=fault)
    python = faulty_session(compiled=False, fault=fault)
    reached = np.flatnonzero(compiled["fault"] != 0)
    size = np.linalg.norm(compiled["force_N"], axis=1)
    assert compiled["fault"][-1] == python["fault"][-1] == code
    assert compiled["state"][-1] == python["state"][-1] == state
    assert np.array_equal(compiled["state"], python["state"])
    for name in ("position_m", "force_N", "lamps", "depth_mm"):
        # the first tick, which took no time in one of them, is marked as a stall
        assert np.array_equal(compiled[name][1:], python[name][1:])
    # force was on before, and is zero 20 ms after the fault was seen
    assert size[: reached[0] if reached.size else TICKS].max() > 0.1
    assert reached.size == 0 or np.all(size[reached[0] + 19 :] == 0.0)


COUNT_M = 45e-6


class Driven(ExitStack):
    """A servo on a device that is where the test says."""

    def __init__(self, start_m: float = 0.01) -> None:
        super().__init__()
        self.device = FakeDevice()
        self.device.position[2], self.device.counts[:] = start_m, round(start_m / COUNT_M)
        self.io, self.servo, ring, self.block = self.enter_context(servo_here(self.device))
        self.reader = ring.reader()
        self.block.order(COMMAND_ENGAGE)
        self.now = 0.0

    def publish(self) -> None:
        self.block.write(parameters(surface_z=0.0, scales=(0.01, 1.0)))

    def tick(self, count: int = 1, dt: float = PERIOD) -> np.ndarray:
        for _ in range(count):
            self.now += dt
            # encoders of a hand that is alive: a count more or less
            self.device.counts[0] ^= 1
            tick(self.io, self.servo, self.now, dt, 0.0, 0)
        return self.reader.read_new()[0]

    def go(self, to_m: float, ticks: int) -> np.ndarray:
        """Move in steps, counts with it."""
        records = []
        for place in np.linspace(self.device.position[2], to_m, ticks + 1)[1:]:
            self.device.position[2] = place
            self.device.counts[:] = round(place / COUNT_M)
            records.append(self.tick())
        return np.concatenate(records)


@pytest.fixture
def driven() -> Iterator[Driven]:
    with Driven() as made:
        yield made


def pressed(driven):
    """Engaged, with the start-up ramp behind it, 4 mm deep."""
    driven.publish()
    driven.tick(1200)
    assert driven.servo.guard_memory[GAIN] == 1.0
    records = driven.go(-0.004, 300)
    assert records["state"][-1] == State.ENGAGED
    assert records["force_N"][-1, 2] > 1.0


@pytest.mark.parametrize(
    ("fails", "fault", "after"),
    [
        (lambda device: setattr(device, "broken", DeviceError("gone")), Fault.TRANSPORT, 0),
        (lambda device: device.answer.update(valid=False), Fault.NO_REPLY, 99),
        (lambda device: device.counts.__iadd__(300), Fault.ENCODER_JUMP, 0),
        (lambda device: device.answer.update(homed=False), Fault.NOT_HOMED, 0),
    ],
)
def test_a_device_in_python_that_fails_in_contact_is_without_force_in_20_ms(driven, fails, fault, after):
    pressed(driven)
    fails(driven.device)
    records = driven.tick(160)
    assert np.flatnonzero(records["fault"])[0] == after
    assert set(records["fault"][after:]) == {fault}
    assert (records["force_N"][after + 19 :] == 0.0).all()


def test_tissue_of_new_parameters_was_never_touched(driven):
    pressed(driven)
    # out at once, so that what is left of the last touch would still be there
    driven.go(0.0005, 6)
    driven.publish()
    driven.tick()
    again = driven.go(-0.004, 30)
    with Driven(start_m=0.0005) as fresh:
        fresh.publish()
        fresh.tick(1200)
        first = fresh.go(-0.004, 30)
    np.testing.assert_allclose(again["tissue_force_N"], first["tissue_force_N"], rtol=1e-12)


def test_a_velocity_is_that_of_the_time_since_the_last_answer(driven):
    driven.publish()
    driven.tick(1200)
    driven.go(0.02, 100)
    assert driven.servo.velocity[2] == pytest.approx(0.1, rel=1e-6)
    # three answers are missing: the hand goes on meanwhile
    driven.device.answer["valid"] = False
    driven.tick(3)
    driven.device.answer["valid"] = True
    driven.device.position[2] += 4e-4
    driven.tick()
    assert driven.servo.velocity[2] == pytest.approx(0.1, rel=1e-6)


def test_a_first_reading_far_away_is_no_motion():
    with Driven(start_m=0.05) as far:
        # homed before the loop begins
        for _ in range(60):
            far.device.read()
        assert far.device.state is State.ARMED
        far.publish()
        records = far.tick(1200)
    assert {int(one) for one in records["fault"]} == {0}
    assert far.servo.guard_memory[GAIN] == 1.0
    assert (far.servo.velocity == 0.0).all()


def test_energy_is_counted_on_what_was_sent_not_on_what_was_wanted(driven):
    driven.publish()
    driven.block.order(COMMAND_ENGAGE - 1)
    driven.tick(200)
    records = driven.go(-0.004, 300)
    assert records["state"][-1] == State.ARMED
    assert records["tissue_force_N"][-1] > 10.0
    assert (records["force_N"] == 0.0).all()
    assert driven.servo.control_memory[TOTAL_J] == 0.0


def test_a_law_is_given_the_time_that_passed(driven):
    forces = []
    for dt in (PERIOD, 4.0 * PERIOD):
        with Driven() as one:
            pressed(one)
            # held: the force relaxes with tau = 21 ms, by the clock and not by the tick
            forces.append(one.tick(round(0.02 / dt), dt=dt)["tissue_force_N"][-1])
    assert forces[1] == pytest.approx(forces[0], rel=1e-6)
    assert driven.now == 0.0


def felt(records: np.ndarray) -> float:
    """Share of the tissue's force that was sent last."""
    return float(records["force_N"][-1, 2] / (0.01 * records["tissue_force_N"][-1]))


def test_commands_without_an_answer_lower_the_force_and_light_the_lamp(driven):
    pressed(driven)
    assert felt(driven.tick()) == pytest.approx(1.0)
    driven.servo.words[UNANSWERED] = 2
    assert not (driven.tick(100)["lamps"] & int(Lamp.LATENCY)).any()
    driven.servo.words[UNANSWERED] = 4
    records = driven.tick(200)
    # 20 ms until it is believed, then down within the time of a recovery
    assert not (records["lamps"][:19] & int(Lamp.LATENCY)).any()
    assert (records["lamps"][21:] & int(Lamp.LATENCY)).all()
    assert felt(records) == pytest.approx(1.5 / 5.5)
    driven.servo.words[UNANSWERED] = 0
    records = driven.tick(900)
    # not forgotten at once, and given back without a jump
    assert (records["lamps"][:500] & int(Lamp.LATENCY)).all()
    assert abs(np.diff(records["force_N"][:, 2])).max() < 0.01
    driven.tick(400)
    assert felt(driven.tick()) == pytest.approx(1.0)
