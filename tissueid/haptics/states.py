"""States of a device, reasons of a fault, and their numbers: the words that guard, servo and log share.

CLOSED, OPEN, FIRMWARE, HOMING, ARMED, ENGAGED in this order; from any of them to FAULT, and to CLOSED.
Force is other than zero in ENGAGED alone, and in FAULT while it is taken back to zero.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag


class State(IntEnum):
    """State of a device."""

    CLOSED = 0
    OPEN = 1
    FIRMWARE = 2
    HOMING = 3
    ARMED = 4
    ENGAGED = 5
    FAULT = 6


class Fault(IntEnum):
    """Why a device went to FAULT."""

    NONE = 0
    TRANSPORT = 1
    NO_REPLY = 2
    BAD_PACKETS = 3
    ENCODER_FROZEN = 4
    ENCODER_JUMP = 5
    NOT_HOMED = 6
    NOT_A_NUMBER = 7
    OVERSPEED = 8
    HEARTBEAT = 9
    PARENT_DIED = 10
    OVERHEATED = 11
    LEGS_APART = 12


class Lamp(IntFlag):
    """Mark of a tick; the flags of a record."""

    NONE = 0
    CLIPPED = 1
    SLEWED = 2
    PASSIVITY = 4
    OUTSIDE_DEPTH = 8
    OUTSIDE_SPEED = 16
    STALLED = 32
    RMS_LIMITED = 64
    DEAD_MAN = 128
    RAMPING = 256
    RUPTURED = 512
    LATE = 2048
    SILENT = 4096
    LATENCY = 8192


#: What a fault is, in words that end a message.
FAULT_WORDS: dict[Fault, str] = {
    Fault.NONE: "no fault",
    Fault.TRANSPORT: "the device is gone: the transport returned an error",
    Fault.NO_REPLY: "the device did not answer in time",
    Fault.BAD_PACKETS: "the device sent too many damaged packets in a row",
    Fault.ENCODER_FROZEN: "no encoder moved although the force changed",
    Fault.ENCODER_JUMP: "an encoder jumped further in one tick than a hand can move it",
    Fault.NOT_HOMED: "the device lost its homing",
    Fault.NOT_A_NUMBER: "the force law returned no finite number",
    Fault.OVERSPEED: "the grip moved faster than a hand that holds it",
    Fault.HEARTBEAT: "the program that owns the session stopped giving signs of life",
    Fault.PARENT_DIED: "the program that owns the session ended",
    Fault.OVERHEATED: "the mean force stayed over the motors' limit",
    Fault.LEGS_APART: "the encoders told of a place or a motion that no hand makes",
}
