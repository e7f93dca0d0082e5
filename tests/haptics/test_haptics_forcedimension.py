"""The Force Dimension backend against a stand-in for its SDK, compiled here."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from c_library import compiled

from tissueid.errors import DeviceError
from tissueid.haptics.falcon.packets import BUTTON_NAMES
from tissueid.haptics.forcedimension.device import (
    LIBRARY_VARIABLE,
    ORIGIN_M,
    ROTATION,
    ForceDimensionDevice,
    Sdk,
    candidates,
)
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.states import State


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return compiled("dhd_stub", tmp_path_factory.mktemp("dhd"))


class Stub:
    """The numbers inside the stand-in."""

    def __init__(self, library: Path) -> None:
        self.library = ctypes.CDLL(str(library))

    def array(self, name: str) -> ctypes.Array[ctypes.c_double]:
        return (ctypes.c_double * 3).in_dll(self.library, f"stub_{name}")

    def number(self, name: str) -> ctypes.c_int:
        return ctypes.c_int.in_dll(self.library, f"stub_{name}")


@pytest.fixture
def stub(library: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stub]:
    monkeypatch.setenv(LIBRARY_VARIABLE, str(library))
    found = Stub(library)
    yield found
    for name in ("homed", "fails", "stopped", "code"):
        found.number(name).value = 0
    found.number("major").value = 3


def test_sdk_is_looked_for_where_its_documentation_puts_it(monkeypatch, tmp_path):
    monkeypatch.delenv(LIBRARY_VARIABLE, raising=False)
    monkeypatch.setattr("tissueid.haptics.forcedimension.device.platform.machine", lambda: "x86_64")
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("FDSDK", "/opt/fd")
    monkeypatch.setenv("FORCEDIM_SDK", "/opt/other")
    places = list(candidates())
    assert places[0] == "/opt/fd/lib/release/lin-x86_64-gcc/libdrd.so"
    assert "/opt/other/lib/release/lin-x86_64-gcc/libdrd.so" in places
    assert places.index(f"{tmp_path}/.local/lib/libdrd.so") < places.index("/usr/local/lib/libdrd.so")
    monkeypatch.setenv(LIBRARY_VARIABLE, "/mine/libdrd.so")
    assert list(candidates()) == ["/mine/libdrd.so"]


def test_without_sdk_nothing_is_detected_and_opening_says_where_it_belongs(monkeypatch, tmp_path):
    monkeypatch.setenv(LIBRARY_VARIABLE, str(tmp_path / "none.so"))
    assert ForceDimensionDevice.detect() == []
    with pytest.raises(DeviceError, match=r"not installed.* FDSDK .*TISSUEID_FORCEDIM"):
        ForceDimensionDevice().open()


def test_a_library_that_is_something_else_is_refused(monkeypatch):
    monkeypatch.setenv(LIBRARY_VARIABLE, "libc.so.6")
    with pytest.raises(DeviceError, match="has no dhdGetSDKVersion"):
        Sdk()


def test_an_old_sdk_is_refused_with_its_version(stub):
    stub.number("major").value = 2
    with pytest.raises(DeviceError, match=r"is 2\.17\.5\.1; 3\.16 or newer"):
        Sdk()


def test_no_device_is_told_in_the_sdks_words(stub):
    stub.number("fails").value = 1
    assert ForceDimensionDevice.detect() == []
    with pytest.raises(DeviceError, match="no device found"):
        ForceDimensionDevice().open()


def test_axes_are_mapped_once_and_back(stub):
    # ours: x right, y up, z to the user; theirs: x to the user, y right, z up
    assert pytest.approx(np.eye(3)) == ROTATION @ ROTATION.T
    assert np.linalg.det(ROTATION) == pytest.approx(1.0)
    stub.array("position")[:] = [0.01, 0.02, 0.03]
    with ForceDimensionDevice() as device:
        assert device.read().position_m == pytest.approx([0.02, 0.03, ORIGIN_M[2] + 0.01])
        device._write(np.array([1.0, 2.0, 3.0]))
        assert list(stub.array("force")) == pytest.approx([3.0, 1.0, 2.0])


def test_opening_switches_gravity_off_and_motors_on_under_the_clamp(stub):
    (found,) = ForceDimensionDevice.detect()
    assert (found.name, found.note, stub.number("open").value) == ("forcedimension", "", 0)
    with ForceDimensionDevice():
        assert (stub.number("gravity").value, stub.number("forces_on").value) == (0, 1)
        assert ctypes.c_double.in_dll(stub.library, "stub_max_force").value == 2.0
        assert stub.number("open").value == 1
    assert (stub.number("stopped").value, stub.number("open").value) == (1, 0)
    assert list(stub.array("force")) == [0.0, 0.0, 0.0]


def test_homing_waits_for_the_drivers_flag_and_no_longer_than_told(stub, monkeypatch):
    monkeypatch.setattr("tissueid.haptics.device.TICK_S", 0.0)
    with ForceDimensionDevice(homing_timeout_s=0.05) as device:
        with pytest.raises(DeviceError, match="homing never completed"):
            device.home()
        stub.number("homed").value = 1
        # a busy machine takes its time for fifty readings
        device._homing_timeout_s = 10.0
        device.home()
        assert device.state is State.ARMED


def test_answers_short_of_failure_are_taken_and_a_lost_device_is_an_error(stub):
    with ForceDimensionDevice() as device:
        for code in (1, 2):
            stub.number("code").value = code
            assert device.read().valid
        stub.number("code").value = 0
        stub.number("fails").value = 1
        with pytest.raises(DeviceError, match="dhdGetPosition failed: no device found"):
            device.read()


def test_buttons_are_those_of_the_wire_and_centre_is_the_dead_mans(stub):
    # the SDK's number of a button: centre 0, left 1, up 2, right 3
    names = {0: "centre", 1: "minus", 2: "forward", 3: "plus"}
    bits = {name: bit for bit, name in BUTTON_NAMES.items()}
    for limits in (None, GuardLimits()):
        with ForceDimensionDevice(limits) as device:
            read = {}
            for index in names:
                stub.number("buttons").value = 1 << index
                read[index] = device.read().buttons
            assert read == {index: bits[name] for index, name in names.items()}
            stub.number("buttons").value = 0b1001
            assert device.read().buttons == bits["centre"] | bits["plus"]
            assert device.limits.dead_man_buttons == bits["centre"]
            assert device.limits.dead_man
            stub.number("buttons").value = 0


def test_compiled_servo_is_given_three_addresses_and_the_mapping(stub):
    device = ForceDimensionDevice()
    assert device.compiled() is None
    with device:
        given = device.compiled()
        assert given.kind == "tissueid.haptics.forcedimension.servo_io:SDK"
        assert given.handles[3] == 5
        assert given.constants.tolist() == [*ROTATION.ravel().tolist(), *ORIGIN_M.tolist()]
        prototype = ctypes.CFUNCTYPE(
            ctypes.c_int, ctypes.c_double, ctypes.c_double, ctypes.c_double, ctypes.c_int8
        )
        assert prototype(int(given.handles[1]))(0.1, 0.2, 0.3, 5) == 0
        assert list(stub.array("force")) == [0.1, 0.2, 0.3]
