"""Links of an emulated Falcon: a pseudo-terminal or a socket pair, in a thread or a process."""

from __future__ import annotations

import os
import select
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Sequence
from typing import Self

from tissueid.errors import DeviceError
from tissueid.haptics.falcon.emulator.machine import EmulatedFalcon, EmulatorSettings
from tissueid.own_process import own_process

#: Beginning of the line with which an emulator's own process says where it is.
READY_LINE = "emulated Falcon at "
#: Longest wait for bytes before the clock and the stop sign are looked at [s].
LOOK_S = 0.05
READ_BYTES = 4096
#: ``struct termios2``, the only place where Linux keeps a rate that has no name.
TERMIOS2 = struct.Struct("4I20B2I")
GET_TERMIOS2 = 0x802C542A
#: Longest wait for an emulator's process to say where it is [s]; its first start compiles.
START_S = 60.0


def _asked_baud(descriptor: int) -> int | None:
    """Rate a host asked of a pseudo-terminal, by the master's descriptor; None for a socket."""
    try:
        import fcntl
    except ModuleNotFoundError:  # no system of POSIX, and no pseudo-terminals
        return None
    answer = bytearray(TERMIOS2.size)
    try:
        fcntl.ioctl(descriptor, GET_TERMIOS2, answer)
    except OSError:
        return None
    return int(TERMIOS2.unpack(answer)[-1])


def serve_once(descriptor: int, falcon: EmulatedFalcon) -> bool:
    """Answer the bytes that have arrived; False where the host closed its end."""
    try:
        data = os.read(descriptor, READ_BYTES)
        if not falcon.running and (baud := _asked_baud(descriptor)) is not None:
            # bytes that came with the rate of the running firmware belong to it
            falcon.set_baud(baud)
        answer = falcon.receive(data)
        time.sleep(falcon.answer_delay_s)
        if answer:
            os.write(descriptor, answer)
    except OSError:
        return False
    return bool(data)


class EmulatedLink:
    """An emulated Falcon served by a thread of this process, on a pseudo-terminal or a socket pair."""

    def __init__(self, settings: EmulatorSettings, *, pty: bool = False) -> None:
        self.falcon = EmulatedFalcon(settings)
        self.path: str | None = None
        if pty:
            self._device, self._host = os.openpty()
            import tty

            tty.setraw(self._host)
            self.path = os.ttyname(self._host)
        else:
            device, host = socket.socketpair()
            self._device, self._host = device.detach(), host.detach()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="emulated Falcon", daemon=True)

    def descriptor(self) -> int:
        """A new descriptor of the host's end; whoever asks closes it."""
        return os.dup(self._host)

    def _run(self) -> None:
        """Exchange bytes until the host leaves, the device is unplugged or the link is closed."""
        virtual = self.falcon.settings.period_s is not None
        last = time.monotonic()
        try:
            while not self._stop.is_set() and not self.falcon.gone:
                readable = select.select([self._device], [], [], LOOK_S)[0]
                now = time.monotonic()
                if not virtual:
                    self.falcon.advance(now - last)
                last = now
                if readable and not serve_once(self._device, self.falcon):
                    return
        finally:
            if self.falcon.gone:
                # both ends: a terminal hangs up only when its last holder lets go
                self._close_ends()

    def _close_ends(self) -> None:
        for descriptor in (self._device, self._host):
            if descriptor >= 0:
                os.close(descriptor)
        self._device = self._host = -1

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end_thread()
        self._close_ends()

    def step(self) -> None:
        """Answer what has arrived in the caller's own thread, in place of the link's; wait for nothing."""
        self._end_thread()
        while self._device >= 0 and select.select([self._device], [], [], 0.0)[0]:
            if not serve_once(self._device, self.falcon) or self.falcon.gone:
                self._close_ends()

    def _end_thread(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()


class EmulatorProcess:
    """An emulated Falcon in a process that ends with its owner; DeviceError, in its words, without one."""

    def __init__(self, arguments: Sequence[str] = ()) -> None:
        self._process = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            own_process("tissueid.haptics.falcon.emulator", "--until-eof", *arguments),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        out = self._process.stdout
        ready = out is not None and select.select([out], [], [], START_S)[0]
        line = out.readline().decode(errors="replace").strip() if ready and out is not None else ""
        if not line.startswith(READY_LINE):
            self._process.kill()
            said = self._process.communicate()[1].decode(errors="replace").strip().splitlines()
            raise DeviceError(f"the emulator did not start: {said[-1] if said else 'it said nothing'}")
        self.path = line.removeprefix(READY_LINE)

    def close(self) -> None:
        """End the process."""
        if self._process.poll() is None:
            self._process.terminate()
        self._process.communicate()
