"""A guard brought into a state, and one tick of it."""

from typing import Self

import numpy as np

from tissueid.haptics import guard as machine
from tissueid.haptics.guard import REPLY_VALID, guard, new_guard, observe, transition
from tissueid.haptics.limits import GuardLimits

TICK = 1e-3
REST = np.zeros(3)
STILL = np.zeros(3, np.int64)
#: Counts of a grip that moves: encoders that stand still while the force changes are a fault of their own.
MOVING = np.ones(3, np.int64)
#: No dead-man button: most tests are of something else.
FREE = GuardLimits(clamp_N=5.0, rms_limit_N=5.0, dead_man=False)


class Guarded:
    """Memory and limits of one guard; ``seen`` is what the next tick observes."""

    def __init__(self, limits: GuardLimits = FREE) -> None:
        self.limits = limits.block()
        self.memory = new_guard()
        self.seen = {
            "reply": REPLY_VALID, "homed": True, "buttons": 0, "moved": MOVING, "velocity": REST,
            "penetration": 0.0,
        }  # fmt: skip

    def tell(self, event: float) -> bool:
        return transition(self.memory, self.limits, event)

    def tick(self, force=(0.0, 0.0, 0.0), dt: float = TICK, **seen: object) -> np.ndarray:
        """One tick: what was seen, then a wanted force; the force that may be sent."""
        words = {**self.seen, **seen}
        observe(
            self.memory, self.limits, words["reply"], words["homed"], words["buttons"], words["moved"],
            np.asarray(words["velocity"], float), words["penetration"], dt,
        )  # fmt: skip
        out = np.full(3, 99.0)
        guard(self.memory, self.limits, np.asarray(force, float), dt, out)
        return out

    def ticks(self, count: int, force, **seen: object) -> list[np.ndarray]:
        """Equal ticks, and the forces that may be sent."""
        return [self.tick(force, **seen) for _ in range(count)]

    def to(self, state: float) -> Self:
        """Walk up to a state; ENGAGED with the start-up ramp behind it."""
        for event in (machine.OPENED, machine.FIRMWARE_OK, machine.HOME):
            if self.memory[machine.STATE] == state:
                return self
            self.tell(event)
        while self.memory[machine.STATE] < min(state, machine.ARMED):
            self.tick()
        if state == machine.ENGAGED:
            self.tell(machine.ENGAGE)
            while self.memory[machine.GAIN] < 1.0:
                self.tick(buttons=0xF)
        return self

    @property
    def state(self) -> float:
        return float(self.memory[machine.STATE])

    @property
    def fault(self) -> int:
        return int(self.memory[machine.FAULT])

    @property
    def lamps(self) -> int:
        return int(self.memory[machine.LAMPS])
