"""The Falcon's 16-byte packets: one encoder and one automaton that reads byte by byte.

Both directions have one shape (falcon firmware, as observed by others; no unit confirmed it here)::

    byte      0     1-4, 5-8, 9-12               13                       14        15
    host     '<'    motor 1, 2, 3                'A' + (LEDs | homing)    'A'       '>'
    device   '<'    encoder 1, 2, 3              'A' + (homed | buttons)  anything  '>'

A number is a signed 16-bit integer in four nibbles, least significant first, each plus 'A'.  No byte after
the first of a valid reply may be ``<``: replies never overlap, and ``<`` always starts a new one, so that
the automaton finds every intact reply in any garbage without a second look at a byte.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import ByteArray, IntArray
from tissueid.compiled import tick_kernel
from tissueid.haptics.states import State

PACKET_BYTES = 16
#: Largest motor command [motor units].
MOTOR_LIMIT = 4095

#: LED bits of the wire.  Which colour is which has been read, not seen: no unit confirmed it here.
LED_GREEN, LED_BLUE, LED_RED = 0x02, 0x04, 0x08
ALL_LEDS = LED_GREEN | LED_BLUE | LED_RED

START = 0x3C  # '<'
END = 0x3E  # '>'
OFFSET = 0x41  # 'A': what is added to every value
LAST_NIBBLE = 0x50  # 'P'
#: Largest status byte: four buttons and three homed flags, all set.
LAST_STATUS = 0xC0
HOMING_BIT = 0x01
SIGN = 0x8000
RANGE = 0x10000
STATUS_AT, UNKNOWN_AT, END_AT = 13, 14, 15

_ARMED, _ENGAGED = int(State.ARMED), int(State.ENGAGED)

#: Memory of the automaton, int64: bytes taken of the present candidate, the bytes themselves (by position),
#: then the fields of the last whole reply and the counters since the memory was made.
FILLED, ENCODERS, HOMED, BUTTONS = 0, 16, 19, 20
#: Whole replies, candidates that broke, bytes that belong to no reply.
PACKETS, INVALID, DROPPED, PARSER_SIZE = 21, 22, 23, 24


@tick_kernel
def leds_of_state(state: int) -> int:
    """LED bits of a device's state: red until it is homed and after a fault, then green, blue with force."""
    if state == _ENGAGED:
        return LED_GREEN | LED_BLUE
    return LED_GREEN if state == _ARMED else LED_RED


@tick_kernel
def encode_into(motor: IntArray, leds: int, homing: bool, out: ByteArray) -> None:
    """Write one command (16,).

    A motor value outside +-4095 is the caller's bug, which must not become a force: then all three are sent
    as zero.  The device leaves homing mode with the first command without it.
    """
    inside = True
    for i in range(3):
        if motor[i] < -MOTOR_LIMIT or motor[i] > MOTOR_LIMIT:
            inside = False
    out[0] = START
    for i in range(3):
        value = motor[i] % RANGE if inside else 0
        for nibble in range(4):
            out[1 + 4 * i + nibble] = OFFSET + ((value >> (4 * nibble)) & 0xF)
    out[STATUS_AT] = OFFSET + (leds & ALL_LEDS) + (HOMING_BIT if homing else 0)
    out[UNKNOWN_AT] = OFFSET
    out[END_AT] = END


@tick_kernel
def _fits(position: int, byte: int) -> bool:
    """True where a byte may stand at a position 1 to 15 of a reply."""
    if position < STATUS_AT:
        return OFFSET <= byte <= LAST_NIBBLE
    if position == STATUS_AT:
        return OFFSET <= byte <= LAST_STATUS
    if position == UNKNOWN_AT:
        return byte not in (START, END)
    return byte == END


@tick_kernel
def _decode(memory: IntArray) -> None:
    """Fields of a whole reply, from its bytes."""
    for i in range(3):
        value = 0
        for nibble in range(4):
            value += (memory[1 + 4 * i + nibble] - OFFSET) << (4 * nibble)
        memory[ENCODERS + i] = value - RANGE if value >= SIGN else value
    status = memory[STATUS_AT] - OFFSET
    memory[BUTTONS] = status & 0xF
    memory[HOMED] = (status >> 4) & 0x7
    memory[PACKETS] += 1


@tick_kernel
def parse_byte(memory: IntArray, byte: int) -> int:
    """Take one byte; 1 if it completed a reply, whose fields then stand in ``memory``, else 0."""
    filled = memory[FILLED]
    if byte == START:
        if filled > 0:
            memory[INVALID] += 1
            memory[DROPPED] += filled
        memory[FILLED] = 1
        return 0
    if filled == 0:
        memory[DROPPED] += 1
        return 0
    if not _fits(filled, byte):
        memory[INVALID] += 1
        memory[DROPPED] += filled + 1
        memory[FILLED] = 0
        return 0
    if filled < END_AT:
        memory[filled] = byte
        memory[FILLED] = filled + 1
        return 0
    _decode(memory)
    memory[FILLED] = 0
    return 1


#: ``Reply.homed`` with all three legs homed.
ALL_HOMED = 0b111

#: Button bit -> name.
BUTTON_NAMES = {0x01: "plus", 0x02: "forward", 0x04: "centre", 0x08: "minus"}


class Reply(NamedTuple):
    """One reply of the device."""

    encoders: tuple[int, int, int]
    homed: int
    buttons: int


def encode_command(motor_units: Sequence[int] | NDArray[np.int64], *, leds: int, homing: bool) -> bytes:
    """A command packet of three motors within +-4095, LED bits and homing mode; ValueError for others."""
    try:
        motor = [operator.index(value) for value in motor_units]
        bits = operator.index(leds)
    except TypeError as error:
        msg = f"motor units and LED bits are integers, not {motor_units!r} and {leds!r}"
        raise ValueError(msg) from error
    if len(motor) != 3 or any(abs(value) > MOTOR_LIMIT for value in motor):
        raise ValueError(f"a command has three motor values within +-{MOTOR_LIMIT}, not {motor}")
    if bits & ~ALL_LEDS:
        raise ValueError(f"LED bits are 0x02, 0x04 and 0x08, not {bits:#04x}")
    if homing not in (True, False):
        raise ValueError(f"homing is True or False, not {homing!r}")
    out = np.empty(PACKET_BYTES, dtype=np.uint8)
    encode_into(np.array(motor, dtype=np.int64), bits, bool(homing), out)
    return out.tobytes()


class PacketParser:
    """Replies out of a byte stream that may begin anywhere, lose, gain or change bytes.

    What is none is dropped and counted.  The wire has no checksum: a reply whose nibble turned into
    another nibble is still a reply.
    """

    def __init__(self) -> None:
        self._memory = np.zeros(PARSER_SIZE, dtype=np.int64)

    def feed(self, data: bytes) -> list[Reply]:
        """Take the next bytes, in pieces of any length; the replies that they completed, in order."""
        replies = []
        for byte in memoryview(data):
            if parse_byte(self._memory, byte) == 1:
                first, second, third, homed, buttons = self._memory[ENCODERS:PACKETS].tolist()
                replies.append(Reply((first, second, third), homed, buttons))
        return replies

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
