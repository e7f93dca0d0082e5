"""Truth of what docs/devices.md prints: the plug-in runs, keys, rule and numbers are those of the code."""

from __future__ import annotations

import re
import sys
from dataclasses import asdict, replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from tissueid.haptics.device import HapticDevice
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.kinematics import DEFAULT_GEOMETRY, forward, inverse
from tissueid.haptics.falcon.transport import UDEV_RULE
from tissueid.haptics.registry import DEVICES
from tissueid.haptics.states import State

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "devices.md").read_text(encoding="utf-8")


class Driver:
    """The page's my_driver."""

    pushed: tuple[float, ...] | None = None

    def read(self) -> tuple[list[float], int]:
        return [0.0, 0.0, 0.13], 4

    def push(self, *force: float) -> None:
        self.pushed = force

    def close(self) -> None:
        pass


def test_plug_in_of_the_page_runs_behind_the_guard(monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Driver()
    module = ModuleType("my_driver")
    module.open = lambda: driver
    module.places = lambda: ["/dev/input/js0"]
    monkeypatch.setitem(sys.modules, "my_driver", module)
    (block,) = re.findall(r"^```python\n(.*?)^```$", PAGE, flags=re.MULTILINE | re.DOTALL)
    found: dict[str, object] = {}
    exec(compile(block, "joystick.py", "exec"), found)
    kind = found["Joystick"]
    assert isinstance(kind, type)
    assert issubclass(kind, HapticDevice)
    assert [one.where for one in kind.detect()] == ["/dev/input/js0"]
    with kind() as device:
        for _ in range(60):
            device.read()
            device.write_force(np.array([0.0, 0.0, 50.0]), 1e-3)
        assert device.state is State.ARMED
        assert driver.pushed == (0.0, 0.0, 0.0)
        assert device.compiled() is None
    assert 'tissueid.devices"]' in PAGE


def test_every_device_and_every_key_stands_on_the_page() -> None:
    assert set(DEVICES) <= set(re.findall(r"^\| `(\w+)` \|", PAGE, flags=re.MULTILINE))
    rows = dict(re.findall(r"^\| `(\w+)` \| `?([\w.]+)`? \|", PAGE, flags=re.MULTILINE))
    said = {bool: lambda value: str(value).lower(), float: "{:g}".format, tuple: lambda _: "zeros", str: str}
    calibration = asdict(Calibration())
    assert not any(calibration["weight_N"] + calibration["weight_slope_N_per_m"])
    for key, value in calibration.items():
        assert rows[key] == said[type(value)](value)
    assert UDEV_RULE in PAGE


def test_a_wrong_zero_angle_shows_on_a_ruler_as_the_page_says() -> None:
    true, wrong = DEFAULT_GEOMETRY, replace(DEFAULT_GEOMETRY, zero_angle_deg=36.0)
    counts = [(inverse([0.0, 0.0, z]) - np.radians(35.0)) / true.radians_per_count for z in (0.182, 0.132)]
    shown = [
        forward(np.radians(36.0) + true.radians_per_count * count, geometry=wrong)[2] for count in counts
    ]
    (less,) = re.findall(r"falls by about ([\d.]+) mm less", PAGE)
    assert 50.0 - 1e3 * (shown[0] - shown[1]) == pytest.approx(float(less), abs=0.1)
