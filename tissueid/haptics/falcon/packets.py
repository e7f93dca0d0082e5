"""Packets of the Falcon for Python: commands to bytes, bytes to replies.

The servo uses the same compiled functions (:mod:`tissueid.haptics.falcon.packet_kernels`).
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.haptics.falcon.packet_kernels import (
    DROPPED,
    INVALID,
    LED_BLUE,
    LED_GREEN,
    LED_RED,
    MOTOR_LIMIT,
    PACKET_BYTES,
    PACKETS,
    PARSER_SIZE,
    REPLY_FIELDS,
    encode_into,
    parse_bytes,
)

__all__ = [
    "ALL_HOMED",
    "BUTTON_NAMES",
    "LED_BLUE",
    "LED_GREEN",
    "LED_RED",
    "MOTOR_LIMIT",
    "PACKET_BYTES",
    "PacketParser",
    "Reply",
    "encode_command",
]

ALL_LEDS = LED_GREEN | LED_BLUE | LED_RED

#: ``Reply.homed`` with all three legs homed.
ALL_HOMED = 0b111

#: Button bit -> name.
BUTTON_NAMES = {0x01: "plus", 0x02: "forward", 0x04: "centre", 0x08: "minus"}


class Reply(NamedTuple):
    """One reply of the device.

    Attributes
    ----------
    encoders : tuple of int
        Counts of legs 1, 2 and 3, signed 16 bit.  Without meaning until the device is homed.
    homed : int
        One bit a leg, 7 when all are; valid while homing mode is commanded.
    buttons : int
        Bits as in :data:`BUTTON_NAMES`.
    """

    encoders: tuple[int, int, int]
    homed: int
    buttons: int


def encode_command(motor_units: Sequence[int] | NDArray[np.int64], *, leds: int, homing: bool) -> bytes:
    """One command packet.

    Parameters
    ----------
    motor_units : sequence of 3 int
        Motors 1, 2 and 3, within +-4095.
    leds : int
        Any of 0x02, 0x04 and 0x08 together, see :data:`LED_GREEN` and its neighbours.
    homing : bool
        Homing mode; the device forgets its homing with the first packet without it.

    Returns
    -------
    bytes
        16 bytes.

    Raises
    ------
    ValueError
        For anything else than three integers in range, other LED bits, or a homing that is no boolean.
    """
    try:
        motor = [operator.index(value) for value in motor_units]
        bits = operator.index(leds)
    except TypeError as error:
        msg = f"motor units and LED bits are integers, not {motor_units!r} and {leds!r}"
        raise ValueError(msg) from error
    if len(motor) != 3 or any(abs(value) > MOTOR_LIMIT for value in motor):
        msg = f"a command has three motor values within +-{MOTOR_LIMIT}, not {motor}"
        raise ValueError(msg)
    if bits & ~ALL_LEDS:
        msg = f"LED bits are 0x02, 0x04 and 0x08, not {bits:#04x}"
        raise ValueError(msg)
    if homing not in (True, False):
        msg = f"homing is True or False, not {homing!r}"
        raise ValueError(msg)
    out = np.empty(PACKET_BYTES, dtype=np.uint8)
    encode_into(np.array(motor, dtype=np.int64), bits, bool(homing), out)
    return out.tobytes()


class PacketParser:
    """Replies out of a byte stream that may begin anywhere, lose, gain or change bytes.

    A reply is 16 bytes: ``<``, twelve of ``A`` to ``P``, a status byte 0x41 to 0xC0, any byte but ``<`` and
    ``>``, and ``>``.  Everything else is dropped and counted.  An intact reply is found whatever stands
    before it.  The wire has no checksum: a reply whose nibble turned into another nibble is still a reply.
    """

    def __init__(self) -> None:
        self._memory = np.zeros(PARSER_SIZE, dtype=np.int64)

    def feed(self, data: bytes) -> list[Reply]:
        """Take the next bytes of the stream, in pieces of any length.

        Parameters
        ----------
        data : bytes

        Returns
        -------
        list of Reply
            The replies that these bytes completed, in order.
        """
        fields = np.empty((len(data) // PACKET_BYTES + 1, REPLY_FIELDS), dtype=np.int64)
        count = parse_bytes(self._memory, np.frombuffer(data, dtype=np.uint8), fields)
        return [
            Reply((first, second, third), homed, buttons)
            for first, second, third, homed, buttons in fields[:count].tolist()
        ]

    @property
    def packets(self) -> int:
        """Whole replies so far."""
        return int(self._memory[PACKETS])

    @property
    def invalid(self) -> int:
        """Candidates so far that began with ``<`` and were no reply."""
        return int(self._memory[INVALID])

    @property
    def dropped(self) -> int:
        """Bytes so far that belong to no reply."""
        return int(self._memory[DROPPED])
