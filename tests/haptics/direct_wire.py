"""A transport without a wire."""

from __future__ import annotations

import time

from tissueid.haptics.falcon.emulator import EmulatedFalcon
from tissueid.haptics.falcon.transport import TransportLost


class Direct:
    """An emulated Falcon that answers at once, with the modem lines of the chip or none."""

    where = "test"

    def __init__(self, falcon: EmulatedFalcon, *, modem: bool = True) -> None:
        self.falcon = falcon
        self.said: list[str] = []
        self.closed = False
        self._modem = modem
        self._waiting = b""

    @property
    def modem(self) -> Direct | None:
        return self if self._modem else None

    def write(self, data: bytes) -> None:
        if self.falcon.gone:
            msg = "gone"
            raise TransportLost(msg)
        self._waiting += self.falcon.receive(data)

    def read(self, timeout_s: float) -> bytes:
        data, self._waiting = self._waiting[:50], self._waiting[50:]
        if not data:
            time.sleep(min(timeout_s, 1e-3))
        return data

    def purge(self) -> None:
        self._waiting = b""

    def set_baud(self, baud: int) -> None:
        self.said.append(f"baud {baud}")
        self.falcon.set_baud(baud)

    def set_dtr(self, on: bool) -> None:
        self.said.append(f"dtr {on}")
        if on:
            self.falcon.control(1, 0x0101)

    def set_rts(self, on: bool) -> None:
        self.said.append(f"rts {on}")

    def set_frame(self) -> None:
        self.said.append("8N1")

    def set_latency(self, milliseconds: int) -> None:
        self.said.append(f"latency {milliseconds}")

    def close(self) -> None:
        self.closed = True
