"""Faults an emulated Falcon shows on purpose, each at a time of its own clock."""

from __future__ import annotations

from dataclasses import dataclass

from tissueid.errors import UsageError, printable

#: Kinds, and what each does while it lasts.
FAULT_KINDS = {
    "unplug": "the transport closes",
    "silence": "commands are obeyed, none is answered",
    "bad packets": "the letters of every answer are spoilt",
    "short": "an answer lacks its last two bytes before the end",
    "garbled": "one byte of an answer is flipped",
    "doubled": "an answer comes twice",
    "frozen": "the encoders stand still",
    "jump": "encoder 1 is off by `size` counts",
    "creep": "encoder 1 runs away by `size` counts a second",
    "unhomed": "leg 2 is no longer homed",
    "stall": "the answer comes `size` milliseconds late",
}
#: Kinds that spoil one answer where no duration is given.
SINGLE = frozenset({"short", "garbled", "doubled", "stall"})


@dataclass(frozen=True, slots=True)
class ScriptedFault:
    """One fault."""

    kind: str  # one of :data:`FAULT_KINDS`
    at_s: float  # when it begins [s after homing was first commanded]
    #: How long it lasts; None is for good, and one answer for "short", "garbled", "doubled" and "stall".
    duration_s: float | None = None
    size: float = 1000.0  # counts of a jump, counts a second of a creep, milliseconds of a stall

    def __post_init__(self) -> None:
        if self.kind not in FAULT_KINDS:
            msg = f"there is no fault {printable(self.kind)!r}; faults are {', '.join(FAULT_KINDS)}"
            raise UsageError(msg)

    @property
    def once(self) -> bool:
        """It spoils one answer and is over."""
        return self.duration_s is None and self.kind in SINGLE

    def active(self, time_s: float) -> bool:
        """It is on at a time of the device's clock [s]."""
        return self.at_s <= time_s and (self.duration_s is None or time_s < self.at_s + self.duration_s)


def parse_fault(text: str) -> ScriptedFault:
    """Read ``KIND@SECONDS[:SIZE][/DURATION]``, e.g. ``jump@6:300`` or ``silence@5/0.5``.

    Raises UsageError: it is no such text, or there is no such kind.
    """
    kind, _, rest = text.partition("@")
    rest, _, duration = rest.partition("/")
    at, _, size = rest.partition(":")
    try:
        numbers = float(at), float(duration) if duration else None, float(size) if size else 1000.0
    except ValueError as error:
        msg = (
            f"{printable(text)!r} is no fault; write KIND@SECONDS, e.g. unplug@6, jump@6:300 or silence@5/0.5"
        )
        raise UsageError(msg) from error
    return ScriptedFault(kind.strip(), numbers[0], numbers[1], numbers[2])
