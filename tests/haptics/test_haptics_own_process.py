"""A process of our own runs the files of the one that starts it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tissueid.own_process import own_process
from tissueid.rendering import servo_spawn


@pytest.fixture
def other_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with another ``tissueid`` in it, which one stands in."""
    package = tmp_path / "tissueid"
    package.mkdir()
    (package / "__init__.py").write_text("raise SystemExit('the wrong files')\n", encoding="ascii")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_checkout_one_stands_in_is_not_what_runs(other_checkout: Path) -> None:
    by_module = [sys.executable, "-m", "tissueid.haptics.falcon.emulator", "--help"]
    assert "the wrong files" in subprocess.run(by_module, capture_output=True, text=True, check=False).stderr
    ours = own_process("tissueid.haptics.falcon.emulator", "--help")
    shown = subprocess.run(ours, capture_output=True, text=True, check=False)
    assert shown.returncode == 0, shown.stderr
    assert "--until-eof" in shown.stdout


def test_the_servo_beside_another_checkout_is_ours(other_checkout: Path) -> None:
    servo = servo_spawn.spawn_servo()
    # one that can't be loaded ends at once, ours waits for its plan
    with pytest.raises(subprocess.TimeoutExpired):
        servo.process.wait(1.0)
    servo.close()


def test_modules_beside_a_script_stay_reachable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "beside.py").write_text("import sys\nprint(sys.argv[1:], __name__)\n", encoding="ascii")
    monkeypatch.syspath_prepend(str(tmp_path))
    shown = subprocess.run(own_process("beside", "a", "b"), capture_output=True, text=True, check=True)
    assert shown.stdout.split() == ["['a',", "'b']", "__main__"]
