"""Drivers called by address from the compiled servo, against stand-in libraries that see every command."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from c_library import compiled

from tissueid.haptics import guard as machine
from tissueid.haptics.device import HANDLES_SIZE, CompiledIO
from tissueid.haptics.falcon.kinematics import DEFAULT_GEOMETRY, forward
from tissueid.haptics.guard import REPLY_LOST, REPLY_VALID, new_guard
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.servo_access import compiled_io
from tissueid.rendering.servo_io import sense
from tissueid.rendering.servo_tick import send

LIMITS = GuardLimits(clamp_N=2.0, rms_limit_N=2.0, dead_man=False).block()
#: Turns the driver's x, y, z into our y, z, x; its origin lies 0.1 m out.
ROTATION = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
ORIGIN = np.array([0.0, 0.0, 0.1])


def address(library: ctypes.CDLL, name: str) -> int:
    return ctypes.cast(getattr(library, name), ctypes.c_void_p).value


def engaged() -> np.ndarray:
    """Memory of a guard with the start-up ramp behind it."""
    memory = new_guard()
    memory[[machine.STATE, machine.GAIN]] = machine.ENGAGED, 1.0
    return memory


class Loop:
    """What a tick has in its hands, and the reading and the sending of one."""

    def __init__(self, given: CompiledIO) -> None:
        self.io = compiled_io(given)
        self.memory = engaged()
        self.position, self.counts = np.zeros(3), np.zeros(3, np.int64)
        self.words, self.out = np.zeros(4, np.int64), np.zeros(3)

    def read(self) -> int:
        sense(self.io, 1e-3, self.position, self.counts, self.words)
        return int(self.words[0])

    def send(self, force: tuple[float, float, float], times: int = 1) -> None:
        for _ in range(times):
            send(self.io, self.memory, LIMITS, np.array(force), 1e-3, self.out)


@pytest.fixture
def driver(tmp_path):
    """The stand-in of the Force Dimension driver, open."""
    library = ctypes.CDLL(str(compiled("dhd_stub", tmp_path)))
    library.dhdOpenType(60)
    return library


def force_dimension(library: ctypes.CDLL) -> Loop:
    handles = np.zeros(HANDLES_SIZE, np.int64)
    names = ("dhdGetPosition", "dhdSetForce", "dhdGetButtonMask")
    handles[:4] = [*(address(library, name) for name in names), 5]
    return Loop(
        CompiledIO(
            "tissueid.haptics.forcedimension.servo_io:SDK",
            handles,
            np.concatenate([ROTATION.ravel(), ORIGIN]),
        )
    )


class TestForceDimension:
    def test_position_and_buttons_are_read_in_our_frame(self, driver):
        (ctypes.c_double * 3).in_dll(driver, "stub_position")[:] = (0.01, 0.02, 0.03)
        ctypes.c_uint.in_dll(driver, "stub_buttons").value = 0x5
        loop = force_dimension(driver)
        assert loop.read() == REPLY_VALID
        assert loop.position.tolist() == (ROTATION @ [0.01, 0.02, 0.03] + ORIGIN).tolist()
        # centre and up of the SDK are centre and forward of the wire
        assert loop.words[2] == 0x4 | 0x2
        assert loop.words[1] == 1

    def test_a_force_passes_the_guard_and_arrives_in_the_drivers_frame(self, driver):
        loop = force_dimension(driver)
        loop.send((0.0, 3.0, 4.0), times=10)
        arrived = np.array((ctypes.c_double * 3).in_dll(driver, "stub_force"))
        assert loop.out == pytest.approx([0.0, 1.2, 1.6], rel=1e-12)
        assert arrived == pytest.approx(ROTATION.T @ loop.out, rel=1e-12)

    def test_a_driver_that_fails_is_a_lost_device(self, driver):
        loop = force_dimension(driver)
        ctypes.c_int.in_dll(driver, "stub_fails").value = 1
        assert loop.read() == REPLY_LOST


@pytest.fixture
def usb(tmp_path, monkeypatch):
    """The stand-in of libusb with a Falcon that runs."""
    monkeypatch.delenv("FALCON_STUB", raising=False)
    library = ctypes.CDLL(str(compiled("usb_stub", tmp_path)))
    context, listed, handle = ctypes.c_void_p(), ctypes.POINTER(ctypes.c_void_p)(), ctypes.c_void_p()
    library.libusb_init(ctypes.byref(context))
    library.libusb_get_device_list(context, ctypes.byref(listed))
    library.libusb_open(ctypes.c_void_p(listed[1]), ctypes.byref(handle))
    library.handle = handle.value
    library.stub_record.restype = ctypes.c_char_p
    return library


def falcon(library: ctypes.CDLL) -> Loop:
    handles = np.zeros(HANDLES_SIZE, np.int64)
    handles[:5] = address(library, "libusb_bulk_transfer"), library.handle, 0x02, 0x81, 2
    constants = np.concatenate([[6600.0], DEFAULT_GEOMETRY.block()])
    return Loop(CompiledIO("tissueid.haptics.falcon.servo_io:USB", handles, constants))


class TestUsb:
    def test_a_reply_is_read_without_the_status_bytes_of_its_packet(self, usb):
        loop = falcon(usb)
        loop.send((0.0, 0.0, 0.0))
        assert loop.read() == REPLY_VALID
        angles = np.radians(35.0) + loop.counts * DEFAULT_GEOMETRY.radians_per_count
        assert loop.position == pytest.approx(forward(angles), abs=1e-9)

    def test_a_force_goes_out_as_one_packet_of_sixteen_bytes(self, usb):
        loop = falcon(usb)
        loop.read()
        usb.stub_clear()
        loop.send((0.0, 0.0, 0.0))
        # zero torque three times, then green, blue and homing for a device with force
        assert usb.stub_record() == b"out 3c" + 12 * b" 41" + b" 48 41 3e\n"

    def test_an_unplugged_device_is_lost(self, usb):
        loop = falcon(usb)
        loop.send((0.0, 0.0, 0.0))
        loop.read()
        usb.stub_unplug()
        assert loop.read() == REPLY_LOST
