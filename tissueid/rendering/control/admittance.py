"""Admittance rendering on a device: the controller of variant B behind the device's own guard."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError
from tissueid.haptics.guard import velocity_step
from tissueid.haptics.hand import Hand
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.registry import choose_device, device_class
from tissueid.haptics.sim import CENTRE_M, SimulatedDevice, carried
from tissueid.haptics.states import FAULT_WORDS, State
from tissueid.rendering.control.settings import ControlSettings, Gains, Mechanics, VirtualTool
from tissueid.rendering.control.simulation import adapt, command, loop_block, new_controller, tissue_law
from tissueid.rendering.options import ASSUMED_DEVICE
from tissueid.rendering.precheck import check_before_force
from tissueid.rendering.tissue_block import Tissue

#: Into the tissue: away from the user.
INWARD = np.array([0.0, 0.0, -1.0])
PERIOD_S = 1e-3
#: Virtual mass [kg] and gains that a 0.25 kg arm behind 1.5 ticks bears; assumed.
VIRTUAL_MASS_KG = 1.0
DEVICE_GAINS = Gains(
    reference_rate_per_s=30.0, damping_N_s_per_m=15.0, disturbance_bound_N=0.3, adaptation=(0.01, 1.0, 10.0)
)
#: Way of the simulated hand's target [s and m from the surface]: in the air, pressed with 4 N at most, back.
WAY = ((0.0, -0.010), (1.0, -0.010), (2.5, 0.012), (4.0, 0.012), (5.5, -0.010))
SECONDS = 6.0
#: Before this the guard still fades its force in [s].
SETTLED_S = 1.0


def require_force_sensor(name: str) -> str:
    """The device that a name stands for; DeviceError where it has no force sensor, UsageError without it."""
    found = choose_device(name).name
    if not hasattr(device_class(found), "sensed_force_N"):
        raise DeviceError(
            f"{found} has no force sensor: the adaptive controller moves the device by the measured force of "
            "the hand. Feel the tissue with `tissueid render`, which needs none, or take --device sim"
        )
    return found


@dataclass(frozen=True, slots=True, eq=False)
class DeviceRun:
    """A session on a device, a row a tick."""

    settings: ControlSettings
    time_s: FloatArray  # (rows,)
    #: (rows,): true position of the grip, and of the virtual tool, into the tissue.
    position_m: FloatArray
    tool_position_m: FloatArray  # (rows,)
    #: (rows,): sensed, wanted, after the guard (into the tissue), and of the tissue; at the device.
    hand_force_N: FloatArray
    control_force_N: FloatArray  # (rows,)
    sent_force_N: FloatArray  # (rows,)
    environment_force_N: FloatArray  # (rows,)

    def as_json(self) -> dict[str, float]:
        """Numbers of the time after the guard's fade-in."""
        late = self.time_s > SETTLED_S
        error = 1e3 * (self.tool_position_m - self.position_m)[late]
        touching = late & (self.environment_force_N > 0.0)
        pressed = self.hand_force_N[touching] - self.environment_force_N[touching]
        return {
            "force_scale": self.settings.force_scale,
            "motion_scale": self.settings.motion_scale,
            "error_rms_mm": float(np.sqrt(np.mean(error**2))),
            "error_max_mm": float(np.abs(error).max()),
            "hand_force_max_N": float(self.hand_force_N.max()),
            "environment_force_max_N": float(self.environment_force_N.max()),
            "hand_less_tissue_rms_N": float(np.sqrt(np.mean(pressed**2))) if pressed.size else 0.0,
            "clipped_share": float(np.mean(np.abs(self.control_force_N - self.sent_force_N)[late] > 1e-9)),
        }


def simulated_device() -> SimulatedDevice:
    """The simulated device, in a hand that presses along :data:`WAY`."""
    times, places = zip(*WAY, strict=True)
    positions = [tuple(np.array(CENTRE_M) + place * INWARD) for place in places]
    hand = Hand(times, tuple(positions), (1.0,) * len(times))
    # on stiff tissue the grip rests while the hand's force changes: its encoders stand still in good health
    return SimulatedDevice(carried(GuardLimits.simulated()), hand=hand, period_s=PERIOD_S)


def device_settings(tissue: Tissue, device: SimulatedDevice, *, stiffness_scale: float) -> ControlSettings:
    """The loop around a simulated device, at the scale that rendering would take."""
    scaling = check_before_force(tissue, ASSUMED_DEVICE).scaling
    return ControlSettings(
        tissue,
        stiffness_scale=stiffness_scale,
        force_scale=scaling.force,
        motion_scale=scaling.motion,
        variant="B",
        device=Mechanics(device.arm.mass_kg, device.arm.damping_N_s_per_m, 0.0),
        # this hand is a spring and a damper without mass
        operator=Mechanics(0.0, device.hand.damping_N_s_per_m, device.hand.stiffness_N_per_m),
        tool=VirtualTool(VIRTUAL_MASS_KG),
        gains=DEVICE_GAINS,
        seconds=SECONDS,
    )


def render_on_simulated(tissue: Tissue, *, stiffness_scale: float = 1.0) -> DeviceRun:
    """Press a simulated hand into a tissue in virtual time; DeviceError where the guard tripped."""
    device = simulated_device()
    settings = device_settings(tissue, device, stiffness_scale=stiffness_scale)
    with device:
        rows = _loop(settings, device)
    return DeviceRun(settings, *rows.T)


def _loop(settings: ControlSettings, device: SimulatedDevice) -> FloatArray:
    """Read, command, guard, write, once a tick; the columns of :class:`DeviceRun`."""
    ticks = round(settings.seconds / PERIOD_S)
    block = loop_block(settings)
    gains, bounds, law = settings.adaptation_gains(), settings.estimate_bounds(), tissue_law(settings)
    controller = new_controller(1, 0.5 * settings.estimated_truth())
    velocity, last = np.zeros(3), np.zeros(3)
    rows = np.zeros((ticks, 7))
    touched = 0.0
    for tick in range(ticks):
        sample = device.read()
        if tick == 0:
            device.engage()
            last[:] = sample.position_m
            controller.xe[0] = INWARD @ (sample.position_m - CENTRE_M)
        velocity_step(velocity, sample.position_m, last, PERIOD_S)
        x = np.array([INWARD @ (sample.position_m - CENTRE_M)])
        v = np.array([INWARD @ velocity])
        sensed = np.array([INWARD @ device.sensed_force_N])
        before, was = touched, controller.xe[0]
        told = command(block, law, controller, tick * PERIOD_S, (x, v), sensed, touched)
        touched, wanted = told.touched, told.u[0]
        adapt(block, told.Y, told.rho, gains, bounds, PERIOD_S, controller.estimates)
        true = INWARD @ (device.true_position_m - CENTRE_M)
        sent = device.write_force(wanted * INWARD, PERIOD_S)
        if device.state is State.FAULT:
            msg = f"the guard took the force away after {tick * PERIOD_S:.3f} s: {FAULT_WORDS[device.fault]}"
            raise DeviceError(msg)
        rows[tick] = tick * PERIOD_S, true, was, sensed[0], wanted, INWARD @ sent, before
    return rows
