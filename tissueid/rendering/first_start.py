"""The first start on a machine: the simulated device runs uncompiled while the loop is being compiled.

Compiling takes 10 to 20 s, in a second process (``python -m tissueid.rendering.first_start``); a device with
motors waits for the compiled loop.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from tissueid.own_process import own_process

#: Switches numba off in a process that is started with it.
_SWITCH = "NUMBA_DISABLE_JIT"
#: Compiling must not take time from the session that runs beside it.
_NICENESS = 10
_SIMULATED, SIMULATED_IO = "sim", "SimulatedIO"
FIRST_WORDS = "first start: the loop is being compiled; until then it runs uncompiled and skips ticks"
LAST_WORDS = "compiling for the next start; Ctrl-C puts it off"


def is_compiled(kind: str = SIMULATED_IO) -> bool:
    """True where the servo's loop for a kind of device lies compiled on the disk, or is not to be compiled.

    ``kind``: name of the tuple that stands for the device in a loop.
    """
    return os.environ.get(_SWITCH, "0") not in {"", "0"} or _mark(kind).exists()


def note_compiled(kind: str) -> None:
    """Note that the loop for a kind of device was compiled, beside the loop itself."""
    # without a folder of its own nothing lasts
    with suppress(OSError):
        _mark(kind).touch()


def _mark(kind: str) -> Path:
    from tissueid.rendering import servo_loop

    loop: Any = servo_loop.compiled_loop
    return Path(str(loop.stats.cache_path)) / f"servo_loop.{kind}"


@contextmanager
def first_start(device: str, tell: Callable[[str], None]) -> Iterator[bool]:
    """Let a servo of the simulated device run uncompiled where it is the first; yields whether it does."""
    if device != _SIMULATED or is_compiled():
        yield False
        return
    tell(FIRST_WORDS)
    # our own interpreter and module; nothing of it comes from a user
    command = own_process("tissueid.rendering.first_start")
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
        # the other process is seen to its end: none is left behind
        try:
            if compiling.poll() is None:
                tell(LAST_WORDS)
            compiling.wait()
        except KeyboardInterrupt:
            compiling.terminate()
            compiling.wait()


def compile_loop() -> None:
    """Compile the servo's loop for the simulated device, or take it from the disk."""
    from tissueid.haptics.sim import SimulatedDevice
    from tissueid.rendering.servo_loop import BINS, compiled_loop, new_watch
    from tissueid.rendering.servo_tick import servo_here

    device = SimulatedDevice()
    with servo_here(device) as (io, servo, _ring, _block):
        device.home()
        compiled_loop(io, servo, new_watch(), np.zeros(BINS + 1, np.int64), 1_000_000, 0)
        note_compiled(type(io).__name__)


if __name__ == "__main__":
    os.nice(_NICENESS)
    compile_loop()
