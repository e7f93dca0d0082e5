"""Anonymous memory that a spawned process inherits by its descriptor alone."""

from __future__ import annotations

import os

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
