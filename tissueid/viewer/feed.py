"""The newest samples for every client, each at its own pace: nobody waits for anybody."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import numpy as np

from tissueid.arrays import RecordArray
from tissueid.haptics.ring import Ring
from tissueid.viewer.frames import SAMPLE, samples_of, write_frame
from tissueid.viewer.protocols import Play

#: RecordArray in one frame, and the furthest a client may lie behind: 2 s at 1 kHz, 144 kB.
MOST_SAMPLES = 2000
#: Frames on their way to a client that has not answered: a picture of 60 ms at 100 frames/s, and a network.
MOST_UNANSWERED = 12
#: RecordArray kept: some more than any client may ask for.
KEPT = 4096


class LiveFeed:
    """Samples of a running servo, out of a ring that is read and never written."""

    def __init__(self, ring: Ring) -> None:
        self._reader = ring.reader(from_start=True)
        self._kept = np.zeros(KEPT, SAMPLE)
        #: Number of samples so far, those that came too fast for this feed included.
        self.published = 0
        self.ended = False

    def end(self) -> None:
        """No more samples will come."""
        self.pump()
        self.ended = True

    def now_s(self) -> float:
        """CLOCK_MONOTONIC, the servo's [s]."""
        return time.monotonic()

    def pump(self) -> int:
        """Take what is new in the ring; how much that was."""
        records, overrun = self._reader.read_new()
        new = samples_of(records[-KEPT:])
        self.published += records.size + overrun
        slots = np.arange(self.published - new.size, self.published) % KEPT
        self._kept[slots] = new
        return int(records.size)

    def between(self, first: int, end: int) -> RecordArray:
        """Samples ``first`` to ``end``."""
        return self._kept[np.arange(first, end) % KEPT]


class Client:
    """Cursor and credit of one client, and where it is, for messages."""

    def __init__(self, source: Source, name: str) -> None:
        self.source = source
        self.name = name
        #: RecordArray this client was too slow for.
        self.dropped = 0
        self.sent = self.answered = 0
        self._cursor = max(source.published - MOST_SAMPLES, 0)
        self._sent_s: deque[float] = deque()
        self._round_trip_s = 0.0
        self._said_ended = False

    def next_frame(self) -> bytes | None:
        """The frame to send now; None where nothing is new, or where too many are unanswered."""
        if self.sent - self.answered >= MOST_UNANSWERED:
            return None
        end, ended = self.source.published, self.source.ended
        if end == self._cursor and (not ended or self._said_ended):
            return None
        first = max(self._cursor, end - MOST_SAMPLES)
        self.dropped += first - self._cursor
        samples = self.source.between(first, end)
        self._cursor, self._said_ended = end, ended
        self.sent += 1
        self._sent_s.append(time.monotonic())
        return write_frame(
            samples,
            first=first,
            now_s=self.source.now_s(),
            dropped=self.dropped,
            round_trip_us=round(1e6 * self._round_trip_s),
            ended=ended,
        )

    def rewind(self) -> None:
        """The source has moved: go on with what is newest there."""
        self._cursor = max(self.source.published - MOST_SAMPLES, 0)
        self._said_ended = False

    def answer(self, count: int) -> bool:
        """Note that a client has drawn so many frames since it came; False where it can't have."""
        if not self.answered <= count <= self.sent:
            return False
        now = time.monotonic()
        for _ in range(count - self.answered):
            self._round_trip_s = now - self._sent_s.popleft()
        self.answered = count
        return True


class Playback:
    """A log that is played to one client, as it was felt, until somebody seeks or pauses."""

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


#: Source of a client's samples.
Source = LiveFeed | Playback
