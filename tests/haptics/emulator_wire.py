"""Bytes for an emulated Falcon, spelled here by hand: tests of the emulator need nothing of the driver."""

from __future__ import annotations

import numpy as np

from tissueid.haptics.falcon.emulator import EmulatedFalcon, EmulatorSettings

LETTERS = "ABCDEFGHIJKLMNOP"
ZERO = b"<AAAAAAAAAAAAAA>"
HOME = b"<AAAAAAAAAAAABA>"
#: Commands after which the emulated user has pulled and pushed the grip, at a millisecond each.
HOMED_AFTER = 2400


def command(motors: tuple[int, int, int], flags: int = 1) -> bytes:
    """A command packet of motor units; flag 1 is homing mode."""
    body = ""
    for value in motors:
        digits = f"{value & 0xFFFF:04x}"
        body += "".join(LETTERS[int(digit, 16)] for digit in reversed(digits))
    return f"<{body}{LETTERS[flags]}A>".encode()


def encoders(packet: bytes) -> list[int]:
    """The three counts of a reply packet."""
    values = []
    for leg in range(3):
        hexadecimal = "".join(
            f"{LETTERS.index(chr(letter)):x}" for letter in reversed(packet[1 + 4 * leg : 5 + 4 * leg])
        )
        value = int(hexadecimal, 16)
        values.append(value - 65536 if value >= 32768 else value)
    return values


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
