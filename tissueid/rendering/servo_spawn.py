"""The entry of the servo's process, which imports nothing slow: it loads while its owner decides."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from dataclasses import dataclass

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
    """Start a servo's process, without a plan; UsageError where numba isn't installed."""
    require("numba")
    theirs, ours = socket.socketpair()
    report, reporting = os.pipe()
    command = own_process(__name__, str(theirs.fileno()), str(reporting))
    try:
        # our own interpreter and module; nothing of it comes from a user
        process = subprocess.Popen(  # noqa: S603
            command, pass_fds=(theirs.fileno(), reporting), stdin=subprocess.DEVNULL,
            # what a terminal sends its programs, Ctrl-C and Ctrl-Z, is the owner's to hear
            start_new_session=True,
        )  # fmt: skip
    except BaseException:
        ours.close()
        os.close(report)
        raise
    finally:
        theirs.close()
        os.close(reporting)
    return SpawnedServo(process, ours.detach(), report)


if __name__ == "__main__":
    from tissueid.rendering.servo_process import main

    sys.exit(main(sys.argv[1:]))
