"""Punctuality of the servo against a loop in C, in turn, and what a tick costs.

    python benchmarks/servo.py [--pairs 5] [--seconds 5] [--json]

At 1 and 4 kHz the same session runs as a loop in C (gcc -O2, the same scheduling class, processor, locked
memory and timer slack) and as the servo's process, once alone and once beside a busy Python thread in the
owner: four runs in turn, and then again.  The figure is the median ratio of the pairs' p99 of |period error|;
the bar is 1.5.  Beside the busy thread the servo is compared with C alone and with C beside the same thread:
the first ratio has the thread's share of the machine in it, which no loop is to blame for.  A force step
(tissue law and guard) should take at most 100 ns, a whole tick at most 5 us at the 99th percentile; in C the
law is the same with its exponentials folded by the compiler.  The ping-pong on a pseudo-terminal is the rate
at which the compiled Falcon code sends a command and parses an answer, with a process that echoes.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numba as nb
import numpy as np
from harness import command_line

from tissueid.haptics.device import CompiledIO, compiled_io
from tissueid.haptics.falcon.kinematics import DEFAULT_GEOMETRY
from tissueid.haptics.falcon.servo_io import DESCRIPTOR
from tissueid.haptics.guard import REPLY_VALID, new_guard
from tissueid.haptics.limits import GuardLimits
from tissueid.rendering.selftest import FORCE_STEP_NS, TICK_US, time_ticks
from tissueid.rendering.servo import ServoPlan, ServoProcess

RATIO = 1.5
RATES_HZ = (1000, 4000)
PING_PONGS = 50_000
_SENSE, _COMMAND = DESCRIPTOR.sense, DESCRIPTOR.command
C_STEPS = "2000000"
REFERENCE = Path(__file__).with_name("servo_reference.c")

ECHO = """
import os, sys, tty
descriptor = int(sys.argv[1])
tty.setraw(descriptor)
while data := os.read(descriptor, 512):
    os.write(descriptor, data)
"""


@contextmanager
def busy_thread(*, wanted: bool) -> Iterator[None]:
    """A thread that never lets go of the interpreter for longer than it must."""
    ended = threading.Event()

    def burn() -> None:
        while not ended.is_set():
            sum(range(1000))

    thread = threading.Thread(target=burn)
    if wanted:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        if wanted:
            thread.join()


def in_c(program: Path, rate_hz: int, seconds: float) -> dict[str, float]:
    """Period errors of the loop in C."""
    command = [program, str(10**9 // rate_hz), str(int(seconds * rate_hz))]
    words = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    return dict(zip(("median", "p99", "p999", "max", "missed"), map(float, words), strict=True))


def in_servo(rate_hz: int, seconds: float, *, busy: bool) -> dict[str, float]:
    """Period errors of the servo's process."""
    plan = ServoPlan(
        "sim",
        {"real_time": True},
        period_ns=10**9 // rate_hz,
        ticks=int(seconds * rate_hz),
        alive_wanted=False,
    )
    with ServoProcess(plan) as servo, busy_thread(wanted=busy):
        servo.engage()
        while servo.poll() is None:
            time.sleep(0.05)
        found = servo.end.statistics
    return {
        "median": found.median_us, "p99": found.p99_us, "p999": found.p999_us, "max": found.max_us,
        "missed": found.missed, "scheduling": found.scheduling,
    }  # fmt: skip


def pairs(program: Path, count: int, seconds: float) -> dict[str, dict[str, object]]:
    """Interleaved runs at every rate."""
    in_servo(RATES_HZ[0], 0.1, busy=False)
    result: dict[str, dict[str, object]] = {}
    for rate in RATES_HZ:
        runs: dict[str, list[dict[str, float]]] = {
            "c": [], "servo": [], "c, busy owner": [], "servo, busy owner": []
        }  # fmt: skip
        for _ in range(count):
            runs["c"].append(in_c(program, rate, seconds))
            runs["servo"].append(in_servo(rate, seconds, busy=False))
            with busy_thread(wanted=True):
                runs["c, busy owner"].append(in_c(program, rate, seconds))
            runs["servo, busy owner"].append(in_servo(rate, seconds, busy=True))
        found: dict[str, object] = {
            name: {
                key: statistics.median(run[key] for run in of)
                for key in ("median", "p99", "p999", "max", "missed")
            }
            for name, of in runs.items()
        }
        # the servo counts in whole microseconds: half of one is added to what it says
        for name, peers in (
            ("servo", "c"), ("servo, busy owner", "c"), ("servo, busy owner", "c, busy owner")
        ):  # fmt: skip
            found[f"p99 ratio, {name} / {peers}"] = statistics.median(
                (ours["p99"] + 0.5) / peer["p99"] for ours, peer in zip(runs[name], runs[peers], strict=True)
            )
        found["scheduling"] = runs["servo"][0]["scheduling"]
        result[f"{rate} Hz"] = found
    return result


@nb.njit(nogil=True)
def exchange(io, limits, memory, position, counts, words, times):
    """Send a command and take its answer, as often as wanted; how often the answer was looked for."""
    force = np.zeros(3)
    looked = 0
    for _ in range(times):
        _COMMAND(io, memory, limits, force)
        words[0] = 0
        while words[0] != REPLY_VALID:
            _SENSE(io, 0.0, position, counts, words)
            looked += 1
    return looked


def ping_pong_hz() -> float:
    """Commands and answers a second on a pseudo-terminal."""
    ours, theirs = os.openpty()
    echo = subprocess.Popen([sys.executable, "-c", ECHO, str(theirs)], pass_fds=(theirs,))
    try:
        os.set_blocking(ours, False)
        time.sleep(0.5)
        handles = np.array([ours], np.int64)
        constants = np.concatenate([[6600.0], DEFAULT_GEOMETRY.block()])
        io = compiled_io(CompiledIO("tissueid.haptics.falcon.servo_io:DESCRIPTOR", handles, constants))
        room = (GuardLimits().block(), new_guard(), np.zeros(3), np.zeros(3, np.int64), np.zeros(4, np.int64))
        exchange(io, *room, 100)
        begun = time.perf_counter()
        exchange(io, *room, PING_PONGS)
        return PING_PONGS / (time.perf_counter() - begun)
    finally:
        echo.kill()
        echo.wait()
        os.close(ours)
        os.close(theirs)


def main() -> None:
    parser = command_line(__doc__)
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=5.0)
    options = parser.parse_args()
    compiler = shutil.which("gcc")
    if compiler is None:
        sys.exit("gcc is needed for the loop in C")
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "servo_reference"
        subprocess.run([compiler, "-O2", "-ffp-contract=off", REFERENCE, "-lm", "-o", program], check=True)
        result: dict[str, object] = dict(pairs(program, options.pairs, options.seconds))
        step = subprocess.run([program, "step", C_STEPS], check=True, capture_output=True, text=True).stdout
    times = time_ticks()
    result["force step [ns]"] = {"c": float(step), "servo": times.force_step_ns, "bar": FORCE_STEP_NS}
    result["tick [us]"] = {"median": times.tick_median_us, "p99": times.tick_p99_us, "bar": TICK_US}
    result["pty ping-pong [1/s]"] = ping_pong_hz()
    result["bar of the p99 ratio"] = RATIO
    result["load of the machine"] = os.getloadavg()[0]
    if options.json:
        print(json.dumps(result, indent=2))
        return
    for rate, figures in result.items():
        print(rate, figures if not isinstance(figures, dict) else "")
        for name, value in figures.items() if isinstance(figures, dict) else ():
            print(f"  {name}: {value}")


if __name__ == "__main__":
    main()
