"""The servo's own way to USB and to the SDK, against the same stand-ins as the Python drivers."""

from __future__ import annotations

import ctypes
import os
import socket
from typing import Any

import numba as nb
import numpy as np
import pytest
from c_library import compiled
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.falcon.kinematics import GUESS_M, forward
from tissueid.haptics.falcon.transport import of_socket
from tissueid.haptics.forcedimension import ForceDimensionDevice
from tissueid.haptics.guard import GUARD_SIZE, REPLY_APART, REPLY_LOST, REPLY_VALID, STATE
from tissueid.haptics.servo_access import HOMED, PRESSED, REPLY, WORDS_SIZE, compiled_io
from tissueid.haptics.states import State
from tissueid.rendering.servo_io import command, sense


@nb.njit(cache=True, nogil=True, error_model="numpy")
def exchange(
    io: Any, guard_memory: FloatArray, limits: FloatArray, force: FloatArray, position: FloatArray,
    counts: NDArray[np.int64], words: NDArray[np.int64],
) -> None:  # fmt: skip
    """One command and the reading after it, compiled."""
    command(io, guard_memory, limits, force)
    sense(io, 1e-3, position, counts, words)


def engaged_memory() -> FloatArray:
    memory = np.zeros(GUARD_SIZE)
    memory[STATE] = float(State.ENGAGED)
    return memory


def test_compiled_servo_sends_the_packet_of_the_driver_over_usb(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = compiled("usb_stub", tmp_path_factory.mktemp("usb"))
    monkeypatch.setenv("TISSUEID_LIBUSB", str(library))
    monkeypatch.delenv("FALCON_STUB", raising=False)
    stub = ctypes.CDLL(str(library))
    stub.stub_record.restype = ctypes.c_char_p
    device = FalconDevice(calibration=Calibration())
    device.open()
    given = device.compiled()
    assert given is not None
    io = compiled_io(given)
    position, counts, words = (
        np.array([0.0, 0.0, 0.13]),
        np.zeros(3, np.int64),
        np.zeros(WORDS_SIZE, np.int64),
    )
    force = np.array([0.3, -0.2, 0.5])
    exchange(io, engaged_memory(), device.limits.block(), force, position, counts, words)
    (sent,) = stub.stub_record().decode("ascii").splitlines()[-1:]
    # counts -2345, -338, -267 of the stand-in's reply are beyond the stops: no position, but not homed either
    assert counts.tolist() == [-2345, -338, -267]
    assert (words[HOMED], words[PRESSED]) == (0, 0)
    device._grip[:] = GUESS_M
    device._write(force)
    by_driver = stub.stub_record().decode("ascii").splitlines()[-1]
    # the same numbers; the light of the driver's own state is red, that of the compiled state green and blue
    assert sent.split()[:14] == by_driver.split()[:14]
    assert sent.split()[14] == f"{0x41 + 0x01 + 0x02 + 0x04:02x}"
    stub.stub_unplug()
    exchange(io, engaged_memory(), device.limits.block(), force, position, counts, words)
    assert words[REPLY] == REPLY_LOST
    device.close()


def test_compiled_servo_reads_and_pushes_through_the_sdk(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = compiled("dhd_stub", tmp_path_factory.mktemp("dhd"))
    monkeypatch.setenv("TISSUEID_FORCEDIM", str(library))
    stub = ctypes.CDLL(str(library))
    place = (ctypes.c_double * 3).in_dll(stub, "stub_position")
    pushed = (ctypes.c_double * 3).in_dll(stub, "stub_force")
    place[:] = [0.01, 0.02, 0.03]
    ctypes.c_uint.in_dll(stub, "stub_buttons").value = 1
    with ForceDimensionDevice() as device:
        given = device.compiled()
        assert given is not None
        io = compiled_io(given)
        position, counts, words = np.zeros(3), np.zeros(3, np.int64), np.zeros(WORDS_SIZE, np.int64)
        force = np.array([0.3, -0.2, 0.5])
        exchange(io, engaged_memory(), device.limits.block(), force, position, counts, words)
        assert words[REPLY] == REPLY_VALID
        # the SDK's first button is the centre, 4 on the wire
        assert words[PRESSED] == device.read().buttons == 4
        assert position == pytest.approx(device.read().position_m, abs=1e-15)
        assert list(pushed) == [0.5, 0.3, -0.2]
        ctypes.c_int.in_dll(stub, "stub_fails").value = 1
        exchange(io, engaged_memory(), device.limits.block(), force, position, counts, words)
        exchange(io, engaged_memory(), device.limits.block(), force, position, counts, words)
        assert words[REPLY] == REPLY_LOST
        ctypes.c_int.in_dll(stub, "stub_fails").value = 0


def test_compiled_servo_finds_the_position_of_the_driver() -> None:
    ours, theirs = socket.socketpair()
    device = FalconDevice(calibration=Calibration(), port=0)
    device._transport = of_socket(ours)
    given = device.compiled()
    assert given is not None
    io = compiled_io(given)
    position, counts, words = np.zeros(3), np.zeros(3, np.int64), np.zeros(WORDS_SIZE, np.int64)
    # 256, 16 and -240 counts, all homed, centre button
    theirs.send(b"<AABAABAAABPP\xb5A>")
    exchange(io, engaged_memory(), device.limits.block(), np.zeros(3), position, counts, words)
    assert counts.tolist() == [256, 16, -240]
    assert (words[REPLY], words[HOMED], words[PRESSED]) == (REPLY_VALID, 1, 4)
    angles = np.radians(35.0) + counts * Calibration().legs().radians_per_count
    assert position == pytest.approx(forward(angles), abs=1e-12)
    assert theirs.recv(64) == b"<AAAAAAAAAAAAHA>"
    # 12288 counts of one leg, homed: no position of the grip has them
    theirs.send(b"<AAADAAAAAAAA\xb5A>")
    exchange(io, engaged_memory(), device.limits.block(), np.zeros(3), position, counts, words)
    assert words[REPLY] == REPLY_APART
    assert position == pytest.approx(forward(angles), abs=1e-12)
    theirs.close()
    os.fstat(int(given.handles[0]))
    exchange(io, engaged_memory(), device.limits.block(), np.zeros(3), position, counts, words)
    assert words[REPLY] == REPLY_LOST
    device._close()
