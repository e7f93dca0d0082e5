"""A session of the servo's tick with an emulated Falcon behind a socket, in virtual time, in one thread.

The driver opens the device as it would open a real one; then tick and emulator take turns, a millisecond of
the emulator's clock for each command, so that "within 20 ms" is counted and not measured.
"""

from contextlib import ExitStack
from typing import Any, Self

import numpy as np
from felt_block import parameters, preset_check

from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.falcon.emulator import EmulatedLink, EmulatorSettings
from tissueid.haptics.hand import Hand
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.parameter_block import COMMAND_ENGAGE
from tissueid.haptics.states import Fault, State
from tissueid.rendering.servo_tick import compiled_tick, servo_here

TICK_S = 1e-3
LIMITS = GuardLimits(clamp_N=5.0, rms_limit_N=5.0, dead_man=False, ramp_s=0.5)
#: Emulated time of homing, and of the way to where the hand starts [s].
HOMED_S = 3.0


def pressing(stiffness: float = 500.0) -> Hand:
    """A hand that is in the tissue from 0.75 s after homing on, and goes on deeper slowly."""
    places = tuple((0.0, 0.0, height) for height in (0.133, 0.133, 0.122, 0.110))
    held = {"stiffness_N_per_m": stiffness, "damping_N_s_per_m": 11.0}
    return Hand((0.0, 0.6, 0.75, 3.0), places, (1.0,) * 4, **held)


class EmulatedSession(ExitStack):
    """Driver, emulator and servo; of each tick its record, and motor units that had arrived by then."""

    def __init__(self, *faults, hand=None, limits=LIMITS, tissue="paper-a", surface_z=0.130, **settings):
        super().__init__()
        given = EmulatorSettings(hand=hand or pressing(), period_s=TICK_S, faults=faults, **settings)
        self.link = EmulatedLink(given)
        self.falcon = self.link.falcon
        self.device = FalconDevice(limits, port=self.link.descriptor(), calibration=Calibration())
        self.limits = limits
        self.tissue = tissue
        self.surface_z = surface_z
        self.scale = preset_check(tissue).scaling
        self.records: list[Any] = []
        self.motors: list[tuple[int, ...]] = []

    def __enter__(self) -> Self:
        self.enter_context(self.link)
        self.io, self.servo, ring, block = self.enter_context(servo_here(self.device))
        self.reader = ring.reader()
        self.link.step()
        # the user homes the device while nobody asks
        self.falcon.advance(HOMED_S - self.falcon.time_s)
        block.write(parameters(self.tissue, surface_z=self.surface_z))
        block.order(COMMAND_ENGAGE)
        self.now_s = 0.0
        return self

    def tick(self, dt: float = TICK_S) -> Any:
        """One tick of the servo, then the emulator's answer."""
        self.now_s += dt
        compiled_tick(self.io, self.servo, self.now_s, dt, 0.0, 0)
        self.records.append(self.reader.read_new()[0][0])
        self.link.step()
        self.motors.append(self.falcon.last_motors)
        return self.records[-1]

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.tick()

    def run(self, until_s: float) -> None:
        """Tick until the emulator's clock says so, or the clock stands still."""
        while self.falcon.time_s < until_s and not self.falcon.gone:
            self.tick()

    def forces(self) -> np.ndarray:
        """|F| that was sent, tick by tick [N]."""
        return np.array([float(np.linalg.norm(record["force_N"])) for record in self.records])

    def states(self) -> list[State]:
        return [State(int(record["state"])) for record in self.records]

    def faults(self) -> set[int]:
        """Every fault that was recorded, NONE included."""
        return {int(record["fault"]) for record in self.records}

    def first(self, fault: Fault) -> int:
        """Tick in which a fault was first recorded; -1 for never."""
        return next((at for at, record in enumerate(self.records) if record["fault"] == fault), -1)
