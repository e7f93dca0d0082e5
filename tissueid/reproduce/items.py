"""Rows and figures of a comparison with a paper."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from tissueid.documents import plain

Value = float | tuple[float, float]
Interval = tuple[float, float] | None


class Kind(StrEnum):
    """Ground of a recomputed number."""

    #: Printed, and computed from what the paper states without the number itself.
    REPRODUCED = "reproduced"
    #: Computed from what the paper states, which prints no number to stand beside it.
    RECOMPUTED = "recomputed"
    #: Printed as an input: put in, not computed.
    GIVEN = "given"
    #: The number itself, or what was made from it, is among the inputs.
    ROUND_TRIP = "round trip"
    #: An input is printed by no paper.
    ASSUMED = "assumed"
    #: Its inputs are lost, or were never printed.
    NOT_REPRODUCIBLE = "not reproducible"


@dataclass(frozen=True, slots=True)
class Judgement:
    """Rule of agreement, in words and as a function of (published, recomputed, interval)."""

    words: str
    holds: Callable[[Value, Value, Interval], bool]


def near(tolerance: float, unit: str) -> Judgement:
    """Within a tolerance."""

    def holds(published: Value, recomputed: Value, _interval: Interval) -> bool:
        return abs(_single(published) - _single(recomputed)) <= tolerance

    return Judgement(f"within {tolerance:g} {unit}".rstrip(), holds)


def within_interval() -> Judgement:
    """The published number lies in the interval of the recomputed one."""

    def holds(published: Value, _recomputed: Value, interval: Interval) -> bool:
        return interval is not None and interval[0] <= _single(published) <= interval[1]

    return Judgement("the published number lies inside the 99 % interval", holds)


def overlaps() -> Judgement:
    """Two ranges share something: they are consistent, which is no proof."""

    def holds(published: Value, recomputed: Value, _interval: Interval) -> bool:
        (low, high), (least, most) = _pair(published), _pair(recomputed)
        return low <= most and least <= high

    return Judgement("the ranges overlap (consistent with, no more)", holds)


def rounded(digits: int) -> Judgement:
    """Equal once rounded as it is printed."""

    def holds(published: Value, recomputed: Value, _interval: Interval) -> bool:
        return round(_single(recomputed), digits) == round(_single(published), digits)

    return Judgement(f"equal when rounded to {digits} decimals", holds)


def _single(value: Value) -> float:
    if isinstance(value, tuple):
        msg = "a range can't be judged as a number"
        raise TypeError(msg)
    return value


def _pair(value: Value) -> tuple[float, float]:
    return value if isinstance(value, tuple) else (value, value)


@dataclass(frozen=True, slots=True)
class Item:
    """One row: published beside recomputed."""

    item: str  # stable key, as ``table-1/tau-2mm``
    paper: str
    where: str  # table, figure or section of the paper
    words: str
    unit: str
    published: Value | None  # ``None`` where the paper prints no number
    recomputed: Value | None
    interval: Interval  # 99 % interval
    agrees: bool | None  # ``None`` where there is nothing to compare
    kind: Kind
    rule: str | None  # how agreement was decided
    reading: str | None  # interpretations of lost equations it rests on
    inputs: tuple[str, ...]  # published numbers that it was computed from
    assumed: tuple[str, ...]  # inputs that no paper prints
    instrument: str | None  # could an instrument alone give this?
    note: str | None

    def __post_init__(self) -> None:
        if self.kind in (Kind.REPRODUCED, Kind.GIVEN) and self.published is None:
            msg = f"{self.item} is called {self.kind}, and no printed number stands beside it"
            raise ValueError(msg)

    def as_json(self) -> dict[str, Any]:
        """The ``items`` object of ``schemas/reproduction.schema.json``."""
        document: dict[str, Any] = plain(self)
        return document


@dataclass(frozen=True, slots=True)
class Trace:
    """One line of a figure."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    style: str = "line"  # {"line", "dash", "points"}
    band: tuple[tuple[float, ...], tuple[float, ...]] | None = None  # lower and upper edge beside y

    def as_json(self) -> dict[str, Any]:
        """The ``traces`` object of the schema."""
        band = None if self.band is None else {"low": list(self.band[0]), "high": list(self.band[1])}
        return {"name": self.name, "x": list(self.x), "y": list(self.y), "style": self.style, "band": band}


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of a paper, drawn again."""

    key: str  # as ``figure-2``
    paper: str
    where: str
    title: str
    kind: Kind
    caption: str  # what was computed from what, and what can't be read off it
    x_title: str = ""
    y_title: str = ""
    traces: tuple[Trace, ...] = ()  # empty for a drawing
    drawing: str | None = None  # name of a drawing of the page: a schematic or a block diagram
    x_log: bool = False

    def as_json(self) -> dict[str, Any]:
        """The ``figures`` object of the schema."""
        document: dict[str, Any] = plain(self)
        return document | {"traces": [trace.as_json() for trace in self.traces]}
