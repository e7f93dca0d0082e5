"""Faults around the servo process, with an emulated Falcon on a terminal: dead and silent owners, unplugging.

Real time on a shared machine: bounds are wide, and the watchdog for silence is set to a second.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from emulated_session import pressing
from felt_block import parameters
from owner_to_kill import plan

from tissueid.haptics.falcon.emulator import EmulatedFalcon, EmulatedLink, EmulatorSettings
from tissueid.haptics.states import Fault, State
from tissueid.rendering.servo import ServoProcess

pytestmark = pytest.mark.needs_jit

OWNER = Path(__file__).with_name("owner_to_kill.py")
#: Longest wait for a session to come into contact [s]: compiling on a slow machine takes most of it.
START_S = 60.0


def wait_for(what: Callable[[], bool], timeout_s: float) -> float:
    """Time it took [s]; infinite where it did not come."""
    begin = time.monotonic()
    while not what():
        if time.monotonic() - begin > timeout_s:
            return float("inf")
        time.sleep(0.002)
    return time.monotonic() - begin


def pushes(falcon: EmulatedFalcon) -> bool:
    return max(abs(units) for units in falcon.last_motors) > 60


@pytest.mark.slow
def test_an_owner_that_is_killed_leaves_zero_packets_behind():
    with EmulatedLink(EmulatorSettings(hand=pressing(), waits_for_blue=True), pty=True) as link:
        owner = subprocess.Popen([sys.executable, str(OWNER), str(link.path)])
        in_contact = wait_for(lambda: pushes(link.falcon), START_S)
        owner.send_signal(signal.SIGKILL)
        owner.wait()
        relaxed = wait_for(lambda: link.falcon.last_motors == (0, 0, 0), 5.0)
        commands = link.falcon.commands
        silent = wait_for(lambda: not commands_grow(link.falcon), 10.0)
        assert in_contact < START_S
        # noticed within 5 ms, ramped within 20 ms; the rest is the machine's
        assert relaxed < 1.0
        assert silent < 10.0
        assert link.falcon.commands - commands >= 15
        assert link.falcon.last_motors == (0, 0, 0)


def commands_grow(falcon: EmulatedFalcon) -> bool:
    before = falcon.commands
    time.sleep(0.2)
    return falcon.commands > before


@pytest.mark.slow
def test_an_owner_that_falls_silent_loses_the_force_after_half_a_second():
    with (
        EmulatedLink(EmulatorSettings(hand=pressing(), waits_for_blue=True), pty=True) as link,
        ServoProcess(plan(str(link.path))) as servo,
    ):
        servo.block.write(parameters())
        servo.engage()
        begin = time.monotonic()
        while not pushes(link.falcon) and time.monotonic() - begin < START_S:
            servo.beat()
            time.sleep(0.01)
        assert pushes(link.falcon)
        silent = time.monotonic()
        relaxed = wait_for(lambda: link.falcon.last_motors == (0, 0, 0), 5.0)
        ended = wait_for(lambda: servo.poll() is not None, 5.0)
        assert 0.4 < relaxed < 2.0
        assert ended < 5.0
        assert time.monotonic() - silent < 7.0
        assert (servo.end.reason, servo.end.fault, servo.end.state) == ("fault", Fault.HEARTBEAT, State.FAULT)
        assert "stopped giving signs of life" in servo.end.message
