"""Printed numbers of the two papers, their readings, and an account of what a computation used of them.

Computations get published numbers from a :class:`Ledger` only, which remembers what it handed out: a number
that agrees because it must is labelled a round trip.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from types import MappingProxyType
from typing import Any, Final, Literal, TypeVar

from msgspec import structs

from tissueid.documents.reproduction import Figure, Item, Kind, PaperName, Trace
from tissueid.errors import printable, refuse

Value = float | tuple[float, float]
Interval = tuple[float, float] | None
Drawing = Literal["schematic", "block-diagram"]


@dataclass(frozen=True, slots=True)
class Judgement:
    """Rule of agreement, in words and as a function of (published, recomputed, interval)."""

    words: str
    holds: Callable[[Any, Any, Interval], bool]


def near(tolerance: float, unit: str) -> Judgement:
    """Within a tolerance."""
    return Judgement(
        f"within {tolerance:g} {unit}".rstrip(),
        lambda published, recomputed, _: abs(published - recomputed) <= tolerance,
    )


def rounded(digits: int) -> Judgement:
    """Equal once rounded as it is printed."""
    return Judgement(
        f"equal when rounded to {digits} decimals",
        lambda published, recomputed, _: round(recomputed, digits) == round(published, digits),
    )


def _within(published: float, _recomputed: Value, interval: Interval) -> bool:
    return interval is not None and interval[0] <= published <= interval[1]


def _overlap(published: Value, recomputed: Value, _interval: Interval) -> bool:
    (low, high), (least, most) = _pair(published), _pair(recomputed)
    return low <= most and least <= high


def _pair(value: Value) -> tuple[float, float]:
    return value if isinstance(value, tuple) else (value, value)


WITHIN_INTERVAL = Judgement("the published number lies inside the 99 % interval", _within)
#: Two ranges share something: they are consistent, which is no proof.
OVERLAPS = Judgement("the ranges overlap (consistent with, no more)", _overlap)


@dataclass(frozen=True, slots=True)
class Said:
    """Words of a row of which the paper prints no number, and its unit."""

    words: str = ""
    unit: str = ""


#: Sadeghnejad et al., endoscopic sinus surgery: sheep orbital floor, indentation and relaxation.
SADEGHNEJAD: Final = "sadeghnejad"
#: Pires et al., hip resurfacing: haptic guidance with a Novint Falcon.
PIRES: Final = "pires"

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Published:
    """A printed number."""

    where: str  # table or section of the paper
    value: Value  # as printed; two numbers are a range
    unit: str
    words: str  # what it is


Numbers = Mapping[str, Published]
#: Depth of a relaxation test [mm] -> printed peak force [N] and relaxation time [s].
_TABLE_1 = {2: (86.64, 0.0214), 4: (122.32, 0.0212), 6: (176.76, 0.0206), 8: (221.37, 0.0209)}
#: The row of Table 3 as it is printed; which number is what is a reading.
_TABLE_3 = (1.25, 2.0, 30.0, 1.158, 115.4, 31.46)


def points(values: Iterable[float], places: int = 4) -> tuple[float, ...]:
    """Coordinates of a trace, rounded."""
    return tuple(round(float(value), places) for value in values)


def _catalogue() -> dict[str, Published]:
    numbers = {}
    for depth, row in _TABLE_1.items():
        columns = (("peak", "N", "Peak force"), ("tau", "s", "Relaxation time"))
        for (name, unit, words), value in zip(columns, row, strict=True):
            said = f"{words}, held at {depth} mm"
            numbers[f"table-1/{name}-{depth}mm"] = Published("Table 1", value, unit, said)
    numbers["table-2/stiffness"] = Published("Table 2", 63.62, "N/mm", "Stiffness of the branch, K")
    numbers["table-2/tau"] = Published("Table 2", 0.021, "s", "Relaxation time")
    for place, value in enumerate(_TABLE_3, start=1):
        numbers[f"table-3/{place}"] = Published("Table 3", value, "", f"Number {place} of the row")
    numbers["figure-5/nrmsd"] = Published("Fig. 5", (4.23, 10.95), "%", "NRMSD of model and recordings")
    numbers["guidance/tau"] = Published("Fig. 4", 0.05, "s", "Time constant of the radial guidance")
    return numbers


#: Every printed number by its key.
PUBLISHED: Numbers = MappingProxyType(_catalogue())


@dataclass(slots=True)
class Ledger:
    """Hands out the inputs of one computation and remembers them."""

    paper: PaperName
    where: str  # place of its rows in the paper, where no number is printed
    _used: dict[str, None] = field(default_factory=dict)
    _assumed: dict[str, None] = field(default_factory=dict)
    _readings: dict[str, None] = field(default_factory=dict)

    def printed(self, key: str) -> float:
        """A published number as an input; from now on its own row is a round trip."""
        value = PUBLISHED[key].value
        if isinstance(value, tuple):
            raise TypeError(f"{key} is a range, which is no input")
        self._used[key] = None
        return value

    def assume(self, words: str, value: _T) -> _T:
        """An input that no paper prints."""
        self._assumed[words] = None
        return value

    def read(self, words: str) -> None:
        """An interpretation of a lost equation or number that enters from here on."""
        self._readings[words] = None

    def item(
        self,
        key: str,
        recomputed: Value | None,
        *,
        against: str | None = None,
        said: Said | None = None,
        interval: Interval = None,
        judge: Judgement | None = None,
        note: str | None = None,
    ) -> Item:
        """A row of the comparison; its kind follows from what this ledger handed out."""
        beside, said = against or key, said or Said()
        printed = PUBLISHED.get(beside)
        agrees = None
        if printed is not None and judge is not None and recomputed is not None:
            agrees = judge.holds(printed.value, recomputed, interval)
        return Item(
            item=key,
            paper=self.paper,
            where=self.where if printed is None else printed.where,
            words=said.words if said.words or printed is None else printed.words,
            unit=said.unit if printed is None else printed.unit,
            published=None if printed is None else printed.value,
            recomputed=recomputed,
            interval=interval,
            agrees=agrees,
            kind=self._kind(beside, recomputed),
            rule=None if judge is None else judge.words,
            reading="; ".join(self._readings) or None,
            inputs=tuple(self._used),
            assumed=tuple(self._assumed),
            instrument=None,
            note=note,
        )

    def _kind(self, beside: str, recomputed: object) -> Kind:
        if recomputed is None:
            return "not reproducible"
        if beside in self._used:
            return "round trip"
        if self._assumed:
            return "assumed"
        return "reproduced" if beside in PUBLISHED else "recomputed"

    def given(self, key: str, words: str, note: str) -> Item:
        """A printed number that is an input: nothing is computed beside it."""
        return structs.replace(self.item(key, None, said=Said(words), note=note), kind="given")

    def claim(
        self, key: str, said: Said, value: float, holds: Callable[[float], bool], rule: str,
        *, note: str | None = None,
    ) -> Item:  # fmt: skip
        """A sentence of the paper without a number, and whether what is computed bears it out."""
        row = self.item(key, value, said=said, note=note)
        return structs.replace(row, agrees=holds(value), rule=rule)

    def figure(
        self, key: str, kind: Kind, words: tuple[str, str], axes: tuple[str, str],
        traces: Sequence[Trace], *, drawing: Drawing | None = None,
    ) -> Figure:  # fmt: skip
        """A figure of the paper, drawn again: its title and caption, its axes and what is in it."""
        title, caption = words
        return Figure(
            key, self.paper, self.where, title, kind, caption, *axes, tuple(traces), drawing, x_log=False
        )


#: Reading -> choice -> what it takes the paper to say; the first choice is the default.
READINGS: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        "stiffness": {
            "constant": "63.62 is a constant K [N/mm]",
            "linear": "63.62 is the coefficient of K(x) = 63.62 x [N/mm2]",
        },
        "relaxation": {
            "time": "0.021 is the relaxation time [s]",
            "rate": "0.021 is a relaxation rate [1/s]",
        },
        "device": {
            "mass-damping-stiffness": "the device of Table 3 is 1.158 kg, 115.4 N s/m, 31.46 N/m",
            "mass-stiffness-damping": "the device of Table 3 is 1.158 kg, 115.4 N/m, 31.46 N s/m",
        },
        "criterion": {
            "work": "the tissue ruptures at a total work",
            "weighted-force": "the tissue ruptures at a weighted force F_s + 1.5 F_d",
            "stored-energy": "the tissue ruptures at a stored energy",
            "depth": "the tissue ruptures at a depth",
        },
        "surface": {
            "hyperboloid": "the guidance surface is one sheet of a hyperboloid, the 1 under the root",
            "cone": "the guidance surface is the cone as printed",
        },
    }
)


@dataclass(frozen=True, slots=True)
class Readings:
    """One choice for every reading of :data:`READINGS`."""

    stiffness: str = "constant"
    relaxation: str = "time"
    device: str = "mass-damping-stiffness"
    criterion: str = "work"
    surface: str = "hyperboloid"

    def words(self, name: str) -> str:
        """Reading of the paper that the choice takes."""
        return READINGS[name][getattr(self, name)]

    def as_json(self) -> dict[str, dict[str, str]]:
        """Choice and words of each."""
        return {
            one.name: {"choice": getattr(self, one.name), "words": self.words(one.name)}
            for one in fields(self)
        }


def readings_from(settings: Sequence[str]) -> Readings:
    """Readings of ``--set NAME=CHOICE``."""
    readings = Readings()
    for setting in settings:
        name, equals, choice = setting.partition("=")
        if not equals or name not in READINGS:
            refuse(f"--set {printable(setting)}: give NAME=CHOICE, NAME one of {', '.join(READINGS)}")
        if choice not in READINGS[name]:
            refuse(f"--set {printable(setting)}: {name} is one of {', '.join(READINGS[name])}")
        readings = replace(readings, **{name: choice})
    return readings
