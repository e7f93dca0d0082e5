"""Bytes to and from a Falcon: over a file descriptor, or over USB by libusb and the FTDI chip's requests."""

from __future__ import annotations

import contextlib
import ctypes
import ctypes.util
import errno
import math
import os
import select
import struct
import time
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import POINTER, byref, c_char_p, c_int, c_ssize_t, c_ubyte, c_uint, c_uint16, c_void_p
from pathlib import Path
from typing import Any

from tissueid.errors import DeviceError
from tissueid.haptics.device import declared

try:
    import fcntl
    import termios
except ModuleNotFoundError:  # a system without terminals of POSIX
    HAS_TERMINALS = False
else:
    HAS_TERMINALS = True

#: Speeds of the chip's divisors 0x4138, 21 and 2 [baud]; the wire has the last while firmware runs.
BAUD_HELLO, BAUD_UPLOAD, BAUD_RUN = 9_600, 142_857, 1_500_000
#: After how long the chip passes on a packet that is not full [ms].
LATENCY_UPLOAD_MS, LATENCY_RUN_MS = 16, 1
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


class FileTransport:
    """A pseudo-terminal, one end of a socket pair, or a serial port; the descriptor is taken over."""

    def __init__(self, descriptor: int, where: str) -> None:
        self.where = where
        self._descriptor = descriptor
        self._is_terminal = os.isatty(descriptor)
        os.set_blocking(descriptor, False)
        if self._is_terminal:
            # every byte passes as it is: no echo, no line editing, no flow control by bytes
            settings = termios.tcgetattr(descriptor)
            settings[0] = settings[1] = settings[3] = 0
            settings[2] = termios.CS8 | termios.CREAD | termios.CLOCAL
            settings[6][termios.VMIN], settings[6][termios.VTIME] = 1, 0
            termios.tcsetattr(descriptor, termios.TCSANOW, settings)

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
    def handles(self) -> tuple[str, list[int]]:
        """Name and handles of its kind in the compiled loop: the file descriptor, -1 when closed."""
        return "DESCRIPTOR", [self._descriptor]

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
            raise TransportLost(f"{self.where} was closed at its other end")
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

    # --- modem lines of a serial port, by its driver; a pseudo-terminal and a socket have none

    def set_dtr(self, on: bool) -> None:
        """Data terminal ready."""
        self._set_line(termios.TIOCM_DTR, on)

    def set_frame(self) -> None:
        """No request to send; raw mode already has 8 bits, no parity and no flow control."""
        self._set_line(termios.TIOCM_RTS, on=False)

    def set_latency(self, milliseconds: int) -> None:
        """By the driver's file in sysfs, which only root may write; without it the link is just slow."""
        with contextlib.suppress(OSError):
            name = Path(os.ttyname(self._descriptor)).name
            timer = Path("/sys/bus/usb-serial/devices") / name / "latency_timer"
            timer.write_text(str(milliseconds), encoding="ascii")

    def _set_line(self, line: int, on: bool) -> None:
        with contextlib.suppress(OSError):
            request = termios.TIOCMBIS if on else termios.TIOCMBIC
            fcntl.ioctl(self._descriptor, request, struct.pack("I", line))

    def _lost(self, error: OSError | ValueError) -> DeviceError:
        if isinstance(error, OSError) and error.errno not in GONE:
            return DeviceError(f"{self.where}: {error.strerror}")
        return TransportLost(f"{self.where} is gone: unplugged, switched off or closed")


def _cannot_open(path: str, error: OSError) -> str:
    denied = ": no permission; join the group that owns it (often dialout) and log in again"
    known = {
        errno.ENOENT: ": there is no such device; is it plugged in, or the emulator running?",
        errno.EACCES: denied,
        errno.EPERM: denied,
        errno.EBUSY: " is in use by another program; end that one first",
    }
    return path + known.get(error.errno or 0, f": {error.strerror}")


VENDOR, PRODUCT = 0x0403, 0xCB48
UDEV_RULE = 'SUBSYSTEM=="usb", ATTR{idVendor}=="0403", ATTR{idProduct}=="cb48", MODE="0660", TAG+="uaccess"'
UDEV_FILE = "/etc/udev/rules.d/70-falcon.rules"
#: Names to load, first found wins; a path in the environment comes before all.
LIBRARY_VARIABLE = "TISSUEID_LIBUSB"
LIBRARY_NAMES = ("libusb-1.0.so.0", "libusb-1.0.so", "libusb-1.0.dylib")

#: ``struct libusb_device_descriptor``, and where vendor and product stand in it.
DESCRIPTOR_BYTES, VENDOR_AT = 18, 8
INTERFACE, BULK_IN, BULK_OUT = 0, 0x81, 0x02
#: Packets of the chip hold 64 bytes, two of them modem status.
USB_PACKET_BYTES, STATUS_BYTES = 64, 2
WRITE_TIMEOUT_MS = CONTROL_TIMEOUT_MS = 1000
#: Time-out of a transfer in the compiled loop [ms].
TRANSFER_TIMEOUT_MS = 2

#: FTDI requests: bmRequestType, then bRequest with its values.
VENDOR_OUT = 0x40
RESET, MODEM, FLOW, BAUD, DATA, LATENCY = 0, 1, 2, 3, 4, 9
PURGE_RX, PURGE_TX = 1, 2
DTR_HIGH, DTR_LOW, RTS_LOW = 0x0101, 0x0100, 0x0200
FLOW_NONE, DATA_8N1 = 0, 8
DIVISORS = {BAUD_HELLO: 0x4138, BAUD_UPLOAD: 0x0015, BAUD_RUN: 0x0002}

#: libusb's errors that have a way out of their own.
ERROR_ACCESS, ERROR_NO_DEVICE, ERROR_BUSY, ERROR_TIMEOUT = -3, -4, -6, -7

_PROTOTYPES: dict[str, tuple[Any, list[Any]]] = {
    "libusb_init": (c_int, [POINTER(c_void_p)]),
    "libusb_exit": (None, [c_void_p]),
    "libusb_get_device_list": (c_ssize_t, [c_void_p, POINTER(POINTER(c_void_p))]),
    "libusb_free_device_list": (None, [POINTER(c_void_p), c_int]),
    "libusb_get_device_descriptor": (c_int, [c_void_p, c_void_p]),
    "libusb_get_bus_number": (c_ubyte, [c_void_p]),
    "libusb_get_device_address": (c_ubyte, [c_void_p]),
    "libusb_open": (c_int, [c_void_p, POINTER(c_void_p)]),
    "libusb_close": (None, [c_void_p]),
    "libusb_set_auto_detach_kernel_driver": (c_int, [c_void_p, c_int]),
    "libusb_claim_interface": (c_int, [c_void_p, c_int]),
    "libusb_release_interface": (c_int, [c_void_p, c_int]),
    "libusb_control_transfer": (
        c_int, [c_void_p, c_ubyte, c_ubyte, c_uint16, c_uint16, c_void_p, c_uint16, c_uint],
    ),
    "libusb_bulk_transfer": (
        c_int, [c_void_p, c_ubyte, c_void_p, c_int, POINTER(c_int), c_uint],
    ),
    "libusb_error_name": (c_char_p, [c_int]),
}  # fmt: skip


NOT_FOUND = (
    "no Falcon is plugged in (USB 0403:cb48): check its power supply and cable, or go on without one, with "
    "the device sim"
)


class LibUsb:
    """The loaded library with one context; DeviceError where it is not installed, or is not libusb."""

    def __init__(self) -> None:
        self.library = _load()
        self._context = c_void_p()
        code = self.library.libusb_init(byref(self._context))
        if code != 0:
            raise DeviceError(f"libusb can't be started ({self.error_name(code)}); is /dev/bus/usb there?")

    def falcons(self) -> list[str]:
        """Node of every Falcon that is plugged in, whether or not it may be opened."""
        with self._devices() as found:
            return [node for node, _ in found]

    def open(self, node: str | None = None) -> UsbTransport:
        """Open the first Falcon or the one at a node, claim its interface, set the speed of running firmware.

        Raises DeviceError: not found, no permission (with the node and the udev line), or in use.
        """
        with self._devices() as found:
            matching = [(where, device) for where, device in found if node in (None, where)]
            if not matching:
                raise DeviceError(NOT_FOUND)
            where, device = matching[0]
            handle = c_void_p()
            code = self.library.libusb_open(device, byref(handle))
            if code != 0:
                raise DeviceError(self._refusal(code, where))
        # a system whose ftdi_sio was told of the Falcon has it bound; others answer "not supported"
        self.library.libusb_set_auto_detach_kernel_driver(handle, 1)
        code = self.library.libusb_claim_interface(handle, INTERFACE)
        if code != 0:
            self.library.libusb_close(handle)
            raise DeviceError(self._refusal(code, where))
        transport = UsbTransport(self, handle, where)
        try:
            transport.purge()
            transport.set_latency(LATENCY_RUN_MS)
            transport.set_baud(BAUD_RUN)
            transport.purge()
        except DeviceError:
            transport.close()
            raise
        return transport

    def close(self) -> None:
        """End the context; calling twice does no harm."""
        context, self._context = self._context, c_void_p()
        if context:
            self.library.libusb_exit(context)

    def error_name(self, code: int) -> str:
        """Name that the library has for an error."""
        return (self.library.libusb_error_name(code) or b"unknown error").decode("ascii", "replace")

    @contextmanager
    def _devices(self) -> Iterator[list[tuple[str, c_void_p]]]:
        """Nodes of Falcons, which need the permission, and libusb's pointers, which hold inside the block."""
        devices, descriptor = POINTER(c_void_p)(), ctypes.create_string_buffer(DESCRIPTOR_BYTES)
        bus, address = self.library.libusb_get_bus_number, self.library.libusb_get_device_address
        count = self.library.libusb_get_device_list(self._context, byref(devices))
        if count < 0:
            msg = f"libusb can't list the devices ({self.error_name(count)}); is /dev/bus/usb there?"
            raise DeviceError(msg)
        try:
            yield [
                (f"/dev/bus/usb/{bus(device):03d}/{address(device):03d}", device)
                for device in map(c_void_p, devices[:count])
                if self.library.libusb_get_device_descriptor(device, descriptor) == 0
                and struct.unpack_from("HH", descriptor, VENDOR_AT) == (VENDOR, PRODUCT)
            ]
        finally:
            self.library.libusb_free_device_list(devices, 1)

    def _refusal(self, code: int, node: str) -> str:
        if code == ERROR_ACCESS:
            return (
                f"no permission for {node}, which is the Falcon. As root write this line into "
                f"{UDEV_FILE}: {UDEV_RULE} , then run 'udevadm control --reload' and plug it in again"
            )
        known = {
            ERROR_BUSY: "is in use by another program; end that one first",
            ERROR_NO_DEVICE: "went away while it was opened; plug it in again",
        }
        why = known.get(code, f"can't be opened: {self.error_name(code)}")
        return f"the Falcon at {node} {why}"


class UsbTransport:
    """A claimed Falcon. Made by :meth:`LibUsb.open`."""

    def __init__(self, usb: LibUsb, handle: c_void_p, node: str) -> None:
        self.where = node
        self._usb = usb
        self._handle = handle

    @property
    def handles(self) -> tuple[str, list[int]]:
        """Name of its kind in the compiled loop; addresses of transfer and handle, its numbers."""
        transfer = ctypes.cast(self._usb.library.libusb_bulk_transfer, c_void_p).value or 0
        return "USB", [transfer, self._handle.value or 0, BULK_OUT, BULK_IN, TRANSFER_TIMEOUT_MS]

    def write(self, data: bytes) -> None:
        """Send all bytes."""
        moved = c_int(0)
        while data:
            buffer = ctypes.create_string_buffer(data, len(data))
            code = self._usb.library.libusb_bulk_transfer(
                self._handle, BULK_OUT, buffer, len(data), byref(moved), WRITE_TIMEOUT_MS
            )
            if code != 0:
                raise self._lost(code)
            data = data[moved.value :]

    def read(self, timeout_s: float) -> bytes:
        """Up to 496 bytes of data, the chip's status bytes taken out."""
        buffer = ctypes.create_string_buffer(READ_BYTES)
        deadline = time.monotonic() + timeout_s
        while True:
            moved = c_int(0)
            # 0 would be "wait for ever"
            left_ms = max(1, math.ceil(1e3 * (deadline - time.monotonic())))
            code = self._usb.library.libusb_bulk_transfer(
                self._handle, BULK_IN, buffer, READ_BYTES, byref(moved), left_ms
            )
            if code not in {0, ERROR_TIMEOUT}:
                raise self._lost(code)
            data = without_status(buffer.raw[: moved.value])
            # the chip sends its status alone at every tick of the latency timer
            if data or time.monotonic() >= deadline:
                return data

    def purge(self) -> None:
        """Empty the chip's two buffers."""
        self.control(RESET, PURGE_RX)
        self.control(RESET, PURGE_TX)

    def set_baud(self, baud: int) -> None:
        """One of the three speeds a Falcon knows."""
        self.control(BAUD, DIVISORS[baud])

    def close(self) -> None:
        """Release the interface."""
        handle, self._handle = self._handle, c_void_p()
        if handle:
            self._usb.library.libusb_release_interface(handle, INTERFACE)
            self._usb.library.libusb_close(handle)

    # --- the chip's lines and its latency timer

    def set_dtr(self, on: bool) -> None:
        """Data terminal ready."""
        self.control(MODEM, DTR_HIGH if on else DTR_LOW)

    def set_frame(self) -> None:
        """8 data bits, no parity, one stop bit, no flow control, no request to send."""
        self.control(DATA, DATA_8N1)
        self.control(FLOW, FLOW_NONE)
        self.control(MODEM, RTS_LOW)

    def set_latency(self, milliseconds: int) -> None:
        """After how long an incomplete packet is passed on."""
        self.control(LATENCY, milliseconds)

    def control(self, request: int, value: int) -> None:
        """One request to the chip."""
        code = self._usb.library.libusb_control_transfer(
            self._handle, VENDOR_OUT, request, value, 0, None, 0, CONTROL_TIMEOUT_MS
        )
        if code < 0:
            raise self._lost(code)

    def _lost(self, code: int) -> TransportLost:
        return TransportLost(
            f"the Falcon at {self.where} is gone ({self._usb.error_name(code)}): unplugged or switched off"
        )


def without_status(raw: bytes) -> bytes:
    """Data of a read: every 64 bytes begin with two status bytes."""
    return b"".join(
        raw[start + STATUS_BYTES : start + USB_PACKET_BYTES] for start in range(0, len(raw), USB_PACKET_BYTES)
    )


def _load() -> Any:
    """The shared library with its prototypes."""
    named = os.environ.get(LIBRARY_VARIABLE)
    names = [named] if named else [*LIBRARY_NAMES, ctypes.util.find_library("usb-1.0")]
    for name in filter(None, names):
        try:
            library = ctypes.CDLL(name)
        except OSError:
            continue
        return declared(library, _PROTOTYPES, f"{name} is no libusb 1.0 of use")
    where = f"{named} ({LIBRARY_VARIABLE})" if named else "libusb-1.0"
    raise DeviceError(f"{where} can't be loaded, and a Falcon needs it; on Debian: apt install libusb-1.0-0")


#: A way for bytes to a Falcon.
Transport = FileTransport | UsbTransport
