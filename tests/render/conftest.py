"""Owner and report of a servo that runs in the test's own process."""

import contextlib
import os
import socket
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from tissueid.haptics.parameter_block import ParameterBlock
from tissueid.haptics.ring import Ring
from tissueid.rendering import servo_process
from tissueid.rendering.servo import ServoEnd, ServoPlan, send_plan
from tissueid.rendering.servo_schedule import Schedule
from tissueid.rendering.servo_tick import BLOCK_SIZE


class Pipes(NamedTuple):
    """Descriptors, and shared memory."""

    theirs: int
    ours: int
    reading: int
    writing: int
    ring: Ring
    block: ParameterBlock

    def run(self, plan: ServoPlan) -> ServoEnd:
        return servo_process.run_plan(plan, self.ring, self.block, self.theirs, self.writing)

    def main(self, plan: ServoPlan | None = None) -> int:
        if plan is not None:
            send_plan(self.ours, plan, self.ring.descriptor, self.block.descriptor)
        return servo_process.main([str(self.theirs), str(self.writing)])

    def told(self) -> str:
        return os.read(self.reading, 65_536).decode()


@pytest.fixture
def pipes() -> Iterator[Pipes]:
    ends = [one.detach() for one in socket.socketpair()]
    made = Pipes(*ends, *os.pipe(), Ring.create(), ParameterBlock.create(BLOCK_SIZE))
    yield made
    for descriptor in made[:4]:
        with contextlib.suppress(OSError):
            os.close(descriptor)
    made.ring.close()
    made.block.close()


@pytest.fixture
def same_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """The test's own process keeps its priority, processor and unlocked memory."""
    monkeypatch.setattr(
        servo_process, "make_punctual", lambda **_: Schedule("SCHED_OTHER", locked=False, remedies=())
    )
    monkeypatch.setattr(servo_process, "settled", lambda **_: False)
