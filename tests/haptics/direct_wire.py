"""A transport without a wire."""

import time

from tissueid.haptics.falcon.emulator import EmulatedFalcon
from tissueid.haptics.falcon.firmware import HELLO
from tissueid.haptics.falcon.transport import TransportLost


class Direct:
    """An emulated Falcon that answers at once, behind a loader that may miss calls or begin with a zero."""

    where = "test"

    def __init__(
        self, falcon: EmulatedFalcon, *, silent_hellos: int = 0, long_greeting: bool = False
    ) -> None:
        self.falcon = falcon
        self.said: list[str] = []
        self.closed = False
        self._silent_hellos, self._long_greeting = silent_hellos, long_greeting
        self._waiting = b""

    def write(self, data: bytes) -> None:
        if self.falcon.gone:
            raise TransportLost("gone")
        if data == HELLO and self._silent_hellos > 0:
            self._silent_hellos -= 1
            return
        self._waiting += b"\x00" * (data == HELLO and self._long_greeting) + self.falcon.receive(data)

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

    def set_frame(self) -> None:
        self.said.append("8N1")

    def set_latency(self, milliseconds: int) -> None:
        self.said.append(f"latency {milliseconds}")

    def close(self) -> None:
        self.closed = True
