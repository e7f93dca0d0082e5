"""A device that is homed in the servo's process tells its user what to do."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import HOMING_STEPS, limits_of
from tissueid.haptics.falcon.emulator import EmulatedLink, EmulatorSettings
from tissueid.render.servo import ServoProcess
from tissueid.render.servo_plan import ServoPlan


@pytest.mark.slow
def test_instructions_of_homing_come_out_of_the_servo_process() -> None:
    told: list[str] = []
    with EmulatedLink(EmulatorSettings(), pty=True) as link:
        # a busy machine starves an emulator for longer than a device may be silent
        limits = replace(limits_of(Calibration()), no_reply_s=10.0)
        plan = ServoPlan("falcon", {"port": link.path, "calibration": Calibration(), "limits": limits})
        with ServoProcess(plan, tell=told.append) as servo:
            servo.beat()
            assert servo.ready is not None
            assert servo.ready.compiled
    assert told == list(HOMING_STEPS)
