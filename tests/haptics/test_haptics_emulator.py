"""The emulated Falcon: its end of the wire, and what lies between its bytes."""

import os
import select
import time
from contextlib import closing, suppress

import numpy as np
import pytest
from command_line import python
from emulator_wire import HOME, HOMED_AFTER, ZERO, angles, command, encoders, homed_bits, homed_falcon

from tissueid.errors import DeviceError, UsageError
from tissueid.haptics.falcon import kinematics
from tissueid.haptics.falcon.emulator import (
    EmulatedFalcon,
    EmulatedLink,
    EmulatorProcess,
    EmulatorSettings,
    ScriptedFault,
    machine,
)
from tissueid.haptics.falcon.emulator.__main__ import main as emulator_main
from tissueid.haptics.hand import Hand


@pytest.fixture
def falcon() -> EmulatedFalcon:
    """In virtual time, a millisecond a command."""
    return EmulatedFalcon(EmulatorSettings(period_s=1e-3))


def test_angles_found_by_search_and_forces_by_differences_are_those_of_the_driver():
    rng, found, force, wanted = np.random.default_rng(8), np.zeros(3), np.zeros(3), np.array([1.0, -2.0, 3.0])
    for direction in rng.normal(size=(30, 3)):
        # in the working sphere of 40 mm about its centre
        place = [0.0, 0.0, 0.13] + 0.04 * direction / np.linalg.norm(direction) * rng.random() ** (1.0 / 3.0)
        assert machine.leg_angles(place, found)
        np.testing.assert_allclose(found, kinematics.inverse(place), atol=1e-12)
        torques = kinematics.torque(place, wanted)
        assert machine.grip_force(place, torques, force)
        # truncation of a central difference over 10 um
        np.testing.assert_allclose(force, wanted, atol=1e-6)


@pytest.mark.parametrize("place", [[0.0, 0.0, 0.25], [0.15, 0.0, 0.1], [0.0, 0.12, 0.13]])
def test_a_place_out_of_reach_is_said(place):
    found, force = np.full(3, 7.0), np.ones(3)
    assert not machine.leg_angles(np.array(place), found)
    assert not machine.grip_force(np.array(place), np.ones(3), force)
    assert (force == 0.0).all()


def test_legs_are_homed_by_a_pull_and_a_push_and_jump_to_their_true_counts(falcon):
    answers = [falcon.receive(HOME) for _ in range(HOMED_AFTER)]
    counts = [encoders(packet) for packet in answers]
    assert (homed_bits(answers[0]), homed_bits(answers[-1])) == (0, 7)
    assert np.abs(np.diff(counts, axis=0)).max() > 200  # the unknown zero of power-up goes
    np.testing.assert_allclose(kinematics.forward(angles(counts[-1])), falcon.position_m, atol=1e-4)
    # before that the counters begin at nought, wherever the grip hangs
    assert np.abs(counts[0]).max() <= 1


@pytest.mark.needs_jit
def test_homed_bits_are_said_only_while_homing_is_commanded_and_forgotten_without():
    falcon = homed_falcon()
    # the dead-man button is held all the time
    assert [falcon.receive(packet)[13] - 0x41 for packet in (HOME, ZERO, HOME)] == [0x74, 0x04, 0x04]
    # a user who never homes is waited for in vain
    assert homed_bits(homed_falcon(homes=False).receive(HOME)) == 0


def test_the_user_waits_for_the_first_homing_command(falcon):
    assert len({falcon.receive(ZERO) for _ in range(100)}) == 1
    assert falcon.time_s == 0.0


@pytest.mark.needs_jit
def test_a_user_who_waits_for_the_blue_lamp_holds_time_up_until_it_is_lit():
    falcon = homed_falcon(waits_for_blue=True)
    assert falcon.time_s == pytest.approx(HOMED_AFTER * 1e-3, abs=2e-3)
    falcon.advance(1.0)
    assert falcon.position_m[2] > 0.170
    waiting = falcon.time_s
    falcon.receive(50 * HOME)
    assert falcon.time_s == waiting
    falcon.receive(10 * command((0, 0, 0), 1 | 4) + HOME)
    assert falcon.time_s == pytest.approx(waiting + 0.010, abs=1.1e-3)


def spoilt_answers(fault: ScriptedFault) -> list[bytes]:
    hand = Hand((0.0, 5.0), ((0.0, 0.0, 0.17), (0.0, 0.0, 0.10)), (1.0, 1.0))
    falcon = homed_falcon(hand=hand, faults=(fault,))
    falcon.advance(3.5 - falcon.time_s)
    return [falcon.receive(HOME) for _ in range(60)]


@pytest.mark.needs_jit
@pytest.mark.parametrize(
    ("fault", "length", "spoilt"),
    [
        (ScriptedFault("short", 3.52), 14, 1),
        (ScriptedFault("doubled", 3.52), 32, 1),
        (ScriptedFault("garbled", 3.52), 16, 1),
        (ScriptedFault("stall", 3.52), 16, 0),
        # lasting ones end when they are over
        (ScriptedFault("silence", 3.51, duration_s=0.020), 0, 20),
        (ScriptedFault("bad packets", 3.51, duration_s=0.020), 16, 20),
    ],
)
def test_a_fault_spoils_one_answer_or_those_of_its_time(fault, length, spoilt):
    answers = spoilt_answers(fault)
    bad = [one for one in answers if len(one) != 16 or not set(one[1:13]) <= set(b"ABCDEFGHIJKLMNOP")]
    assert len(bad) == pytest.approx(spoilt, abs=1 if spoilt > 1 else 0)
    assert {len(one) for one in bad} <= {length}
    assert answers[0] not in bad
    assert answers[-1] not in bad


@pytest.mark.needs_jit
def test_encoders_that_are_frozen_stand_still():
    assert len({packet[1:13] for packet in spoilt_answers(ScriptedFault("frozen", 3.51))[15:]}) == 1


def exchange(descriptor: int, data: bytes) -> bytes:
    os.write(descriptor, data)
    return os.read(descriptor, 512) if select.select([descriptor], [], [], 5.0)[0] else b""


@pytest.mark.parametrize("pty", [False, True])
def test_it_answers_over_a_link_and_hangs_up_when_unplugged(pty):
    settings = EmulatorSettings(period_s=1e-3, faults=(ScriptedFault("unplug", 0.010),))
    with EmulatedLink(settings, pty=pty) as link:
        host = link.descriptor()
        answers = [exchange(host, HOME) for _ in range(9)]
        assert {len(packet) for packet in answers} == {16}
        os.write(host, HOME * 2)
        deadline = time.monotonic() + 5.0
        # a socket ends with no bytes, a terminal with an error
        with suppress(OSError):
            while os.read(host, 512):
                assert time.monotonic() < deadline
        os.close(host)


@pytest.mark.needs_jit
def test_in_real_time_the_arm_moves_between_commands():
    with EmulatedLink(EmulatorSettings()) as link:
        host = link.descriptor()
        exchange(host, HOME)
        begin = link.falcon.time_s
        start = time.monotonic()
        time.sleep(0.2)
        exchange(host, HOME)
        waited = time.monotonic() - start
        # time that had gone by unnoticed before the first look counts too
        assert 0.1 < link.falcon.time_s - begin <= waited + 0.1
        os.close(host)


@pytest.mark.needs_jit
def test_it_runs_as_a_process_of_its_own_and_ends_with_its_owner():
    with closing(EmulatorProcess(["--hand", "hold", "--fault", "silence@30"])) as emulator:
        host = os.open(emulator.path, os.O_RDWR | os.O_NOCTTY)
        assert len(exchange(host, HOME)) == 16
        os.close(host)
    with pytest.raises(ProcessLookupError):
        os.kill(emulator._process.pid, 0)


@pytest.mark.parametrize(
    "moved_by", [["--hand", "slow press"], ["--script", "indent 2 mm at 5 mm/s"], ["--sweep"], []]
)
def test_its_command_says_where_it_is_and_ends_with_its_input(monkeypatch, capsys, moved_by):
    reading, writing = os.pipe()
    os.close(writing)
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setattr("os.sched_setscheduler", lambda *_: None)
    with os.fdopen(reading) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        assert emulator_main(["--until-eof", "--no-firmware", *moved_by]) == 0
    assert capsys.readouterr().out.startswith("emulated Falcon at /dev/")


def test_a_script_that_is_too_long_for_it_is_refused_in_one_line(capsys):
    script = ";".join(f"indent {depth} mm at 50 mm/s; hold 0.1 s" for depth in range(1, 31))
    assert emulator_main(["--script", script]) == 2
    assert "58 fit" in capsys.readouterr().err


def test_a_process_that_can_not_start_says_why():
    with pytest.raises(DeviceError, match="there is no fault 'melt'"):
        EmulatorProcess(["--fault", "melt@3"])


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("unplug@6", ScriptedFault("unplug", 6.0)),
        ("jump@6.5:300", ScriptedFault("jump", 6.5, size=300.0)),
        ("bad packets@5/0.5", ScriptedFault("bad packets", 5.0, 0.5)),
        ("stall@5:100/0.2", ScriptedFault("stall", 5.0, 0.2, 100.0)),
        *((text, None) for text in ("unplug", "unplug@soon", "jump@5:x", "melt@5")),
    ],
)
def test_faults_are_read_and_those_that_are_none_refused(text, fault):
    if fault is not None:
        assert machine.parse_fault(text) == fault
        return
    with pytest.raises(UsageError, match="no fault"):
        machine.parse_fault(text)


@pytest.mark.needs_jit
def test_an_emulator_is_compiled_before_it_answers():
    # at the first force of a first start it was silent for half a second, which ends a session
    program = (
        "from tissueid.haptics.falcon.emulator import EmulatedFalcon, EmulatorSettings\n"
        "from tissueid.haptics.falcon.emulator import machine\n"
        "EmulatedFalcon(EmulatorSettings())\n"
        "print([len(one.signatures) for one in (machine.grip_force, machine.arm_step, machine.leg_angles)])"
    )
    assert python("-c", program).stdout == "[1, 1, 1]\n"


HELLO, GREETING = b"\nC\r", b"\nD,\r"


@pytest.mark.parametrize(
    ("packet", "motors", "homing", "lamps"),
    [
        (ZERO, (0, 0, 0), False, set()),
        (b"<AAAAAAAAAAAADA>", (0, 0, 0), True, {"green"}),
        (b"<AAAAAAAAAAAAPA>", (0, 0, 0), True, {"green", "blue", "red"}),
        (b"<PPPAAAAABAAAIA>", (4095, 0, 1), False, {"red"}),
        (command((-4095, 12, -1), 4), (-4095, 12, -1), False, {"blue"}),
    ],
)
def test_commands_are_read_as_published(packet, motors, homing, lamps):
    (found,) = machine.CommandReader().feed(packet)
    assert (found.motors, found.homing, set(found.lamps)) == (motors, homing, lamps)


def test_the_loader_answers_at_its_rates_only_and_starts_at_the_last():
    falcon = EmulatedFalcon(EmulatorSettings(firmware_loaded=False, period_s=1e-3))
    falcon.set_baud(1_500_000)
    assert (falcon.receive(ZERO), falcon.receive(HELLO)) == (b"", b"")
    falcon.set_baud(9600)
    assert falcon.receive(HELLO) == GREETING
    falcon.set_baud(140_000)  # what a tty makes of the divisor is 1.5 % off
    assert falcon.receive(b"A") == b"A"
    falcon.set_baud(9600)
    assert falcon.receive(b"firmware") == b""
    falcon.set_baud(140_000)
    assert falcon.receive(b"firmware") == b"firmware"
    assert not falcon.running
    falcon.set_baud(1_500_000)
    assert falcon.running
    assert len(falcon.receive(HOME)) == 16
