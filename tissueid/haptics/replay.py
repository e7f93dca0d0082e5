"""A device that moves as a recorded session did: ``tissueid render --replay LOG``.

Between two records it is on their line, outside them at rest; no force changes the motion.  SI units.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError
from tissueid.haptics.device import Capabilities, DetectedDevice, DeviceSample, HapticDevice
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.sim import CENTRE_M, DEFAULT_PERIOD_S, DEFAULT_QUANTUM_M, carried, computed


class ReplayDevice(HapticDevice):
    """The motion of a log, in real time or one period a force written; DeviceError where it holds none."""

    name = "replay"

    def __init__(
        self,
        limits: GuardLimits | None = None,
        *,
        log: str | os.PathLike[str] | None = None,
        real_time: bool = True,
        period_s: float = DEFAULT_PERIOD_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(carried(limits or GuardLimits.simulated()))
        self.real_time = real_time
        self.period_s = period_s
        self._clock = clock
        self._started_s: float | None = None
        self._written = 0
        self._time_s, self._position_m = np.zeros(1), np.array([CENTRE_M])
        self._buttons = np.zeros(1, np.int64)
        self._log = log
        if log is not None:
            self._load(Path(log))

    @classmethod
    def detect(cls) -> list[DetectedDevice]:
        """It is there where a log is named."""
        return [DetectedDevice(cls.name, "this program", "needs the log of a session: --replay LOG")]

    @property
    def capabilities(self) -> Capabilities:
        """Of a motion that no force changes: nothing to hurt, nothing to damp."""
        return computed(self, damping_N_s_per_m=np.inf, delay_ticks=0.0)

    @property
    def duration_s(self) -> float:
        """Time from the first to the last record [s]."""
        return float(self._time_s[-1])

    @property
    def ended(self) -> bool:
        """The motion is over."""
        return self._elapsed() >= self.duration_s

    def _load(self, path: Path) -> None:
        from tissueid.store.session_log import read_session_log

        records = read_session_log(path).records
        times = np.asarray(records["time_s"], dtype=np.float64)
        places = np.asarray(records["position_m"], dtype=np.float64)
        sound = np.isfinite(times) & np.isfinite(places).all(axis=1)
        times, places = times[sound], places[sound]
        if times.size < 2 or (np.diff(times) <= 0.0).any():
            msg = f"{path}: its {times.size} usable records hold no motion that goes forward in time"
            raise DeviceError(msg)
        self._time_s, self._position_m = times - times[0], places
        self._buttons = np.zeros(times.size, np.int64)
        if "buttons" in (records.dtype.names or ()):
            self._buttons = records["buttons"][sound].astype(np.int64)

    def _elapsed(self) -> float:
        if not self.real_time:
            return self._written * self.period_s
        return 0.0 if self._started_s is None else self._clock() - self._started_s

    def _open(self) -> None:
        if self._log is None:
            msg = "replay: no log was named; give one with --replay LOG"
            raise DeviceError(msg)
        self._started_s = None
        self._written = 0

    def _close(self) -> None:
        """Nothing to let go of."""

    def _read(self) -> DeviceSample:
        if self._started_s is None:
            self._started_s = self._clock() if self.real_time else 0.0
        now = self._elapsed()
        place = np.array([np.interp(now, self._time_s, self._position_m[:, axis]) for axis in range(3)])
        at = min(int(np.searchsorted(self._time_s, now, side="right")), self._time_s.size) - 1
        return DeviceSample(
            time_s=now,
            position_m=place,
            counts=np.floor(place / DEFAULT_QUANTUM_M).astype(np.int64),
            buttons=int(self._buttons[max(at, 0)]),
            homed=True,
            valid=True,
        )

    def _write(self, force_N: FloatArray) -> None:  # noqa: ARG002 - no force changes a recorded motion
        self._written += 1
