"""Time of the servo: CLOCK_MONOTONIC, sleep to an absolute moment, and what other processes say meanwhile."""

from __future__ import annotations

from numba import types

from tissueid.arrays import IntArray
from tissueid.compiled import tick_kernel
from tissueid.haptics.foreign import libc_function

#: int64 words of room: a ``timespec``, then one ``pollfd``.
CLOCK_SIZE = 4
_POLLFD_AT = 2

CLOCK_MONOTONIC, TIMER_ABSTIME = 1, 1
INTERRUPTED = 4
NANOSECONDS = 1_000_000_000
#: poll(2): an int32 descriptor, int16 events and int16 returned events, here as one little-endian word.
POLL_IN, EVENTS_SHIFT, RETURNED_SHIFT = 0x1, 32, 48

_gettime = libc_function("clock_gettime", types.int32, types.int32, types.int64)
_nanosleep = libc_function("clock_nanosleep", types.int32, types.int32, types.int32, types.int64, types.int64)
_poll = libc_function("poll", types.int32, types.int64, types.int64, types.int32)


@tick_kernel
def monotonic_ns(room: IntArray) -> int:
    """CLOCK_MONOTONIC [ns], which no clock jump moves; ``room`` is int64, shape (CLOCK_SIZE,)."""
    _gettime(CLOCK_MONOTONIC, room.ctypes.data)
    return int(room[0] * NANOSECONDS + room[1])


@tick_kernel
def sleep_until(deadline_ns: int, room: IntArray) -> None:
    """Sleep to a moment of CLOCK_MONOTONIC; no spinning, which a real-time class is punished for."""
    room[0] = deadline_ns // NANOSECONDS
    room[1] = deadline_ns % NANOSECONDS
    while _nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, room.ctypes.data, 0) == INTERRUPTED:
        pass


@tick_kernel
def readable(descriptor: int, room: IntArray) -> bool:
    """True where a descriptor has bytes, or its other end is gone; False for a negative one."""
    if descriptor < 0:
        return False
    room[_POLLFD_AT] = descriptor | (POLL_IN << EVENTS_SHIFT)
    return bool(_poll(room.ctypes.data + 8 * _POLLFD_AT, 1, 0) > 0 and room[_POLLFD_AT] >> RETURNED_SHIFT)
