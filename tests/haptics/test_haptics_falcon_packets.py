"""Packets of the Falcon against published vectors, tables written here, and garbage."""

import re

import numpy as np
import pytest
from emulator_wire import command, encoders, spelled

from tissueid.haptics.falcon.packets import PACKET_BYTES, PacketParser, Reply, encode_command, encode_into

#: What may stand before the end bracket.
FILLERS = [bytes([byte]) for byte in range(256) if byte not in b"<>"]
#: A whole reply, as falcon firmware is described: the oracle of what is in a stream.
WHOLE = re.compile(rb"<[A-P]{12}[\x41-\xc0][^<>]>", re.DOTALL)


def reply_by_table(counts: tuple[int, int, int], homed: int, buttons: int, filler: bytes = b"A") -> bytes:
    return b"<" + spelled(counts) + bytes([0x41 + 16 * homed + buttons]) + filler + b">"


def read_by_table(packet: bytes) -> Reply:
    first, second, third = encoders(packet)
    return Reply((first, second, third), *divmod(packet[13] - 0x41, 16))


def drawn_reply(random: np.random.Generator) -> bytes:
    filler = FILLERS[random.integers(len(FILLERS))]
    counts = tuple(random.integers(-32768, 32768, 3).tolist())
    return reply_by_table(counts, int(random.integers(8)), int(random.integers(16)), filler)


@pytest.mark.parametrize(
    ("leds", "homing", "letter"), [(0, False, b"A"), (0x02, True, b"D"), (0x0E, True, b"P")]
)
def test_published_commands_are_made(leds, homing, letter):
    assert encode_command((0, 0, 0), leds=leds, homing=homing) == b"<AAAAAAAAAAAA" + letter + b"A>"


def test_every_motor_value_is_coded_as_by_the_table():
    for value in range(-4095, 4096, 7):
        motors = (value, -value, 4095)
        assert encode_command(motors, leds=0, homing=False) == command(motors, 0)


def test_every_encoder_value_and_status_is_read_as_by_the_table():
    assert PacketParser().feed(b"<BAAAPPPPAAAAAA>") == [Reply((1, -1, 0), 0, 0)]
    replies = [Reply((value, -1 - value, 32767), 5, 9) for value in range(-32768, 32768, 97)]
    replies += [Reply((0, 0, 0), homed, buttons) for homed in range(8) for buttons in range(16)]
    for reply in replies:
        packet = reply_by_table(*reply)
        assert PacketParser().feed(packet) == [read_by_table(packet)] == [reply]


@pytest.mark.parametrize(
    ("motor", "leds", "homing"),
    [
        *((motor, 0, False) for motor in ((4096, 0, 0), (0, -4096, 0), (0, 0), (0,) * 4)),
        *((motor, 0, False) for motor in ((0.5, 0, 0), (float("nan"), 0, 0))),
        *(((0, 0, 0), leds, False) for leds in (0x01, 0x10, -2)),
        ((0, 0, 0), 0, "yes"),
    ],
)
def test_what_no_command_holds_is_refused(motor, leds, homing):
    with pytest.raises(ValueError, match=r"command|integers|LED|homing"):
        encode_command(motor, leds=leds, homing=homing)


def test_numpy_integers_are_integers_and_a_value_no_motor_has_is_sent_as_zero():
    plain = encode_command((1, -2, 4095), leds=4, homing=True)
    assert encode_command(np.array([1, -2, 4095]), leds=np.int64(4), homing=np.bool_(True)) == plain
    out = np.zeros(PACKET_BYTES, np.uint8)
    encode_into(np.array([0, 4096, 17]), 0x02, True, out)
    assert out.tobytes() == b"<AAAAAAAAAAAADA>"


def garbage(random: np.random.Generator) -> bytes:
    """Bytes that look like packets as much as they can: letters, brackets, pieces of replies."""
    length, cut, whole = int(random.integers(1, 60)), int(random.integers(16)), drawn_reply(random)
    kinds = (
        random.bytes(length),
        bytes(random.choice(np.frombuffer(b"<<>>ABCDEFGHIJKLMNOP", np.uint8), length)),
        whole[: min(cut + 1, 15)],
        whole[:cut] + whole[cut + 1 :],
        whole[:cut] + random.bytes(int(random.integers(1, 3))) + whole[cut:],
    )
    return kinds[random.integers(len(kinds))]


@pytest.mark.needs_jit
def test_a_million_bytes_of_garbage_hide_no_packet_and_invent_none():
    """Garbage of all kinds, some 20 bytes a piece, with whole replies inside."""
    random, stream, inside = np.random.default_rng(5), bytearray(), []
    for _ in range(38_000):
        stream += garbage(random)
        if random.random() < 0.5:
            inside.append(drawn_reply(random))
            stream += inside[-1]
    stream = bytes(stream)
    assert len(stream) > 1_000_000
    expected = [read_by_table(found) for found in WHOLE.findall(stream)]
    parser = PacketParser()
    found = parser.feed(stream)
    assert found == expected
    # replies cannot overlap, so each that was put in is in the oracle's list, in order
    remaining = iter(found)
    assert all(read_by_table(packet) in remaining for packet in inside)
    assert parser.packets == len(found) > 15_000
    assert PACKET_BYTES * parser.packets + parser.dropped == pytest.approx(len(stream), abs=PACKET_BYTES)


@pytest.mark.parametrize(
    "before", [b"", b"<", b"<<<<", b"<AAAAAAAAAAAAAA", b"<AAAA<A", b">", b"<AAAAAAAAAAAA<", b"\x00<"]
)
def test_a_published_reply_is_read_whatever_bracket_stands_before_it(before):
    parser = PacketParser()
    assert parser.feed(before + b"<HNGPOKOPFPOPAA>") == [Reply((-2345, -338, -267), 0, 0)]
    assert (parser.invalid, parser.dropped) == (before.count(b"<"), len(before))


def test_a_reply_two_bytes_short_never_reads_as_homed():
    # the end bracket would stand where the status byte does, and look like all legs homed
    short = reply_by_table((5, 6, 7), 0, 0)[:13] + b">"
    parser = PacketParser()
    assert parser.feed(short * 50) == []
    assert parser.invalid == 50
    assert [reply.homed for reply in parser.feed(short + reply_by_table((5, 6, 7), 0, 3))] == [0]


@pytest.mark.parametrize(
    ("at", "byte"),
    [(1, 0x40), (1, 0x51), (12, 0x61), (13, 0x40), (13, 0xC1), (14, 0x3C), (14, 0x3E), (15, 0x41)],
)
def test_bytes_out_of_their_range_are_dropped_and_counted(at, byte):
    good = reply_by_table((1, 2, 3), 7, 0)
    parser = PacketParser()
    assert parser.feed(good[:at] + bytes([byte]) + good[at + 1 :] + good) == [Reply((1, 2, 3), 7, 0)]
    # a bracket at byte 14 may begin a reply, which the last byte then breaks
    assert parser.invalid in (1, 2)
    assert (parser.packets, parser.dropped) == (1, PACKET_BYTES)
