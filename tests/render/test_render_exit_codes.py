"""Exit codes and log of `tissueid render` when a device fails.

Real time on a shared machine: the watchdog for silence is set to a second.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from emulated_session import pressing
from owner_to_kill import LIMITS

from tissueid.cli.main import main
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.emulator import EmulatedLink, EmulatorSettings, ScriptedFault
from tissueid.haptics.states import FAULT_WORDS, Fault, State
from tissueid.store.session_log import read_session_log

pytestmark = pytest.mark.needs_jit

FALCON = ("render", "--preset", "paper-a", "--device", "falcon", "--yes", "--quiet")


def run(*arguments: str | Path) -> tuple[int, str]:
    """``tissueid`` in this process: exit code and everything it said."""
    said = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
        code = main([str(argument) for argument in arguments])
    return code, said.buffer.getvalue().decode("utf-8")


@contextlib.contextmanager
def emulated(
    monkeypatch: pytest.MonkeyPatch, *faults: ScriptedFault, **settings: Any
) -> Iterator[EmulatedLink]:
    """An emulated Falcon that ``--device falcon`` finds."""
    device_options = {key: settings.pop(key) for key in ("homing_timeout_s", "firmware") if key in settings}
    given = EmulatorSettings(hand=pressing(), waits_for_blue=True, faults=faults, **settings)
    with EmulatedLink(given, pty=True) as link:
        options = {"port": link.path, "calibration": Calibration(), "limits": LIMITS, **device_options}
        monkeypatch.setattr("tissueid.haptics.registry.configured", lambda *_: options)
        yield link


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "fault"),
    [
        ("unplug", Fault.TRANSPORT),
        ("silence", Fault.NO_REPLY),
        ("bad packets", Fault.BAD_PACKETS),
        ("jump", Fault.ENCODER_JUMP),
        ("unhomed", Fault.NOT_HOMED),
    ],
)
def test_a_device_that_fails_is_exit_5_with_its_reason_on_the_screen_and_in_the_log(
    monkeypatch, tmp_path, kind, fault
):
    log = tmp_path / "out.h5"
    with emulated(monkeypatch, ScriptedFault(kind, 4.2)) as link:
        code, text = run(*FALCON, "--seconds", "30", "--log", log)
        # a device that is gone can't be told
        assert kind == "unplug" or link.falcon.last_motors == (0, 0, 0)
    assert code == 5
    assert FAULT_WORDS[fault] in text
    kept = read_session_log(log)
    assert kept.summary is not None
    assert kept.records["fault"][-1] == fault
    assert kept.records["state"][-1] == State.FAULT
    assert (kept.records["force_N"][-1] == 0.0).all()
    assert np.abs(kept.records["force_N"]).max() > 0.1


@pytest.mark.slow
def test_firmware_that_fails_twice_is_exit_0(monkeypatch, tmp_path):
    firmware = tmp_path / "any.bin"
    firmware.write_bytes(bytes(range(256)) * 2)
    with emulated(monkeypatch, firmware_loaded=False, failing_tries=2, firmware=firmware) as link:
        code, _ = run(*FALCON, "--seconds", "1")
        assert link.falcon.firmware_tries == 3
    assert code == 0


@pytest.mark.slow
def test_homing_that_never_completes_is_exit_5_and_says_what_to_do(monkeypatch):
    with emulated(monkeypatch, homes=False, homing_timeout_s=0.3) as link:
        code, text = run(*FALCON, "--seconds", "5")
        assert link.falcon.last_motors == (0, 0, 0)
    assert code == 5
    assert "pull the grip all the way out, push it all the way in" in text
