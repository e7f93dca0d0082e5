"""Firmware: is it there, which file, an upload that fails before it succeeds; what libusb is asked for."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
from direct_wire import Direct

from tissueid.errors import DeviceError
from tissueid.haptics.falcon import firmware as module
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.falcon.emulator import EmulatedFalcon, EmulatorSettings
from tissueid.haptics.falcon.transport import LibUsb, TransportLost, without_status

CONTENT = np.random.default_rng(2).bytes(500)
FILE = module.Firmware(Path("firmware.bin"), CONTENT, None)


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A silent device is given up after milliseconds, not seconds."""
    for name, value in (("PRESENCE_WAIT_S", 0.005), ("HELLO_WAIT_S", 0.005), ("ECHO_WAIT_S", 0.05)):
        monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(module, "PRESENCE_TRIES", 3)
    monkeypatch.delenv("TISSUEID_FALCON_FIRMWARE", raising=False)


class Told(list):
    """Failed tries of an upload, out of its progress."""

    def __call__(self, message: str, _done: int, _all: int) -> None:
        if "try" in message:
            self.append(message)


@pytest.fixture
def told() -> Told:
    return Told()


def bare(failing_tries: int = 0, **wire: int) -> Direct:
    """A wire to a device without firmware."""
    settings = EmulatorSettings(firmware_loaded=False, failing_tries=failing_tries)
    return Direct(EmulatedFalcon(settings), **wire)


@pytest.mark.parametrize("wire", [{}, {"long_greeting": True}, {"silent_hellos": 20}])
def test_an_upload_starts_the_firmware_once_a_hello_is_answered(told, wire):
    transport = bare(**wire)
    assert not module.is_running(transport)
    module.upload(transport, CONTENT, told)
    assert transport.falcon.running
    assert module.is_running(transport)
    assert transport.said == [
        "latency 16", "baud 9600", "8N1", "dtr False", "dtr True",
        "dtr False", "baud 142857", "latency 1", "baud 1500000",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("hellos", "tries", "reason"), [(10_000, 0, "no answer to 100 calls"), (0, 1, "echo of bytes 186 to 247")]
)
def test_a_loader_that_never_answers_or_echoes_wrongly_is_given_up(told, hellos, tries, reason):
    with pytest.raises(module.UploadError, match=reason):
        module.upload(bare(tries, silent_hellos=hellos), CONTENT, told)


@pytest.mark.parametrize(("failing", "opened"), [(2, 3), (99, 10)])
def test_each_failed_upload_is_followed_by_another_on_a_new_transport_up_to_ten(told, failing, opened):
    falcon = bare(failing).falcon
    wires: list[Direct] = []

    def open_transport() -> Direct:
        wires.append(Direct(falcon))
        return wires[-1]

    if failing < 10:
        assert module.ensure_running(open_transport, lambda: FILE, told) is wires[-1]
    else:
        with pytest.raises(DeviceError, match=r"in 10 tries; the last: the echo .*\(no hub\)"):
            module.ensure_running(open_transport, lambda: FILE, told)
    assert falcon.boot.tries == len(wires) == opened
    assert [one.closed for one in wires] == [True] * (opened - 1) + [failing > 10]
    assert told == [
        f"firmware, try {k} of 10: the echo of bytes 186 to 247 of the firmware is missing or differs"
        for k in range(1, min(failing, 10) + 1)
    ]


def test_a_device_that_stays_silent_gets_no_ten_tries(monkeypatch, told):
    # a try is 100 calls of 5 ms here, and of 40 ms in use: 8 s are two of them
    monkeypatch.setattr(module, "SILENT_S", 0.8)
    with pytest.raises(DeviceError, match=r"in 2 tries; the last: no answer to 100 calls .*\(no hub\)"):
        module.ensure_running(lambda: bare(silent_hellos=10_000), lambda: FILE, told)
    assert told == [f"firmware, try {k} of 10: no answer to 100 calls of the loader" for k in (1, 2)]


def test_a_file_is_asked_for_where_none_runs_and_a_missing_one_closes_the_transport(told):
    there, transport = Direct(EmulatedFalcon(EmulatorSettings(period_s=1e-3))), bare()
    assert module.ensure_running(lambda: there, module.find_firmware, told) is there
    with pytest.raises(DeviceError, match=r"--firmware FILE or \$TISSUEID_FALCON_FIRMWARE"):
        module.ensure_running(lambda: transport, module.find_firmware, told)
    assert transport.closed


@pytest.mark.parametrize(
    ("content", "reason"),
    [(None, "No such file"), (b"", "is empty"), (b"x" * 70_000, "has 70000 bytes, far more")],
)
def test_a_file_that_is_no_firmware_is_refused(content, reason, tmp_path):
    file = tmp_path / "firmware.bin"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(DeviceError, match=rf"firmware\.bin.*{reason}.*--firmware FILE"):
        module.find_firmware(file)


def test_option_comes_before_environment_and_an_unknown_file_is_warned_of(monkeypatch, tmp_path):
    first, second = tmp_path / "first.bin", tmp_path / "second.bin"
    first.write_bytes(CONTENT)
    second.write_bytes(b"second")
    monkeypatch.setenv("TISSUEID_FALCON_FIRMWARE", str(second))
    assert module.find_firmware().content == b"second"
    unknown = module.find_firmware(first)
    digest = hashlib.sha256(CONTENT).hexdigest()
    assert unknown.content == CONTENT
    assert digest[:12] in (unknown.warning or "")
    monkeypatch.setattr(module, "KNOWN", {(digest[:8], digest[-4:], len(CONTENT))})
    assert module.find_firmware(first).warning is None


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
    module.upload(transport, content, lambda _text, done, total: seen.append((done, total)))
    assert usb.lines[len(OPENING) :] == [
        *PURGE, LATENCY_16, HELLO_BAUD, *FRAME, RTS_LOW, DTR_LOW, DTR_HIGH,
        "out 0a 43 0d",
        DTR_LOW, UPLOAD_BAUD, "out 41",
        *("out " + content[at : at + 62].hex(" ") for at in (0, 62, 124)),
        LATENCY_1, RUN_BAUD, *PURGE,
    ]  # fmt: skip
    assert seen == [(62, 150), (124, 150), (150, 150)]
    assert module.is_running(transport)


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
