"""Devices and force laws by name: what is taken, and what a missing, unknown or broken plug-in says."""

from __future__ import annotations

import re
import sys
from importlib.metadata import EntryPoint, EntryPoints
from types import ModuleType

import fake_device
import numpy as np
import pytest
from command_line import REPOSITORY, python
from fake_device import FakeDevice

from tissueid.errors import DeviceError, UsageError
from tissueid.haptics import registry
from tissueid.haptics.device import AskedDevice, DetectedDevice, HapticDevice
from tissueid.haptics.sim import SimulatedDevice
from tissueid.haptics.states import State

PAGE = (REPOSITORY / "docs" / "devices.md").read_text(encoding="utf-8")

BROKEN = EntryPoint("broken", "no_such_distribution:Device", registry.DEVICE_GROUP)
NO_DEVICE = EntryPoint("nothing", "fake_device:law", registry.DEVICE_GROUP)
PLUGIN = EntryPoint("fake", "fake_device:FakeDevice", registry.DEVICE_GROUP)
THIEF = EntryPoint("sim", "fake_device:FakeDevice", registry.DEVICE_GROUP)
LAW = EntryPoint("spring", "fake_device:law", registry.ENVIRONMENT_GROUP)
NO_LAW = EntryPoint("number", "fake_device:RANGE", registry.ENVIRONMENT_GROUP)


@pytest.fixture
def plugins(monkeypatch):
    """Entry points as if distributions with them were installed."""
    installed = EntryPoints([BROKEN, NO_DEVICE, PLUGIN, THIEF, LAW, NO_LAW])
    monkeypatch.setattr(registry, "entry_points", installed.select)


def nothing_found(monkeypatch, note: str | None = None) -> None:
    """No hardware on this machine, or one with something in its way."""
    found = [] if note is None else [DetectedDevice("falcon", "/dev/bus/usb/001/004", note)]
    for name in registry.HARDWARE:
        kind, there = registry.device_class(name), found if name == "falcon" else []
        monkeypatch.setattr(kind, "detect", classmethod(lambda cls, there=there: there))


@pytest.mark.parametrize("name", registry.DEVICES)
def test_a_built_in_device_is_told_of_found_or_not_and_closed_until_it_is_opened(name):
    kind = registry.device_class(name)
    assert issubclass(kind, HapticDevice)
    assert kind.name == name
    assert f"\n| `{name}` |" in PAGE
    assert all(one.name == name for one in kind.detect())
    device = kind(**kind.configured(AskedDevice()))
    assert device.state is State.CLOSED
    assert device.compiled() is None or not registry.DEVICES[name].hardware
    with pytest.raises(DeviceError, match=f"^{name}: is closed"):
        device.write_force(np.zeros(3), 1e-3)
    low, high = np.array(kind.typical().workspace_m).T
    assert (high - low > 0.03).all()
    if registry.DEVICES[name].hardware:
        # until somebody weighed its force, with the button held
        assert device.limits.clamp_N <= 2.0
        assert device.limits.dead_man
        assert kind.typical().hardware
        assert not kind.typical().calibrated


def test_asking_for_names_imports_no_device():
    program = (
        "import sys\nfrom tissueid.haptics import registry\nregistry.device_names()\n"
        "print([m for m in sys.modules if 'falcon' in m or 'haptics.sim' in m or 'forcedim' in m])"
    )
    assert python("-c", program).stdout == "[]\n"


def test_a_device_of_another_distribution_is_found_and_takes_no_built_in_name(plugins):
    assert registry.device_class("fake") is FakeDevice
    assert registry.device_names()[-3:] == ["broken", "fake", "nothing"]
    assert registry.device_class("sim") is SimulatedDevice


def test_a_broken_plugin_says_what_broke_and_the_way_out(plugins):
    with pytest.raises(DeviceError, match=r"'broken'.*ModuleNotFoundError.*repair or remove"):
        registry.device_class("broken")
    with pytest.raises(DeviceError, match=r"'nothing'.*HapticDevice"):
        registry.device_class("nothing")


def test_a_broken_plugin_hides_no_other_device(plugins, monkeypatch):
    nothing_found(monkeypatch)
    found = {device.name: device for device in registry.detect_all()}
    assert {"sim", "fake", "broken", "nothing"} <= set(found)
    assert "ModuleNotFoundError" in found["broken"].note
    assert registry.choose_device() == registry.Choice("fake", "device fake: found at this test")


@pytest.mark.parametrize(
    ("note", "choice"),
    [
        (None, ("sim", "device sim, simulated: no haptic device was found")),
        ("", ("falcon", "device falcon: found at /dev/bus/usb/001/004")),
        ("no permission", ("sim", "device sim, simulated: falcon at /dev/bus/usb/001/004: no permission")),
    ],
)
def test_auto_takes_hardware_with_nothing_in_its_way_else_the_simulated_one_and_says_why(
    monkeypatch, note, choice
):
    nothing_found(monkeypatch, note)
    assert registry.choose_device() == registry.Choice(*choice)


def test_a_device_named_by_the_user_is_never_replaced(monkeypatch):
    nothing_found(monkeypatch)
    assert registry.choose_device("falcon") == registry.Choice("falcon", "device falcon: asked for by name")
    with pytest.raises(UsageError, match=r"no device named 'flacon'.*falcon, forcedimension.*sim.*auto"):
        registry.choose_device("flacon")


def test_a_force_law_of_another_distribution_is_found(request):
    with pytest.raises(UsageError, match="installed: none"):
        registry.environment_law("magnet")
    request.getfixturevalue("plugins")
    assert registry.environment_law("spring") is fake_device.law
    with pytest.raises(UsageError, match=r"'magnet'.*number, spring.*tissueid\.environments"):
        registry.environment_law("magnet")
    with pytest.raises(DeviceError, match=r"'number'.*tuple, not a function"):
        registry.environment_law("number")


class Driver:
    """The page's my_driver."""

    pushed: tuple[float, ...] | None = None

    def read(self) -> tuple[list[float], int]:
        return [0.0, 0.0, 0.13], 4

    def push(self, *force: float) -> None:
        self.pushed = force

    def close(self) -> None:
        pass


def test_plug_in_of_the_page_runs_behind_the_guard(monkeypatch):
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
