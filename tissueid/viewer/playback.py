"""A session's log as it was felt: samples come when they came, until somebody seeks or pauses."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from tissueid.arrays import RecordArray
from tissueid.viewer.protocols import Play


class Playback:
    """A log that is played to one client.

    ``samples`` (n,): times rising; ``clock``: seconds, never falling.
    """

    def __init__(self, samples: RecordArray, clock: Callable[[], float] = time.monotonic) -> None:
        self._samples = samples
        self._begin_s, self._end_s = float(samples["time_s"][0]), float(samples["time_s"][-1])
        self._clock = clock
        self._since_s = clock()
        self._at_s = self._begin_s
        self._paused = False

    @property
    def published(self) -> int:
        """Number of samples up to now."""
        return int(np.searchsorted(self._samples["time_s"], self.now_s(), side="right"))

    @property
    def ended(self) -> bool:
        """True where the last sample was played."""
        return self.now_s() >= self._end_s

    def now_s(self) -> float:
        """Time within the log [s]; it stands at the end."""
        passed = 0.0 if self._paused else self._clock() - self._since_s
        return min(self._at_s + passed, self._end_s)

    def between(self, first: int, end: int) -> RecordArray:
        """Samples ``first`` to ``end``."""
        return self._samples[first:end]

    def play(self, asked: Play) -> None:
        """Go to a place, go on, or stand still."""
        now = self.now_s() if asked.at_s is None else min(self._begin_s + asked.at_s, self._end_s)
        self._at_s, self._since_s, self._paused = now, self._clock(), asked.paused
