"""The base of every device: what is final, and zero force on every way out."""

import re
from collections.abc import Iterator

import numpy as np
import pytest
from command_line import PACKAGES, REPOSITORY, python
from fake_device import FakeDevice

from tissueid.errors import DeviceError
from tissueid.haptics import device as devices
from tissueid.haptics.device import ZERO_COMMANDS
from tissueid.haptics.states import Fault, State

SOURCES = REPOSITORY / "tissueid"


@pytest.fixture
def engaged() -> Iterator[FakeDevice]:
    """A device with 2 N on."""
    with FakeDevice() as device:
        device.engage()
        for _ in range(1100):
            device.counts = 1 - device.counts
            device.read()
            device.write_force((0.0, 0.0, 0.1), 1e-3)
        for _ in range(10):
            device.write_force((0.0, 0.0, 2.0), 1e-3)
        yield device


def test_what_is_final_can_not_be_overridden():
    for method in ("open", "close", "sample", "read", "write_force", "engage", "disengage"):
        with pytest.raises(TypeError, match=f"{method}: final"):
            type("Sneaky", (FakeDevice,), {method: lambda self: None})


def test_a_device_walks_to_armed_and_to_force_and_returns_what_was_sent(engaged):
    device = FakeDevice()
    assert device.state is State.CLOSED
    with device:
        assert device.state is State.HOMING
        for _ in range(50):
            device.read()
        assert device.state is State.ARMED
    assert engaged.state is State.ENGAGED
    assert engaged.sent[-1].tolist() == [0.0, 0.0, 2.0]
    returned = engaged.write_force((0.0, 30.0, 40.0), 1e-3)
    assert returned.tolist() == engaged.sent[-1].tolist()
    assert np.linalg.norm(returned) == pytest.approx(2.0 * 0.8 + 0.5, rel=1e-12)


def test_closing_sends_zero_force_twenty_times_then_lets_go(engaged):
    before = len(engaged.sent)
    engaged.close()
    assert np.array(engaged.sent[before:]).tolist() == np.zeros((ZERO_COMMANDS, 3)).tolist()
    assert engaged.closed == 1
    assert engaged.state is State.CLOSED
    engaged.close()
    assert engaged.closed == 1


def test_an_exception_in_the_users_code_ends_in_zero_force():
    device = FakeDevice()
    with pytest.raises(ZeroDivisionError), device:
        device.write_force((0.0, 0.0, 0.0), 1 / 0)
    assert len(device.sent) == ZERO_COMMANDS
    assert device.closed == 1


@pytest.mark.parametrize("error", [OSError("gone"), DeviceError("gone")])
@pytest.mark.parametrize("act", [FakeDevice.read, lambda one: one.write_force((0.0, 0.0, 1.0), 1e-3)])
def test_a_device_that_is_gone_while_read_or_written_is_a_fault_with_its_reason(engaged, error, act):
    engaged.broken = error
    with pytest.raises(DeviceError, match=r"fake: the device is gone.*gone"):
        act(engaged)
    assert engaged.fault is Fault.TRANSPORT
    engaged.close()
    assert engaged.closed == 1


def test_a_device_that_can_not_be_opened_stays_closed():
    device = FakeDevice()
    device.refuses = DeviceError("no permission")
    with pytest.raises(DeviceError, match="no permission"):
        device.open()
    assert device.state is State.CLOSED
    assert device.sent == []


def test_a_closed_device_and_a_misshapen_force_are_refused():
    device = FakeDevice()
    with pytest.raises(DeviceError, match=r"open\(\) first"):
        device.write_force((0.0, 0.0, 0.0), 1e-3)
    with pytest.raises(DeviceError, match=r"open\(\) first"):
        device.read()
    with device:
        with pytest.raises(DeviceError, match="open already"):
            device.open()
        with pytest.raises(ValueError, match="shape"):
            device.write_force((0.0, 0.0), 1e-3)


@pytest.mark.parametrize(
    ("answer", "fault"),
    [
        ({"valid": False}, Fault.NO_REPLY),
        ({"valid": False, "damaged": 1}, Fault.BAD_PACKETS),
        ({"homed": False}, Fault.NOT_HOMED),
    ],
)
def test_silence_and_damage_reach_the_watchdogs(engaged, answer, fault):
    engaged.answer.update(answer)
    for _ in range(101):
        engaged.read()
    assert engaged.fault is fault


@pytest.mark.parametrize(("readings", "fault"), [(9, Fault.NONE), (10, Fault.BAD_PACKETS)])
def test_a_place_that_is_no_number_is_a_damaged_reading(engaged, readings, fault):
    engaged.position[1] = np.nan
    for _ in range(readings):
        assert not engaged.read().valid
    engaged.position[1] = 0.0
    engaged.read()
    assert engaged.fault is fault


def test_ending_the_interpreter_sends_zero_force():
    program = (
        "from fake_device import FakeDevice\n"
        "FakeDevice._write = lambda self, force_N: print(force_N.tolist())\n"
        "device = FakeDevice()\ndevice.open()\nraise SystemExit(3)\n"
    )
    ended = python("-c", program, check=False, PYTHONPATH=f"{PACKAGES}:{REPOSITORY / 'tests'}")
    assert ended.returncode == 3
    assert ended.stdout.splitlines() == ["[0.0, 0.0, 0.0]"] * ZERO_COMMANDS


#: Who may call what reaches a transport: a call -> the modules it stands in and how often.
TRANSPORT_CALLS = {
    # the base class: after the guard, and with zeros on the way out (the recorder's is its file)
    r"\._write\(": {"haptics/device.py": 2, "rendering/recorder.py": 2},
    # the servo: after the guard, then by the type of the device
    r"(?<!def )(?<![a-z_])command\(io": {"rendering/servo_tick.py": 2},
    # what `_write` of a device and the servo's command make of a force
    r"(?<!def )simulated_command\(": {"haptics/sim.py": 2},
    r"_set_force\(io|\"dhdSetForce\"[,)]": {
        "haptics/forcedimension/device.py": 2,
        "haptics/forcedimension/servo_io.py": 1,
    },
    r"(?<!def )motor_units\(": {"haptics/falcon/device.py": 1, "haptics/falcon/servo_io.py": 1},
    # the firmware's is the test whether it runs, with zeros
    r"(?<!def )encode_(command|into)\(": {
        "haptics/falcon/device.py": 1,
        "haptics/falcon/firmware.py": 1,
        "haptics/falcon/packets.py": 1,
        "haptics/falcon/servo_io.py": 1,
    },
}


def test_nothing_but_the_guard_leads_to_a_transport():
    texts = {one.relative_to(SOURCES).as_posix(): one.read_text("utf-8") for one in SOURCES.rglob("*.py")}
    for call, places in TRANSPORT_CALLS.items():
        counts = {name: len(re.findall(call, text)) for name, text in texts.items()}
        assert {name: count for name, count in counts.items() if count} == places, call


def test_a_host_that_stood_still_has_not_waited_for_the_device(monkeypatch):
    clock = {"now": 0.0, "stall": 30.0}
    device = FakeDevice()
    device.open()
    read = device.read

    def stalled():
        clock["now"] += clock.pop("stall", 0.001)
        return read()

    monkeypatch.setattr(devices.time, "monotonic", lambda: clock["now"])
    monkeypatch.setattr(device, "read", stalled)
    device._wait_until(lambda: device.state is State.ARMED, 2.0, lambda: "not homed")
    assert device.state is State.ARMED
    with pytest.raises(DeviceError, match="not in time"):
        device._wait_until(lambda: False, 2.0, lambda: "not in time")
    assert 31.5 < clock["now"] < 33.0
    device.close()
