"""Boot loader of the emulated Falcon: it greets, then echoes every byte it is given.

Which bytes of the echo end the upload the wire does not say: a host changes to the baud rate of the running
firmware.  Where a transport has no baud rate (a socket), the upload ends after ``firmware_bytes``.
Which firmware it is does not matter here; a file of any contents does.
"""

from __future__ import annotations

from enum import Enum

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


class BootLoader:
    """The upload protocol, without a clock.

    ``firmware_bytes``: length after which the upload is complete; None leaves that to the change of baud
    rate; ``failing_tries``: uploads whose echo is spoilt before one succeeds; ``silent_hellos``: greetings
    that get no answer; ``long_greeting``: put a zero byte before the greeting, as some stacks do.
    """

    def __init__(
        self,
        *,
        firmware_bytes: int | None,
        failing_tries: int = 0,
        silent_hellos: int = 0,
        long_greeting: bool = False,
    ) -> None:
        self.firmware_bytes = firmware_bytes
        self.failing_tries = failing_tries
        self.silent_hellos = silent_hellos
        self.long_greeting = long_greeting
        self.baud: int | None = None
        self.taken = 0
        self.tries = 0
        self._stage = _Stage.GREETING
        self._tail = b""

    def restart(self) -> None:
        """Begin anew, as when the DTR line rises or the device is switched on."""
        self._stage = _Stage.GREETING
        self._tail = b""
        self.taken = 0

    def set_baud(self, baud: int) -> bool:
        """Take a new rate; True where that starts the firmware."""
        self.baud = baud
        return self._speaks(RUN_BAUD) and self._stage is _Stage.UPLOAD and self.taken > 0

    def feed(self, data: bytes) -> tuple[bytes, bool]:
        """Answer bytes of the host.

        Returns ``answer``; ``complete``: the last byte of the firmware arrived.
        """
        answer = b""
        for byte in data:
            answer += self._take(bytes([byte]))
            if self._stage is _Stage.UPLOAD and self.taken == self.firmware_bytes:
                return answer, True
        return answer, False

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
            if self.silent_hellos > 0:
                self.silent_hellos -= 1
                return b""
            self._stage = _Stage.READY
            return (b"\x00" if self.long_greeting else b"") + GREETING
        return b""
