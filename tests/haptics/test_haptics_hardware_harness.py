"""The hardware tests themselves: left out visibly, and writing their report on an emulated device."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tissueid.haptics.falcon.emulator import EmulatedLink, EmulatorSettings

HARDWARE = Path(__file__).resolve().parent / "hardware"


def run_hardware(*options: str, environment: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-rs", str(HARDWARE), *options],
        capture_output=True, text=True, check=False, cwd=HARDWARE.parents[2],
        # without a terminal there is nobody to ask
        start_new_session=True,
        env={"XDG_CONFIG_HOME": str(environment), "PATH": "/usr/bin:/bin", "HOME": str(environment)},
    )  # fmt: skip


@pytest.mark.slow
def test_hardware_tests_are_left_out_visibly(tmp_path: Path) -> None:
    ended = run_hardware(environment=tmp_path)
    assert ended.returncode == 0
    assert "13 skipped" in ended.stdout
    assert "moves a real Falcon: give --falcon" in ended.stdout


@pytest.mark.slow
def test_report_holds_what_was_read_and_who_was_not_asked(tmp_path: Path) -> None:
    report = tmp_path / "hardware-report.json"
    with EmulatedLink(EmulatorSettings(), pty=True) as link:
        ended = run_hardware(
            "--falcon", "--falcon-port", str(link.path), "--falcon-report", str(report), environment=tmp_path
        )
    found = json.loads(report.read_text(encoding="utf-8"))
    assert found["port"] == link.path
    assert found["passed"]["test_3_homing_comes_to_its_end"] == "passed"
    assert found["homed"]["position_m"][2] > 0.170
    assert found["link"]["replies"] > 100
    assert found["passed"]["test_2_lights_have_their_colours"] == "skipped"
    assert "needs a person at a terminal" in ended.stdout
