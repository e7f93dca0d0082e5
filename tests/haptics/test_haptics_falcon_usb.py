"""The Falcon over libusb: which requests it sends, in which order, and what it says when it can't."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np
import pytest
from c_library import compiled

from tissueid.errors import DeviceError
from tissueid.haptics.falcon import firmware
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.falcon.transport import LibUsb, TransportLost, without_status

#: Requests: type, request, value, index, length.
PURGE = ["control 40 0 0001 0 0", "control 40 0 0002 0 0"]
LATENCY_1, LATENCY_16 = "control 40 9 0001 0 0", "control 40 9 0010 0 0"
RUN_BAUD, HELLO_BAUD, UPLOAD_BAUD = (f"control 40 3 {divisor} 0 0" for divisor in ("0002", "4138", "0015"))
FRAME = ["control 40 4 0008 0 0", "control 40 2 0000 0 0"]
RTS_LOW, DTR_LOW, DTR_HIGH = (f"control 40 1 {value} 0 0" for value in ("0200", "0100", "0101"))
OPENING = ["open", "claim 0", *PURGE, LATENCY_1, RUN_BAUD, *PURGE]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled("usb_stub", tmp_path_factory.mktemp("usb"))


class Stub:
    """The stand-in for libusb: what it was asked, and how it behaves."""

    def __init__(self, library: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.library, self._environment = ctypes.CDLL(str(library)), monkeypatch
        self.library.stub_record.restype = ctypes.c_char_p
        monkeypatch.setenv("TISSUEID_LIBUSB", str(library))
        monkeypatch.delenv("FALCON_STUB", raising=False)

    @property
    def lines(self) -> list[str]:
        text: bytes = self.library.stub_record()
        return text.decode("ascii").splitlines()

    def mode(self, word: str) -> None:
        # it reads its own process's environment
        self._environment.setenv("FALCON_STUB", word)
        self.library.stub_clear()


@pytest.fixture
def stub(library: Path, monkeypatch: pytest.MonkeyPatch) -> Stub:
    return Stub(library, monkeypatch)


def test_opening_purges_then_sets_latency_and_baud_then_purges(stub):
    usb = LibUsb()
    transport = usb.open()
    assert stub.lines == OPENING
    transport.close()
    usb.close()
    assert stub.lines[len(OPENING) :] == ["release 0", "close", "exit"]
    transport.close()
    usb.close()
    assert stub.lines[-1] == "exit"


def test_falcons_are_found_by_their_numbers_among_other_chips(stub):
    usb = LibUsb()
    assert usb.falcons() == ["/dev/bus/usb/003/007"]
    with pytest.raises(DeviceError, match="no Falcon is plugged in"):
        usb.open("/dev/bus/usb/009/009")


def test_upload_follows_the_known_order_of_lines_rates_and_bytes(stub):
    stub.mode("bare")
    usb = LibUsb()
    transport = usb.open()
    content = np.random.default_rng(1).bytes(150)
    seen: list[tuple[int, int]] = []
    firmware.upload(transport, content, lambda _text, done, total: seen.append((done, total)))
    assert stub.lines[len(OPENING) :] == [
        *PURGE, LATENCY_16, HELLO_BAUD, *FRAME, RTS_LOW, DTR_LOW, DTR_HIGH,
        "out 0a 43 0d",
        DTR_LOW, UPLOAD_BAUD, "out 41",
        *("out " + content[at : at + 62].hex(" ") for at in (0, 62, 124)),
        LATENCY_1, RUN_BAUD, *PURGE,
    ]  # fmt: skip
    assert seen == [(62, 150), (124, 150), (150, 150)]
    assert firmware.is_running(transport)


def test_status_bytes_are_taken_out_of_every_64():
    data = bytes(range(200))
    packets = b"".join(b"\x01\x60" + data[at : at + 62] for at in range(0, 200, 62))
    assert without_status(packets) == data
    assert without_status(b"\x01\x60") == b""
    assert without_status(b"") == b""


def test_device_reads_and_commands_over_usb(stub):
    device = FalconDevice(calibration=Calibration())
    device.open()
    sample = device.read()
    assert sample.counts.tolist() == [-2345, -338, -267]
    assert (sample.valid, sample.homed, sample.buttons) == (True, False, 0)
    device.write_force([0.0, 0.0, 1.0], 0.001)
    # not homed: no force; homing mode and the red light
    assert stub.lines[-1] == "out " + b"<AAAAAAAAAAAAJA>".hex(" ")
    device.close()
    ended = stub.lines
    zeros = ended.count("out " + b"<AAAAAAAAAAAAJA>".hex(" "))
    assert zeros >= 20
    assert ended[-3:] == ["release 0", "close", "exit"]


def test_compiled_servo_is_given_libusbs_own_transfer(stub):
    device = FalconDevice(calibration=Calibration())
    assert device.compiled() is None
    device.open()
    given = device.compiled()
    address, handle, bulk_out, bulk_in, timeout = given.handles[:5].tolist()
    assert (given.kind, bulk_out, bulk_in) == ("tissueid.haptics.falcon.servo_io:USB", 0x02, 0x81)
    assert 0 < timeout <= 5
    packet = np.frombuffer(b"<BAAAPPPPAAAAAA>", np.uint8).copy()
    moved = np.zeros(1, np.int32)
    size, byte = ctypes.c_size_t, ctypes.c_ubyte
    transfer = ctypes.CFUNCTYPE(ctypes.c_int, size, byte, size, ctypes.c_int, size, ctypes.c_uint)(address)
    assert transfer(handle, bulk_out, packet.ctypes.data, 16, moved.ctypes.data, timeout) == 0
    assert moved[0] == 16
    assert stub.lines[-1] == "out " + packet.tobytes().hex(" ")
    assert given.constants[0] == 6600.0
    assert given.constants[1:].tolist() == Calibration().legs().block().tolist()
    device.close()


def test_no_permission_names_the_node_and_the_udev_line(stub):
    stub.mode("access")
    with pytest.raises(DeviceError) as refused:
        LibUsb().open()
    text = refused.value.message
    assert "/dev/bus/usb/003/007" in text
    assert 'ATTR{idVendor}=="0403", ATTR{idProduct}=="cb48", MODE="0660", TAG+="uaccess"' in text
    (found,) = FalconDevice.detect()
    assert found.where == "/dev/bus/usb/003/007"
    assert found.note == text


@pytest.mark.parametrize(
    ("word", "reason", "said"),
    [("busy", "in use by another program", ["open", "close"]), ("none", "power supply", [])],
)
def test_a_falcon_in_use_and_one_that_is_missing_say_so(stub, word, reason, said):
    stub.mode(word)
    with pytest.raises(DeviceError, match=reason):
        FalconDevice(calibration=Calibration()).open()
    assert [line for line in stub.lines if line in {"open", "close"}] == said
    assert [bool(found.note) for found in FalconDevice.detect()] == [True] * (word == "busy")


def test_a_falcon_that_can_be_opened_has_no_note(stub):
    assert [(found.where, found.note) for found in FalconDevice.detect()] == [("/dev/bus/usb/003/007", "")]


def test_a_missing_library_says_how_to_get_it(monkeypatch, tmp_path):
    monkeypatch.setenv("TISSUEID_LIBUSB", str(tmp_path / "none.so"))
    with pytest.raises(DeviceError, match=r"none\.so .*can't be loaded.*apt install libusb-1\.0-0"):
        LibUsb()
    (found,) = FalconDevice.detect()
    assert "can't be loaded" in found.note


def test_another_library_is_no_libusb(monkeypatch):
    monkeypatch.setenv("TISSUEID_LIBUSB", "libc.so.6")
    with pytest.raises(DeviceError, match="has no libusb_init"):
        LibUsb()


def test_unplugging_is_a_lost_transport(stub):
    transport = LibUsb().open()
    stub.library.stub_unplug()
    for action in (lambda: transport.write(b"x"), lambda: transport.read(0.01), transport.purge):
        with pytest.raises(TransportLost, match=r"/dev/bus/usb/003/007 is gone \(LIBUSB_ERROR_NO_DEVICE\)"):
            action()


def test_a_read_returns_nothing_after_its_time_out(stub):
    assert LibUsb().open().read(0.002) == b""
