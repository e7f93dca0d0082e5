"""The Falcon device over descriptors, against an emulator that shares no code with it."""

import fcntl
import os
import pty
import socket
import struct
import termios
import tty
from collections.abc import Iterator
from contextlib import closing, contextmanager

import numpy as np
import pytest
from command_line import until
from direct_wire import Direct

from tissueid.errors import DeviceError
from tissueid.haptics.falcon import device as module
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.falcon.emulator import EmulatedFalcon, EmulatedLink, EmulatorSettings, ScriptedFault
from tissueid.haptics.falcon.transport import FileTransport, TransportLost
from tissueid.haptics.limits import NO_REPLY_S
from tissueid.haptics.states import Fault, State

#: Thousands of packets of an emulator, and watchdogs in real time.
pytestmark = pytest.mark.needs_jit

TERMIOS2 = struct.Struct("4I20B2I")
GET_TERMIOS2 = 0x802C542A
NOTHING = np.zeros(3)


@pytest.fixture(autouse=True)
def _no_pause(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time is the emulator's: nothing is waited for."""
    monkeypatch.setattr("tissueid.haptics.device.TICK_S", 0.0)


def wired(**settings: object) -> tuple[FalconDevice, EmulatedFalcon, list[str]]:
    """A device on an emulator in which each command takes five milliseconds."""
    falcon = EmulatedFalcon(EmulatorSettings(period_s=5e-3, **settings))
    told: list[str] = []
    device = FalconDevice(calibration=Calibration(), port=0, homing_timeout_s=8.0)
    device.tell = told.append
    device._open_transport = lambda: Direct(falcon)
    return device, falcon, told


@contextmanager
def at_home(**settings: object) -> Iterator[tuple[FalconDevice, EmulatedFalcon]]:
    """The same, homed and open."""
    device, falcon, _ = wired(**settings)
    with device:
        device.home()
        yield device, falcon


def idle(device: FalconDevice, falcon: EmulatedFalcon, until_s: float) -> None:
    """Read and send no force until the emulator's clock says so, or a fault."""
    while falcon.time_s < until_s and device.state is not State.FAULT:
        device.read()
        device.write_force(NOTHING, 1e-3)


def test_homing_tells_what_to_do_and_ends_pulled_out():
    device, falcon, told = wired()
    with device:
        assert device.state is State.HOMING
        device.home()
        assert device.state is State.ARMED
        assert told == list(module.HOMING_STEPS)
        sample = device.read()
        assert sample.position_m[2] > 0.170
        # one count is up to 50 um, and the two kinematics share no code
        assert sample.position_m == pytest.approx(falcon.position_m, abs=1e-4)
        assert falcon.lamps == {"green"}
    assert (falcon.lamps, falcon.last_motors) == ({"red"}, (0, 0, 0))


def test_force_on_the_wire_pushes_the_emulated_grip_the_way_it_was_asked():
    with at_home() as (device, falcon):
        # the emulated user still pulls
        idle(device, falcon, 3.0)
        for force in ([0.3, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.0, -0.4], [0.2, -0.2, 0.1]):
            for _ in range(4):
                device.read()
                device._write(np.array(force))
            # whole motor units: one is 1/6600 N m at a lever of 25 to 90 mm; the emulator's motors push
            # through differences of its own kinematics
            assert falcon.force_N == pytest.approx(force, abs=0.01)


def test_homing_that_never_comes_ends_with_the_missing_legs():
    device, falcon, _ = wired(homes=False)
    device._homing_timeout_s = 0.2
    missing = r"leg 1 and 2 and 3 missing .* pull the grip all the way out"
    with pytest.raises(DeviceError, match=missing), device:
        device.home()
    assert device.state is State.CLOSED
    assert (falcon.last_motors, falcon.lamps) == ((0, 0, 0), {"red"})


def test_a_grip_that_stays_in_is_not_armed_for_force(monkeypatch):
    device, _, told = wired()
    monkeypatch.setattr(module, "PULLED_OUT_M", 0.30)

    def impatient(sentence: str) -> None:
        told.append(sentence)
        if sentence == module.HOMING_STEPS[1]:
            device._homing_timeout_s = 0.1

    device.tell = impatient
    with pytest.raises(DeviceError, match=r"not pulled out: .* forces wait for 300 mm"), device:
        device.home()
    assert told[-1] == module.HOMING_STEPS[1]


@pytest.mark.parametrize(
    ("kind", "expected"),
    [("bad packets", Fault.BAD_PACKETS), ("silence", Fault.NO_REPLY), ("unhomed", Fault.NOT_HOMED)],
)
def test_lasting_faults_of_the_wire_end_in_fault(kind, expected):
    device, falcon, _ = wired(faults=(ScriptedFault(kind, 3.5),))
    homing, _, _ = wired(faults=(ScriptedFault(kind, 0.5),))
    if kind == "bad packets":
        # each of them is a silence as well, and on a busy machine ten of them may take 20 ms
        device._limits[NO_REPLY_S] = homing._limits[NO_REPLY_S] = 10.0
        with pytest.raises(DeviceError, match="homing ended: the device sent too many damaged"), homing:
            homing.home()
    with device:
        device.home()
        idle(device, falcon, 12.5)
        assert (device.state, device.fault) == (State.FAULT, expected)


@pytest.mark.parametrize(("kind", "invalid"), [("short", 1), ("garbled", 1), ("doubled", 0)])
def test_one_spoilt_reply_is_dropped_and_counted(kind, invalid):
    with at_home(faults=(ScriptedFault(kind, 3.0),)) as (device, falcon):
        idle(device, falcon, 3.2)
        assert device.state is State.ARMED
        assert device._parser.invalid == invalid


def test_counts_of_no_position_are_as_good_as_damaged():
    with at_home() as (device, _):
        before = device.read().position_m
        # leg angles of 83, 35 and -19 degrees and more have no grip position
        device._transport.read = lambda _timeout: b"<AAAIAAAIAAAA\xb1A>"
        device._reply = device._reply._replace(encoders=(0, 0, 0))
        sample = device.read()
        assert not sample.valid
        assert sample.damaged >= 1
        assert sample.position_m == pytest.approx(before)


def test_unplugging_is_a_device_error_and_closing_still_ends():
    with at_home(faults=(ScriptedFault("unplug", 3.0),)) as (device, falcon):
        with pytest.raises(DeviceError, match="the device is gone"):
            idle(device, falcon, 20.0)
        assert device.fault is Fault.TRANSPORT
    assert falcon.gone
    assert device.state is State.CLOSED


@pytest.mark.parametrize("is_pty", [False, True])
def test_opens_reads_and_closes_on_a_real_descriptor(is_pty):
    with EmulatedLink(EmulatorSettings(period_s=1e-3), pty=is_pty) as link:
        port: str | int = link.path if is_pty and link.path else link.descriptor()
        with FalconDevice(calibration=Calibration(), port=port) as device:
            given = device.compiled()
            assert given.kind == "tissueid.haptics.falcon.servo_io:DESCRIPTOR"
            os.fstat(int(given.handles[0]))
            # a thread of this process answers: it may be late on a busy machine
            assert any(device.read().valid for _ in range(500))
        if isinstance(port, int):
            os.close(port)
        # all zero commands of closing arrive, though the port is closed at once
        until(lambda: link.falcon.commands >= 20, 5.0)


def test_firmware_is_loaded_over_a_pseudo_terminal(tmp_path, monkeypatch):
    monkeypatch.setattr("tissueid.haptics.falcon.firmware.PRESENCE_TRIES", 3)
    file = tmp_path / "firmware.bin"
    file.write_bytes(np.random.default_rng(4).bytes(700))
    told: list[str] = []
    settings = EmulatorSettings(period_s=1e-3, firmware_loaded=False, failing_tries=1)
    with EmulatedLink(settings, pty=True) as link:
        device = FalconDevice(calibration=Calibration(), port=link.path, firmware=file)
        device.tell = told.append
        with device:
            assert link.falcon.running
            assert link.falcon.boot.tries == 2
    assert told[0].startswith(f"{file} is no firmware known to work (700 bytes, sha256 ")
    assert [line for line in told if line.startswith("firmware, try")] == [
        "firmware, try 1 of 10: the echo of bytes 186 to 247 of the firmware is missing or differs"
    ]
    # 62 bytes at a time, the first beyond each quarter of 700
    assert told[-4:] == [f"firmware: {done} of 700 bytes" for done in (186, 372, 558, 700)]


@pytest.fixture
def terminal() -> Iterator[tuple[int, FileTransport]]:
    """The other end of a terminal, and the transport on it."""
    master, slave = pty.openpty()
    tty.setraw(master)
    with closing(FileTransport.open(os.ttyname(slave))) as transport:
        yield master, transport
    os.close(master)
    os.close(slave)


@pytest.fixture
def socketed() -> Iterator[tuple[socket.socket, FileTransport]]:
    """The other end of a socket pair, and the transport on it."""
    ours, theirs = socket.socketpair()
    with theirs, closing(FileTransport(ours.detach(), "socket")) as transport:
        yield theirs, transport


def test_a_terminal_takes_the_three_rates(terminal):
    master, transport = terminal
    for baud in (9600, 142_857, 1_500_000):
        transport.set_baud(baud)
        answer = bytearray(TERMIOS2.size)
        fcntl.ioctl(master, GET_TERMIOS2, answer)
        assert TERMIOS2.unpack(answer)[-1] == baud


def test_every_byte_passes_a_terminal_unchanged(terminal):
    master, transport = terminal
    everything = bytes(range(256))
    transport.write(everything)
    os.write(master, everything)
    received = back = b""
    while len(received) < 256:
        received += os.read(master, 256)
    while len(back) < 256:
        back += transport.read(1.0)
    assert (received, back) == (everything, everything)


def test_socket_transport_purges_times_out_and_notices_the_end(socketed):
    theirs, transport = socketed
    theirs.send(b"stale")
    transport.purge()
    assert transport.read(0.001) == b""
    transport.set_baud(9600)
    theirs.send(b"new")
    assert transport.read(1.0) == b"new"
    theirs.close()
    with pytest.raises(TransportLost, match="closed at its other end"):
        transport.read(1.0)
    with pytest.raises(TransportLost, match="gone"):
        transport.write(b"x")
    transport.close()
    with pytest.raises(TransportLost):
        transport.read(0.0)


def test_a_reader_that_never_reads_is_a_lost_transport(monkeypatch, socketed):
    monkeypatch.setattr("tissueid.haptics.falcon.transport.WRITE_TIMEOUT_S", 0.02)
    with pytest.raises(TransportLost, match="takes no more bytes"):
        socketed[1].write(bytes(50_000_000))


def test_ports_that_can_not_be_opened_say_why(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("", encoding="utf-8")
    for name, why in (("ttyUSB9", "there is no such device"), ("file", "is no terminal device")):
        with pytest.raises(DeviceError, match=why):
            FileTransport.open(str(tmp_path / name))

    def refused(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("tissueid.haptics.falcon.transport.os.open", refused)
    with pytest.raises(DeviceError, match=r"no permission; join the group .*dialout"):
        FileTransport.open("/dev/ttyUSB0")


def test_modem_lines_are_set_one_by_one_and_do_no_harm_where_there_are_none(monkeypatch, terminal, socketed):
    asked: list[tuple[int, int]] = []

    def ioctl(_descriptor: int, request: int, value: bytes) -> int:
        asked.append((request, struct.unpack("I", value)[0]))
        return 0

    for there in (False, True):
        if there:
            monkeypatch.setattr("tissueid.haptics.falcon.transport.fcntl.ioctl", ioctl)
        for transport in (terminal[1], socketed[1])[: 2 - there]:
            transport.set_frame()
            transport.set_dtr(on=False)
            transport.set_dtr(on=True)
            # there is no timer of a pseudo-terminal
            transport.set_latency(1)
    assert asked == [
        (termios.TIOCMBIC, termios.TIOCM_RTS),
        (termios.TIOCMBIC, termios.TIOCM_DTR),
        (termios.TIOCMBIS, termios.TIOCM_DTR),
    ]
