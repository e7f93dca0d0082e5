"""Seeded sessions in virtual time: hand, arm, wire, servo tick, tissue and guard in one compiled loop.

The loop calls the very tick of the servo on the simulated device and looks on: at the true port of the arm
(unquantised position, force felt), at the force that the guard let through, at the encoders.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numba as nb
import numpy as np
from felt_block import parameters

from tissueid.haptics.arm import DAMPING_LOSS, FRICTION_LOSS, MOTOR_WORK, Arm
from tissueid.haptics.guard import FAULT, STATE
from tissueid.haptics.hand import PRESETS as HANDS
from tissueid.haptics.hand import preset
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.parameter_block import COMMAND_ENGAGE, ParameterBlock
from tissueid.haptics.ring import Ring
from tissueid.haptics.shared_hand import QUANTUM
from tissueid.haptics.sim import CENTRE_M, SimulatedDevice, SimulatedIO
from tissueid.model.passivity import required_damping, scaling_for
from tissueid.rendering.environment import INFO_DEPTH_MM
from tissueid.rendering.options import PRESETS, preset_tissue
from tissueid.rendering.passivity_control import CORRECTION, TOTAL_J, PassivityLimits
from tissueid.rendering.precheck import scaling_at
from tissueid.rendering.servo_tick import BLOCK_SIZE, new_servo, tick
from tissueid.rendering.tissue_block import Tissue

SURFACE = np.array(CENTRE_M)
INWARD = np.array([0.0, 0.0, -1.0])
PERIOD_S = 1e-3
CLAMP_N = 5.0
#: Damping that a device is assumed to have [N s/m].
PRESET_DAMPING = 0.5
MOTION_SCALE = 5.0
#: Allowance of the energy bar besides that of the counts [J].
ALLOWANCE_J = 1e-6
#: Ticks at the end of a session in which a hold must be quiet.
QUIET_TICKS = 300
DELAYS = (1.0, 1.25, 1.5, 1.75, 2.0)

#: What a session is judged by.
MARGIN_J, LEAST_J, RISE_N, SWING, LARGEST_N, LEDGER_J, KICK_N, DEEPEST_MM, STATE_AT_END, FAULT_AT_END = range(
    10
)
#: Smallest share of the most that a touch took from the hand which it had not given back at its end.
KEPT = 10
FIGURES = 11
#: Touches that took less than this say nothing of shares [J].
NOTABLE_J = 2e-5
#: What is remembered of a touch.
IN_CONTACT, LAST_J, BEGAN_J, ALLOWED_J, COUNT_M, MOST_J = range(6)

#: One standard error of each parameter: of paper A's tissue as 18 ramps and 4 holds identify it (K and tau
#: are known by their product), of the meat about what `tissueid fit` says of its ramp and hold.
_SD = {
    "paper-a": np.array([0.5, 0.15, 0.012, 1.0, 0.0]),
    "meat": np.array([0.0035, 0.0023, 0.00034, 0.004, 0.006, 0.017, 0.0, 0.0005, 0.24]),
}
#: K tau of paper A and its standard error [N s/mm].
K_TAU = (1.336, 0.002)


def drawn_tissue(name: str, rng: np.random.Generator) -> Tissue:
    """A tissue within the posterior of a preset: passive, as every stored draw."""
    given = preset_tissue(name)
    while True:
        theta = given.theta + _SD[name] * rng.normal(size=given.theta.size)
        if name == "paper-a":
            theta[4] = (K_TAU[0] + K_TAU[1] * rng.normal()) / theta[3]
        if given.model.is_passive(theta):
            return Tissue(given.model, theta, given.speeds_mm_s, name=name)


@cache
def pool(name: str, count: int) -> list[tuple[Tissue, dict[float, float]]]:
    """Drawn tissues, and for each and every delay the damping its scale of 1 would need [N s/m]."""
    rng = np.random.default_rng([7, count])
    found = []
    for _ in range(count):
        tissue = drawn_tissue(name, rng)
        unit = scaling_at(tissue, force=1.0, motion=MOTION_SCALE)
        need = {
            delay: required_damping(tissue.model, tissue.theta, unit, period_s=PERIOD_S, delay_ticks=delay)
            for delay in DELAYS
        }
        found.append((tissue, need))
    return found


# not kept on the disk: a kept loop would go on calling a tick that has changed since
@nb.njit(nogil=True, error_model="numpy")
def _look(io: Any, servo: Any, static: Any, factor: float, last: int, touch: Any, figures: Any) -> None:
    """Energy at the true port since this touch began, and what is allowed for the counts passed in it.

    What was dissipated in air pays for nothing: the ledger of a touch begins with its last tick in air.
    """
    depth = servo.info[INFO_DEPTH_MM]
    # through the grip into what is rendered, and into damping and friction (doi 10.1002/rob.4620140110)
    energy = io.memory[DAMPING_LOSS] + io.memory[FRICTION_LOSS] - io.memory[MOTOR_WORK]
    if depth > 0.0 and touch[IN_CONTACT] == 0.0:
        touch[BEGAN_J] = touch[LAST_J]
        touch[ALLOWED_J] = ALLOWANCE_J
        touch[MOST_J] = 0.0
    touch[MOST_J] = max(touch[MOST_J], energy - touch[BEGAN_J])
    if depth <= 0.0 and touch[IN_CONTACT] == 1.0 and touch[MOST_J] > NOTABLE_J:
        figures[KEPT] = min(figures[KEPT], (energy - touch[BEGAN_J]) / touch[MOST_J])
    touch[IN_CONTACT] = 1.0 if depth > 0.0 else 0.0
    touch[LAST_J] = energy
    inside = max(depth, 0.0)
    slope = (static[0] + inside * (2.0 * static[1] + 3.0 * inside * static[2])) * factor
    if depth > 0.0:
        touch[ALLOWED_J] += 0.5 * max(slope, 0.0) * touch[COUNT_M] ** 2 * abs(servo.counts[2] - last)
    figures[LEAST_J] = min(figures[LEAST_J], energy - touch[BEGAN_J])
    figures[MARGIN_J] = min(figures[MARGIN_J], energy - touch[BEGAN_J] + touch[ALLOWED_J])
    figures[LEDGER_J] = min(figures[LEDGER_J], servo.control_memory[TOTAL_J])
    figures[DEEPEST_MM] = max(figures[DEEPEST_MM], inside)


@nb.njit(nogil=True, error_model="numpy")
def run_session(
    io: Any, servo: Any, steps: Any, static: Any, factor: float, quantum: float, figures: Any
) -> None:
    """Tick through the steps given and fill in the figures."""
    touch = np.array([0.0, 0.0, 0.0, ALLOWANCE_J, quantum, 0.0])
    before = np.zeros(3)
    correction = np.zeros(3)
    low = high = 0.0
    drawn_up = drawn_down = 0.0
    now = 0.0
    figures[:] = 0.0
    figures[MARGIN_J] = ALLOWANCE_J
    figures[KEPT] = 1.0
    for step in range(steps.size):
        last = servo.counts[2] if step > 0 else 0
        now += steps[step]
        tick(io, servo, now, steps[step], 0.0, 0)
        if step == 0:
            last = servo.counts[2]
        _look(io, servo, static, factor, last, touch, figures)
        size = rise = kick = 0.0
        for i in range(3):
            size += servo.out[i] * servo.out[i]
            rise += before[i] * before[i]
            change = servo.control_memory[CORRECTION + i] - correction[i]
            kick += change * change
            before[i] = servo.out[i]
            correction[i] = servo.control_memory[CORRECTION + i]
        figures[LARGEST_N] = max(figures[LARGEST_N], np.sqrt(size))
        figures[RISE_N] = max(figures[RISE_N], np.sqrt(size) - np.sqrt(rise))
        figures[KICK_N] = max(figures[KICK_N], np.sqrt(kick))
        if step == steps.size - QUIET_TICKS:
            low = high = servo.counts[2]
        if step >= steps.size - QUIET_TICKS:
            low, high = min(low, servo.counts[2]), max(high, servo.counts[2])
            drawn_up = max(drawn_up, servo.counts[2] - low)
            drawn_down = max(drawn_down, high - servo.counts[2])
    # a creeping tissue drifts one way; what swings goes both ways
    figures[SWING] = min(drawn_up, drawn_down)
    figures[STATE_AT_END] = servo.guard_memory[STATE]
    figures[FAULT_AT_END] = servo.guard_memory[FAULT]


@dataclass(frozen=True, slots=True)
class Setting:
    """One session, as drawn."""

    tissue: str
    hand: str
    share_of_bound: float
    near: bool


def drawn_session(
    seed: int, *, near: bool, pool_size: int, controller: bool = False
) -> tuple[Setting, np.ndarray]:
    """Draw a session of a preset tissue and run it; ``pool_size``: tissues drawn from each posterior.

    ``near``: the device's damping is drawn within a tenth above the bound of this very tissue, scale and
    delay; else it is the preset, and the scale as large as clamp and preset allow.
    """
    rng = np.random.default_rng([1999, seed])
    name = list(PRESETS)[int(rng.integers(len(PRESETS)))]
    tissue, needs = pool(name, pool_size)[int(rng.integers(pool_size))]
    delay = float(rng.choice(DELAYS))
    full = scaling_for(tissue.model, tissue.theta, clamp_N=CLAMP_N, fastest_mm_s=tissue.speeds_mm_s[1]).force
    if near:
        scale = full * rng.uniform(0.3, 1.0)
        damping = needs[delay] * scale / rng.uniform(0.9, 1.0)
    else:
        scale = min(full, 0.95 * PRESET_DAMPING / needs[delay])
        damping = PRESET_DAMPING
    hand = HANDS[int(rng.integers(len(HANDS)))]
    stiffness = float(np.exp(rng.uniform(np.log(50.0), np.log(1000.0))))
    speed = float(rng.uniform(3e-4, 2e-3) if hand == "slow press" else rng.uniform(0.01, 0.1))
    depth = rng.uniform(0.1, 1.0) * tissue.model.depth_mm * MOTION_SCALE * 1e-3
    # a slow press would take minutes to the bottom, and 40 mm in 30 ms is no hand but an overspeed
    depth = min(depth, {"slow press": 2e-3, "step": 0.02}.get(hand, depth))
    device = SimulatedDevice(
        GuardLimits(clamp_N=CLAMP_N, rms_limit_N=CLAMP_N, dead_man=False, ramp_s=0.5),
        arm=Arm(mass_kg=rng.uniform(0.15, 0.4), damping_N_s_per_m=damping, friction_N=rng.uniform(0.05, 0.1)),
        hand=preset(
            hand,
            surface_m=SURFACE,
            inward=INWARD,
            depth_m=depth,
            speed_m_per_s=speed,
            stiffness_N_per_m=stiffness,
            damping_N_s_per_m=2.0 * rng.uniform(0.2, 0.8) * np.sqrt(stiffness * 0.25),
            tremor_m=rng.uniform(5e-5, 5e-4),
            tremor_hz=rng.uniform(6.0, 12.0),
            tremor_phase=rng.uniform(0.0, 2.0 * np.pi),
            rest_s=rng.uniform(0.1, 0.7),
            stay_s=1.0,
        ),
        quantum_m=rng.uniform(40e-6, 90e-6),
        delay_ticks=delay,
        seed=seed,
    )
    ticks = round(device.hand.duration_s / PERIOD_S) + 200
    steps = np.clip(rng.normal(PERIOD_S, 3e-5, ticks), 0.8e-3, 1.2e-3)
    figures = in_closed_loop(device, tissue, scale, steps, controller=controller)
    return Setting(name, hand, needs[delay] * scale / damping, near), figures


@cache
def shared_memory() -> tuple[Ring, ParameterBlock]:
    """One ring and one block for all sessions."""
    return Ring.create(64), ParameterBlock.create(BLOCK_SIZE)


def in_closed_loop(
    device: SimulatedDevice, tissue: Tissue, scale: float, steps: np.ndarray, *, controller: bool
) -> np.ndarray:
    """Figures of one session of a device with a tissue under its hand, shape (FIGURES,)."""
    ring, block = shared_memory()
    factor = scale / MOTION_SCALE * 1e3
    quantum = float(device.parameters[QUANTUM])
    tangent = scaling_at(tissue, force=scale, motion=MOTION_SCALE).device_stiffness_N_per_m
    control = PassivityLimits(on=controller, count_m=quantum, stiffness_N_per_m=tangent)
    servo = new_servo(device, ring, block)
    block.write(parameters(tissue, surface_z=CENTRE_M[2], scales=(scale, MOTION_SCALE), control=control))
    block.order(COMMAND_ENGAGE)
    figures = np.zeros(FIGURES)
    io = SimulatedIO(device.parameters, device.memory)
    device.open()
    try:
        static = tissue.model.split(tissue.theta)[0]
        run_session(io, servo, steps, np.ascontiguousarray(static), factor, quantum, figures)
    finally:
        device.close()
    return figures
