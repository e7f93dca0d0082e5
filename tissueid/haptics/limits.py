"""Limits of the guard: what a device may do to a hand, each with its reason (docs/devices.md).  SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

#: Indices into :meth:`GuardLimits.block`, in the order of the fields.
CLAMP_N, SLEW_N, RMS_LIMIT_N, RMS_WINDOW_S, RAMP_S, RECOVERY_S, FAULT_RAMP_S, DAMPING, DAMPING_S = range(9)
ENGAGE_BELOW_N, HOMED_NEEDED, OVERSPEED, JUMP_COUNTS, JUMP_S, NO_REPLY_S, BAD_PACKETS = range(9, 16)
FROZEN_S, FROZEN_CHANGE_N, HEARTBEAT_S, STALL_S, DEAD_MAN, DEAD_MAN_BUTTONS, DEAD_MAN_S = range(16, 23)
MOTOR_CLAMP, PAUSE_S, PAUSE_RAMP_S, DELAY_TICKS = range(23, 27)

#: A fault takes the force away within this time [s]; no limit may be slower.
LONGEST_FAULT_RAMP_S = 0.020
#: Ticks from a sample to the force it causes, where nothing was measured.
DEFAULT_DELAY_TICKS = 1.5
#: The start-up ramp is never shorter [s].
SHORTEST_RAMP_S = 0.5
#: With 0.5 N a tick at 1 kHz a larger force is not back at zero within 20 ms [N].
LARGEST_CLAMP_N = 10.0
#: Force [N] that an uncalibrated device may reach with the most favourable constant anybody reported ...
UNCALIBRATED_N = 5.0
#: ... which is this many motor units for one newton metre of arm torque.
WORST_UNITS_PER_NM = 3460.0


def uncalibrated_clamp_N(units_per_Nm: float) -> float:
    """Clamp [nominal N] of a device whose force was never weighed.

    Nominal newtons times ``units_per_Nm`` are motor units, whatever the true constant.  This clamp is the
    largest force whose motor units would be :data:`UNCALIBRATED_N` if the true constant were the worst one:
    2.6 N for the usual 6600.  Raises ValueError: the constant is not positive.
    """
    if not units_per_Nm > 0.0:
        raise ValueError(f"units_per_Nm must be positive, is {units_per_Nm}")
    return min(UNCALIBRATED_N, UNCALIBRATED_N * WORST_UNITS_PER_NM / units_per_Nm)


@dataclass(frozen=True, slots=True)
class GuardLimits:
    """Limits of one device in one session."""

    clamp_N: float = 2.0  # largest |F| [N]; direction is kept
    slew_N_per_tick: float = 0.5  # most that |F| may rise in a tick [N]
    #: Root mean square force the motors bear, over an exponential window.
    rms_limit_N: float = 1.5
    rms_window_s: float = 30.0
    ramp_s: float = 1.0  # time from engaging to the full force [s], at least 0.5
    recovery_s: float = 0.1  # time to the full force after a stall [s]
    fault_ramp_s: float = 0.020  # time to zero after a fault [s], at most 0.020
    #: Damping felt instead of the share of the force that is ramped away: a tenth of what a Falcon's driver
    #: allows, far below what a 5 ms velocity filter and 1.5 ticks of delay make unstable.
    damping_N_s_per_m: float = 2.0
    #: How long damping alone is kept before a fault that leaves the device answering [s].
    damping_s: float = 0.1
    engage_below_N: float = 0.2  # wanted force under which a device may engage inside tissue [N]
    homed_needed: int = 50  # consecutive homed replies before ARMED
    overspeed_m_per_s: float = 1.5  # fastest grip that a hand holds [m/s]
    #: More counts than this in ``jump_s`` are no hand.
    jump_counts: float = 200.0
    jump_s: float = 0.001
    #: Silence, and damaged replies in a row, that are a fault.
    no_reply_s: float = 0.1
    bad_packets: int = 10
    #: No count on any leg for this long although the force changed by more than this: twice Coulomb friction
    #: (0.1 N), and what moves a 1000 N/m hand by one count of 90 um, so that a resting arm would have shown
    #: it.
    frozen_s: float = 0.2
    frozen_change_N: float = 0.3
    heartbeat_s: float = 0.5  # silence of the owning program that is a fault
    stall_s: float = 0.005  # a longer tick is a stall; so a loop under 200 Hz is never felt
    dead_man: bool = True  # whether force needs a held button; ``dead_man_buttons`` is its bit mask
    dead_man_buttons: int = 0x04
    dead_man_s: float = 0.1  # time to zero after that button is released [s]
    motor_clamp: float = 4095.0  # largest motor command [motor units]
    #: Silence after which the force is taken away until the device answers again, and the time that takes
    #: [s]; together at most 0.020, so that a silent device is without force that soon.
    pause_s: float = 0.008
    pause_ramp_s: float = 0.010
    #: Delay that the scale of a session is worked out for [ticks]; answers later than that lower the force.
    delay_ticks: float = DEFAULT_DELAY_TICKS

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = float(getattr(self, entry.name))
            free = entry.name in {"dead_man", "dead_man_buttons", "damping_N_s_per_m"}
            if not (value >= 0.0 if free else value > 0.0) or math.isinf(value):
                msg = f"{entry.name} must be {'zero or more' if free else 'positive'} and finite, is {value}"
                raise ValueError(msg)
        # no limit is looser than the bar it must keep
        for name, value, largest in (
            ("fault_ramp_s", self.fault_ramp_s, LONGEST_FAULT_RAMP_S),
            ("pause_s + pause_ramp_s", self.pause_s + self.pause_ramp_s, LONGEST_FAULT_RAMP_S),
            ("clamp_N", self.clamp_N, LARGEST_CLAMP_N),
            ("motor_clamp", self.motor_clamp, 4095.0),
            ("slew_N_per_tick", self.slew_N_per_tick, 0.5),
            ("engage_below_N", self.engage_below_N, 0.2),
        ):
            if value > largest:
                raise ValueError(f"{name} must be at most {largest}, is {value}")
        if self.ramp_s < SHORTEST_RAMP_S:
            raise ValueError(f"ramp_s must be at least {SHORTEST_RAMP_S} s, is {self.ramp_s}")

    @classmethod
    def simulated(cls) -> GuardLimits:
        """Limits of a device without motors: 5 N, no dead-man button, no sustained limit."""
        return cls(clamp_N=5.0, rms_limit_N=5.0, dead_man=False)

    def block(self) -> NDArray[np.float64]:
        """The limits for the kernels, float64, shape (27,)."""
        return np.array([float(getattr(self, entry.name)) for entry in fields(self)])
