"""The emulated Falcon's end of the wire: published vectors, garbage, firmware upload."""

from __future__ import annotations

import numpy as np
import pytest
from emulator_wire import HOME, ZERO, command

from tissueid.haptics.falcon.emulator import EmulatedFalcon, EmulatorSettings
from tissueid.haptics.falcon.emulator.wire import BootLoader, CommandReader, reply_bytes
from tissueid.haptics.falcon.packets import PacketParser, encode_command

HELLO, GREETING = b"\nC\r", b"\nD,\r"


@pytest.mark.parametrize(
    ("encoders", "packet"),
    [((-2345, -338, -267), b"<HNGPOKOPFPOPAA>"), ((1, -1, 0), b"<BAAAPPPPAAAAAA>")],
)
def test_replies_are_spelled_as_recorded(encoders, packet):
    assert reply_bytes(encoders, buttons=0, homed=0) == packet


def test_byte_thirteen_of_a_reply_carries_buttons_and_homed_legs():
    packet = reply_bytes((0, 0, 0), buttons=0b1010, homed=0b101)
    assert packet[13] == 0x41 + 0x0A + 0x50
    assert reply_bytes((0, 0, 0), buttons=15, homed=7)[13] == 0xC0


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
    (found,) = CommandReader().feed(packet)
    assert (found.motors, found.homing, set(found.lamps)) == (motors, homing, lamps)


def test_driver_and_emulator_spell_every_number_alike():
    rng = np.random.default_rng(11)
    reader, parser = CommandReader(), PacketParser()
    for _ in range(500):
        motors = tuple(int(value) for value in rng.integers(-4095, 4096, 3))
        leds, homing = int(rng.integers(0, 8)) << 1, bool(rng.integers(0, 2))
        (heard,) = reader.feed(encode_command(motors, leds=leds, homing=homing))
        assert (heard.motors, heard.homing) == (motors, homing)
        assert len(heard.lamps) == leds.bit_count()
        counts = tuple(int(value) for value in rng.integers(-32768, 32768, 3))
        buttons, homed = int(rng.integers(0, 16)), int(rng.integers(0, 8))
        (said,) = parser.feed(reply_bytes(counts, buttons=buttons, homed=homed))
        assert (tuple(said.encoders), said.buttons, said.homed) == (counts, buttons, homed)


def test_commands_are_found_in_any_pieces_and_among_garbage():
    rng = np.random.default_rng(3)
    sent, stream = [], b""
    for _ in range(300):
        # garbage of letters that could belong to a packet, but never ends one
        stream += bytes(rng.choice(np.frombuffer(b"<ABCPQ\x00\xff", np.uint8), rng.integers(0, 20)))
        motors = tuple(int(value) for value in rng.integers(-4095, 4096, 3))
        sent.append(motors)
        stream += command(motors)
    reader, heard = CommandReader(), []
    at = 0
    while at < len(stream):
        size = int(rng.integers(1, 40))
        heard += [found.motors for found in reader.feed(stream[at : at + size])]
        at += size
    assert heard == sent
    assert reader.dropped == len(stream) - 16 * len(sent)


@pytest.mark.parametrize(
    "spoilt", [b"<AAAAQAAAAAAAAA>", b"<AAAAAAAAAAAAQA>", b"<AAAAAAAAAAAAAAA", b"AAAAAAAAAAAAAAA>"]
)
def test_what_is_no_command_gets_no_answer(spoilt):
    falcon = EmulatedFalcon(EmulatorSettings(period_s=1e-3))
    assert falcon.receive(spoilt) == b""
    assert falcon.commands == 0
    assert len(falcon.receive(ZERO)) == 16


def uploaded(boot: BootLoader, firmware: bytes) -> list[bytes]:
    """Answers to a greeting, a start and the chunks of a firmware."""
    return [boot.feed(HELLO)[0], boot.feed(b"A")[0]] + [
        boot.feed(firmware[at : at + 62])[0] for at in range(0, len(firmware), 62)
    ]


@pytest.mark.parametrize("long_greeting", [False, True])
def test_an_upload_is_greeted_and_echoed_byte_for_byte(long_greeting):
    firmware = bytes(range(256)) * 2
    boot = BootLoader(firmware_bytes=len(firmware), long_greeting=long_greeting)
    answers = uploaded(boot, firmware)
    assert answers[:2] == [(b"\x00" if long_greeting else b"") + GREETING, b"A"]
    assert b"".join(answers[2:]) == firmware
    assert boot.tries == 1


def test_an_upload_that_is_to_fail_shows_in_its_echo_and_the_next_start_works():
    firmware = bytes(300)
    boot = BootLoader(firmware_bytes=len(firmware), failing_tries=2)
    for _ in range(2):
        assert b"".join(uploaded(boot, firmware)[2:]) != firmware
    assert b"".join(uploaded(boot, firmware)[2:]) == firmware
    assert boot.tries == 3


def test_the_loader_answers_at_its_rates_only_and_starts_at_the_last():
    boot = BootLoader(firmware_bytes=None)
    assert not boot.set_baud(1_500_000)
    assert boot.feed(HELLO)[0] == b""
    boot.set_baud(9600)
    assert boot.feed(HELLO)[0] == GREETING
    boot.set_baud(140_000)  # what a tty makes of the divisor is 1.5 % off
    assert boot.feed(b"A")[0] == b"A"
    assert boot.feed(b"firmware")[0] == b"firmware"
    assert boot.set_baud(1_500_000)


def test_greetings_may_stay_unanswered():
    boot = BootLoader(firmware_bytes=10, silent_hellos=3)
    assert [boot.feed(HELLO)[0] for _ in range(4)] == [b"", b"", b"", GREETING]


def test_requests_of_the_serial_chip_reach_the_loader():
    falcon = EmulatedFalcon(EmulatorSettings(firmware_loaded=False, period_s=1e-3))
    assert falcon.receive(ZERO) == b""
    for request, value in (
        (0, 1),
        (0, 2),
        (9, 16),
        (3, 0x4138),
        (4, 8),
        (2, 0),
        (1, 0x0200),
        (1, 0x0100),
        (1, 0x0101),
    ):
        falcon.control(request, value)
    assert falcon.receive(HELLO) == GREETING
    falcon.control(3, 0x0015)
    assert falcon.receive(b"A") == b"A"
    assert falcon.receive(b"some firmware") == b"some firmware"
    assert not falcon.running
    falcon.control(3, 0x0002)
    assert falcon.running
    assert len(falcon.receive(HOME)) == 16
