"""The Falcon's 16-byte packets, compiled: one encoder and one automaton that reads byte by byte.

Both directions have one shape (falcon firmware, as observed by others; no unit confirmed it here)::

    byte      0     1-4, 5-8, 9-12               13                       14        15
    host     '<'    motor 1, 2, 3                'A' + (LEDs | homing)    'A'       '>'
    device   '<'    encoder 1, 2, 3              'A' + (homed | buttons)  anything  '>'

A number is a signed 16-bit integer in four nibbles, least significant first, each plus 'A'.

No byte after the first of a valid reply may be ``<``.  Two valid replies can therefore never overlap, and
``<`` always starts a new one, whatever came before: the automaton needs no second look at a byte, finds
every intact reply in any garbage, and is in step again with the first ``<`` that is the device's.
"""

from __future__ import annotations

from tissueid.arrays import ByteArray, IntArray
from tissueid.compiled import tick_kernel
from tissueid.haptics.states import State

PACKET_BYTES = 16
#: Largest motor command [motor units].
MOTOR_LIMIT = 4095

#: LED bits of the wire.  Which colour is which has been read, not seen: no unit confirmed it here.
LED_GREEN = 0x02
LED_BLUE = 0x04
LED_RED = 0x08

START = 0x3C  # '<'
END = 0x3E  # '>'
OFFSET = 0x41  # 'A': what is added to every value
LAST_NIBBLE = 0x50  # 'P'
#: Largest status byte: four buttons and three homed flags, all set.
LAST_STATUS = 0xC0
HOMING_BIT = 0x01
SIGN = 0x8000
RANGE = 0x10000
STATUS_AT = 13
UNKNOWN_AT = 14
END_AT = 15

_ARMED, _ENGAGED = int(State.ARMED), int(State.ENGAGED)

#: Memory of the automaton, int64: bytes taken of the present candidate, the bytes themselves (by position),
#: then the fields of the last whole reply and the counters since the memory was made.
FILLED = 0
ENCODERS = 16
HOMED = 19
BUTTONS = 20
#: Whole replies, candidates that broke, bytes that belong to no reply.
PACKETS = 21
INVALID = 22
DROPPED = 23
PARSER_SIZE = 24
#: Fields of a reply in a row: three encoders, homed flags, buttons.
REPLY_FIELDS = 5


@tick_kernel
def leds_of_state(state: int) -> int:
    """LED bits of a device's state: red until it is homed and after a fault, then green, blue with force."""
    if state == _ENGAGED:
        return LED_GREEN | LED_BLUE
    return LED_GREEN if state == _ARMED else LED_RED


@tick_kernel
def encode_into(motor: IntArray, leds: int, homing: bool, out: ByteArray) -> None:
    """Write one command.

    ``motor`` (3,): motor commands within +-4095.  One outside is the caller's bug, which must not become a
    force: then all three are sent as zero; ``leds``: LED bits of the wire, 0x02 | 0x04 | 0x08; others are
    left out; ``homing``: whether the device shall be in homing mode, which it leaves with the first command
    without it; ``out`` (16,): filled.
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
    out[STATUS_AT] = OFFSET + (leds & (LED_GREEN | LED_BLUE | LED_RED)) + (HOMING_BIT if homing else 0)
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
    """Take one byte of the device's stream.

    ``memory`` (PARSER_SIZE,): state of the automaton, zeros at the start; changed; ``byte``: 0 to 255.
    Returns 1 if this byte completed a reply, whose fields are then at ``ENCODERS``, ``HOMED`` and
    ``BUTTONS``; else 0.
    """
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


@tick_kernel
def parse_bytes(memory: IntArray, data: ByteArray, replies: IntArray) -> int:
    """Take many bytes.

    ``memory`` (PARSER_SIZE,): as :func:`parse_byte`; ``data`` (n,); ``replies`` (n // 16 + 1, 5): filled from
    the start: three encoders, homed flags, buttons of each reply.  Returns replies that these bytes
    completed.
    """
    count = 0
    for byte in data:
        if parse_byte(memory, int(byte)) == 1:
            for k in range(REPLY_FIELDS):
                replies[count, k] = memory[ENCODERS + k]
            count += 1
    return count
