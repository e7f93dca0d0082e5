"""An owner for a test to kill: starts a servo on the terminal named, engages it, gives signs of life."""

import sys
import time
from dataclasses import replace

from emulated_session import LIMITS as QUICK
from felt_block import parameters

from tissueid.haptics.falcon.calibration import Calibration
from tissueid.rendering.servo import ServoPlan, ServoProcess

#: A loaded machine starves an emulator for longer than a device would be silent.
LIMITS = replace(QUICK, no_reply_s=1.0)


def plan(port: str) -> ServoPlan:
    """The driver of a Falcon on a terminal."""
    return ServoPlan("falcon", {"limits": LIMITS, "port": port, "calibration": Calibration()})


def main(port: str) -> None:
    """Hold a session until somebody ends this process."""
    with ServoProcess(plan(port)) as servo:
        servo.block.write(parameters())
        servo.engage()
        while servo.poll() is None:
            servo.beat()
            time.sleep(0.02)


if __name__ == "__main__":
    main(sys.argv[1])
