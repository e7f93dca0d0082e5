"""A device in Python (``write_force``) and the compiled servo meet the same faults with the same forces."""

from __future__ import annotations

import numpy as np
import pytest
from test_render_servo_tick import PERIOD, Rig, tissue

from tissueid.haptics import guard as machine
from tissueid.haptics import sim
from tissueid.haptics.guard import transition
from tissueid.haptics.states import Fault, State
from tissueid.rendering.environment import LAW
from tissueid.rendering.servo_io import PythonIO
from tissueid.rendering.servo_tick import tick

pytestmark = pytest.mark.needs_jit

#: In contact, in the middle of the press.
FAULT_AT_S = 2.0
TICKS = 2400


def session(*, compiled: bool, fault: str) -> np.ndarray:
    """Records of a session that meets a fault."""
    with Rig(seed=11) as rig:
        rig.block.write(tissue())
        io = rig.io if compiled else PythonIO(rig.device)
        kinds = {"gone": 1, "silent": 2, "frozen": 3, "jump": 4, "unhomed": 5}
        if fault in kinds:
            rig.device.parameters[[sim.FAULT_KIND, sim.FAULT_AT]] = kinds[fault], FAULT_AT_S
            rig.device.parameters[sim.FAULT_SIZE] = 300.0
        for k in range(TICKS):
            if k == round(FAULT_AT_S / PERIOD) and fault == "not a number":
                rig.servo.environment[LAW : LAW + 8] = np.nan
            if k == round(FAULT_AT_S / PERIOD) and fault == "heartbeat":
                transition(rig.servo.guard_memory, rig.servo.limits, machine.HEARTBEAT_LOST)
            if k == round(FAULT_AT_S / PERIOD) and fault == "owner":
                transition(rig.servo.guard_memory, rig.servo.limits, machine.PARENT_DIED)
            # a device in Python moves on its period when it is commanded, a compiled one when it is read
            dt = PERIOD if k or not compiled else 0.0
            tick(io, rig.servo, PERIOD * k, dt, 0.0, 0)
        return rig.records.read_new()[0]


@pytest.mark.parametrize(
    ("fault", "code", "state"),
    [
        ("none", Fault.NONE, State.ENGAGED),
        ("gone", Fault.TRANSPORT, State.FAULT),
        ("silent", Fault.NO_REPLY, State.FAULT),
        ("jump", Fault.ENCODER_JUMP, State.FAULT),
        ("unhomed", Fault.NOT_HOMED, State.FAULT),
        ("not a number", Fault.NOT_A_NUMBER, State.FAULT),
        ("heartbeat", Fault.HEARTBEAT, State.FAULT),
        ("owner", Fault.PARENT_DIED, State.FAULT),
    ],
)
def test_both_ways_to_a_device_send_the_same_forces(fault, code, state):
    compiled = session(compiled=True, fault=fault)
    python = session(compiled=False, fault=fault)
    reached = np.flatnonzero(compiled["fault"] != 0)
    size = np.linalg.norm(compiled["force_N"], axis=1)
    assert compiled["fault"][-1] == python["fault"][-1] == code
    assert compiled["state"][-1] == python["state"][-1] == state
    assert np.array_equal(compiled["state"], python["state"])
    # a device that is gone can't be commanded: what Python could not send counts as zero
    compared = ("position_m",) if fault == "gone" else ("position_m", "force_N", "lamps")
    for name in compared:
        # the first tick, which took no time in one of them, is marked as a stall
        assert np.array_equal(compiled[name][1:], python[name][1:])
    # force was on before, and is zero 20 ms after the fault was seen
    assert size[: reached[0] if reached.size else TICKS].max() > 0.1
    assert reached.size == 0 or np.all(size[reached[0] + 19 :] == 0.0)
