"""An emulated Falcon: what comes out of its wire for what goes in, with an arm, a hand and scripted faults.

Written from the description of the protocol alone.  It shares no code with the driver, so that the two check
each other: its packets are read and written by tables, its inverse kinematics are found by bisection, and
its motors push through differences of that.  What both took from the description, both have wrong where the
description is wrong: no real Falcon has confirmed either.
"""

from tissueid.haptics.falcon.emulator.links import EmulatedLink, EmulatorProcess
from tissueid.haptics.falcon.emulator.machine import EmulatedFalcon, EmulatorSettings, ScriptedFault

__all__ = ["EmulatedFalcon", "EmulatedLink", "EmulatorProcess", "EmulatorSettings", "ScriptedFault"]
