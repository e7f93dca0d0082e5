"""Records of the servo as binary frames of a websocket, version 1, for every client at its own pace.

One message is a head of 32 bytes and ``count`` samples of 72 bytes, all little-endian::

    head    magic "TF" (2 bytes), version u1, flags u1 (bit 0: the source has ended), count u4,
            first u8 (number of the first sample since the session began), dropped u4 (samples this client
            was too slow for, so far), round_trip_us u4 (from a frame to its answer; 0 before the first),
            now_s f8 (the source's clock when the frame was made)
    sample  see SAMPLE: time f8, then f4, then integers, each aligned to its size

``time_s`` and ``now_s`` share a clock (CLOCK_MONOTONIC of the servo's machine, or the time of a log), so that
their difference is the age of a sample.  Positions, forces and the like are rounded to f4, which holds a
force of 5 N to 0.5 uN.  Before the first frame comes one text message, the hello
(:mod:`tissueid.viewer.hello`), which repeats this layout: a page reads fields by their names.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import RecordArray
from tissueid.haptics.ring import Ring

if TYPE_CHECKING:
    from tissueid.viewer.protocols import Play

VERSION = 1
MAGIC = b"TF"
#: Flag of a head: no further samples will come.
ENDED = 1

HEAD = np.dtype(
    [
        ("magic", "S2"),
        ("version", "u1"),
        ("flags", "u1"),
        ("count", "<u4"),
        ("first", "<u8"),
        ("dropped", "<u4"),
        ("round_trip_us", "<u4"),
        ("now_s", "<f8"),
    ]
)
#: One tick, as :data:`tissueid.haptics.ring.RECORD` without the encoders; ``tick`` counts modulo 2**32.
SAMPLE = np.dtype(
    [
        ("time_s", "<f8"),
        ("tick", "<u4"),
        ("dt_s", "<f4"),
        ("position_m", "<f4", (3,)),
        ("force_N", "<f4", (3,)),
        ("depth_mm", "<f4"),
        ("tissue_force_N", "<f4"),
        ("speed_mm_per_s", "<f4"),
        ("energy_J", "<f4"),
        ("surface_mm", "<f4"),
        ("lamps", "<u4"),
        ("missed", "<u2"),
        ("label", "<u2"),
        ("buttons", "<u2"),
        ("state", "u1"),
        ("fault", "u1"),
    ]
)
_TICKS = 2**32


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A frame that was read."""

    first: int  # number of the first sample since the session began
    samples: RecordArray  # (n,)
    dropped: int  # samples this client was too slow for, so far
    round_trip_us: int
    now_s: float  # the source's clock when the frame was made [s]
    ended: bool


#: Methods by which a DataView of a page reads a number of a type.
READERS = {
    "<f8": "getFloat64", "<f4": "getFloat32", "<u4": "getUint32", "<u2": "getUint16", "|u1": "getUint8"
}  # fmt: skip


def layout() -> list[tuple[str, str, int]]:
    """Name, reader and offset of every number of a sample; those of a vector are ``field.0`` and so on."""
    assert SAMPLE.fields is not None  # noqa: S101 -- a structured type has fields
    columns = []
    for field, (kind, offset, *_) in SAMPLE.fields.items():
        names = [f"{field}.{part}" for part in range(kind.shape[0])] if kind.shape else [field]
        read, size = READERS[kind.base.str], kind.base.itemsize
        columns += [(name, read, offset + part * size) for part, name in enumerate(names)]
    return columns


def samples_of(records: NDArray[Any]) -> RecordArray:
    """Records (n,) of a ring or a log as samples; what they lack is 0."""
    samples = np.zeros(records.size, SAMPLE)
    for name in set(SAMPLE.names or ()) & set(records.dtype.names or ()):
        samples[name] = records[name] % _TICKS if name == "tick" else records[name]
    return samples


def write_frame(
    samples: RecordArray,
    *,
    first: int,
    now_s: float,
    dropped: int = 0,
    round_trip_us: int = 0,
    ended: bool = False,
) -> bytes:
    """One message; ``first`` and the others as in :class:`Frame`."""
    head = np.zeros((), HEAD)
    head["magic"], head["version"] = MAGIC, VERSION
    head["flags"] = ENDED if ended else 0
    head["count"], head["first"], head["now_s"] = samples.size, first, now_s
    head["dropped"], head["round_trip_us"] = min(dropped, _TICKS - 1), min(round_trip_us, _TICKS - 1)
    return head.tobytes() + samples.tobytes()


def read_frame(data: bytes) -> Frame:
    """The inverse of :func:`write_frame`; ValueError: it is no frame of this version, or not whole."""
    if len(data) < HEAD.itemsize:
        raise ValueError(f"a frame has a head of {HEAD.itemsize} bytes, this one is {len(data)} bytes long")
    head = np.frombuffer(data, HEAD, 1)[0]
    if head["magic"] != MAGIC or head["version"] != VERSION:
        raise ValueError(f"no frame of version {VERSION}: it begins with {data[:4]!r}")
    if len(data) != HEAD.itemsize + int(head["count"]) * SAMPLE.itemsize:
        raise ValueError(f"a frame of {head['count']} samples can't have {len(data)} bytes")
    return Frame(
        int(head["first"]),
        np.frombuffer(data, SAMPLE, offset=HEAD.itemsize),
        int(head["dropped"]),
        int(head["round_trip_us"]),
        float(head["now_s"]),
        bool(head["flags"] & ENDED),
    )


#: Samples in one frame, and the furthest a client may lie behind: 2 s at 1 kHz, 144 kB.
MOST_SAMPLES = 2000
#: Frames on their way to a client that has not answered: a picture of 60 ms at 100 frames/s, and a network.
MOST_UNANSWERED = 12
#: Samples kept: some more than any client may ask for.
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
        self._kept[np.arange(self.published - new.size, self.published) % KEPT] = new
        return int(records.size)

    def between(self, first: int, end: int) -> RecordArray:
        """Samples ``first`` to ``end``."""
        return self._kept[np.arange(first, end) % KEPT]


class Client:
    """Cursor and credit of one client."""

    def __init__(self, source: Source) -> None:
        self.source = source
        #: Samples this client was too slow for.
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
