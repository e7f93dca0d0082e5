"""Memory that a spawned process inherits by its descriptor alone, and words in it that are read in order.

One 64-bit integer that other processes see in order, read and written from Python.
x86-64 keeps loads in the order of the program, and stores too (Intel 64 Architectures Software Developer's
Manual, volume 3, 10.2.2): a plain aligned word is an acquire and a release, and between two steps of the
interpreter no compiler moves anything.  Elsewhere the compiled ones of :mod:`tissueid.haptics.atomic` are
taken.  Loading those costs a process half a second, which most readers of a ring would spend on nothing else.
"""

from __future__ import annotations

import os
import platform

from tissueid.arrays import IntArray
from tissueid.errors import DeviceError


def shared_memory(name: str, size: int) -> int:
    """Descriptor of new memory, all zero; another process gets it only where it is handed over.

    ``name``: what it holds, in a word; ``size``: bytes.  Raises DeviceError: the system has no such memory.
    """
    try:
        descriptor = os.memfd_create(f"tissueid-{name}", 0)
        os.ftruncate(descriptor, size)
    except (AttributeError, OSError) as error:
        msg = f"no shared memory for the servo's {name} ({error}); rendering needs Linux with memfd"
        raise DeviceError(msg) from error
    os.set_inheritable(descriptor, False)
    return descriptor


_KEEPS_ORDER = platform.machine().lower() in {"x86_64", "amd64"}


def read_ordered(words: IntArray, at: int) -> int:
    """``words[at]``, before everything read after.

    ``words``: shared.
    """
    if _KEEPS_ORDER:
        return int(words[at])
    from tissueid.haptics.atomic import load_acquire

    return int(load_acquire(words[at : at + 1]))


def write_ordered(words: IntArray, at: int, value: int) -> None:
    """Set ``words[at]``, after everything written before.

    ``words``: shared.
    """
    if _KEEPS_ORDER:
        words[at] = value
        return
    from tissueid.haptics.atomic import store_release

    store_release(words[at : at + 1], value)
