"""Faults injected on an emulated Falcon in contact: what detects each, what is sent then, how it ends.

Counted in ticks of the emulator's own clock, 1 ms each.  At the end exit codes and log of `tissueid render`,
in real time on a shared machine: there the watchdog for silence is set to a second.
"""

import contextlib
import os
import socket
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any, Self

import numpy as np
import pytest
from command_line import run
from emulated_session import HOMED_S, TICK_S, EmulatedSession, pressing
from owner_to_kill import LIMITS

from tissueid.haptics.device import ZERO_COMMANDS
from tissueid.haptics.falcon.calibration import Calibration
from tissueid.haptics.falcon.device import limits_of
from tissueid.haptics.falcon.emulator import EmulatedLink, EmulatorSettings, ScriptedFault
from tissueid.haptics.falcon.emulator import machine as emulator
from tissueid.haptics.falcon.packets import INVALID, PACKETS
from tissueid.haptics.guard import GAIN
from tissueid.haptics.hand import Hand
from tissueid.haptics.states import FAULT_WORDS, Fault, Lamp, State
from tissueid.store.session_log import read_session_log

pytestmark = pytest.mark.needs_jit

#: When faults begin on the emulator's clock [s]: half a second into the tissue.
FAULT_S = 4.5
#: A fault's ramp to zero is over in this many ticks after detection, the tick of detection included.
RAMP_TICKS = 20
#: Most that |F| may change in a tick of that ramp [N].
RAMP_STEP_N = 0.5


#: Faults that last: what detects each, and within how many ticks.
LASTING = [
    ("unplug", Fault.TRANSPORT, 1), ("silence", Fault.NO_REPLY, 100), ("bad packets", Fault.BAD_PACKETS, 20),
    ("jump", Fault.ENCODER_JUMP, 1), ("unhomed", Fault.NOT_HOMED, 1),
]  # fmt: skip


def firm(times_s: tuple[float, ...], positions_m: tuple[tuple[float, float, float], ...]) -> Hand:
    """A hand that keeps to its way."""
    grips = (1.0,) * len(times_s)
    return Hand(times_s, positions_m, grips, stiffness_N_per_m=1000.0, damping_N_s_per_m=20.0)


@pytest.mark.parametrize(("kind", "fault", "within_ticks"), LASTING)
def test_a_lasting_fault_in_contact_ends_in_fault_and_zero_packets(kind, fault, within_ticks):
    with EmulatedSession(ScriptedFault(kind, FAULT_S)) as session:
        session.run(FAULT_S - 1.5 * TICK_S)
        assert session.states()[-1] is State.ENGAGED
        assert session.forces()[-1] > 0.5
        assert session.motors[-1] != (0, 0, 0)
        begins = len(session.records)
        session.ticks(160)
        if kind in {"silence", "bad packets"}:
            # the answer of the first spoilt tick is read one tick later
            assert (session.forces()[begins + 21 :] == 0.0).all()
        detected = session.first(fault)
        # the answer of the first spoilt tick is read one tick later
        assert 0 <= detected - begins <= within_ticks + 1
        # from the last tick before it on
        forces = session.forces()[detected - 1 :]
        assert (forces[1 + RAMP_TICKS :] == 0.0).all()
        assert np.abs(np.diff(forces)).max() <= RAMP_STEP_N
        assert (np.diff(forces[: 1 + RAMP_TICKS]) <= 0.0).all()
        assert session.states()[-1] is State.FAULT
        assert FAULT_WORDS[Fault(int(session.records[-1]["fault"]))] == FAULT_WORDS[fault]
        if kind != "unplug":
            # it is still commanded: with zeros, and often enough to survive a lost packet
            assert session.motors[-ZERO_COMMANDS:] == [(0, 0, 0)] * ZERO_COMMANDS


@cache
def undisturbed() -> EmulatedSession:
    """A session without a fault, closed."""
    with EmulatedSession() as session:
        session.run(FAULT_S + 0.2)
    return session


def test_a_session_without_faults_renders_from_homing_on():
    session = undisturbed()
    assert session.faults() == {Fault.NONE}
    assert set(session.states()) == {State.HOMING, State.ARMED, State.ENGAGED}
    assert session.io.parts.parser[INVALID] == 0
    assert session.forces()[-1] > 0.5


@pytest.mark.parametrize(("kind", "damaged"), [("short", 1), ("garbled", 1), ("doubled", 0)])
def test_one_spoilt_answer_is_dropped_and_counted_and_rendering_goes_on(kind, damaged):
    plain = undisturbed()
    with EmulatedSession(ScriptedFault(kind, FAULT_S, size=5.0)) as session:
        session.run(FAULT_S + 0.2)
        parser = session.io.parts.parser
        assert parser[INVALID] == damaged
        assert parser[PACKETS] == plain.io.parts.parser[PACKETS] + (1 if kind == "doubled" else -1)
        assert set(session.states()[-300:]) == {State.ENGAGED}
        assert session.first(Fault.BAD_PACKETS) == session.first(Fault.NO_REPLY) == -1
        # one tick more or less of a slow press is nothing that could be felt
        assert session.forces()[-1] == pytest.approx(plain.forces()[-1], abs=0.02)
        assert np.abs(np.diff(session.forces()[-300:])).max() < 0.05


def test_a_hiccup_of_30_ms_in_contact_pauses_and_resumes():
    with EmulatedSession(ScriptedFault("silence", FAULT_S, duration_s=0.030)) as session:
        session.run(FAULT_S - 1.5 * TICK_S)
        begins = len(session.records)
        session.run(FAULT_S + 0.3)
        forces = session.forces()[begins - 1 :]
        assert set(session.states()[begins:]) == {State.ENGAGED}
        assert session.faults() == {Fault.NONE}
        assert (forces[22:31] == 0.0).all()
        assert np.abs(np.diff(forces)).max() <= RAMP_STEP_N
        assert forces[-1] == pytest.approx(undisturbed().forces()[-1], abs=0.05)
        silent = [bool(int(record["lamps"]) & Lamp.SILENT) for record in session.records[begins:]]
        assert 20 <= sum(silent) <= 26


def test_a_creeping_encoder_makes_no_more_than_the_torques_of_the_clamp_can():
    """The force of a pose that is believed wrongly: 9.7 N at the grip without a bound on the torques."""
    limits = replace(limits_of(Calibration()), dead_man=False)
    creep = ScriptedFault("creep", HOMED_S + 1.5, size=1000.0)
    with EmulatedSession(creep, limits=limits) as session:
        felt = []
        while session.falcon.time_s < HOMED_S + 3.5 and not session.falcon.gone:
            session.tick()
            felt.append(float(np.linalg.norm(session.falcon.force_N)))
    assert 1.5 < max(felt) <= 1.7 * limits.clamp_N


@pytest.mark.parametrize("counts_a_second", [200.0, 3000.0])
def test_a_leg_that_counts_alone_is_a_fault_before_it_makes_a_force(counts_a_second):
    # held still 15 mm above the tissue, into which the believed grip would go
    hand = firm((0.0, 3.0), ((0.0, 0.0, 0.145),) * 2)
    begins = HOMED_S + 1.0
    with EmulatedSession(ScriptedFault("creep", begins, size=counts_a_second), hand=hand) as session:
        session.run(begins)
        assert session.states()[-1] is State.ENGAGED
        session.run(begins + 170.0 / counts_a_second + 0.05)
        assert session.states()[-1] is State.FAULT
        assert int(session.records[-1]["fault"]) == Fault.LEGS_APART
        # the hand's way there was damped while the force was ramped up
        assert (session.forces()[-round((170.0 / counts_a_second + 0.05) / TICK_S) :] == 0.0).all()


def test_a_stroke_along_two_legs_or_a_trembling_one_along_one_is_a_hand():
    # 12 mm sideways and back, and 0.5 mm of tremor across it
    time_s = np.linspace(1.0, 3.0, 41)
    along, across = 0.006 * np.sin(2.0 * np.pi * (time_s - 1.0)), 0.0005 * np.sin(40.0 * time_s)
    where = [(0.0, 0.0, 0.145), *((0.3 * a + b, -a, 0.145 + b) for a, b in zip(along, across, strict=True))]
    hand = firm((0.0, *time_s.tolist()), tuple(where))
    with EmulatedSession(hand=hand) as session:
        session.run(HOMED_S + 3.0)
        assert session.faults() == {Fault.NONE}


class LateSession(EmulatedSession):
    """A session whose answers come some ticks late: as they come, on their way through a second socket."""

    def __init__(self, late_ticks: int, **settings: object) -> None:
        super().__init__(**settings)
        self.late_ticks = late_ticks

    def __enter__(self) -> Self:
        super().__enter__()
        theirs, self.ours = socket.socketpair()
        self.far = socket.socket(fileno=self.link.descriptor())
        # from here on the driver's own descriptor is one end of the second socket
        os.dup2(theirs.fileno(), self.io.descriptor)
        os.set_blocking(self.io.descriptor, False)
        theirs.close()
        self.ours.setblocking(False)
        self.far.setblocking(False)
        self.answers: list[bytes] = []
        self.link_step, self.link.step = self.link.step, self.pump
        return self

    def __exit__(self, *raised: object) -> None:
        super().__exit__(*raised)
        self.ours.close()
        self.far.close()

    def pump(self) -> None:
        """Commands there at once, answers back when they are due."""
        with contextlib.suppress(BlockingIOError):
            self.far.send(self.ours.recv(4096))
        self.link_step()
        came = b""
        with contextlib.suppress(BlockingIOError):
            came = self.far.recv(4096)
        self.answers.append(came)
        while len(self.answers) > self.late_ticks:
            self.ours.send(self.answers.pop(0))


@pytest.mark.parametrize("late_ticks", [1, 4, 12])
def test_a_late_wire_lights_its_lamp_and_lowers_the_force(late_ticks):
    with LateSession(late_ticks) as session:
        session.run(FAULT_S)
        lamps = [bool(int(record["lamps"]) & Lamp.LATENCY) for record in session.records]
        assert session.states()[-1] is State.ENGAGED
        share = session.servo.guard_memory[GAIN]
        if late_ticks < 2:
            assert not any(lamps)
            assert share == 1.0
        else:
            # before any force
            assert lamps[60]
            assert all(lamps[60:])
            assert share == pytest.approx(1.5 / (1.5 + late_ticks), rel=0.35)
            assert session.forces()[-1] == pytest.approx(share * undisturbed().forces()[-1], rel=0.25)


@pytest.mark.parametrize("at", [0, 6, 15])
def test_lost_answers_now_and_then_are_no_late_wire(monkeypatch, at):
    def spoilt(packet):
        return packet[:at] + bytes([packet[at] ^ 0x20]) + packet[at + 1 :]

    monkeypatch.setitem(emulator.SPOILT, "garbled", spoilt)
    faults = [ScriptedFault("garbled", HOMED_S + 0.3 * k, size=5.0) for k in range(1, 5)]
    with EmulatedSession(*faults) as session:
        session.run(FAULT_S + 0.2)
        assert not any(int(record["lamps"]) & Lamp.LATENCY for record in session.records)


FALCON = ("render", "--preset", "paper-a", "--device", "falcon", "--yes", "--quiet")


@contextlib.contextmanager
def emulated(
    monkeypatch: pytest.MonkeyPatch, *faults: ScriptedFault, **settings: Any
) -> Iterator[EmulatedLink]:
    """An emulated Falcon that ``--device falcon`` finds."""
    device_options = {key: settings.pop(key) for key in ("homing_timeout_s", "firmware") if key in settings}
    given = EmulatorSettings(hand=pressing(), waits_for_blue=True, faults=faults, **settings)
    with EmulatedLink(given, pty=True) as link:
        options = {"port": link.path, "calibration": Calibration(), "limits": LIMITS, **device_options}
        monkeypatch.setattr("tissueid.haptics.registry.configured", lambda *_: options)
        yield link


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "fault"), [one[:2] for one in LASTING])
def test_a_device_that_fails_is_exit_5_with_its_reason_on_the_screen_and_in_the_log(
    monkeypatch, tmp_path, kind, fault
):
    log = tmp_path / "out.h5"
    with emulated(monkeypatch, ScriptedFault(kind, 4.2)) as link:
        run(*FALCON, "--seconds", "30", "--log", log, code=5, said=FAULT_WORDS[fault])
        # a device that is gone can't be told
        assert kind == "unplug" or link.falcon.last_motors == (0, 0, 0)
    kept = read_session_log(log)
    assert kept.summary is not None
    assert (kept.records["fault"][-1], kept.records["state"][-1]) == (fault, State.FAULT)
    assert (kept.records["force_N"][-1] == 0.0).all()
    assert np.abs(kept.records["force_N"]).max() > 0.1


@pytest.mark.slow
def test_firmware_that_fails_twice_is_exit_0(monkeypatch, tmp_path):
    firmware = tmp_path / "any.bin"
    firmware.write_bytes(bytes(range(256)) * 2)
    with emulated(monkeypatch, firmware_loaded=False, failing_tries=2, firmware=firmware) as link:
        run(*FALCON, "--seconds", "1", code=0)
        assert link.falcon.boot.tries == 3


@pytest.mark.slow
def test_homing_that_never_completes_is_exit_5_and_says_what_to_do(monkeypatch):
    with emulated(monkeypatch, homes=False, homing_timeout_s=0.3) as link:
        run(*FALCON, "--seconds", "5", code=5, said="pull the grip all the way out, push it all the way in")
        assert link.falcon.last_motors == (0, 0, 0)
