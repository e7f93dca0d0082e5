"""A Falcon in the compiled loop: the answer to the last tick's command is parsed, nobody waits."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import types

from tissueid.arrays import ByteArray, FloatArray, IntArray
from tissueid.compiled import tick_kernel
from tissueid.haptics import guard as machine
from tissueid.haptics.device import HOMED, PRESSED, REPLY, Access, CompiledIO, register
from tissueid.haptics.device import UNANSWERED as WITHOUT_ANSWER
from tissueid.haptics.falcon import packets
from tissueid.haptics.falcon.kinematics import GUESS_M, angles_of_counts, forward_kernel, motor_units
from tissueid.haptics.falcon.transport import ERROR_TIMEOUT, READ_BYTES, STATUS_BYTES, USB_PACKET_BYTES
from tissueid.haptics.foreign import POLL_BROKEN, POLL_IN, POLL_OUT, by_address, libc_function, ready
from tissueid.haptics.limits import MOTOR_CLAMP
from tissueid.haptics.states import Lamp

#: Constants: motor units for one newton metre, then the geometry block.
UNITS_PER_NM, GEOMETRY = 0, 1
CLIPPED = int(Lamp.CLIPPED)
#: Flags of a tuple: the transport is gone; damaged replies already reported; commands without an answer;
#: ticks since one of them was given up, and since an answer came; answers so far, by their bytes.
LOST, REPORTED, UNANSWERED, WAITED, SILENT, ANSWERED = range(6)
#: A command whose answer was lost is given up after so many ticks; after a silence that long, all are.
GIVEN_UP_TICKS, SILENT_TICKS = 1000, 8
#: Before the first answer no silence is one: a wire may have been late all the time [ticks].
NEVER = 1 << 40
#: Counts of one leg beside which the two others stood still that no hand makes (10 mm along one curve), and
#: counts that are standing still (0.25 mm).
ALONE_COUNTS, STILL_COUNTS = 160, 4
#: Counts before the first reply: from there every place is a jump.
NOWHERE = 1 << 20

_read = libc_function("read", types.int64, types.int32, types.int64, types.int64)
_write = libc_function("write", types.int64, types.int32, types.int64, types.int64)
_bulk_transfer = by_address(
    types.int32, types.int64, types.uint8, types.int64, types.int32, types.int64, types.uint32
)


class FalconParts(NamedTuple):
    """Parts that both transports keep: constants, parser, room for bytes and results."""

    units_per_Nm: float
    geometry: FloatArray
    parser: IntArray
    flags: IntArray
    word: IntArray
    incoming: ByteArray
    outgoing: ByteArray
    motor: IntArray
    left: FloatArray  # of motor units, by rounding
    since: IntArray  # counts from which a leg is seen to move alone
    last: IntArray  # counts of the last reply
    angles: FloatArray
    grip: FloatArray


class DescriptorIO(NamedTuple):
    """A Falcon behind a file descriptor."""

    descriptor: int
    parts: FalconParts


class UsbIO(NamedTuple):
    """A Falcon behind libusb: address of the transfer function, device handle, end points, time-out [ms]."""

    address: int
    handle: int
    bulk_out: int
    bulk_in: int
    timeout_ms: int
    parts: FalconParts


def _parts(given: CompiledIO) -> FalconParts:
    """Fresh parts for a device."""
    return FalconParts(
        units_per_Nm=float(given.constants[UNITS_PER_NM]),
        geometry=np.ascontiguousarray(given.constants[GEOMETRY:]),
        parser=np.zeros(packets.PARSER_SIZE, np.int64),
        flags=np.array([0, 0, 0, 0, -NEVER, 0], np.int64),
        word=np.zeros(1, np.int64),
        incoming=np.zeros(READ_BYTES, np.uint8),
        outgoing=np.zeros(packets.PACKET_BYTES, np.uint8),
        motor=np.zeros(3, np.int64),
        left=np.zeros(3),
        since=np.zeros(3, np.int64),
        last=np.full(3, NOWHERE, np.int64),
        angles=np.zeros(3),
        grip=np.array(GUESS_M),
    )


@tick_kernel
def _unanswered(flags: IntArray, answers: int) -> int:
    """Commands that are on their way, or whose answers are, after these answers came."""
    flags[UNANSWERED] = max(0, flags[UNANSWERED] - answers)
    flags[WAITED] += 1
    # answers that were lost now and then; more at once are late, and stay so until they come
    if 0 < flags[UNANSWERED] < machine.LATE_COMMANDS and flags[WAITED] >= GIVEN_UP_TICKS:
        flags[UNANSWERED] -= 1
        flags[WAITED] = 0
    # what a silence swallowed is not on its way any more
    if answers > 0 and flags[SILENT] >= SILENT_TICKS:
        flags[UNANSWERED] = 0
    flags[SILENT] = 0 if answers > 0 else flags[SILENT] + 1
    return int(flags[UNANSWERED])


@tick_kernel
def _alone(since: IntArray, last: IntArray, counts: IntArray) -> bool:
    """True where one leg has gone on and on while the others stood still, as no hand leads it; no jump."""
    most, others, step = 0, 0, 0
    for i in range(3):
        moved = abs(counts[i] - since[i])
        others = max(others, min(moved, most))
        most = max(most, moved)
        step = max(step, abs(counts[i] - last[i]))
        last[i] = counts[i]
    if others > STILL_COUNTS or step >= ALONE_COUNTS:
        for i in range(3):
            since[i] = counts[i]
        return False
    return most >= ALONE_COUNTS


@tick_kernel
def _understand(
    parts: FalconParts, replies: int, position: FloatArray, counts: IntArray, words: IntArray
) -> None:
    """The last whole reply as position, counts and buttons."""
    damaged = parts.parser[packets.INVALID] - parts.flags[REPORTED]
    parts.flags[REPORTED] = parts.parser[packets.INVALID]
    words[REPLY] = machine.REPLY_DAMAGED if damaged > 0 else machine.REPLY_NONE
    if replies > 0:
        words[HOMED] = 1 if parts.parser[packets.HOMED] == packets.ALL_HOMED else 0
        words[PRESSED] = parts.parser[packets.BUTTONS]
        for i in range(3):
            counts[i] = parts.parser[packets.ENCODERS + i]
        angles_of_counts(counts, parts.geometry, parts.angles)
        found = forward_kernel(parts.angles, parts.geometry, parts.grip) >= 0
        # before homing counts mean nothing
        words[REPLY] = machine.REPLY_VALID
        if words[HOMED] == 0:
            parts.last[0] = NOWHERE
        elif not found or _alone(parts.since, parts.last, counts):
            words[REPLY] = machine.REPLY_APART
        for i in range(3):
            position[i] = parts.grip[i]
    if parts.flags[LOST] != 0:
        words[REPLY] = machine.REPLY_LOST
    # an answer that is damaged anywhere, at its first byte too, is late no more
    taken = packets.PACKET_BYTES * parts.parser[packets.PACKETS] + parts.parser[packets.DROPPED]
    answers = (taken + parts.parser[packets.FILLED]) // packets.PACKET_BYTES - parts.flags[ANSWERED]
    parts.flags[ANSWERED] += answers
    words[WITHOUT_ANSWER] = _unanswered(parts.flags, answers)


@tick_kernel
def _packet(parts: FalconParts, guard_memory: FloatArray, limits: FloatArray, force: FloatArray) -> None:
    """The command for a force at the grip's last position; homing mode stays, or homing is lost."""
    clamp, units = limits[MOTOR_CLAMP], parts.units_per_Nm
    if motor_units(force, parts.grip, parts.geometry, units, clamp, parts.motor, parts.left):
        guard_memory[machine.LAMPS] = float(int(guard_memory[machine.LAMPS]) | CLIPPED)
    leds = packets.leds_of_state(int(guard_memory[machine.STATE]))
    packets.encode_into(parts.motor, leds, True, parts.outgoing)
    parts.flags[UNANSWERED] += 1


@tick_kernel
def _sense_descriptor(
    io: DescriptorIO, dt: float, position: FloatArray, counts: IntArray, words: IntArray
) -> None:
    """Parse what has arrived."""
    parts = io.parts
    replies = 0
    events = ready(io.descriptor, POLL_IN, parts.word)
    if (events & POLL_IN) != 0:
        length = _read(io.descriptor, parts.incoming.ctypes.data, READ_BYTES)
        if length <= 0:
            parts.flags[LOST] = 1
        for i in range(length):
            replies += packets.parse_byte(parts.parser, int(parts.incoming[i]))
    elif (events & POLL_BROKEN) != 0:
        parts.flags[LOST] = 1
    _understand(parts, replies, position, counts, words)


@tick_kernel
def _command_descriptor(
    io: DescriptorIO, guard_memory: FloatArray, limits: FloatArray, force: FloatArray
) -> None:
    """Send one packet; where the other end takes no bytes its silence is noticed by the watchdog."""
    parts = io.parts
    _packet(parts, guard_memory, limits, force)
    events = ready(io.descriptor, POLL_OUT, parts.word)
    where, size = parts.outgoing.ctypes.data, packets.PACKET_BYTES
    if (events & POLL_OUT) != 0 and _write(io.descriptor, where, size) < 0:
        parts.flags[LOST] = 1


@tick_kernel
def _sense_usb(io: UsbIO, dt: float, position: FloatArray, counts: IntArray, words: IntArray) -> None:
    """Parse what has arrived, without the status bytes of each USB packet."""
    parts = io.parts
    replies = 0
    parts.word[0] = 0
    where, length_at = parts.incoming.ctypes.data, parts.word.ctypes.data
    result = _bulk_transfer(io.address, (io.handle, io.bulk_in, where, READ_BYTES, length_at, io.timeout_ms))
    if result not in (0, ERROR_TIMEOUT):
        parts.flags[LOST] = 1
    for i in range(parts.word[0] & 0xFFFFFFFF):
        if i % USB_PACKET_BYTES >= STATUS_BYTES:
            replies += packets.parse_byte(parts.parser, int(parts.incoming[i]))
    _understand(parts, replies, position, counts, words)


@tick_kernel
def _command_usb(io: UsbIO, guard_memory: FloatArray, limits: FloatArray, force: FloatArray) -> None:
    """Send one packet."""
    parts = io.parts
    _packet(parts, guard_memory, limits, force)
    where, size, length_at = parts.outgoing.ctypes.data, packets.PACKET_BYTES, parts.word.ctypes.data
    result = _bulk_transfer(io.address, (io.handle, io.bulk_out, where, size, length_at, io.timeout_ms))
    if result not in (0, ERROR_TIMEOUT):
        parts.flags[LOST] = 1


#: A Falcon behind a file descriptor, and one behind libusb.
DESCRIPTOR = register(
    Access(
        DescriptorIO,
        lambda given: DescriptorIO(int(given.handles[0]), _parts(given)),
        _sense_descriptor,
        _command_descriptor,
    )
)
USB = register(
    Access(
        UsbIO, lambda given: UsbIO._make((*given.handles.tolist(), _parts(given))), _sense_usb, _command_usb
    )
)
