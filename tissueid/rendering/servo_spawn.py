"""The servo's process before it has a plan: spawned early, it loads while its owner decides.

Loading numba and the compiled loop takes most of a second, reading a bundle and choosing a scale another;
both at once, a session begins in half the time.  A process without a plan has no device and waits: nothing
can move before the plan passed its checks and was sent.

This module is the entry of that process, and imports nothing slow.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.extras import require
from tissueid.own_process import own_process

#: How long the end of a process is waited for before it is killed [s]: ramp, zero commands, closing.
REAP_S = 5.0


@dataclass(slots=True)
class SpawnedServo:
    """A servo's process, as its owner holds it."""

    process: subprocess.Popen[bytes]
    #: Descriptor of the socket the plan goes through; its end of file is the owner's death.  -1 once closed.
    owner: int
    report: int  # descriptor of the pipe that lines of JSON come from
    #: Whether a plan was sent: from then on it may have a device, and ends with zero force in its own time.
    planned: bool = False

    def reap(self) -> int:
        """Wait for the end, a while kindly; the exit code."""
        try:
            return self.process.wait(REAP_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return self.process.wait()

    def close(self) -> None:
        """Let go of the process, which ends it, and wait for that; harmless when called twice."""
        if self.owner < 0:
            return
        # to a servo with a device this is the owner's death: zero force, whatever it was doing
        os.close(self.owner)
        self.owner = -1
        if not self.planned:
            self.process.terminate()
        self.reap()
        os.close(self.report)


def spawn_servo() -> SpawnedServo:
    """Start a servo's process, without a plan.

    Raises UsageError: numba isn't installed.
    """
    require("numba")
    theirs, ours = socket.socketpair()
    report, reporting = os.pipe()
    command = own_process(__name__, str(theirs.fileno()), str(reporting))
    try:
        # our own interpreter and module; nothing of it comes from a user
        process = subprocess.Popen(  # noqa: S603
            command, pass_fds=(theirs.fileno(), reporting), stdin=subprocess.DEVNULL
        )
    except BaseException:
        ours.close()
        os.close(report)
        raise
    finally:
        theirs.close()
        os.close(reporting)
    return SpawnedServo(process, ours.detach(), report)


def _main() -> int:
    # Ctrl-C reaches every process of a terminal: until the servo hears signals itself it just ends
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from tissueid.rendering.servo_process import main

    return main(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(_main())


#: Switches numba off in a process that is started with it.
_SWITCH = "NUMBA_DISABLE_JIT"
#: Compiling must not take time from the session that runs beside it.
_NICENESS = 10
_SIMULATED = "sim"
FIRST_WORDS = "first start: the loop is being compiled; until then it runs uncompiled and skips ticks"
LAST_WORDS = "compiling for the next start; Ctrl-C puts it off"


def is_compiled() -> bool:
    """True where the servo's loop lies compiled on the disk, or compiling is switched off."""
    from tissueid.rendering import servo_loop

    if os.environ.get(_SWITCH, "0") not in {"", "0"}:
        return True
    loop: Any = servo_loop.compiled_loop
    folder = Path(str(loop.stats.cache_path))
    return any(folder.glob("servo_loop.realtime_loop-*.nbi"))


@contextmanager
def first_start(device: str, tell: Callable[[str], None]) -> Iterator[bool]:
    """Let a servo that is started inside run uncompiled, where it is the first on this machine.

    ``device``: only the simulated one begins uncompiled; ``tell``: told what happens.  Yields whether the
    loop is uncompiled.
    """
    if device != _SIMULATED or is_compiled():
        yield False
        return
    tell(FIRST_WORDS)
    # our own interpreter and module; nothing of it comes from a user
    command = own_process("tissueid.rendering.servo_spawn")
    compiling = subprocess.Popen(  # noqa: S603
        command, stdin=subprocess.DEVNULL, start_new_session=True
    )
    os.environ[_SWITCH] = "1"
    try:
        yield True
    except BaseException:
        compiling.terminate()
        raise
    finally:
        del os.environ[_SWITCH]
        _await(compiling, tell)


def _await(compiling: subprocess.Popen[bytes], tell: Callable[[str], None]) -> None:
    """See the other process to its end: none is left behind."""
    try:
        if compiling.poll() is None:
            tell(LAST_WORDS)
        compiling.wait()
    except KeyboardInterrupt:
        compiling.terminate()
        compiling.wait()


def compile_loop() -> None:
    """Compile the servo's loop for the simulated device, or take it from the disk."""
    from tissueid.haptics.parameter_block import ParameterBlock
    from tissueid.haptics.ring import Ring
    from tissueid.haptics.servo_access import compiled_io
    from tissueid.haptics.sim import SimulatedDevice
    from tissueid.rendering.servo_loop import BINS, compiled_loop, new_watch
    from tissueid.rendering.servo_tick import BLOCK_SIZE, new_servo

    ring, block = Ring.create(), ParameterBlock.create(BLOCK_SIZE)
    try:
        with SimulatedDevice() as device:
            device.home()
            io, servo = compiled_io(device.compiled()), new_servo(device, ring, block)
            compiled_loop(io, servo, new_watch(), np.zeros(BINS + 1, np.int64), 1_000_000, 0)
    finally:
        ring.close()
        block.close()


if __name__ == "__main__":
    os.nice(_NICENESS)
    compile_loop()
