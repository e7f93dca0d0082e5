"""Homing: read and send zero force until a device knows where it is, and no longer than a time-out."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from tissueid.errors import DeviceError
from tissueid.haptics.device import HapticDevice
from tissueid.haptics.states import FAULT_WORDS, State

#: How long homing may take before it is given up [s].
HOMING_TIMEOUT_S = 60.0
#: Pause between two readings [s].
TICK_S = 0.001
#: The most of a time-out that one reading takes [s]: a host that stood still has not waited.
MOST_A_READING_S = 0.1


def wait_with_zero_force(
    device: HapticDevice, reached: Callable[[], bool], timeout_s: float, why_not: Callable[[], str]
) -> None:
    """Read and send zero force until something is reached.

    ``device``: open; ``reached``: asked before each reading; ``timeout_s``: of waiting: a reading that took
    longer than ``MOST_A_READING_S`` counts as that long; ``why_not``: the message of the error after the
    time-out.  Raises DeviceError: after the time-out, on a fault, or when the device is lost; and what
    ``device.while_waiting`` raises.
    """
    waited_s, before = 0.0, time.monotonic()
    zero = np.zeros(3)
    while not reached():
        now = time.monotonic()
        waited_s, before = waited_s + min(now - before, MOST_A_READING_S), now
        if waited_s > timeout_s:
            raise DeviceError(why_not())
        device.while_waiting()
        device.read()
        if device.state is State.FAULT:
            msg = f"homing ended: {FAULT_WORDS[device.fault]}"
            raise DeviceError(msg)
        device.write_force(zero, TICK_S)
        time.sleep(TICK_S)


def await_homed(
    device: HapticDevice, timeout_s: float, why_not: Callable[[], str] = lambda: "homing never completed"
) -> None:
    """Wait until the guard has seen enough homed replies (ARMED); as :func:`wait_with_zero_force`."""
    wait_with_zero_force(device, lambda: device.state is State.ARMED, timeout_s, why_not)
