"""The device's end of the wire, by tables: commands in, replies out, and the boot loader before them."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

START, END, FILLER = b"<"[0], b">"[0], b"A"
LETTERS = b"ABCDEFGHIJKLMNOP"
#: Worth of a letter at each of the four places; the last place carries the sign.
WORTH = tuple(
    {
        letter: (value if place < 3 or value < 8 else value - 16) * 16**place
        for value, letter in enumerate(LETTERS)
    }
    for place in range(4)
)
#: Letters of every 16-bit number.
SPELLING = {
    number: bytes(LETTERS[(number >> shift) & 15] for shift in (0, 4, 8, 12))
    for number in range(-32768, 32768)
}
#: Byte 13 of a command: homing mode and lamps.
HOMING = {LETTERS[bits]: bool(bits & 1) for bits in range(16)}
LAMPS = {
    LETTERS[bits]: frozenset(name for bit, name in ((2, "green"), (4, "blue"), (8, "red")) if bits & bit)
    for bits in range(16)
}


@dataclass(frozen=True, slots=True)
class Command:
    """Command of a host."""

    motors: tuple[int, int, int]  # motor units of legs 1 to 3, as sent
    homing: bool
    lamps: frozenset[str]


class CommandReader:
    """Finds command packets in a stream of bytes; whatever is none is dropped and counted."""

    def __init__(self) -> None:
        self._kept = b""
        self.dropped = 0

    def feed(self, data: bytes) -> list[Command]:
        """Return the commands that ``data`` completes, in order."""
        self._kept += data
        found: list[Command] = []
        while True:
            start = self._kept.find(START)
            if start != 0:
                cut = len(self._kept) if start < 0 else start
                self.dropped += cut
                self._kept = self._kept[cut:]
            if len(self._kept) < 16:
                return found
            command = _command(self._kept[:16])
            if command is None:
                self.dropped += 1
                self._kept = self._kept[1:]
            else:
                found.append(command)
                self._kept = self._kept[16:]


def _command(packet: bytes) -> Command | None:
    if packet[15] != END or packet[13] not in HOMING:
        return None
    numbers = []
    for leg in range(3):
        letters = packet[1 + 4 * leg : 5 + 4 * leg]
        if any(letter not in WORTH[0] for letter in letters):
            return None
        numbers.append(sum(WORTH[place][letter] for place, letter in enumerate(letters)))
    return Command((numbers[0], numbers[1], numbers[2]), HOMING[packet[13]], LAMPS[packet[13]])


def reply_bytes(encoders: tuple[int, int, int], *, buttons: int, homed: int) -> bytes:
    """Packet the device answers with; counts wrap at 16 bits, ``homed`` has a bit for each leg."""
    spelled = b"".join(SPELLING[(count + 32768) % 65536 - 32768] for count in encoders)
    return b"<" + spelled + bytes([0x41 + (buttons & 15) + ((homed & 7) << 4)]) + FILLER + b">"


HELLO = bytes([0x0A, 0x43, 0x0D])
GREETING = bytes([0x0A, 0x44, 0x2C, 0x0D])
READY = b"A"
HELLO_BAUD, BOOT_BAUD, RUN_BAUD = 9600, 142_857, 1_500_000
#: A tty rounds a rate as it likes; a wrong one is off by far more.
BAUD_TOLERANCE = 0.05


class _Stage(Enum):
    GREETING = "waits for a greeting"
    READY = "waits for the start of an upload"
    UPLOAD = "takes firmware"
    BROKEN = "waits for a new start"


@dataclass
class BootLoader:
    """The upload protocol, without a clock: it greets, then echoes every byte it is given.

    The change of the baud rate completes the upload; ``failing_tries``: uploads whose echo is spoilt.
    """

    failing_tries: int = 0
    baud: int | None = None
    taken: int = 0
    tries: int = 0
    _stage: _Stage = _Stage.GREETING
    _tail: bytes = b""

    def set_baud(self, baud: int) -> bool:
        """Take a new rate; True where that starts the firmware."""
        self.baud = baud
        return self._speaks(RUN_BAUD) and self._stage is _Stage.UPLOAD and self.taken > 0

    def feed(self, data: bytes) -> bytes:
        """Answer bytes of the host."""
        return b"".join(self._take(bytes([byte])) for byte in data)

    def _speaks(self, baud: int) -> bool:
        """The rate is the one this stage needs, or the transport has none."""
        return self.baud is None or abs(self.baud - baud) <= BAUD_TOLERANCE * baud

    def _take(self, byte: bytes) -> bytes:
        if self._stage is _Stage.UPLOAD:
            if not self._speaks(BOOT_BAUD):
                return b""
            self.taken += 1
            if self.tries <= self.failing_tries and self.taken == 3 * 62 + 1:
                # the first byte of the fourth chunk comes back spoilt
                self._stage = _Stage.BROKEN
                self._tail = b""
                return bytes([byte[0] ^ 0xFF])
            return byte
        if self._stage is _Stage.READY and byte == READY and self._speaks(BOOT_BAUD):
            self._stage = _Stage.UPLOAD
            self.taken = 0
            self.tries += 1
            return READY
        self._tail = (self._tail + byte)[-len(HELLO) :]
        if self._tail == HELLO and self._speaks(HELLO_BAUD):
            self._tail = b""
            self._stage = _Stage.READY
            return GREETING
        return b""
