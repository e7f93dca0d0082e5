"""The Force Dimension backend against a stand-in for its SDK, compiled here."""

from __future__ import annotations

import numpy as np
import pytest

from tissueid.errors import DeviceError
from tissueid.haptics.falcon.packets import BUTTON_NAMES
from tissueid.haptics.forcedimension import device as driver
from tissueid.haptics.states import State


def test_sdk_is_looked_for_where_its_documentation_puts_it(monkeypatch, tmp_path):
    monkeypatch.delenv(driver.LIBRARY_VARIABLE, raising=False)
    monkeypatch.setattr("tissueid.haptics.forcedimension.device.platform.machine", lambda: "x86_64")
    for name, folder in (("HOME", tmp_path), ("FDSDK", "/opt/fd"), ("FORCEDIM_SDK", "/opt/other")):
        monkeypatch.setenv(name, str(folder))
    places = list(driver.candidates())
    assert places[0] == "/opt/fd/lib/release/lin-x86_64-gcc/libdrd.so"
    assert "/opt/other/lib/release/lin-x86_64-gcc/libdrd.so" in places
    assert places.index(f"{tmp_path}/.local/lib/libdrd.so") < places.index("/usr/local/lib/libdrd.so")
    monkeypatch.setenv(driver.LIBRARY_VARIABLE, "/mine/libdrd.so")
    assert list(driver.candidates()) == ["/mine/libdrd.so"]


@pytest.mark.parametrize(
    ("library_name", "stub", "reason"),
    [
        ("none.so", {}, r"not installed.* FDSDK .*TISSUEID_FORCEDIM"),
        ("libc.so.6", {}, "has no dhdGetSDKVersion"),
        (None, {"major": 2}, r"is 2\.17\.5\.1; 3\.16 or newer"),
        (None, {"fails": 1}, "no device found"),
    ],
)
def test_without_an_sdk_of_use_nothing_is_detected_and_opening_says_why(
    sdk, monkeypatch, library_name, stub, reason
):
    for name, value in stub.items():
        sdk[name] = value
    if library_name is not None:
        monkeypatch.setenv(driver.LIBRARY_VARIABLE, library_name)
    assert driver.ForceDimensionDevice.detect() == []
    with pytest.raises(DeviceError, match=reason):
        driver.ForceDimensionDevice().open()


def test_axes_are_mapped_once_and_back(sdk):
    # ours: x right, y up, z to the user; theirs: x to the user, y right, z up
    assert pytest.approx(np.eye(3)) == driver.ROTATION @ driver.ROTATION.T
    assert np.linalg.det(driver.ROTATION) == pytest.approx(1.0)
    sdk.move(0.01, 0.02, 0.03)
    with driver.ForceDimensionDevice() as device:
        assert device.read().position_m == pytest.approx([0.02, 0.03, driver.ORIGIN_M[2] + 0.01])
        device._write(np.array([1.0, 2.0, 3.0]))
        assert sdk["force"] == pytest.approx([3.0, 1.0, 2.0])


def test_opening_switches_gravity_off_and_motors_on_under_the_clamp(sdk):
    (found,) = driver.ForceDimensionDevice.detect()
    assert (found.name, found.note, sdk["open"]) == ("forcedimension", "", 0)
    with driver.ForceDimensionDevice():
        assert (sdk["gravity"], sdk["forces_on"], sdk["max_force"], sdk["open"]) == (0, 1, 2.0, 1)
    assert (sdk["stopped"], sdk["open"], sdk["force"]) == (1, 0, [0.0, 0.0, 0.0])


def test_homing_waits_for_the_drivers_flag_and_no_longer_than_told(sdk, monkeypatch):
    monkeypatch.setattr("tissueid.haptics.device.TICK_S", 0.0)
    with driver.ForceDimensionDevice(homing_timeout_s=0.05) as device:
        with pytest.raises(DeviceError, match="homing never completed"):
            device.home()
        sdk["homed"] = 1
        # a busy machine takes its time for fifty readings
        device._homing_timeout_s = 10.0
        device.home()
        assert device.state is State.ARMED


def test_answers_short_of_failure_are_taken_and_a_lost_device_is_an_error(sdk):
    with driver.ForceDimensionDevice() as device:
        for code in (1, 2, 0):
            sdk["code"] = code
            assert device.read().valid
        sdk["fails"] = 1
        with pytest.raises(DeviceError, match="dhdGetPosition failed: no device found"):
            device.read()


def test_buttons_are_those_of_the_wire_and_centre_is_the_dead_mans(sdk):
    bits = {name: bit for bit, name in BUTTON_NAMES.items()}
    # in the order of the SDK's bits
    order = [bits[name] for name in ("centre", "minus", "forward", "plus")]
    with driver.ForceDimensionDevice() as device:
        for mask in range(16):
            sdk["buttons"] = mask
            assert device.read().buttons == sum(bit for k, bit in enumerate(order) if mask >> k & 1)
        assert device.limits.dead_man_buttons == bits["centre"]
        assert device.limits.dead_man
