"""Papers, recomputed."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from msgspec import Meta

from tissueid.documents.base import Count, Document, JsonSchema, NonNegative

#: First author of a paper.
PaperName = Literal["sadeghnejad", "pires"]


class Paper(Document, frozen=True):
    """Source paper."""

    name: PaperName
    words: str
    places: tuple[str, ...]  # Tables and figures in the order of a page


class Reading(Document, frozen=True):
    """Choice that a paper leaves open."""

    choice: str
    words: str


Value = float | tuple[float, float] | None

# Ground of a recomputed number: printed, and computed from what the paper states without the number itself;
# computed, and no number is printed beside it; printed as an input; the number itself, or what was made from
# it, is among the inputs; an input is printed by no paper; its inputs are lost, or were never printed.
Kind = Literal["reproduced", "recomputed", "given", "round trip", "assumed", "not reproducible"]


class Item(Document, frozen=True):
    """Printed number and the recomputed one."""

    RULES: ClassVar[JsonSchema] = {
        "allOf": [
            {
                "if": {"properties": {"kind": {"enum": ["given", "not reproducible"]}}},
                "then": {"properties": {"recomputed": {"type": "null"}, "agrees": {"type": "null"}}},
                "else": {"properties": {"recomputed": {"not": {"type": "null"}}}},
            }
        ]
    }

    item: str
    paper: PaperName
    where: str
    words: str
    unit: str
    published: Value  # null where the paper prints no number
    recomputed: Value
    interval: tuple[float, float] | None  # 99 %
    agrees: bool | None
    kind: Kind
    rule: str | None  # Rule of agreement
    reading: str | None
    inputs: tuple[str, ...]  # Published numbers it was computed from
    assumed: tuple[str, ...]
    instrument: str | None  # Could an instrument alone give this?
    note: str | None

    def __post_init__(self) -> None:
        if self.kind in ("reproduced", "given") and self.published is None:
            raise ValueError(f"{self.item} is called {self.kind}, and no printed number stands beside it")


class Band(Document, frozen=True):
    """Band around a trace."""

    low: tuple[float, ...]
    high: tuple[float, ...]


class Trace(Document, frozen=True):
    """Line of a figure."""

    name: str
    x: tuple[float, ...]
    y: tuple[float, ...]
    style: Literal["line", "dash", "points"]
    band: Band | None


class Figure(Document, frozen=True):
    """Redrawn figure."""

    key: str
    paper: PaperName
    where: str
    title: str
    kind: Kind
    caption: str
    x_title: str
    y_title: str
    traces: tuple[Trace, ...]
    drawing: Literal["schematic", "block-diagram"] | None
    x_log: bool


class Reproduction(Document, frozen=True):
    """Printed numbers of the source papers, recomputed."""

    schema: Literal["tissueid/reproduction/1"]
    tissueid: str
    papers: Annotated[tuple[Paper, ...], Meta(min_length=1)]
    seed: Count
    seconds: NonNegative
    readings: dict[str, Reading]  # Reading of each lost equation and number; each can be switched
    items: tuple[Item, ...]
    figures: tuple[Figure, ...]
    lost: tuple[str, ...]
