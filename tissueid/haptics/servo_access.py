"""Access of the compiled servo to devices: one reading and one command a tick.

Each vendor's folder registers its ways; a loop asks by the type of the tuple that stands for a device.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple

from tissueid.errors import DeviceError
from tissueid.haptics.device import CompiledIO

#: Words of a reading: what came (:mod:`tissueid.haptics.guard`), whether homed, buttons, and commands
#: without an answer where each is answered.
REPLY, HOMED, PRESSED, UNANSWERED = 0, 1, 2, 3
WORDS_SIZE = 4
#: Modules that may register a device.
OURS = "tissueid.haptics."


class Access(NamedTuple):
    """Ways to one kind of device."""

    io: type  # named tuple that stands for a device in a loop
    made: Callable[[CompiledIO], Any]  # :class:`~tissueid.haptics.device.CompiledIO` -> such a tuple
    sense: Callable[..., None]  # compiled: of io, dt, position, counts and words; never waits
    command: Callable[..., None]  # compiled: of io, guard memory, limits and a force that passed the guard


_REGISTERED: dict[type, Access] = {}


def register(access: Access) -> Access:
    """Let loops find a kind of device by the type of its tuple."""
    _REGISTERED[access.io] = access
    return access


def access_of(io: type) -> Access:
    """Ways to the devices that tuples of this type stand for."""
    return _REGISTERED[io]


def compiled_io(given: CompiledIO) -> Any:
    """The tuple for what a device says of itself.

    Raises DeviceError: its kind is none of this package: compiled loops are kept by a hash of its sources
    alone, and would not notice a change of another's.
    """
    module, _, name = given.kind.partition(":")
    # a name of this package that is none is a bug of ours, and an error of its import
    if not module.startswith(OURS):
        msg = f"the compiled servo knows no device of kind {given.kind!r}; return None from compiled()"
        raise DeviceError(msg)
    access: Access = getattr(import_module(module), name)
    return access.made(given)
