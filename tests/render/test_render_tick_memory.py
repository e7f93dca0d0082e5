"""Memory of a tick from one reading to the next: gaps, first readings, exchanged tissue, energy, wires."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest
from fake_device import FakeDevice
from felt_block import parameters

from tissueid.haptics.device import UNANSWERED
from tissueid.haptics.guard import GAIN
from tissueid.haptics.parameter_block import COMMAND_ENGAGE
from tissueid.haptics.states import Lamp, State
from tissueid.rendering.passivity_control import TOTAL_J
from tissueid.rendering.servo_tick import servo_here, tick

TICK = 1e-3
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

    def tick(self, count: int = 1, dt: float = TICK) -> np.ndarray:
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


def pressed(driven: Driven) -> None:
    """Engaged, with the start-up ramp behind it, 4 mm deep."""
    driven.publish()
    driven.tick(1200)
    assert driven.servo.guard_memory[GAIN] == 1.0
    records = driven.go(-0.004, 300)
    assert records["state"][-1] == State.ENGAGED
    assert records["force_N"][-1, 2] > 1.0


def test_tissue_of_new_parameters_was_never_touched(driven: Driven) -> None:
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


def test_a_velocity_is_that_of_the_time_since_the_last_answer(driven: Driven) -> None:
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


def test_a_first_reading_far_away_is_no_motion() -> None:
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


def test_energy_is_counted_on_what_was_sent_not_on_what_was_wanted(driven: Driven) -> None:
    driven.publish()
    driven.block.order(COMMAND_ENGAGE - 1)
    driven.tick(200)
    records = driven.go(-0.004, 300)
    assert records["state"][-1] == State.ARMED
    assert records["tissue_force_N"][-1] > 10.0
    assert (records["force_N"] == 0.0).all()
    assert driven.servo.control_memory[TOTAL_J] == 0.0


def test_a_law_is_given_the_time_that_passed(driven: Driven) -> None:
    forces = []
    for dt in (TICK, 4.0 * TICK):
        with Driven() as one:
            pressed(one)
            # held: the force relaxes with tau = 21 ms, by the clock and not by the tick
            forces.append(one.tick(round(0.02 / dt), dt=dt)["tissue_force_N"][-1])
    assert forces[1] == pytest.approx(forces[0], rel=1e-6)
    assert driven.now == 0.0


def felt(records: np.ndarray) -> float:
    """Share of the tissue's force that was sent last."""
    return float(records["force_N"][-1, 2] / (0.01 * records["tissue_force_N"][-1]))


def test_commands_without_an_answer_lower_the_force_and_light_the_lamp(driven: Driven) -> None:
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
