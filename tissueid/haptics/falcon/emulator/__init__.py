"""An emulated Falcon: what comes out of its wire for what goes in, with an arm, a hand and faults.

It shares no code with the driver, so that the two check each other: packets by tables, kinematics by
bisection, forces by differences.  No real Falcon has confirmed either.
"""

from tissueid.haptics.falcon.emulator.links import EmulatedLink, EmulatorProcess
from tissueid.haptics.falcon.emulator.machine import EmulatedFalcon, EmulatorSettings, ScriptedFault

__all__ = ["EmulatedFalcon", "EmulatedLink", "EmulatorProcess", "EmulatorSettings", "ScriptedFault"]
