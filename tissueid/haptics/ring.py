"""The ring: records of the servo in shared memory, one writer that never waits, any number of readers.

The writer fills the slot after the newest, then publishes the number of records.  A reader copies what is
new, looks at that number again, and leaves out and counts what may have been overwritten.  The memory is a
``memfd``: 64 bytes of head (magic, capacity, published), then ``capacity`` records of 128 bytes.
"""

from __future__ import annotations

import mmap
import os
import platform
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import IntArray
from tissueid.errors import DeviceError

#: Head of a shared memory: its magic number, the number of things in it, and words of their own.
HEAD_BYTES = 64


@dataclass(frozen=True, slots=True)
class Shared:
    """Memory that processes share, mapped into this one."""

    descriptor: int  # of the memory; another process is sent one of its own

    def close(self) -> None:
        """Give the descriptor back; the mapping lives as long as its arrays."""
        os.close(self.descriptor)


def shared_memory(name: str, size: int) -> int:
    """Descriptor of new memory, all zero, for whom it is handed to; DeviceError on systems without any."""
    try:
        descriptor = os.memfd_create(f"tissueid-{name}", 0)
        os.ftruncate(descriptor, size)
    except (AttributeError, OSError) as error:
        msg = f"no shared memory for the servo's {name} ({error}); rendering needs Linux with memfd"
        raise DeviceError(msg) from error
    os.set_inheritable(descriptor, False)
    return descriptor


def counted(descriptor: int, magic: int, bytes_each: int, what: str) -> int:
    """Number of things in a memory whose head says what it is and how many; DeviceError where it is none."""
    size = os.fstat(descriptor).st_size
    if size >= HEAD_BYTES:
        said, count = np.frombuffer(os.pread(descriptor, HEAD_BYTES, 0), np.int64)[:2].tolist()
        if said == magic and size == HEAD_BYTES + count * bytes_each:
            return int(count)
    raise DeviceError(f"descriptor {descriptor} is no {what} of a servo")


_KEEPS_ORDER = platform.machine().lower() in {"x86_64", "amd64"}


def read_ordered(words: IntArray, at: int) -> int:
    """``words[at]`` of shared words, before everything read after."""
    if _KEEPS_ORDER:
        return int(words[at])
    from tissueid.haptics.foreign import load_acquire

    return int(load_acquire(words[at : at + 1]))


def write_ordered(words: IntArray, at: int, value: int) -> None:
    """Set ``words[at]`` of shared words, after everything written before."""
    if _KEEPS_ORDER:
        words[at] = value
        return
    from tissueid.haptics.foreign import store_release

    store_release(words[at : at + 1], value)


#: One tick.  ``time_s`` is CLOCK_MONOTONIC or virtual; ``dt_s`` what was measured; ``force_N`` what the guard
#: let through; ``depth_mm``, ``tissue_force_N`` and ``speed_mm_per_s`` are the tissue's; ``energy_J`` the
#: passivity observer's; ``surface_mm`` where the tissue's surface is, at the tool or, behind one that left,
#: on its way back; ``late_s`` how late the tick began; ``version`` counts exchanged parameters;
#: ``missed`` the ticks skipped so far; ``counts`` the encoders.
RECORD = np.dtype(
    [
        ("tick", "<i8"),
        ("time_s", "<f8"),
        ("dt_s", "<f8"),
        ("position_m", "<f8", (3,)),
        ("force_N", "<f8", (3,)),
        ("depth_mm", "<f8"),
        ("tissue_force_N", "<f8"),
        ("speed_mm_per_s", "<f4"),
        ("surface_mm", "<f4"),
        ("energy_J", "<f8"),
        ("lamps", "<u4"),
        ("state", "u1"),
        ("fault", "u1"),
        ("buttons", "<u2"),
        ("late_s", "<f4"),
        ("version", "<u2"),
        ("missed", "<u2"),
        ("counts", "<i2", (3,)),
        ("label", "<u2"),
    ]
)
#: 65 s at 1 kHz: far more than any reader may sleep.
CAPACITY = 65_536
#: "tissring" as a little-endian integer.
MAGIC = int.from_bytes(b"tissring", "little")
PUBLISHED_AT = 2


@dataclass(frozen=True, slots=True)
class Ring(Shared):
    """Shared memory of one session, mapped into this process."""

    head: IntArray  # (8,)
    records: NDArray[Any]  # (capacity,)

    @classmethod
    def create(cls, capacity: int = CAPACITY) -> Ring:
        """A new ring in anonymous memory; DeviceError where the system has no such memory."""
        descriptor = shared_memory("records", HEAD_BYTES + capacity * RECORD.itemsize)
        ring = cls._mapped(descriptor, capacity)
        ring.head[:2] = MAGIC, capacity
        return ring

    @classmethod
    def attach(cls, descriptor: int) -> Ring:
        """The ring behind a descriptor, read-only where that is; DeviceError if it is none."""
        return cls._mapped(descriptor, counted(descriptor, MAGIC, RECORD.itemsize, "ring"))

    @classmethod
    def _mapped(cls, descriptor: int, capacity: int) -> Ring:
        # every page at once: a page that is met for the first time in a tick costs more than the tick
        size, shared = HEAD_BYTES + capacity * RECORD.itemsize, mmap.MAP_SHARED | mmap.MAP_POPULATE
        try:
            memory = mmap.mmap(descriptor, size, flags=shared)
        except PermissionError:  # a descriptor that can only be read
            memory = mmap.mmap(descriptor, size, flags=shared, prot=mmap.PROT_READ)
        return cls(
            descriptor,
            np.frombuffer(memory, np.int64, HEAD_BYTES // 8),
            np.frombuffer(memory, RECORD, capacity, HEAD_BYTES),
        )

    @property
    def published(self) -> int:
        """Records written since the ring was made."""
        return read_ordered(self.head, PUBLISHED_AT)

    def read_only(self) -> int:
        """A new descriptor of the memory through which nobody can write."""
        return os.open(f"/proc/self/fd/{self.descriptor}", os.O_RDONLY | os.O_CLOEXEC)

    def reader(self, *, from_start: bool = False) -> RingReader:
        """A reader of its own pace, from now on or from the oldest record."""
        return RingReader(self, 0 if from_start else self.published)


class RingReader:
    """Reader of records that are new since the last look, from the number ``position`` on."""

    def __init__(self, ring: Ring, position: int) -> None:
        self._ring = ring
        #: Number of the next record to read.
        self.position = position

    def read_new(self) -> tuple[NDArray[Any], int]:
        """Whole records published since the last call, in order, and how many were lost before them."""
        records = self._ring.records
        capacity = records.size
        # the slot after the newest may be half written: capacity - 1 records are safe at any moment
        count = self._ring.published
        start = max(self.position, count - (capacity - 1))
        slots = np.arange(start, count) % capacity
        copied = records[slots]
        oldest = self._ring.published - (capacity - 1)
        late = min(max(oldest - start, 0), copied.size)
        overrun = start + late - self.position
        self.position = count
        return copied[late:], overrun
