"""The device's end of the wire, by tables: command packets in, reply packets out.

A packet is 16 bytes from ``<`` to ``>``; numbers are four letters ``A`` to ``P``, least significant first,
two's complement in 16 bits.
"""

from __future__ import annotations

from dataclasses import dataclass

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
    """Packet the device answers with.

    ``encoders``: counts of legs 1 to 3; they wrap at 16 bits, as counters do; ``buttons``: bits 0 to 3;
    ``homed``: a bit for each leg.
    """
    spelled = b"".join(SPELLING[(count + 32768) % 65536 - 32768] for count in encoders)
    return b"<" + spelled + bytes([0x41 + (buttons & 15) + ((homed & 7) << 4)]) + FILLER + b">"
