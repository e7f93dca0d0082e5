"""Rate, delay and errors of the link to a device, with zero force."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import numpy as np

from tissueid.errors import DeviceError
from tissueid.haptics.device import HapticDevice

#: Tick of the servo [s].
TICK_S = 0.001
#: After this time an answer is lost, not late [s].
PATIENCE_S = 0.05
#: Share of the answers that make the delay: the slowest are stalls of this machine, which the guard sees to.
USUAL_SHARE = 0.95
#: What passes inside the device, between wire, encoders and motors, is not seen here: allowed for [ticks].
UNSEEN_TICKS = 0.5


@dataclass(frozen=True)
class LinkReport:
    """Result of :func:`measure_link`."""

    duration_s: float
    #: Sent, and answered.
    commands: int
    replies: int
    damaged: int  # replies that began and were none
    rate_hz: float  # replies a second when each command waits for its answer
    round_trip_ms: tuple[float, float, float]  # median, 95 % and largest time from a command to its answer
    #: From a position to the force it causes, in a loop of 1 kHz that reads at each tick what was answered to
    #: the last: whole ticks until the answer, plus :data:`UNSEEN_TICKS`; the slowest 5 % are left out.
    delay_ticks: float


def measure_link(device: HapticDevice, duration_s: float = 5.0) -> LinkReport:
    """Send zero force and wait for the answer, over and over.

    ``device``: open; it need not be homed.  Raises DeviceError: if the device is lost, or answers nothing at
    all.
    """
    zero = np.zeros(3)
    trips: list[float] = []
    commands = damaged = 0
    # the answer to what opening sent must not count as a fast one
    device.sample()
    begin = time.monotonic()
    while (sent := time.monotonic()) - begin < duration_s:
        device.write_force(zero, TICK_S)
        commands += 1
        sample = device.sample()
        # a late answer must not count as a quick one to the next command
        while not (sample.valid or sample.damaged) and time.monotonic() - sent < PATIENCE_S:
            sample = device.sample()
        damaged += sample.damaged
        if sample.valid:
            trips.append(time.monotonic() - sent)
    elapsed = time.monotonic() - begin
    if not trips:
        msg = f"the device answered none of {commands} commands; is its power supply plugged in?"
        raise DeviceError(msg)
    median, high, largest = np.quantile(trips, [0.5, 0.95, 1.0])
    usual = sorted(trips)[: math.ceil(USUAL_SHARE * len(trips))]
    ticks = np.mean([max(1, math.ceil(trip / TICK_S)) for trip in usual])
    return LinkReport(
        duration_s=elapsed,
        commands=commands,
        replies=len(trips),
        damaged=damaged,
        rate_hz=len(trips) / elapsed,
        round_trip_ms=(1e3 * float(median), 1e3 * float(high), 1e3 * float(largest)),
        delay_ticks=float(ticks) + UNSEEN_TICKS,
    )
