"""The way down to the servo: parameters and a heartbeat, never forces.

The owner writes the copy that is not in use, then publishes its version; the servo copies it when no tissue
is touched, and says which it took: only then the next is written, so that no copy is read meanwhile. Layout,
int64 words: magic, size, version published, version taken, heartbeat, command; 2 x ``size`` float64.
"""

from __future__ import annotations

import mmap
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import tick_kernel, tick_part
from tissueid.errors import DeviceError
from tissueid.haptics.foreign import load_acquire, store_release
from tissueid.haptics.ring import HEAD_BYTES, Shared, counted, read_ordered, shared_memory, write_ordered

#: "tissparm" as a little-endian integer.
MAGIC = int.from_bytes(b"tissparm", "little")
_PUBLISHED_AT, _TAKEN_AT, _BEAT_AT, _COMMAND_AT = range(2, 6)

#: What the owner wants: no force; force; the end.
COMMAND_DISENGAGE, COMMAND_ENGAGE, COMMAND_STOP = 0, 1, 2


@tick_part
def beats(head: IntArray) -> int:
    """Signs of life so far."""
    return load_acquire(head[_BEAT_AT : _BEAT_AT + 1])


@tick_part
def command(head: IntArray) -> int:
    """Command of the owner: COMMAND_DISENGAGE, COMMAND_ENGAGE or COMMAND_STOP."""
    return load_acquire(head[_COMMAND_AT : _COMMAND_AT + 1])


@tick_part
def waiting(head: IntArray) -> bool:
    """True where parameters were published that the servo has not taken."""
    return bool(load_acquire(head[_PUBLISHED_AT : _PUBLISHED_AT + 1]) != head[_TAKEN_AT])


@tick_kernel
def take(head: IntArray, values: FloatArray, out: FloatArray) -> int:
    """Copy the newest parameters to ``out`` (size,); their version, counted from 1, 0 while there is none."""
    version = load_acquire(head[_PUBLISHED_AT : _PUBLISHED_AT + 1])
    source = values[version % 2]
    for i in range(out.size):
        out[i] = source[i]
    store_release(head[_TAKEN_AT : _TAKEN_AT + 1], version)
    return version


@dataclass(frozen=True, slots=True)
class ParameterBlock(Shared):
    """Shared parameters of one session, mapped into this process."""

    head: IntArray  # (8,)
    values: FloatArray  # (2, size)

    @classmethod
    def create(cls, size: int) -> ParameterBlock:
        """A new block for ``size`` parameters; DeviceError where the system has no such memory."""
        block = cls._mapped(shared_memory("parameters", HEAD_BYTES + 16 * size), size)
        block.head[:2] = MAGIC, size
        return block

    @classmethod
    def attach(cls, descriptor: int) -> ParameterBlock:
        """The block behind an inherited descriptor; DeviceError where it is none."""
        return cls._mapped(descriptor, counted(descriptor, MAGIC, 16, "parameter block"))

    @classmethod
    def _mapped(cls, descriptor: int, size: int) -> ParameterBlock:
        memory = mmap.mmap(descriptor, HEAD_BYTES + 16 * size)
        values = np.frombuffer(memory, np.float64, 2 * size, HEAD_BYTES).reshape(2, size)
        return cls(descriptor, np.frombuffer(memory, np.int64, HEAD_BYTES // 8), values)

    @property
    def published(self) -> int:
        """Newest version; 0 before the first."""
        return read_ordered(self.head, _PUBLISHED_AT)

    @property
    def taken(self) -> int:
        """Version the servo renders; 0 before the first."""
        return read_ordered(self.head, _TAKEN_AT)

    def write(self, parameters: FloatArray) -> int:
        """Publish finite parameters (size,); their version, or DeviceError while the last are not taken."""
        if parameters.shape != self.values.shape[1:] or not np.isfinite(parameters).all():
            raise ValueError(f"parameters must be {self.values.shape[1]} finite numbers")
        version = self.published
        if version != self.taken:
            msg = "the last parameters are still waiting for a moment at which nothing is touched"
            raise DeviceError(msg)
        self.values[(version + 1) % 2] = parameters
        write_ordered(self.head, _PUBLISHED_AT, version + 1)
        return version + 1

    def beat(self) -> None:
        """Give a sign of life; 500 ms without one, and the servo takes the force away."""
        write_ordered(self.head, _BEAT_AT, int(self.head[_BEAT_AT]) + 1)

    def order(self, what: int) -> None:
        """Tell the servo what is wanted: COMMAND_DISENGAGE, COMMAND_ENGAGE or COMMAND_STOP."""
        write_ordered(self.head, _COMMAND_AT, what)
