"""The Falcon over libusb: which requests it sends, in which order, and what it says when it can't."""

from __future__ import annotations

import numpy as np
import pytest

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
NODE = "/dev/bus/usb/003/007"


def test_opening_purges_then_sets_latency_and_baud_then_purges(usb):
    opened = LibUsb()
    transport = opened.open()
    assert usb.lines == OPENING
    for _ in range(2):
        transport.close()
        opened.close()
        assert usb.lines[len(OPENING) :] == ["release 0", "close", "exit"]


def test_falcons_are_found_by_their_numbers_among_other_chips(usb):
    opened = LibUsb()
    assert opened.falcons() == [NODE]
    with pytest.raises(DeviceError, match="no Falcon is plugged in"):
        opened.open("/dev/bus/usb/009/009")
    assert [(found.where, found.note) for found in FalconDevice.detect()] == [(NODE, "")]


def test_upload_follows_the_known_order_of_lines_rates_and_bytes(usb):
    usb.mode("bare")
    transport = LibUsb().open()
    content = np.random.default_rng(1).bytes(150)
    seen: list[tuple[int, int]] = []
    firmware.upload(transport, content, lambda _text, done, total: seen.append((done, total)))
    assert usb.lines[len(OPENING) :] == [
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
    assert [without_status(raw) for raw in (packets, b"\x01\x60", b"")] == [data, b"", b""]


def test_device_reads_and_commands_over_usb(usb):
    device = FalconDevice(calibration=Calibration())
    device.open()
    sample = device.read()
    assert sample.counts.tolist() == [-2345, -338, -267]
    assert (sample.valid, sample.homed, sample.buttons) == (True, False, 0)
    device.write_force([0.0, 0.0, 1.0], 0.001)
    # not homed: no force; homing mode and the red light
    zero = "out " + b"<AAAAAAAAAAAAJA>".hex(" ")
    assert usb.lines[-1] == zero
    device.close()
    assert usb.lines.count(zero) >= 20
    assert usb.lines[-3:] == ["release 0", "close", "exit"]


@pytest.mark.parametrize(
    ("word", "reason", "said"),
    [
        ("busy", "in use by another program", ["open", "close"]),
        ("none", "power supply", []),
        (
            "access",
            NODE + r'.*ATTR\{idVendor\}=="0403", ATTR\{idProduct\}=="cb48", MODE="0660", TAG\+="uaccess"',
            [],
        ),
    ],
)
def test_a_falcon_that_can_not_be_opened_says_why_and_the_way_out(usb, word, reason, said):
    usb.mode(word)
    with pytest.raises(DeviceError, match=reason) as refused:
        FalconDevice(calibration=Calibration()).open()
    assert [line for line in usb.lines if line in {"open", "close"}] == said
    found = [] if word == "none" else [(NODE, refused.value.message)]
    assert [(one.where, one.note) for one in FalconDevice.detect()] == found


@pytest.mark.parametrize(
    ("library_name", "reason"),
    [
        ("none.so", r"none\.so .*can't be loaded.*apt install libusb-1\.0-0"),
        ("libc.so.6", "has no libusb_init"),
    ],
)
def test_a_library_that_is_missing_or_another_is_told(monkeypatch, library_name, reason):
    monkeypatch.setenv("TISSUEID_LIBUSB", library_name)
    with pytest.raises(DeviceError, match=reason) as refused:
        LibUsb()
    assert [found.note for found in FalconDevice.detect()] == [refused.value.message]


def test_unplugging_is_a_lost_transport_and_silence_is_not(usb):
    transport = LibUsb().open()
    assert transport.read(0.002) == b""
    usb.library.stub_unplug()
    for action in (lambda: transport.write(b"x"), lambda: transport.read(0.01), transport.purge):
        with pytest.raises(TransportLost, match=r"/dev/bus/usb/003/007 is gone \(LIBUSB_ERROR_NO_DEVICE\)"):
            action()
