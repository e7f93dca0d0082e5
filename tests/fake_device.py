"""A device with methods in Python, as a plug-in would write it, and every force it was sent."""

import numpy as np

from tissueid.haptics.device import Capabilities, DetectedDevice, DeviceSample, HapticDevice
from tissueid.haptics.limits import GuardLimits

RANGE = (-0.05, 0.05)
CAPABILITIES = Capabilities("fake", 5.0, True, 0.5, 1.0, (RANGE, RANGE, RANGE), hardware=False)
LIMITS = GuardLimits(clamp_N=5.0, rms_limit_N=5.0, dead_man=False)


class FakeDevice(HapticDevice):
    """Answers what ``answer`` says; ``sent`` has every force that reached it."""

    name = "fake"

    def __init__(self, limits: GuardLimits = LIMITS) -> None:
        super().__init__(limits)
        self.sent: list[np.ndarray] = []
        self.answer = {"homed": True, "valid": True, "buttons": 0, "damaged": 0}
        self.position = np.zeros(3)
        self.counts = np.zeros(3, np.int64)
        self.now = 0.0
        self.broken: Exception | None = None
        self.refuses: Exception | None = None
        self.closed = 0

    @classmethod
    def detect(cls) -> list[DetectedDevice]:
        return [DetectedDevice("fake", "this test")]

    @property
    def capabilities(self) -> Capabilities:
        return CAPABILITIES

    def _open(self) -> None:
        if self.refuses is not None:
            raise self.refuses

    def _close(self) -> None:
        self.closed += 1

    def _read(self) -> DeviceSample:
        if self.broken is not None:
            raise self.broken
        self.now += 1e-3
        return DeviceSample(self.now, self.position.copy(), self.counts.copy(), **self.answer)

    def _write(self, force_N: np.ndarray) -> None:
        if self.broken is not None:
            raise self.broken
        self.sent.append(force_N.copy())


def law(position_m: np.ndarray, velocity_m_per_s: np.ndarray, dt_s: float) -> np.ndarray:
    """A spring toward the origin, as another distribution would register it."""
    return -100.0 * position_m
