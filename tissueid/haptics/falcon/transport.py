"""Bytes to and from a Falcon: what every transport can do, and the one over a file descriptor.

Modem lines and the latency timer belong to the FTDI chip; a pseudo-terminal or a socket has none, and then
:attr:`ByteTransport.modem` is None.
"""

from __future__ import annotations

import array
import contextlib
import errno
import os
import select
import socket
import stat
import struct
import time
from pathlib import Path
from typing import Protocol

from tissueid.errors import DeviceError

try:
    import fcntl
    import termios
except ModuleNotFoundError:  # a system without terminals of POSIX
    HAS_TERMINALS = False
else:
    HAS_TERMINALS = True

#: Speeds of the chip's divisors 0x4138, 21 and 2 [baud]; the wire has the last while firmware runs.
BAUD_HELLO = 9_600
BAUD_UPLOAD = 142_857
BAUD_RUN = 1_500_000
#: After how long the chip passes on a packet that is not full [ms].
LATENCY_UPLOAD_MS = 16
LATENCY_RUN_MS = 1
#: Room for one read; first replies after an upload have been longer than a packet.
READ_BYTES = 512
#: How long a write may wait for room [s].
WRITE_TIMEOUT_S = 1.0
#: Linux: ``struct termios2`` and its requests, which take any speed.
TCGETS2 = 0x802C542A
TCSETS2 = 0x402C542B
TERMIOS2 = struct.Struct("4I20B2I")
BOTHER = 0o010000
CBAUD = 0o010017
#: Errors after which no byte will pass any more.
GONE = {errno.EIO, errno.ENXIO, errno.ENODEV, errno.EBADF, errno.EPIPE, errno.ECONNRESET}


class TransportLost(DeviceError):  # noqa: N818 - what happened, in the words of the field
    """The other end is gone: unplugged, closed or powered off."""


class ModemLines(Protocol):
    """The lines and the timer of a serial chip."""

    def set_dtr(self, on: bool) -> None:
        """Data terminal ready."""

    def set_rts(self, on: bool) -> None:
        """Request to send."""

    def set_frame(self) -> None:
        """8 data bits, no parity, one stop bit, no flow control."""

    def set_latency(self, milliseconds: int) -> None:
        """After how long an incomplete packet is passed on."""


class ByteTransport(Protocol):
    """A way for bytes."""

    #: What to call it in a message.
    where: str

    @property
    def modem(self) -> ModemLines | None:
        """Modem lines where there are any."""

    def write(self, data: bytes) -> None:
        """Send all bytes, or raise TransportLost."""

    def read(self, timeout_s: float) -> bytes:
        """Bytes that have arrived, waiting for the first; nothing after the time-out; TransportLost."""

    def purge(self) -> None:
        """Forget what arrived and was not read."""

    def set_baud(self, baud: int) -> None:
        """Change the speed, where the transport has one."""

    def close(self) -> None:
        """Release it; calling twice does no harm."""


class FileTransport:
    """A pseudo-terminal, one end of a socket pair, or a serial port; the descriptor is taken over."""

    def __init__(self, descriptor: int, where: str) -> None:
        self.where = where
        self._descriptor = descriptor
        self._is_terminal = os.isatty(descriptor)
        os.set_blocking(descriptor, False)
        if self._is_terminal:
            self._make_raw()

    @classmethod
    def open(cls, path: str) -> FileTransport:
        """Open a terminal by its path; DeviceError if it is missing, none, taken or forbidden."""
        if not HAS_TERMINALS:
            msg = f"{path}: this system has no terminal devices of POSIX; plug the device in by USB"
            raise DeviceError(msg)
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        except OSError as error:
            raise DeviceError(_cannot_open(path, error)) from error
        if not os.isatty(descriptor):
            os.close(descriptor)
            msg = f"{path} is no terminal device: give the path of a serial port or of an emulator"
            raise DeviceError(msg)
        try:
            fcntl.ioctl(descriptor, termios.TIOCEXCL)
            return cls(descriptor, path)
        except OSError as error:
            os.close(descriptor)
            raise DeviceError(_cannot_open(path, error)) from error

    @property
    def descriptor(self) -> int:
        """The file descriptor, for the compiled loop; -1 when closed."""
        return self._descriptor

    @property
    def modem(self) -> ModemLines | None:
        """Modem lines of a serial port; None for a pseudo-terminal or a socket."""
        if not self._is_terminal:
            return None
        lines = array.array("i", [0])
        try:
            fcntl.ioctl(self._descriptor, termios.TIOCMGET, lines)
        except OSError:
            return None
        return _TerminalLines(self._descriptor)

    def write(self, data: bytes) -> None:
        """Send all bytes, waiting up to a second for room."""
        deadline = time.monotonic() + WRITE_TIMEOUT_S
        while data:
            try:
                data = data[os.write(self._descriptor, data) :]
            except BlockingIOError:
                left = deadline - time.monotonic()
                if left <= 0.0:
                    msg = f"{self.where} takes no more bytes: nobody reads at the other end"
                    raise TransportLost(msg) from None
                select.select([], [self._descriptor], [], left)
            except OSError as error:
                raise self._lost(error) from error

    def read(self, timeout_s: float) -> bytes:
        """Up to 512 bytes; nothing after the time-out."""
        try:
            ready, _, _ = select.select([self._descriptor], [], [], max(timeout_s, 0.0))
            if not ready:
                return b""
            data = os.read(self._descriptor, READ_BYTES)
        except BlockingIOError:
            return b""
        except (OSError, ValueError) as error:
            raise self._lost(error) from error
        if not data:
            msg = f"{self.where} was closed at its other end"
            raise TransportLost(msg)
        return data

    def purge(self) -> None:
        """Forget what arrived and was not read."""
        while self.read(0.0):
            pass

    def set_baud(self, baud: int) -> None:
        """Speed of a terminal, any number; a socket has none."""
        if not self._is_terminal:
            return
        settings = bytearray(TERMIOS2.size)
        try:
            fcntl.ioctl(self._descriptor, TCGETS2, settings)
            fields = list(TERMIOS2.unpack(settings))
            fields[2] = (fields[2] & ~CBAUD) | BOTHER
            fields[-2:] = baud, baud
            fcntl.ioctl(self._descriptor, TCSETS2, bytearray(TERMIOS2.pack(*fields)))
        except OSError as error:
            msg = f"{self.where} can't be set to {baud} baud ({error.strerror}); is it a serial port?"
            raise DeviceError(msg) from error

    def close(self) -> None:
        """Close the descriptor."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor >= 0:
            with contextlib.suppress(OSError):
                os.close(descriptor)

    def _make_raw(self) -> None:
        """Every byte passes as it is: no echo, no line editing, no flow control by bytes."""
        settings = termios.tcgetattr(self._descriptor)
        settings[0] = settings[1] = settings[3] = 0
        settings[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
        settings[6][termios.VMIN], settings[6][termios.VTIME] = 1, 0
        termios.tcsetattr(self._descriptor, termios.TCSANOW, settings)

    def _lost(self, error: OSError | ValueError) -> DeviceError:
        if isinstance(error, OSError) and error.errno not in GONE:
            return DeviceError(f"{self.where}: {error.strerror}")
        return TransportLost(f"{self.where} is gone: unplugged, switched off or closed")


class _TerminalLines:
    """Modem lines of a serial port by its driver."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor

    def set_dtr(self, on: bool) -> None:
        self._set(termios.TIOCM_DTR, on)

    def set_rts(self, on: bool) -> None:
        self._set(termios.TIOCM_RTS, on)

    def set_frame(self) -> None:
        """Raw mode already has 8 bits, no parity and no flow control."""

    def set_latency(self, milliseconds: int) -> None:
        """By the driver's file in sysfs, which only root may write; without it the link is just slow."""
        name = Path(os.ttyname(self._descriptor)).name
        timer = Path("/sys/bus/usb-serial/devices") / name / "latency_timer"
        with contextlib.suppress(OSError):
            timer.write_text(str(milliseconds), encoding="ascii")

    def _set(self, line: int, on: bool) -> None:
        request = termios.TIOCMBIS if on else termios.TIOCMBIC
        fcntl.ioctl(self._descriptor, request, struct.pack("I", line))


def _cannot_open(path: str, error: OSError) -> str:
    if error.errno == errno.ENOENT:
        return f"{path}: there is no such device; is it plugged in, or the emulator running?"
    if error.errno in {errno.EACCES, errno.EPERM}:
        return f"{path}: no permission; join the group that owns it (often dialout) and log in again"
    if error.errno == errno.EBUSY:
        return f"{path} is in use by another program; end that one first"
    return f"{path}: {error.strerror}"


def is_socket(descriptor: int) -> bool:
    """True where a descriptor is a socket."""
    return stat.S_ISSOCK(os.fstat(descriptor).st_mode)


def of_socket(end: socket.socket) -> FileTransport:
    """A transport over one end of a socket pair; the socket object gives up its descriptor."""
    return FileTransport(end.detach(), "socket")
