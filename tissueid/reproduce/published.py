"""Printed numbers of the two papers, and an account of which of it a computation used.

A recomputed number whose inputs hold the published one agrees because it must: it is a round trip.  So that
no row can be labelled otherwise by mistake, computations get published numbers from a :class:`Ledger` only,
which remembers what it handed out; the kind of a row follows from that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeVar

from tissueid.reproduce.items import Item, Judgement, Kind

#: Sadeghnejad et al., endoscopic sinus surgery: sheep orbital floor, indentation and relaxation.
SADEGHNEJAD = "sadeghnejad"
#: Pires et al., hip resurfacing: haptic guidance with a Novint Falcon.
PIRES = "pires"

_T = TypeVar("_T")


@dataclass(frozen=True, slots=True)
class Published:
    """A printed number."""

    where: str  # table or section of the paper
    value: float | tuple[float, float]  # as printed; two numbers are a range
    unit: str
    words: str  # what it is


#: Depth of a relaxation test [mm] -> printed peak force [N] and relaxation time [s].
_TABLE_1 = {2: (86.64, 0.0214), 4: (122.32, 0.0212), 6: (176.76, 0.0206), 8: (221.37, 0.0209)}
#: The row of Table 3 as it is printed; which number is what is a reading.
_TABLE_3 = (1.25, 2.0, 30.0, 1.158, 115.4, 31.46)


def _catalogue() -> dict[str, Published]:
    numbers = {}
    for depth, (peak, tau) in _TABLE_1.items():
        numbers[f"table-1/peak-{depth}mm"] = Published(
            "Table 1", peak, "N", f"Peak force, held at {depth} mm"
        )
        numbers[f"table-1/tau-{depth}mm"] = Published(
            "Table 1", tau, "s", f"Relaxation time, held at {depth} mm"
        )
    numbers["table-2/stiffness"] = Published("Table 2", 63.62, "N/mm", "Stiffness of the branch, K")
    numbers["table-2/tau"] = Published("Table 2", 0.021, "s", "Relaxation time")
    for place, value in enumerate(_TABLE_3, start=1):
        numbers[f"table-3/{place}"] = Published("Table 3", value, "", f"Number {place} of the row")
    numbers["figure-5/nrmsd"] = Published("Fig. 5", (4.23, 10.95), "%", "NRMSD of model and recordings")
    numbers["guidance/tau"] = Published("Fig. 4", 0.05, "s", "Time constant of the radial guidance")
    return numbers


#: Every printed number by its key.
PUBLISHED: Mapping[str, Published] = MappingProxyType(_catalogue())


class Ledger:
    """Hands out the inputs of one computation and remembers them.

    ``numbers``: of :data:`PUBLISHED`; a test gives altered ones.
    """

    def __init__(self, paper: str, numbers: Mapping[str, Published] = PUBLISHED) -> None:
        self.paper = paper
        self._numbers = numbers
        self._used: list[str] = []
        self._assumed: list[str] = []
        self._readings: list[str] = []

    def printed(self, key: str) -> float:
        """A published number as an input; from now on its own row is a round trip."""
        value = self._numbers[key].value
        if isinstance(value, tuple):
            msg = f"{key} is a range, which is no input"
            raise TypeError(msg)
        if key not in self._used:
            self._used.append(key)
        return value

    def assume(self, words: str, value: _T) -> _T:
        """An input that no paper prints."""
        if words not in self._assumed:
            self._assumed.append(words)
        return value

    def read(self, words: str) -> None:
        """An interpretation of a lost equation or number that enters from here on."""
        if words not in self._readings:
            self._readings.append(words)

    def branch(self) -> Ledger:
        """A ledger that starts with what was used so far; what it hands out stays its own."""
        other = Ledger(self.paper, self._numbers)
        other._used, other._assumed, other._readings = [*self._used], [*self._assumed], [*self._readings]
        return other

    def item(
        self,
        key: str,
        recomputed: float | tuple[float, float] | None,
        *,
        against: str | None = None,
        words: str = "",
        unit: str = "",
        where: str = "",
        interval: tuple[float, float] | None = None,
        judge: Judgement | None = None,
        instrument: str | None = None,
        note: str | None = None,
    ) -> Item:
        """A row of the comparison; its kind follows from what this ledger handed out.

        ``key``: of :data:`PUBLISHED`, or a name of its own for what no paper prints; ``recomputed``: ``None``
        where it can't be computed; ``against``: key of the printed number it stands beside, where that is not
        ``key``; ``words``, ``unit``, ``where``: what it is; a printed number brings its own; ``interval``: 99
        % interval of the recomputed number; ``judge``: how agreement is decided; ``instrument``: could an
        instrument alone give this?.
        """
        beside = against or key
        printed = self._numbers.get(beside)
        agrees = None
        if printed is not None and judge is not None and recomputed is not None:
            agrees = judge.holds(printed.value, recomputed, interval)
        return Item(
            item=key,
            paper=self.paper,
            where=where if printed is None else printed.where,
            words=words if words or printed is None else printed.words,
            unit=unit if printed is None else printed.unit,
            published=None if printed is None else printed.value,
            recomputed=recomputed,
            interval=interval,
            agrees=agrees,
            kind=self._kind(beside, recomputed),
            rule=None if judge is None else judge.words,
            reading="; ".join(self._readings) or None,
            inputs=tuple(self._used),
            assumed=tuple(self._assumed),
            instrument=instrument,
            note=note,
        )

    def _kind(self, beside: str, recomputed: object) -> Kind:
        if recomputed is None:
            return Kind.NOT_REPRODUCIBLE
        if beside in self._used:
            return Kind.ROUND_TRIP
        if self._assumed:
            return Kind.ASSUMED
        return Kind.REPRODUCED if beside in self._numbers else Kind.RECOMPUTED

    def given(self, key: str, words: str, note: str) -> Item:
        """A printed number that is an input: nothing is computed beside it."""
        return replace(self.item(key, None, words=words, note=note), kind=Kind.GIVEN)

    def claim(
        self, key: str, words: str, where: str, value: float, holds: Callable[[float], bool], rule: str,
        *, unit: str = "", note: str | None = None,
    ) -> Item:  # fmt: skip
        """A sentence of the paper without a number, and whether what is computed bears it out."""
        row = self.item(key, value, words=words, unit=unit, where=where, note=note)
        return replace(row, agrees=holds(value), rule=rule)
