"""Sessions of a twin: an emulated Falcon with its counts and delay, and the simulated device.

What a machine at the grip would record is the arm's true position and force, with the scales undone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import DeviceError, UsageError
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import FalconDevice
from tissueid.haptics.falcon.emulator import EmulatedLink, EmulatorSettings
from tissueid.haptics.limits import GuardLimits
from tissueid.haptics.parameter_block import COMMAND_ENGAGE
from tissueid.haptics.sim import carried
from tissueid.haptics.states import State
from tissueid.ingest import read_trials
from tissueid.rendering.options import ASSUMED_DEVICE, RenderOptions
from tissueid.rendering.passivity_control import PassivityLimits
from tissueid.rendering.plan import plan_session
from tissueid.rendering.recorder import Recorder
from tissueid.rendering.servo_tick import compiled_tick, servo_here
from tissueid.rendering.session import Session
from tissueid.rendering.session_plan import SessionPlan
from tissueid.rendering.tissue_block import Plane, Tissue, tissue_block
from tissueid.segment import SegmentOptions, segment
from tissueid.trial import Trial, contact_frame
from tissueid.twin.program import Program

TICK_S = 1e-3
#: From a position to the middle of the force it causes: what a session states of its device [s].
LATE_S = (ASSUMED_DEVICE.delay_ticks + 0.5) * TICK_S
LIMITS = GuardLimits(clamp_N=5.0, rms_limit_N=5.0, dead_man=False, ramp_s=0.5)
#: Travel of one encoder count at the grip (docs/devices.md) [mm].
COUNT_MM = 0.0635
#: Emulated time of homing [s], and where the machine meets the surface, in the Falcon's frame [m]: 20 mm
#: beside the axis, on which three legs would count at one moment and a hold be known to a whole count.
HOMED_S, SURFACE_M = 3.0, (0.011, 0.017, 0.1445)
INWARD = (0.0, 0.0, -1.0)
#: Device of a recording that a test machine made at a real grip.
MACHINE = "test machine at the grip"


@dataclass(frozen=True, slots=True, eq=False)
class Felt:
    """Recording at the grip, in tissue units."""

    device: str
    #: (n,): from the rest before contact on; the force is as late as the device makes it.
    time_s: FloatArray
    depth_mm: FloatArray  # (n,)
    force_N: FloatArray  # (n,)
    late_s: float  # delay that the device states
    step_mm: float  # depth of one count of its encoders; a position is known to half of it

    def undone(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Time, depth and force with the stated delay undone."""
        force = np.interp(self.time_s + self.late_s, self.time_s, self.force_N)
        kept = self.time_s <= self.time_s[-1] - self.late_s
        return self.time_s[kept], self.depth_mm[kept], force[kept]


def _block(tissue: Tissue, surface: FloatArray, force_scale: float, motion: float) -> FloatArray:
    plane = Plane(point_m=(float(surface[0]), float(surface[1]), float(surface[2])))
    environment = tissue_block(tissue, plane, force_scale=force_scale, motion_scale=motion)
    return np.concatenate([environment, PassivityLimits(on=False).block()])


def emulated_falcon(tissue: Tissue, program: Program, *, force_scale: float, motion: float) -> Felt:
    """The program on an emulated Falcon: counts, wire, kinematics, motors, delay; DeviceError on a fault."""
    surface = np.array(SURFACE_M)
    hand = program.hand(motion_scale=motion, surface_m=surface, inward=np.array(INWARD))
    link = EmulatedLink(EmulatorSettings(hand=hand, period_s=TICK_S))
    falcon, now, rows = link.falcon, 0.0, []
    # a machine holds still: encoders that do not move are then in good health
    device = FalconDevice(carried(LIMITS), port=link.descriptor(), calibration=Calibration())
    with link, servo_here(device) as (io, servo, _ring, block):
        link.step()
        falcon.advance(HOMED_S - falcon.time_s)
        block.write(_block(tissue, surface, force_scale, motion))
        block.order(COMMAND_ENGAGE)
        start = falcon.time_s
        while falcon.time_s < HOMED_S + program.duration_s + 0.1 and not falcon.gone:
            now += TICK_S
            compiled_tick(io, servo, now, TICK_S, 0.0, 0)
            link.step()
            depth = (surface[2] - falcon.position_m[2]) / motion * 1e3
            rows.append((falcon.time_s - start, depth, falcon.force_N[2] / force_scale))
        if device.state is not State.ENGAGED:
            msg = f"the emulated session ended in {device.fault.name.lower()}"
            raise DeviceError(msg)
    time, depth, force = np.array(rows).T
    return Felt("emulated Falcon", time, depth, force, LATE_S, COUNT_MM / motion)


@dataclass(frozen=True, slots=True)
class Setup:
    """A program, the scales that were asked for, and a test machine's recording at a real device's grip."""

    program: Program
    force_scale: float | None = None
    motion_scale: float | None = None
    felt: Trial | None = None


def planned(bundle: Path, asked: Setup) -> SessionPlan:
    """The session of the simulated device; its scale is that of all."""
    options = RenderOptions(
        bundle=bundle,
        device="sim",
        virtual=True,
        program=asked.program,
        force_scale=asked.force_scale,
        motion_scale=asked.motion_scale,
    )
    return plan_session(options)


def felt_by_a_machine(trial: Trial, *, force_scale: float, motion: float) -> Felt:
    """A recording at a real Falcon's grip, scales undone; UsageError where there is no contact in it."""
    segmentation = segment(trial, options=SegmentOptions(rupture=False))
    if segmentation.contact is None:
        msg = f"{trial.name}: no contact is found in it; name what the test machine recorded at the grip"
        raise UsageError(msg)
    depth, force = contact_frame(trial, segmentation)
    return Felt(MACHINE, trial.time_s, depth / motion, force / force_scale, LATE_S, COUNT_MM / motion)


def simulated(plan: SessionPlan, folder: Path) -> Felt:
    """A plan of :func:`planned` on the simulated device, as ``render`` runs it; its log is ``felt.h5``."""
    with TemporaryDirectory(dir=folder) as made:
        log = Path(made) / "felt.h5"
        Session(plan, recorder=Recorder(log, plan.head)).run()
        (trial,) = read_trials(log)
        log.replace(folder / "felt.h5")
    return Felt("simulated device", trial.time_s, trial.displacement_mm, trial.force_N, 0.0, 0.0)
