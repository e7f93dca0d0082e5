"""A device that is homed in the servo's process tells its user what to do, and does not outlive its owner."""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from command_line import until
from emulated_session import pressing

from tissueid.errors import DeviceError
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import HOMING_STEPS, limits_of
from tissueid.haptics.falcon.emulator import EmulatedLink, EmulatorSettings
from tissueid.haptics.sim import SimulatedDevice
from tissueid.rendering import first_start, servo_process
from tissueid.rendering.servo import ServoPlan, ServoProcess

#: A busy machine starves an emulator for longer than a device may be silent.
LIMITS = replace(limits_of(Calibration()), no_reply_s=10.0)


def test_an_owner_that_dies_during_homing_ends_it_with_zero_force(pipes):
    with EmulatedLink(EmulatorSettings(homes=False), pty=True) as link:
        options = {"port": link.path, "calibration": Calibration(), "limits": LIMITS}
        threading.Timer(0.5, os.close, [pipes.ours]).start()
        begun = time.monotonic()
        with pytest.raises(DeviceError, match="the program that owns the session ended"):
            pipes.run(ServoPlan("falcon", options))
        took = time.monotonic() - begun
        time.sleep(0.1)
        last = link.falcon.last_motors
    assert "pull the grip" in pipes.told()
    # homing itself would be given up after a minute; the timer runs on a clock of its own
    assert 0.4 <= took < 50.0
    assert last == (0, 0, 0)


@pytest.mark.slow
def test_instructions_of_homing_come_out_of_the_servo_process():
    told: list[str] = []
    with EmulatedLink(EmulatorSettings(), pty=True) as link:
        plan = ServoPlan("falcon", {"port": link.path, "calibration": Calibration(), "limits": LIMITS})
        with ServoProcess(plan, tell=told.append) as servo:
            servo.beat()
            assert servo.ready.compiled
    assert told == list(HOMING_STEPS)


def test_what_takes_time_is_done_before_homing_and_a_cold_start_says_how_long(
    monkeypatch, same_priority, pipes
):
    happened: list[str] = []
    home, loop = SimulatedDevice.home, servo_process.compiled_loop

    def noted_home(device):
        happened.append("home")
        home(device)

    def noted_loop(*arguments):
        happened.append(f"loop of {arguments[-1]}")
        return loop(*arguments)

    monkeypatch.setattr(SimulatedDevice, "home", noted_home)
    monkeypatch.setattr(servo_process, "compiled_loop", noted_loop)
    monkeypatch.setattr(servo_process, "is_compiled", lambda _: False)
    monkeypatch.setattr(servo_process, "settled", lambda **_: happened.append("memory"))
    pipes.run(ServoPlan("sim", {}, ticks=3))
    # the loop of one device is no other's
    assert first_start.is_compiled("SimulatedIO")
    assert not first_start.is_compiled("AnotherIO")
    assert happened == ["loop of 0", "memory", "home", "loop of 3"]
    assert "10 to 20 s" in pipes.told()


@pytest.mark.slow
@pytest.mark.needs_jit
def test_an_owner_that_is_killed_leaves_zero_packets_behind():
    with EmulatedLink(EmulatorSettings(hand=pressing(), waits_for_blue=True), pty=True) as link:
        falcon = link.falcon
        owner = subprocess.Popen([sys.executable, Path(__file__).with_name("owner_to_kill.py"), link.path])
        # compiling on a slow machine takes most of the wait
        until(lambda: max(map(abs, falcon.last_motors)) > 60)
        owner.send_signal(signal.SIGKILL)
        owner.wait()
        # noticed within 5 ms, ramped within 20 ms; the rest is the machine's
        until(lambda: falcon.last_motors == (0, 0, 0), 1.0)
        commands = falcon.commands
        time.sleep(1.0)
        ended = falcon.commands
        assert ended - commands >= 15
        time.sleep(0.2)
        assert (falcon.commands, falcon.last_motors) == (ended, (0, 0, 0))
