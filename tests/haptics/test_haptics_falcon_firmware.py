"""Firmware: is it there, which file, and an upload that fails before it succeeds."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from direct_wire import Direct

from tissueid.errors import DeviceError
from tissueid.haptics.falcon import firmware as module
from tissueid.haptics.falcon.emulator import EmulatedFalcon, EmulatorSettings
from tissueid.haptics.falcon.firmware import (
    Firmware,
    UploadError,
    ensure_running,
    find_firmware,
    is_running,
    upload,
)

CONTENT = np.random.default_rng(2).bytes(500)
FILE = Firmware(Path("firmware.bin"), CONTENT, None)


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A silent device is given up after milliseconds, not seconds."""
    for name, value in (("PRESENCE_WAIT_S", 0.005), ("HELLO_WAIT_S", 0.005), ("ECHO_WAIT_S", 0.05)):
        monkeypatch.setattr(module, name, value)
    monkeypatch.setattr(module, "PRESENCE_TRIES", 3)
    monkeypatch.delenv("TISSUEID_FALCON_FIRMWARE", raising=False)


class Told:
    """Progress of an upload."""

    def __init__(self) -> None:
        self.tries: list[str] = []

    def __call__(self, message: str, _done: int, _all: int) -> None:
        if "try" in message:
            self.tries.append(message)


@pytest.fixture
def told() -> Told:
    return Told()


def bare(failing_tries: int = 0, **wire: int) -> Direct:
    """A wire to a device without firmware."""
    settings = EmulatorSettings(firmware_loaded=False, failing_tries=failing_tries)
    return Direct(EmulatedFalcon(settings), **wire)


def running() -> Direct:
    return Direct(EmulatedFalcon(EmulatorSettings(period_s=1e-3)))


@pytest.mark.parametrize("wire", [{}, {"long_greeting": True}, {"silent_hellos": 20}])
def test_an_upload_starts_the_firmware_once_a_hello_is_answered(told, wire):
    transport = bare(**wire)
    assert not is_running(transport)
    upload(transport, CONTENT, told)
    assert transport.falcon.running
    assert is_running(transport)
    assert transport.said == [
        "latency 16", "baud 9600", "8N1", "dtr False", "dtr True",
        "dtr False", "baud 142857", "latency 1", "baud 1500000",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("hellos", "tries", "reason"), [(10_000, 0, "no answer to 100 calls"), (0, 1, "echo of bytes 186 to 247")]
)
def test_a_loader_that_never_answers_or_echoes_wrongly_is_given_up(told, hellos, tries, reason):
    with pytest.raises(UploadError, match=reason):
        upload(bare(tries, silent_hellos=hellos), CONTENT, told)


@pytest.mark.parametrize(("failing", "opened"), [(2, 3), (99, 10)])
def test_each_failed_upload_is_followed_by_another_on_a_new_transport_up_to_ten(told, failing, opened):
    falcon = bare(failing).falcon
    wires: list[Direct] = []

    def open_transport() -> Direct:
        wires.append(Direct(falcon))
        return wires[-1]

    if failing < 10:
        assert ensure_running(open_transport, lambda: FILE, told) is wires[-1]
    else:
        with pytest.raises(DeviceError, match=r"in 10 tries; the last: the echo .*\(no hub\)"):
            ensure_running(open_transport, lambda: FILE, told)
    assert falcon.firmware_tries == len(wires) == opened
    assert [one.closed for one in wires] == [True] * (opened - 1) + [failing > 10]
    assert told.tries == [
        f"firmware, try {k} of 10: the echo of bytes 186 to 247 of the firmware is missing or differs"
        for k in range(1, min(failing, 10) + 1)
    ]


def test_a_device_that_stays_silent_gets_no_ten_tries(monkeypatch, told):
    # a try is 100 calls of 5 ms here, and of 40 ms in use: 8 s are two of them
    monkeypatch.setattr(module, "SILENT_S", 0.8)
    with pytest.raises(DeviceError, match=r"in 2 tries; the last: no answer to 100 calls .*\(no hub\)"):
        ensure_running(lambda: bare(silent_hellos=10_000), lambda: FILE, told)
    assert told.tries == [f"firmware, try {k} of 10: no answer to 100 calls of the loader" for k in (1, 2)]


def test_a_file_is_asked_for_where_none_runs_and_a_missing_one_closes_the_transport(told):
    there, transport = running(), bare()
    assert ensure_running(lambda: there, find_firmware, told) is there
    with pytest.raises(DeviceError, match=r"--firmware FILE or \$TISSUEID_FALCON_FIRMWARE"):
        ensure_running(lambda: transport, find_firmware, told)
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
        find_firmware(file)


def test_option_comes_before_environment_and_an_unknown_file_is_warned_of(monkeypatch, tmp_path):
    first, second = tmp_path / "first.bin", tmp_path / "second.bin"
    first.write_bytes(CONTENT)
    second.write_bytes(b"second")
    monkeypatch.setenv("TISSUEID_FALCON_FIRMWARE", str(second))
    assert find_firmware().content == b"second"
    unknown = find_firmware(first)
    digest = hashlib.sha256(CONTENT).hexdigest()
    assert unknown.content == CONTENT
    assert digest[:12] in (unknown.warning or "")
    monkeypatch.setattr(module, "KNOWN", {(digest[:8], digest[-4:], len(CONTENT))})
    assert find_firmware(first).warning is None
