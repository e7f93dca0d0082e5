"""The compiled servo's own ways to devices, against stand-in libraries that see every command."""

import os
import socket

import numpy as np
import pytest

from tissueid.haptics import guard as machine
from tissueid.haptics.device import HOMED, PRESSED, REPLY, WORDS_SIZE, CompiledIO, compiled_io
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.falcon.kinematics import DEFAULT_GEOMETRY, GUESS_M, forward
from tissueid.haptics.falcon.transport import FileTransport
from tissueid.haptics.forcedimension.device import ForceDimensionDevice
from tissueid.haptics.guard import REPLY_APART, REPLY_LOST, REPLY_VALID, new_guard
from tissueid.haptics.limits import GuardLimits
from tissueid.rendering.servo_tick import command, send, sense

LIMITS = GuardLimits(clamp_N=2.0, rms_limit_N=2.0, dead_man=False).block()


class Loop:
    """Reading and sending of a tick, with the start-up ramp behind it."""

    def __init__(self, given: CompiledIO) -> None:
        self.io = compiled_io(given)
        self.memory = new_guard()
        self.memory[[machine.STATE, machine.GAIN]] = machine.ENGAGED, 1.0
        self.position, self.counts = np.zeros(3), np.zeros(3, np.int64)
        self.words, self.out = np.zeros(WORDS_SIZE, np.int64), np.zeros(3)

    def read(self) -> int:
        sense(self.io, 1e-3, self.position, self.counts, self.words)
        return int(self.words[REPLY])

    def send(self, force: tuple[float, float, float], times: int = 1) -> None:
        for _ in range(times):
            send(self.io, self.memory, LIMITS, np.array(force), 1e-3, self.out)


class TestForceDimension:
    @pytest.fixture
    def device(self, sdk):
        assert ForceDimensionDevice().compiled() is None
        with ForceDimensionDevice() as opened:
            yield opened

    def test_position_and_buttons_are_read_in_our_frame(self, sdk, device):
        sdk.move(0.01, 0.02, 0.03)
        sdk["buttons"] = 0x5
        loop = Loop(device.compiled())
        assert loop.read() == REPLY_VALID
        # x right, y up, z to the user; theirs are x to the user, y right, z up, about the middle
        assert loop.position == pytest.approx([0.02, 0.03, 0.14], abs=1e-15)
        # centre and up of the SDK are centre and forward of the wire
        assert (loop.words[PRESSED], loop.words[HOMED]) == (0x4 | 0x2, 1)

    def test_a_force_passes_the_guard_and_arrives_in_the_drivers_frame(self, sdk, device):
        loop = Loop(device.compiled())
        loop.send((0.0, 3.0, 4.0), times=10)
        assert loop.out == pytest.approx([0.0, 1.2, 1.6], rel=1e-12)
        assert sdk["force"] == pytest.approx([1.6, 0.0, 1.2], rel=1e-12)

    def test_a_driver_that_fails_once_to_read_or_to_send_is_a_lost_device(self, sdk, device):
        loop, sends = Loop(device.compiled()), Loop(device.compiled())
        sdk["fails"] = 1
        assert loop.read() == REPLY_LOST
        sends.send((0.0, 0.0, 0.0))
        sdk["fails"] = 0
        assert sends.read() == REPLY_LOST


class TestFalcon:
    @pytest.fixture
    def device(self, usb):
        opened = FalconDevice(calibration=Calibration())
        opened.open()
        yield opened
        opened.close()

    def test_a_reply_is_read_without_the_status_bytes_of_its_packet(self, device):
        loop = Loop(device.compiled())
        loop.send((0.0, 0.0, 0.0))
        assert loop.read() == REPLY_VALID
        # beyond the stops: no position, but not homed either
        assert loop.counts.tolist() == [-2345, -338, -267]
        assert (loop.words[HOMED], loop.words[PRESSED]) == (0, 0)
        angles = np.radians(35.0) + loop.counts * DEFAULT_GEOMETRY.radians_per_count
        assert loop.position == pytest.approx(forward(angles), abs=1e-9)

    def test_a_force_goes_out_as_the_drivers_own_packet(self, usb, device):
        loop, force = Loop(device.compiled()), np.array([0.3, -0.2, 0.5])
        usb.library.stub_clear()
        command(loop.io, loop.memory, LIMITS, force)
        (sent,) = usb.lines
        device._grip[:] = GUESS_M
        device._write(force)
        by_driver = usb.lines[-1]
        # the same numbers; the light of the driver's own state is red, that of the loop's green and blue
        assert sent.split()[:14] == by_driver.split()[:14]
        assert sent.split()[14:] == [f"{0x41 + 0x01 + 0x02 + 0x04:02x}", "41", "3e"]

    def test_an_unplugged_device_is_lost(self, usb, device):
        loop = Loop(device.compiled())
        loop.send((0.0, 0.0, 0.0))
        loop.read()
        usb.library.stub_unplug()
        assert loop.read() == REPLY_LOST

    def test_a_descriptor_gives_the_position_of_the_driver_or_says_that_there_is_none(self):
        ours, theirs = socket.socketpair()
        device = FalconDevice(calibration=Calibration(), port=0)
        device._transport = FileTransport(ours.detach(), "socket")
        loop = Loop(device.compiled())

        def exchange(reply: bytes) -> int:
            command(loop.io, loop.memory, LIMITS, np.zeros(3))
            theirs.send(reply)
            return loop.read()

        # 256, 16 and -240 counts, all homed, centre button
        assert exchange(b"<AABAABAAABPP\xb5A>") == REPLY_VALID
        assert loop.counts.tolist() == [256, 16, -240]
        assert (loop.words[HOMED], loop.words[PRESSED]) == (1, 4)
        there = forward(np.radians(35.0) + loop.counts * DEFAULT_GEOMETRY.radians_per_count)
        assert loop.position == pytest.approx(there, abs=1e-12)
        assert theirs.recv(64) == b"<AAAAAAAAAAAAHA>"
        # 12288 counts of one leg, homed: no position of the grip has them
        assert exchange(b"<AAADAAAAAAAA\xb5A>") == REPLY_APART
        assert loop.position == pytest.approx(there, abs=1e-12)
        theirs.close()
        os.fstat(int(device.compiled().handles[0]))
        command(loop.io, loop.memory, LIMITS, np.zeros(3))
        assert loop.read() == REPLY_LOST
        device._close()
