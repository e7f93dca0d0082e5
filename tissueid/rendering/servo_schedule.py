"""Real-time scheduling: try what makes a loop punctual, and say what was refused and how to get it."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import json
import os
import sys
from dataclasses import asdict, dataclass

#: Priority under SCHED_FIFO: above every ordinary program, below the kernel's own threads.
PRIORITY = 80
#: mlockall(2): what is mapped now and later.
MCL_CURRENT, MCL_FUTURE = 1, 2
#: prctl(2): slack of timers [ns]; 50,000 by default, which would show in every period, and 0 means that.
PR_SET_TIMERSLACK, TIMERSLACK_NS = 29, 1
#: Memory that the servo locks, with room [bytes].
LOCKED_BYTES = 1 << 30


@dataclass(frozen=True, slots=True)
class Schedule:
    """Schedule that the servo got."""

    name: str  # scheduling class: "SCHED_FIFO 80" or "SCHED_OTHER"
    locked: bool  # whether its memory is locked
    remedies: tuple[str, ...]  # for each refusal one sentence with what to type


def settled(*, collect: bool = False) -> bool:
    """Clear up and lock memory before homing, 0.1 s; True if locked; ``collect``: keep collecting garbage."""
    gc.collect()
    if not collect:
        gc.disable()
    return _lock(ctypes.CDLL(None, use_errno=True))


def make_punctual(*, locked: bool) -> Schedule:
    """Ask for SCHED_FIFO, one processor and exact timers for this process; refusals are no errors."""
    remedies = []
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_TIMERSLACK, TIMERSLACK_NS, 0, 0, 0)
    # the last processor allowed: the first ones get most interrupts
    with contextlib.suppress(OSError):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    if not locked:
        remedies.append(
            "memory is not locked, a page fault may delay a tick: add the line "
            f"'{_user()} - memlock unlimited' to /etc/security/limits.d/tissueid.conf and log in again"
        )
    name = "SCHED_FIFO 80"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        name = "SCHED_OTHER"
        remedies.append(
            "no real-time priority, other programs may delay a tick: add the line "
            f"'{_user()} - rtprio {PRIORITY}' to /etc/security/limits.d/tissueid.conf and log in again, or "
            f"run: sudo setcap cap_sys_nice,cap_ipc_lock+ep {os.path.realpath(sys.executable)}"
        )
    return Schedule(name, locked, tuple(remedies))


def _lock(libc: ctypes.CDLL) -> bool:
    """Lock the memory where the limit allows all of it; a limit that is hit later would kill the process."""
    try:
        import resource
    except ModuleNotFoundError:  # a system without limits of POSIX
        return False
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != hard:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    unlimited = hard == resource.RLIM_INFINITY or hard >= LOCKED_BYTES or os.geteuid() == 0
    return bool(unlimited and libc.mlockall(MCL_CURRENT | MCL_FUTURE) == 0)


def _user() -> str:
    return os.environ.get("USER") or str(os.getuid())


if __name__ == "__main__":
    # what a servo would get, for whoever asks before there is one
    sys.stdout.write(json.dumps(asdict(make_punctual(locked=settled()))))
