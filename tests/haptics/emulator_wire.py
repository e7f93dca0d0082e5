"""Bytes to and from a Falcon, spelled here by hand: tests of the emulator need nothing of the driver."""

from collections.abc import Iterable

import numpy as np

from tissueid.haptics.falcon.emulator import EmulatedFalcon, EmulatorSettings

LETTERS = "ABCDEFGHIJKLMNOP"
ZERO = b"<AAAAAAAAAAAAAA>"
HOME = b"<AAAAAAAAAAAABA>"
#: Commands after which the emulated user has pulled and pushed the grip, at a millisecond each.
HOMED_AFTER = 2400


def spelled(numbers: Iterable[int]) -> bytes:
    """Four letters of each signed number, least significant first."""
    digits = "".join(f"{value & 0xFFFF:04x}"[::-1] for value in numbers)
    return "".join(LETTERS[int(digit, 16)] for digit in digits).encode()


def command(motors: tuple[int, int, int], flags: int = 1) -> bytes:
    """A command packet of motor units; flag 1 is homing mode."""
    return b"<" + spelled(motors) + LETTERS[flags].encode() + b"A>"


def encoders(packet: bytes) -> list[int]:
    """The three counts of a reply packet."""
    nibbles = np.frombuffer(packet[1:13], np.uint8).reshape(3, 4) - ord("A")
    return (nibbles @ (1, 16, 256, 4096)).astype(np.int16).tolist()


def homed_bits(packet: bytes) -> int:
    return (packet[13] - 0x41) >> 4


def homed_falcon(**settings: object) -> EmulatedFalcon:
    """An emulated Falcon in virtual time whose user has homed it."""
    falcon = EmulatedFalcon(EmulatorSettings(period_s=1e-3, **settings))
    falcon.receive(HOME)
    falcon.advance(1e-3 * HOMED_AFTER)
    return falcon


def angles(counts: list[int]) -> np.ndarray:
    """Thigh angles [rad] of counts, 9881 to a turn."""
    return np.radians(35.0 + 0.0364347 * (np.array(counts) + 0.5))
