"""Messages of a page: four short ones of JSON, each checked before anything is done with it.

::

    {"v": 1, "answer": 42}                     42 frames have arrived
    {"v": 1, "pointer": [0.0, 0.01, 0.12]}     lead the simulated hand there [m, device frame]
    {"v": 1, "pointer": null}                  let go: the hand leaves the tissue
    {"v": 1, "play": {"at_s": 3.5, "paused": false}}    where a log is read, and whether it goes on

There is no message that changes a tissue, a scale, a force or a file.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

VERSION = 1
#: The longest of them takes half of this [bytes].
LARGEST_MESSAGE = 256
#: A pointer lies within this of the device's origin along each axis [m].
REACH_M = 0.3
#: A log is shorter than this [s]; a count of frames smaller than that.
LONGEST_LOG_S = 1e6
MOST_FRAMES = 2**53


@dataclass(frozen=True, slots=True)
class Answer:
    """So many frames have arrived."""

    count: int


@dataclass(frozen=True, slots=True)
class Pointer:
    """Goal of the hand [m], or None to let go."""

    position_m: tuple[float, float, float] | None


@dataclass(frozen=True, slots=True)
class Play:
    """Place in a log [s from its begin], or None to stay, and if it stands still."""

    at_s: float | None
    paused: bool


Message = Answer | Pointer | Play


def parse_message(text: str) -> Message | None:
    """Read a message; None for whatever is none.

    ``text``: at most :data:`LARGEST_MESSAGE` characters, or it is none.
    """
    if len(text) > LARGEST_MESSAGE:
        return None
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(found, dict) or len(found) != 2:
        return None
    version = found.pop("v", None)
    if type(version) is not int or version != VERSION:
        return None
    kind, value = found.popitem()
    if kind == "answer":
        return Answer(value) if type(value) is int and 0 <= value < MOST_FRAMES else None
    if kind == "pointer":
        return _pointer(value)
    return _play(value) if kind == "play" else None


def _pointer(value: object) -> Pointer | None:
    if value is None:
        return Pointer(None)
    if not isinstance(value, list) or len(value) != 3:
        return None
    if not all(type(one) in {int, float} and abs(one) <= REACH_M for one in value):
        return None
    return Pointer((float(value[0]), float(value[1]), float(value[2])))


def _play(value: object) -> Play | None:
    if not isinstance(value, dict) or not value.keys() <= {"at_s", "paused"}:
        return None
    at_s, paused = value.get("at_s"), value.get("paused", False)
    if type(paused) is not bool:
        return None
    if at_s is None:
        return Play(None, paused)
    if type(at_s) not in {int, float} or not (math.isfinite(at_s) and 0.0 <= at_s <= LONGEST_LOG_S):
        return None
    return Play(float(at_s), paused)
