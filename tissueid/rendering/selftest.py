"""The figures of this machine, on the simulated device: punctuality of its servo, time of a tick."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray, IntArray
from tissueid.compiled import tick_kernel
from tissueid.haptics.guard import guard
from tissueid.haptics.parameter_block import COMMAND_ENGAGE
from tissueid.haptics.sim import CENTRE_M, SimulatedDevice, SimulatedIO
from tissueid.rendering.environment import INFO_SIZE, MEMORY_SIZE, environment_step
from tissueid.rendering.options import preset_tissue
from tissueid.rendering.passivity_control import PassivityLimits
from tissueid.rendering.servo import PeriodStatistics, ServoPlan, ServoProcess
from tissueid.rendering.servo_loop import CLOCK_SIZE, monotonic_ns, new_watch, virtual_loop
from tissueid.rendering.servo_tick import Servo, compiled_tick, servo_here
from tissueid.rendering.tissue_block import Plane, tissue_block

#: Bars: of the servo's own process at 1 kHz under SCHED_FIFO, of one force step, of a tick.
P99_US, P999_US, FORCE_STEP_NS, TICK_US = 100.0, 1000.0, 100.0, 5.0
DEFAULT_SECONDS = 60.0
TICKS = 20_000
#: Homing takes 50 ticks, the start-up ramp 1000.
START_TICKS = 1_500
#: How deep the tool is in tissue while it is timed [m].
DEPTH_M = 1e-3
#: How far it is pressed in a force step [m].
PRESSED_M = 1e-9
#: Force steps timed at once, and how often: the median leaves out what other programs took.
FORCE_STEPS, BLOCKS = 10_000, 21
PERIOD_S = 1e-3
#: How often a sign of life is given [s].
BEAT_S = 0.1


@dataclass(frozen=True, slots=True)
class Figure:
    """One figure against its bar."""

    name: str
    value: float
    bar: float
    unit: str

    @property
    def holds(self) -> bool:
        """True where the bar is kept."""
        return self.value <= self.bar


@dataclass(frozen=True, slots=True)
class TickTimes:
    """Computing time without the device's wire."""

    force_step_ns: float  # tissue law and guard, in contact, mean of many
    #: A whole tick: simulated device, law, passivity, watchdogs, guard, record.
    tick_median_us: float
    tick_p99_us: float


@dataclass(frozen=True, slots=True)
class SelfTest:
    """Result of ``tissueid render --selftest``."""

    statistics: PeriodStatistics
    remedies: tuple[str, ...]  # what the machine refused, and how to get it
    times: TickTimes
    start_s: float  # from the start of the process to its first tick [s]

    @property
    def figures(self) -> tuple[Figure, ...]:
        """Every figure that has a bar."""
        return (
            Figure("period error, 99 %", self.statistics.p99_us, P99_US, "us"),
            Figure("period error, 99.9 %", self.statistics.p999_us, P999_US, "us"),
            Figure("force step", self.times.force_step_ns, FORCE_STEP_NS, "ns"),
            Figure("tick, 99 %", self.times.tick_p99_us, TICK_US, "us"),
        )


def run_selftest(
    seconds: float = DEFAULT_SECONDS, progress: Callable[[float], None] = lambda _share: None
) -> SelfTest:
    """Measure this machine for some seconds; DeviceError where the servo can't run."""
    begun = time.monotonic()
    with ServoProcess(ServoPlan("sim", {"real_time": True})) as servo:
        start_s = time.monotonic() - begun
        servo.engage()
        begun = time.monotonic()
        while servo.poll() is None and (done := time.monotonic() - begun) < seconds:
            servo.beat()
            progress(done / seconds)
            time.sleep(min(BEAT_S, seconds - done))
        end = servo.stop() if servo.end is None else servo.end
        remedies = servo.ready.remedies if servo.ready is not None else ()
    return SelfTest(end.statistics, remedies, time_ticks(), start_s)


def time_ticks() -> TickTimes:
    """Time the force step and the whole tick, compiled, in this process."""
    with servo_here(SimulatedDevice()) as (io, servo, _ring, block):
        block.write(_tissue_at(-DEPTH_M))
        block.order(COMMAND_ENGAGE)
        # past homing and the start-up ramp with a free tool, then with tissue around it
        virtual_loop(io, servo, new_watch(), 0.0, np.full(START_TICKS, PERIOD_S))
        block.write(_tissue_at(DEPTH_M))
        took = np.zeros(TICKS, np.int64)
        room = np.zeros(CLOCK_SIZE, np.int64)
        _time_each(io, servo, took, room)
        memory, info = np.zeros(MEMORY_SIZE), np.zeros(INFO_SIZE)
        _force_steps(servo, memory, info, 1)
        steps_ns = np.zeros(BLOCKS)
        for k in range(BLOCKS):
            begun = monotonic_ns(room)
            _force_steps(servo, memory, info, FORCE_STEPS)
            steps_ns[k] = (monotonic_ns(room) - begun) / FORCE_STEPS
    median, high = np.quantile(took, [0.5, 0.99]) * 1e-3
    return TickTimes(float(np.median(steps_ns)), float(median), float(high))


def _tissue_at(height_m: float) -> FloatArray:
    """Parameters of a preset tissue whose surface lies ``height_m`` above the resting tool."""
    x, y, z = CENTRE_M
    surface = Plane((x, y, z + height_m))
    environment = tissue_block(preset_tissue("paper-a"), surface, force_scale=0.01, motion_scale=5.0)
    return np.concatenate([environment, PassivityLimits().block()])


@tick_kernel
def _time_each(io: SimulatedIO, servo: Servo, took: IntArray, room: IntArray) -> None:
    for k in range(took.size):
        begun = monotonic_ns(room)
        compiled_tick(io, servo, k * PERIOD_S, PERIOD_S, 0.0, 0)
        took[k] = monotonic_ns(room) - begun


@tick_kernel
def _force_steps(servo: Servo, memory: FloatArray, info: FloatArray, count: int) -> None:
    """Tissue law and guard, on a tool that is pressed in slowly."""
    servo.velocity[2] = -PRESSED_M / PERIOD_S
    for _ in range(count):
        servo.position[2] -= PRESSED_M
        environment_step(
            servo.environment, memory, servo.position, servo.velocity, PERIOD_S, servo.force, info
        )
        guard(servo.guard_memory, servo.limits, servo.force, PERIOD_S, servo.out)
