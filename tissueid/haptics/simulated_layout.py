"""Places of the numbers of a simulated device in its block of parameters, without a compiler.

The block begins with the arm's (:mod:`tissueid.haptics.arm`) and goes on with the encoders and the wire
(:mod:`tissueid.haptics.sim_kernels`).  A process that only leads the hand needs these places and no kernel:
it starts without loading numba.  SI units.
"""

from __future__ import annotations

# --- the arm's
MASS, DAMPING, FRICTION, SUBSTEP = 0, 1, 2, 3
HAND_STIFFNESS, HAND_DAMPING, RIGID = 4, 5, 6
TREMOR, TREMOR_HZ, TREMOR_PHASE, TREMOR_AXIS = 7, 8, 9, 10  # axis: 10, 11, 12
POINTER_ON, POINTER = 13, 14  # pointer: 14, 15, 16
KNOTS = 17
LED_AT = 18  # monotonic time [s] at which whoever leads the hand was last there; no kernel reads it
FIRST_KNOT = 20
#: Columns of a knot of the hand's script: time, x, y, z, grip from here on.
KNOT_COLUMNS = 5
MAX_KNOTS = 64
ARM_PARAMETERS = FIRST_KNOT + KNOT_COLUMNS * MAX_KNOTS

# --- behind them
QUANTUM, PHASE = ARM_PARAMETERS, ARM_PARAMETERS + 1  # phase: 3 values, in counts
DELAY, BUTTONS = ARM_PARAMETERS + 4, ARM_PARAMETERS + 5
#: A scripted fault: its kind and the time [s] it begins at.
FAULT_KIND, FAULT_AT, FAULT_SIZE = ARM_PARAMETERS + 6, ARM_PARAMETERS + 7, ARM_PARAMETERS + 8
SIM_PARAMETERS = ARM_PARAMETERS + 12
