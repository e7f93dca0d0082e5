"""Firmware: is it there, which file, and an upload that fails before it succeeds."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
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
    monkeypatch.setattr(module, "PRESENCE_TRIES", 3)
    monkeypatch.setattr(module, "PRESENCE_WAIT_S", 0.005)
    monkeypatch.setattr(module, "HELLO_WAIT_S", 0.005)
    monkeypatch.setattr(module, "ECHO_WAIT_S", 0.05)


def silently(_message: str, _done: int, _all: int) -> None:
    """Progress that nobody looks at."""


def bare(**settings: object) -> EmulatedFalcon:
    return EmulatedFalcon(EmulatorSettings(firmware_loaded=False, **settings))


def reopening(falcon: EmulatedFalcon) -> tuple[list[Direct], Callable[[], Direct]]:
    """Transports that were opened, and how one more is."""
    opened: list[Direct] = []

    def open_transport() -> Direct:
        opened.append(Direct(falcon))
        return opened[-1]

    return opened, open_transport


def test_running_firmware_is_recognised_by_its_reply():
    assert is_running(Direct(EmulatedFalcon(EmulatorSettings(period_s=1e-3))))
    assert not is_running(Direct(bare()))


@pytest.mark.parametrize("long_greeting", [False, True])
def test_an_upload_starts_the_firmware(long_greeting):
    transport = Direct(bare(), long_greeting=long_greeting)
    upload(transport, CONTENT, silently)
    assert transport.falcon.running
    assert is_running(transport)
    assert transport.said == [
        "latency 16", "baud 9600", "8N1", "rts False", "dtr False", "dtr True",
        "dtr False", "baud 142857", "latency 1", "baud 1500000",
    ]  # fmt: skip


def test_hello_is_said_until_it_is_answered():
    transport = Direct(bare(), silent_hellos=20)
    upload(transport, CONTENT, silently)
    assert transport.falcon.running


@pytest.mark.parametrize(
    ("hellos", "tries", "reason"),
    [(10_000, 0, "no answer to 100 calls"), (0, 1, "echo of bytes 186 to 247")],
)
def test_a_loader_that_never_answers_or_echoes_wrongly_is_given_up(hellos, tries, reason):
    with pytest.raises(UploadError, match=reason):
        upload(Direct(bare(failing_tries=tries), silent_hellos=hellos), CONTENT, silently)


def test_two_failed_uploads_are_followed_by_a_third_on_a_new_transport():
    falcon = bare(failing_tries=2)
    opened, open_transport = reopening(falcon)
    told: list[str] = []
    transport = ensure_running(open_transport, lambda: FILE, lambda text, _done, _all: told.append(text))
    assert transport is opened[-1]
    assert [one.closed for one in opened] == [True, True, False]
    assert falcon.firmware_tries == 3
    assert [text for text in told if "try" in text] == [
        f"firmware, try {k} of 10: the echo of bytes 186 to 247 of the firmware is missing or differs"
        for k in (1, 2)
    ]


def test_ten_failed_uploads_are_the_end_with_what_to_do():
    falcon = bare(failing_tries=99)
    opened, open_transport = reopening(falcon)
    with pytest.raises(DeviceError, match=r"in 10 tries; the last: the echo .*\(no hub\)"):
        ensure_running(open_transport, lambda: FILE, silently)
    assert len(opened) == 10
    assert all(one.closed for one in opened)


def test_a_device_that_stays_silent_gets_no_ten_tries(monkeypatch):
    # a try is 100 calls of 5 ms here, and of 40 ms in use: 8 s are two of them
    monkeypatch.setattr(module, "SILENT_S", 0.8)
    told: list[str] = []
    with pytest.raises(DeviceError, match=r"in 2 tries; the last: no answer to 100 calls .*\(no hub\)"):
        ensure_running(
            lambda: Direct(bare(), silent_hellos=10_000),
            lambda: FILE,
            lambda text, _done, _all: told.append(text),
        )
    assert told == [f"firmware, try {k} of 10: no answer to 100 calls of the loader" for k in (1, 2)]


def test_a_file_is_asked_for_where_none_runs_and_a_missing_one_closes_the_transport(monkeypatch):
    monkeypatch.delenv("TISSUEID_FALCON_FIRMWARE", raising=False)
    running, transport = Direct(EmulatedFalcon(EmulatorSettings(period_s=1e-3))), Direct(bare())
    assert ensure_running(lambda: running, find_firmware, silently) is running
    with pytest.raises(DeviceError, match=r"--firmware FILE or \$TISSUEID_FALCON_FIRMWARE"):
        ensure_running(lambda: transport, find_firmware, silently)
    assert transport.closed


def test_option_comes_before_environment(monkeypatch, tmp_path):
    first, second = tmp_path / "first.bin", tmp_path / "second.bin"
    first.write_bytes(b"first")
    second.write_bytes(b"second")
    monkeypatch.setenv("TISSUEID_FALCON_FIRMWARE", str(second))
    assert find_firmware(first).content == b"first"
    assert find_firmware().content == b"second"


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


def test_an_unknown_file_is_warned_of_and_a_known_one_is_not(monkeypatch, tmp_path):
    file = tmp_path / "firmware.bin"
    file.write_bytes(CONTENT)
    digest = hashlib.sha256(CONTENT).hexdigest()
    unknown = find_firmware(file)
    assert unknown.warning is not None
    assert digest[:12] in unknown.warning
    monkeypatch.setattr(module, "KNOWN", {(digest[:8], digest[-4:], len(CONTENT))})
    assert find_firmware(file).warning is None
