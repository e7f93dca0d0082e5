"""An emulated Falcon on a pseudo-terminal: ``python -m tissueid.haptics.falcon.emulator``."""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
import threading
from typing import Any

import numpy as np

from tissueid.errors import TissueidError
from tissueid.haptics.falcon.emulator.links import READY_LINE, EmulatedLink
from tissueid.haptics.falcon.emulator.machine import FAULT_KINDS, PULLED_M, EmulatorSettings, parse_fault
from tissueid.haptics.hand import PRESETS, Hand, parse_script, preset, scripted_hand

#: Surface that the hand of an emulator aims at [m]: the middle of the workspace, seen from the user.
SURFACE_M = (0.0, 0.0, 0.130)
AIM: dict[str, Any] = {"surface_m": np.array(SURFACE_M), "inward": np.array([0.0, 0.0, -1.0])}
#: Ends of a sweep along z [m], and the time from one to the other [s].
SWEEP_M = (0.165, 0.110)
SWEEP_S = 4.0
SWEEPS = 56
#: Real-time priority, below that of a servo.
PRIORITY = 70
#: Device travel over tissue depth.
MOTION_SCALE = 5.0
SWITCHES = {
    "--no-firmware": "switched on without firmware, as a real one",
    "--never-homes": "the emulated user does not home it",
    "--sweep": "the hand goes in and out of the workspace",
    "--free": "the hand lets go of the grip after homing",
    "--until-eof": "end when standard input does",
}


def _arguments(given: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tissueid.haptics.falcon.emulator",
        description="A Falcon that is computed, on a pseudo-terminal. No real device has confirmed it.",
    )
    for name, what in SWITCHES.items():
        parser.add_argument(name, action="store_true", help=what)
    parser.add_argument("--failing-tries", type=int, default=0, help="uploads that fail before one succeeds")
    parser.add_argument("--hand", choices=PRESETS, help="what the hand does after homing")
    parser.add_argument("--depth-mm", type=float, default=10.0, help="depth it aims at [mm of the device]")
    parser.add_argument("--script", help='carried like a machine: "indent 8 mm at 250 mm/min; hold 2 s"')
    parser.add_argument("--fault", action="append", default=[], help=f"one of: {', '.join(FAULT_KINDS)}")
    return parser.parse_args(given)


def _hand(options: argparse.Namespace) -> Hand | None:
    if options.script is not None:
        return scripted_hand(parse_script(options.script), motion_scale=MOTION_SCALE, **AIM)
    if options.hand is not None:
        return preset(options.hand, depth_m=options.depth_mm * 1e-3, **AIM)
    if options.free:
        return Hand((0.0, 1.0, 1.5), (PULLED_M, SURFACE_M, SURFACE_M), (1.0, 1.0, 0.0))
    if options.sweep:
        # along the axis of the workspace, out of any tissue and into it, for minutes
        turns = range(SWEEPS)
        places = tuple((0.0, 0.0, SWEEP_M[turn % 2]) for turn in turns)
        return Hand(tuple(SWEEP_S * turn for turn in turns), places, (1.0,) * SWEEPS)
    return None


def main(given: list[str] | None = None) -> int:
    """Serve until interrupted; returns an exit code of :mod:`tissueid.errors`."""
    options = _arguments(given)
    try:
        settings = EmulatorSettings(
            hand=_hand(options),
            firmware_loaded=not options.no_firmware,
            failing_tries=options.failing_tries,
            homes=not options.never_homes,
            waits_for_blue=True,
            faults=tuple(parse_fault(text) for text in options.fault),
        )
        link = EmulatedLink(settings, pty=True)
    except TissueidError as error:
        sys.stderr.write(f"error: {error}\n")
        return error.exit_status
    stop = threading.Event()
    for sign in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(sign, lambda _number, _frame: stop.set())
    if options.until_eof:
        threading.Thread(target=_wait_for_eof, args=(stop,), daemon=True).start()
    # a real device is not starved by a busy computer: this runs before other programs where that is allowed
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    with link:
        sys.stdout.write(f"{READY_LINE}{link.path}\n")
        sys.stdout.flush()
        while not stop.wait(0.1) and not link.falcon.gone:
            pass
    return 0


def _wait_for_eof(stop: threading.Event) -> None:
    while os.read(sys.stdin.fileno(), 4096):
        pass
    stop.set()


if __name__ == "__main__":
    sys.exit(main())
