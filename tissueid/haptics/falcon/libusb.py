"""The Falcon over USB: libusb-1.0 by ctypes, and the FTDI chip's requests."""

from __future__ import annotations

import ctypes
import ctypes.util
import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import POINTER, byref, c_char_p, c_int, c_size_t, c_ssize_t, c_ubyte, c_uint, c_uint16, c_void_p
from dataclasses import dataclass
from typing import Any

from tissueid.errors import DeviceError
from tissueid.haptics.falcon.transport import (
    BAUD_HELLO,
    BAUD_RUN,
    BAUD_UPLOAD,
    LATENCY_RUN_MS,
    ModemLines,
    TransportLost,
)

VENDOR = 0x0403
PRODUCT = 0xCB48
UDEV_RULE = 'SUBSYSTEM=="usb", ATTR{idVendor}=="0403", ATTR{idProduct}=="cb48", MODE="0660", TAG+="uaccess"'
UDEV_FILE = "/etc/udev/rules.d/70-falcon.rules"
#: Names to load, first found wins; a path in the environment comes before all.
LIBRARY_VARIABLE = "TISSUEID_LIBUSB"
LIBRARY_NAMES = ("libusb-1.0.so.0", "libusb-1.0.so", "libusb-1.0.dylib")

INTERFACE = 0
BULK_IN = 0x81
BULK_OUT = 0x02
#: Packets of the chip hold 64 bytes, two of them modem status.
USB_PACKET_BYTES = 64
STATUS_BYTES = 2
READ_BYTES = 512
WRITE_TIMEOUT_MS = 1000
CONTROL_TIMEOUT_MS = 1000

#: FTDI requests: bmRequestType, then bRequest with its values.
VENDOR_OUT = 0x40
RESET = 0
PURGE_RX = 1
PURGE_TX = 2
MODEM = 1
DTR_HIGH, DTR_LOW = 0x0101, 0x0100
RTS_HIGH, RTS_LOW = 0x0202, 0x0200
FLOW = 2
FLOW_NONE = 0
BAUD = 3
DIVISORS = {BAUD_HELLO: 0x4138, BAUD_UPLOAD: 0x0015, BAUD_RUN: 0x0002}
DATA = 4
DATA_8N1 = 8
LATENCY = 9

#: libusb's errors that have a way out of their own.
ERROR_ACCESS, ERROR_NO_DEVICE, ERROR_BUSY, ERROR_TIMEOUT = -3, -4, -6, -7

#: ``libusb_bulk_transfer`` with addresses as integers, as a compiled loop takes it.
BULK_TRANSFER = ctypes.CFUNCTYPE(c_int, c_size_t, c_ubyte, c_size_t, c_int, c_size_t, c_uint)

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


class _Descriptor(ctypes.Structure):
    """``struct libusb_device_descriptor``."""

    _fields_ = (
        ("bLength", c_ubyte), ("bDescriptorType", c_ubyte), ("bcdUSB", c_uint16),
        ("bDeviceClass", c_ubyte), ("bDeviceSubClass", c_ubyte), ("bDeviceProtocol", c_ubyte),
        ("bMaxPacketSize0", c_ubyte), ("idVendor", c_uint16), ("idProduct", c_uint16),
        ("bcdDevice", c_uint16), ("iManufacturer", c_ubyte), ("iProduct", c_ubyte),
        ("iSerialNumber", c_ubyte), ("bNumConfigurations", c_ubyte),
    )  # fmt: skip


@dataclass(frozen=True)
class UsbNode:
    """Place of a Falcon on the bus."""

    bus: int
    address: int

    @property
    def path(self) -> str:
        """The node that needs the permission."""
        return f"/dev/bus/usb/{self.bus:03d}/{self.address:03d}"


class LibUsb:
    """The loaded library with one context; DeviceError where it is not installed, or is not libusb."""

    def __init__(self) -> None:
        self.library = _load()
        self._context = c_void_p()
        code = self.library.libusb_init(byref(self._context))
        if code != 0:
            msg = f"libusb can't be started ({self.error_name(code)}); is /dev/bus/usb there?"
            raise DeviceError(msg)

    def falcons(self) -> list[UsbNode]:
        """Every Falcon that is plugged in, whether or not it may be opened."""
        with self._devices() as found:
            return [node for node, _ in found]

    def open(self, node: UsbNode | None = None) -> UsbTransport:
        """Open a Falcon, claim its interface, and set it to the speed of running firmware.

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
            transport.prepare()
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
    def _devices(self) -> Iterator[list[tuple[UsbNode, c_void_p]]]:
        """Falcons and libusb's pointers to them, which hold inside the block."""
        devices = POINTER(c_void_p)()
        count = self.library.libusb_get_device_list(self._context, byref(devices))
        if count < 0:
            msg = f"libusb can't list the devices ({self.error_name(count)}); is /dev/bus/usb there?"
            raise DeviceError(msg)
        try:
            yield [
                (self._node(device), device)
                for device in map(c_void_p, devices[:count])
                if self._is_falcon(device)
            ]
        finally:
            self.library.libusb_free_device_list(devices, 1)

    def _is_falcon(self, device: c_void_p) -> bool:
        descriptor = _Descriptor()
        if self.library.libusb_get_device_descriptor(device, byref(descriptor)) != 0:
            return False
        return (descriptor.idVendor, descriptor.idProduct) == (VENDOR, PRODUCT)

    def _node(self, device: c_void_p) -> UsbNode:
        return UsbNode(
            self.library.libusb_get_bus_number(device), self.library.libusb_get_device_address(device)
        )

    def _refusal(self, code: int, node: UsbNode) -> str:
        if code == ERROR_ACCESS:
            return (
                f"no permission for {node.path}, which is the Falcon. As root write this line into "
                f"{UDEV_FILE}: {UDEV_RULE} , then run 'udevadm control --reload' and plug it in again"
            )
        if code == ERROR_BUSY:
            return f"the Falcon at {node.path} is in use by another program; end that one first"
        if code == ERROR_NO_DEVICE:
            return f"the Falcon at {node.path} went away while it was opened; plug it in again"
        return f"the Falcon at {node.path} can't be opened: {self.error_name(code)}"


class UsbTransport:
    """A claimed Falcon. Made by :meth:`LibUsb.open`."""

    def __init__(self, usb: LibUsb, handle: c_void_p, node: UsbNode) -> None:
        self.where = node.path
        self._usb = usb
        self._handle = handle

    @property
    def handle(self) -> int:
        """Address of libusb's handle, for the compiled loop; 0 when closed."""
        return self._handle.value or 0

    @property
    def bulk_transfer(self) -> int:
        """Address of ``libusb_bulk_transfer``."""
        function = self._usb.library.libusb_bulk_transfer
        return ctypes.cast(function, c_void_p).value or 0

    @property
    def modem(self) -> ModemLines:
        """The chip's lines and its latency timer."""
        return _ChipLines(self)

    def prepare(self) -> None:
        """The order in which a Falcon is opened: purge, latency 1 ms, 1.5 Mbaud, purge."""
        self.purge()
        self.modem.set_latency(LATENCY_RUN_MS)
        self.set_baud(BAUD_RUN)
        self.purge()

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


class _ChipLines:
    """Modem lines by requests to the chip."""

    def __init__(self, transport: UsbTransport) -> None:
        self._transport = transport

    def set_dtr(self, on: bool) -> None:
        self._transport.control(MODEM, DTR_HIGH if on else DTR_LOW)

    def set_rts(self, on: bool) -> None:
        self._transport.control(MODEM, RTS_HIGH if on else RTS_LOW)

    def set_frame(self) -> None:
        self._transport.control(DATA, DATA_8N1)
        self._transport.control(FLOW, FLOW_NONE)

    def set_latency(self, milliseconds: int) -> None:
        self._transport.control(LATENCY, milliseconds)


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
        return _declared(library, name)
    where = f"{named} ({LIBRARY_VARIABLE})" if named else "libusb-1.0"
    msg = f"{where} can't be loaded, and a Falcon needs it; on Debian: apt install libusb-1.0-0"
    raise DeviceError(msg)


def _declared(library: Any, name: str) -> Any:
    for function, (result, arguments) in _PROTOTYPES.items():
        try:
            symbol = getattr(library, function)
        except AttributeError as error:
            msg = f"{name} is no libusb 1.0 of use: it has no {function}"
            raise DeviceError(msg) from error
        symbol.restype, symbol.argtypes = result, arguments
    return library
