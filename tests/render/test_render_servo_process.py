"""The servo's process: it starts, obeys, and ends in zero force whatever happens to it or its owner."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from command_line import until
from test_render_servo_tick import DEEP_M, tissue

from tissueid.errors import DeviceError, UsageError
from tissueid.haptics import registry
from tissueid.haptics.hand import Hand
from tissueid.haptics.parameter_block import COMMAND_ENGAGE, COMMAND_STOP
from tissueid.haptics.sim import CENTRE_M, SimulatedDevice
from tissueid.haptics.states import Fault, Lamp, State
from tissueid.rendering import servo_process
from tissueid.rendering.servo import ServoEnd, ServoPlan, ServoProcess, receive_plan, send_line, send_plan
from tissueid.rendering.servo_spawn import spawn_servo

#: A hand that presses 10 mm deep within half a second of the end of the start-up ramp.
PRESS = Hand((0.0, 1.2, 1.5, 60.0), (CENTRE_M, CENTRE_M, DEEP_M, DEEP_M), (1.0,) * 4)
PLAN = ServoPlan("sim", {"real_time": True, "hand": PRESS})
#: Ctrl-Z would stop the process, Ctrl-\ kill it, with the last force commanded; the others take their time.
OTHERS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR1)
SIGNALS = [signal.SIGTSTP, signal.SIGQUIT, *(pytest.param(one, marks=pytest.mark.slow) for one in OTHERS)]
#: Long enough for a loaded machine.
PATIENCE_S = 20.0


def pressed(servo: ServoProcess) -> np.ndarray:
    """Engage on tissue and wait until a force is on; its last record."""
    servo.block.write(tissue())
    servo.engage()
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        servo.beat()
        time.sleep(0.02)
        records, _ = servo.records.read_new()
        if records.size and np.linalg.norm(records["force_N"][-1]) > 0.2:
            return records[-1]
    pytest.fail("no force came")


def ended(servo: ServoProcess) -> ServoEnd:
    """Wait for the end without a sign of life."""
    until(lambda: servo.poll() is not None, PATIENCE_S)
    return servo.end


def sockets() -> tuple[int, int]:
    """Both ends of an owner's socket."""
    theirs, ours = socket.socketpair()
    return theirs.detach(), ours.detach()


def forces(servo: ServoProcess) -> np.ndarray:
    return np.linalg.norm(servo.records.read_new()[0]["force_N"], axis=1)


@pytest.mark.needs_jit
class TestProcess:
    def test_it_presses_and_ends_as_its_owner_wishes(self):
        with ServoProcess(PLAN) as servo:
            last = pressed(servo)
            assert servo.ready.compiled
            assert last["state"] == State.ENGAGED
            assert last["version"] == servo.block.taken == 1
        assert servo.end.reason == "stopped"
        assert servo.end.fault is Fault.NONE
        assert servo.end.statistics.ticks == servo.ring.published
        assert servo.end.statistics.scheduling == servo.ready.scheduling

    def test_an_owner_that_falls_silent_is_damping_then_a_fault(self):
        with ServoProcess(PLAN) as servo:
            pressed(servo)
            silent = time.monotonic()
            end = ended(servo)
            took = time.monotonic() - silent
            size = forces(servo)
        assert (end.reason, end.fault, end.state) == ("fault", Fault.HEARTBEAT, State.FAULT)
        # damped after half a second, for a while
        assert 0.4 < took < 7.0
        assert np.all(size[-20:] == 0.0)
        assert "stopped giving signs of life" in end.message

    @pytest.mark.parametrize("number", SIGNALS)
    def test_a_signal_ends_it_over_a_ramp_with_the_device_closed(self, number):
        with ServoProcess(PLAN) as servo:
            pressed(servo)
            os.kill(servo._spawned.process.pid, number)
            end = ended(servo)
            records = servo.records.read_new()[0]
        assert end.reason == "signal"
        # the owner still wants force: it goes all the same, in the loop and its records
        assert set(records["state"][-20:]) == {State.ARMED}
        assert np.all(records["force_N"][-20:] == 0.0)
        assert np.all(records["lamps"][-90:-20] & Lamp.RAMPING)
        assert servo._spawned.process.returncode == 0

    def test_a_killed_process_is_told_of_and_its_owner_takes_the_force_away(self, monkeypatch):
        done = []

        class Motors:
            capabilities = replace(SimulatedDevice().capabilities, hardware=True)

            def __init__(self, **options):
                assert options == PLAN.options

            def open(self):
                done.append("opened")

            def close(self):
                done.append("closed with zero force")

        servo = ServoProcess(PLAN)
        servo.start()
        monkeypatch.setattr(registry, "device_class", lambda _name: Motors)
        os.kill(servo._spawned.process.pid, signal.SIGKILL)
        with pytest.raises(DeviceError, match=r"died without a word.*-9"):
            ended(servo)
        servo.close()
        assert done == ["opened", "closed with zero force"]

    def test_a_device_that_refuses_says_so_through_the_process(self):
        with pytest.raises(UsageError, match="no device named 'simm'"):
            ServoProcess(ServoPlan("simm")).start()

    def test_a_process_that_waited_for_its_plan_runs_it(self):
        spawned = spawn_servo()
        plan = ServoPlan("sim", {"real_time": True}, ticks=30, alive_wanted=False)
        with ServoProcess(plan, spawned=spawned) as servo:
            end = ended(servo)
        assert end.statistics.ticks == 30
        assert spawned.process.returncode == 0
        assert spawned.close() is None


def test_a_process_that_may_not_compile_says_so(monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", "1")
    plan = ServoPlan("sim", {"real_time": True}, ticks=20, alive_wanted=False)
    with ServoProcess(plan) as servo:
        assert not servo.ready.compiled
        assert ended(servo).reason == "ticks"


class TestSpawned:
    def test_a_process_that_gets_no_plan_is_ended_without_a_word(self, capfd):
        spawned = spawn_servo()
        spawned.close()
        assert spawned.process.returncode == -signal.SIGTERM
        assert capfd.readouterr() == ("", "")

    def test_the_signals_of_a_terminal_are_its_owner_s_alone(self):
        spawned = spawn_servo()
        assert os.getsid(spawned.process.pid) == spawned.process.pid != os.getsid(0)
        spawned.close()


@pytest.mark.needs_jit
@pytest.mark.usefixtures("same_priority")
class TestInOneProcess:
    """The process's own code, called here, where coverage sees it."""

    def test_a_plan_is_run_to_its_last_tick_and_reported(self, pipes):
        pipes.block.order(COMMAND_ENGAGE)
        assert pipes.main(ServoPlan("sim", ticks=120, alive_wanted=False)) == 0
        lines = pipes.told().splitlines()
        assert [line.split('"')[3] for line in lines] == ["ready", "ended"]
        assert (pipes.ring.published, pipes.ring.records["state"][119]) == (120, State.ENGAGED)

    def test_the_death_of_the_owner_is_a_fault(self, pipes):
        os.close(pipes.ours)
        end = pipes.run(ServoPlan("sim", ticks=2000))
        assert end.fault is Fault.PARENT_DIED
        assert end.reason == "fault"
        # seen within 5 ms, and 20 zeros
        assert pipes.ring.published < 100

    def test_an_owner_that_dies_before_it_sent_a_plan_ends_it_without_a_word(self, pipes, capfd):
        os.close(pipes.ours)
        assert pipes.main() == 5
        assert capfd.readouterr() == ("", "")

    def test_the_wish_to_end_ends_it(self, pipes):
        pipes.block.order(COMMAND_STOP)
        assert pipes.run(ServoPlan("sim", ticks=2000)).reason == "stopped"
        assert pipes.ring.published == 20

    def test_a_signal_is_seen_by_the_loop(self, pipes):
        before = signal.getsignal(signal.SIGTERM)
        program = f"import os, time; time.sleep(0.5); os.kill({os.getpid()}, 15)"
        killer = subprocess.Popen([sys.executable, "-c", program])
        end = pipes.run(ServoPlan("sim", alive_wanted=False, ticks=20_000))
        killer.wait()
        assert end.reason == "signal"
        assert signal.getsignal(signal.SIGTERM) is before

    def test_what_the_device_refuses_is_reported_with_its_kind(self, pipes):
        assert pipes.main(ServoPlan("flacon")) == 2
        assert '"kind": "UsageError"' in pipes.told()

    def test_a_law_in_python_runs_uncompiled_and_says_so(self, pipes, monkeypatch):
        monkeypatch.setattr(servo_process, "environment_law", lambda name: lambda p, v, dt: 0.0 * p)
        plan = ServoPlan("sim", {"real_time": True}, law="nothing", ticks=80, alive_wanted=False)
        pipes.block.order(COMMAND_ENGAGE)
        assert pipes.run(plan).reason == "ticks"
        assert '"compiled": false' in pipes.told()

    @pytest.mark.parametrize(
        ("fails", "said"),
        [
            (lambda: 1 / 0, "broken raised ZeroDivisionError: division by zero"),
            (lambda: sys.exit(3), "broken raised SystemExit: 3"),
            (lambda: [1.0, 2.0], "broken raised ValueError: cannot reshape"),
            (lambda: time.sleep(3.0), "broken did not return within 50 ms"),
            (lambda: stubborn(), "broken did not return within 50 ms"),
        ],
    )
    def test_a_law_that_fails_or_does_not_return_ends_in_zero_force(self, pipes, monkeypatch, fails, said):
        calls = []

        def broken(position_m, velocity_m_per_s, dt_s):
            calls.append(time.monotonic())
            # force waits for a law that gives none at first
            return fails() if len(calls) > 400 else np.array([0.0, 0.0, 0.5 * (len(calls) > 200)])

        monkeypatch.setattr(servo_process, "environment_law", lambda name: broken)
        before = signal.getsignal(signal.SIGALRM)
        plan = ServoPlan("sim", {"real_time": True}, law="broken", ticks=2000, alive_wanted=False)
        pipes.block.order(COMMAND_ENGAGE)
        end = pipes.run(plan)
        assert (end.reason, end.fault, len(calls)) == ("fault", Fault.NOT_A_NUMBER, 401)
        assert end.message.startswith(f"the servo took the force away: {said}")
        records = pipes.ring.records[: pipes.ring.published]
        forces = np.abs(records["force_N"]).max(axis=1)
        assert forces[-1] == 0.0 < forces.max()
        assert records["time_s"][np.flatnonzero(forces)[-1]] - calls[-1] < 0.5
        assert signal.getsignal(signal.SIGALRM) is before


def stubborn():
    """Spin, and swallow what may be swallowed."""
    while True:
        with contextlib.suppress(Exception):
            while True:
                pass


class TestPlan:
    def test_a_plan_arrives_as_it_was_sent(self):
        reading, writing = sockets()
        shared = [os.memfd_create(name) for name in ("ring", "block")]
        send_plan(writing, PLAN, *shared)
        got, received = receive_plan(reading)
        os.close(writing)
        with pytest.raises(EOFError):
            receive_plan(reading)
        os.close(reading)
        same = [os.path.sameopenfile(*two) for two in zip(shared, received, strict=True)]
        for descriptor in (*shared, *received):
            os.close(descriptor)
        assert same == [True, True]
        assert (got.device, got.options["real_time"]) == ("sim", True)
        assert got.options["hand"].times_s == PRESS.times_s

    def test_an_owner_that_dies_in_the_middle_of_a_plan_sent_none(self):
        reading, writing = sockets()
        os.write(writing, (1000).to_bytes(8, "little") + b"half a plan")
        os.close(writing)
        with pytest.raises(EOFError):
            receive_plan(reading)
        os.close(reading)

    def test_a_report_that_nobody_reads_is_no_error(self):
        reading, writing = os.pipe()
        os.close(reading)
        assert send_line(writing, event="ready") is None
        # the descriptor is still the caller's to close
        os.close(writing)
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(writing)
