"""Columns of time, displacement and force, and factors that turn them into s, mm and N.

The rule is the ranked table of :mod:`tissueid.ingest.vocabulary`; a column whose unit measures something else
is no candidate; the user's map wins over everything.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import InputError
from tissueid.flags import Flag
from tissueid.ingest.header import asked_interval
from tissueid.ingest.options import AXES, ReadOptions
from tissueid.ingest.refusals import Place
from tissueid.ingest.vocabulary import (
    CHANNELS,
    OTHER_SENSOR_RANK,
    SIDEWAYS_RANK,
    SYMBOL_RANK,
    Channel,
    is_unknown,
    plain_words,
    rank_of,
    split_name,
)
from tissueid.units import INTERNAL_UNITS, Quantity, bare_unit, factor_to, quantity_of

Channels = tuple[FloatArray, FloatArray, FloatArray]

#: What is most likely meant by small letters: the millinewton, and no meganewton.
_IN_CAPITALS = {"mn": "mN", "un": "uN", "pn": "pN"}
#: Letters of the depth of an indentation.
_DEPTHS = frozenset({"h", "δ", "delta"})
#: Least clock time in one number, as one after midnight could be seconds as well, and fewest that tell.
LEAST_CLOCK, FEWEST_TIMES = 10_000.0, 10
#: Names of whole seconds, and of their part below one, behind the same words: ``header stamp nsecs``.
_WHOLE_SECONDS = re.compile(r"((?:.* )?)(?:s|secs?|seconds?|sekunden?|secondes?|segundos?|secondi)")
_BELOW_SECOND = re.compile(
    r"((?:.* )?)(?:(m|milli)|(u|\u03bc|micro|mikro)|(n|nano))(?:s|secs?|seconds?|sekunden?|secondes?)"
)
#: Words of strain and stress in the nine languages, accents stripped.
_NORMALISED: Mapping[Quantity, re.Pattern[str]] = {
    "strain": re.compile(
        r"strain|stretch|dehnung|stauchung|deformation|deformacion|deformacao|deformazione|odksztalcenie|应变"
    ),
    "stress": re.compile(
        r"stress|spannung|contrainte|tension de|esfuerzo|tensao|tensione|sforzo|naprezenie|应力"
    ),
}
#: Words of strain that need no unit to be taken as one, and words of what is none of the kind.
_STRAIN_WITHOUT_UNIT = re.compile(r"stretch|strain|lambda|dehnung|应变")
_NO_SERIES = re.compile(r"\b(?:rate|max|maximum|min|minimum|peak|yield|mean|modulus|at|sd|error)\b")
#: Ranks of a letter and of a sideways axis.
_DOUBTFUL = {SYMBOL_RANK, SIDEWAYS_RANK}
_WAY_OUT = "name it with --columns time=NAME,displacement=NAME,force=NAME (or #2 for the second column)"


@dataclass(frozen=True, slots=True)
class ColumnChoice:
    """The three columns taken."""

    index: Mapping[Channel, int]  # channel -> column, counted from 0
    names: Mapping[Channel, str]  # channel -> name as printed
    factors: Mapping[Channel, float]  # channel -> what turns the printed value into s, mm or N
    flags: tuple[Flag, ...]
    axes: Mapping[str, str]  # channels that hold a strain or stress, as declared or as their columns say
    interval_s: float | None = None  # of samples whose time is no column, but counted
    stated: Collection[str] = ()  # channels whose unit the user states
    other_clock: int | None = None  # column of a time that is another channel's, by its name
    #: Column of a part of a second, by its name, and its unit [s].
    below_second: tuple[int, float] | None = None
    counter: int | None = None  # column that counts the samples of an interval

    def timed(
        self, columns: Channels, read: Callable[[ColumnChoice], Channels], place: Place, line: int | None
    ) -> tuple[Channels, tuple[Flag, ...]]:
        """Channels on their exact clock; ``read``: of another choice.

        A part of a second in a column of its own is added, a clock in one number taken apart; channels with
        clocks of their own are refused.
        """
        self._refuse_other_clock(columns[0], read, place, line)
        if self.factors["time"] == 1.0 and (of_day := _time_of_day(columns[0])) is not None:
            words = f"{self.names['time']!r} is a clock in one number, hhmmss: the seconds of it are taken"
            values = {"quantity": "time", "taken": self.names["time"], "alternatives": []}
            return (of_day, *columns[1:]), (Flag("column_choice", words, values),)
        if self.counter is not None and self.interval_s is not None:
            return self._by_counter(columns, self.counter, self.interval_s, read)
        if self.below_second is None:
            return columns, ()
        at, unit_s = self.below_second
        # in the place of the force: it starts again at every second
        index, factors = {**self.index, "force": at}, {**self.factors, "force": unit_s}
        try:
            part_s = read(replace(self, index=index, factors=factors))[2]
        except InputError:
            return columns, ()
        time_s = columns[0] + part_s
        whole = (columns[0] == np.rint(columns[0])).all() and (part_s >= 0.0).all() and (part_s < 1.0).all()
        if not (whole and (np.diff(time_s) >= 0.0).all()):
            return columns, ()
        words = f"time is the sum of {self.names['time']!r} and column {at + 1}, its part of a second"
        return (time_s, *columns[1:]), (Flag("column_choice", words, self._by_column(at)),)

    def _by_column(self, at: int) -> dict[str, Any]:
        """Numbers behind a time that takes a column more."""
        return {"quantity": "time", "taken": f"{self.names['time']} and #{at + 1}", "alternatives": []}

    def _by_counter(
        self, columns: Channels, at: int, interval_s: float, read: Callable[[ColumnChoice], Channels]
    ) -> tuple[Channels, tuple[Flag, ...]]:
        """Channels with time by a column that counts samples, where it leaves some out."""
        asked = replace(self, index={**self.index, "time": at}, interval_s=None)
        try:
            number = read(asked)[0]
        except InputError:
            return columns, ()
        steps = np.diff(number)
        if not (steps > 0.0).all() or (steps == 1.0).all() or (steps != np.rint(steps)).any():
            return columns, ()
        lost = int((steps - 1.0).sum())
        words = f"column {at + 1} counts the samples and leaves out {lost}: time goes by it"
        time_s = (number - number[0]) * interval_s
        return (time_s, *columns[1:]), (Flag("column_choice", words, self._by_column(at)),)

    def _refuse_other_clock(
        self, time_s: FloatArray, read: Callable[[ColumnChoice], Channels], place: Place, line: int | None
    ) -> None:
        """Refuse channels whose times drift apart by more than a sample."""
        if self.other_clock is None:
            return
        try:
            other = read(replace(self, index={**self.index, "time": self.other_clock}))[0]
        except InputError:
            return  # no column of numbers
        if other.size != time_s.size or np.ptp(other - time_s) <= np.median(np.abs(np.diff(time_s))):
            return
        columns = [self.index["time"] + 1, self.other_clock + 1]
        apart = float(np.abs(other - time_s).max())
        message = (
            f"the times in columns {columns[0]} and {columns[1]} differ by up to {apart:.3g} s: each channel"
            f" has its own; export them at common times, or take one for all: --columns time=#{columns[0]}"
        )
        place.refuse("several_clocks", message, line=line, column=columns[1])

    def counted(self, columns: list[FloatArray]) -> list[FloatArray]:
        """Printed columns with the time by the number of the row, where that is no column."""
        if self.interval_s is None:
            return columns
        return [np.arange(columns[0].size, dtype=np.float64) * self.interval_s, *columns[1:]]

    def scaled(self, columns: Sequence[FloatArray]) -> Channels:
        """Printed columns of time, displacement and force as channels in s, mm and N."""
        factors = [self.factors[channel] for channel in CHANNELS]
        time_s, displacement_mm, force_N = (
            column if factor == 1.0 else column * factor
            for column, factor in zip(columns, factors, strict=True)
        )
        return time_s, displacement_mm, force_N


@dataclass(frozen=True, slots=True)
class _Column:
    index: int
    name: str
    base: str
    units: tuple[str, ...]  # as printed: of the units row, then of the name

    @property
    def shown(self) -> str:
        """Its name, else its number."""
        return self.name or f"#{self.index + 1}"

    @property
    def unit(self) -> str | None:
        return self.units[0] if self.units else None

    @property
    def by_unit(self) -> bool:
        """True of a name that gave way to its unit."""
        return (
            self.name != "" and self.base != split_name(self.name)[0] and quantity_of(self.name) != self.base
        )


@dataclass(frozen=True, slots=True)
class _Head:
    """The columns under a head, and the options by which channels are sought among them."""

    columns: Sequence[_Column]
    options: ReadOptions

    @classmethod
    def of(cls, names: Sequence[str], units: Sequence[str], options: ReadOptions) -> _Head:
        """The head of these names; a strain or stress is declared where one is there and no other channel."""
        columns: list[_Column] = []
        for index, name in enumerate(names):
            base, inside = split_name(name.strip())
            row_unit = bare_unit(units[index]) if index < len(units) else ""
            columns.append(_Column(index, name.strip(), base, tuple(u for u in (row_unit, inside) if u)))
        head = cls(_named_by_units(columns), options)
        axes = dict(options.axes)
        for channel, (_, axis) in AXES.items():
            if channel in options.columns or channel in options.units or channel in axes:
                continue
            if not head.candidates(cast("Channel", channel)) and any(
                _is_normalised(column, cast("Quantity", axis)) for column in columns
            ):
                axes[channel] = axis
        return head if axes == dict(options.axes) else cls(head.columns, replace(options, axes=axes))

    def rank(self, column: _Column, channel: Channel, *, loose: bool) -> int | None:
        """Rank among a channel's names; a declared strain or stress is sought under its own name first."""
        words = _NORMALISED.get(self.options.quantity(channel))
        if words is not None and words.search(plain_words(column.base)):
            return 0
        return rank_of(column.base, channel, loose=loose)

    def may_be(self, column: _Column, channel: Channel) -> bool:
        """True where a column's name is one of a channel's, at least loosely."""
        return self.rank(column, channel, loose=True) is not None

    def candidates(self, channel: Channel) -> list[tuple[int, _Column]]:
        """Columns that may be this channel, best first; a known unit of something else rules one out."""
        found = []
        wanted = self.options.quantity(channel)
        for column in self.columns:
            measured = quantity_of(column.unit) if column.unit and self.may_be(column, channel) else None
            if measured is not None and measured != wanted:
                continue
            rank = self.rank(column, channel, loose=measured == wanted)
            if rank is not None:
                found.append((rank, column))
        if channel == "time" and not found:
            found = [(0, column) for column in self.columns if _below_second(self, column)][:1]
        # a clock or a stamp has no unit; the time of a test has
        united = channel == "time" and any(column.unit for _, column in found)
        found.sort(key=lambda item: (united and not item[1].unit, item[0], item[1].index))
        # a P is a load beside the depth of an indentation, and a pressure elsewhere
        usual = [one for one in found if one[1].base != "delta" and (one[1].unit or one[1].base not in "Pδ")]
        bases = {column.base for column in self.columns}
        indented = bases & _DEPTHS and "T" not in bases
        found = usual or [one for one in found if indented or one[1].base != "P"]
        # of two letters, or two sideways axes, either may be meant
        doubtful = [rank in _DOUBTFUL for rank, _ in found]
        return [] if sum(doubtful) > 1 and doubtful[0] else found

    def ruled_out(self, channel: Channel, found: Sequence[tuple[int, _Column]]) -> list[str]:
        """Columns of a name as good as the best, but not of its unit; beside another sensor, of its unit."""
        others = [one for one in self.columns if all(one is not candidate for _, candidate in found)]
        named = [(column, self.rank(column, channel, loose=False)) for column in others]
        fitting = [one.name for one, rank in named if rank is not None and rank <= found[0][0]]
        if channel != "displacement" or found[0][0] != OTHER_SENSOR_RANK:
            return fitting
        wanted = self.options.quantity(channel)
        return fitting + [one.name for one, _ in named if one.unit and quantity_of(one.unit) == wanted]

    def named(self, wanted: str) -> list[_Column]:
        """The columns a user's name means: by number, as printed, or but for case, accents and unit."""
        if number := re.fullmatch(r"#(\d+)", wanted.strip()):
            return [column for column in self.columns if column.index == int(number[1]) - 1]
        if exact := [column for column in self.columns if column.name == wanted.strip()]:
            return exact
        plain = plain_words(wanted)
        return [one for one in self.columns if plain and plain in map(plain_words, (one.name, one.base))]

    def seen(self) -> str:
        """The names of the columns, in words."""
        names = [column.name for column in self.columns if column.name]
        if not names:
            return f"the {len(self.columns)} columns have no names"
        shown = ", ".join(repr(name[:40]) for name in names[:20])
        return f"the columns are {shown}{' ...' if len(names) > 20 else ''}"


def _named_by_units(columns: list[_Column]) -> list[_Column]:
    """Columns of three with a unit of each channel: units alone, and names of no known word, yield to it."""
    known = any(rank_of(one.base, "force", loose=False) == 0 for one in columns)
    units = [column.name or column.unit or "" for column in columns]
    # letters may be names: m, s and N, or a depth h
    bare = not known and {quantity_of(unit) for unit in units} == {*CHANNELS} and not {"h", "m"} & {*units}
    if not bare:
        units = [column.unit or "" for column in columns]
    if len(columns) != len(CHANNELS) or {quantity_of(unit) for unit in units} != {*CHANNELS}:
        return columns
    return [
        replace(column, base=str(quantity_of(unit)), units=(unit,))
        if bare or is_unknown(column.base)
        else column
        for column, unit in zip(columns, units, strict=True)
    ]


def _is_normalised(column: _Column, axis: Quantity) -> bool:
    words = plain_words(column.base)
    if not _NORMALISED[axis].search(words) or _NO_SERIES.search(words):
        return False
    if column.unit is None:
        return axis == "strain" and _STRAIN_WITHOUT_UNIT.search(words) is not None
    return quantity_of(column.unit) == axis


def has_channels(names: Sequence[str], units: Sequence[str], options: ReadOptions) -> bool:
    """True where time, displacement and force can all be found (their units may still be wrong)."""
    head = _Head.of(names, units, options)
    return all(
        _asked(head, channel) or head.named(options.columns[channel]) if channel in options.columns
        else any(head.may_be(column, channel) for column in head.columns)
        for channel in CHANNELS
    )  # fmt: skip


def has_time(names: Sequence[str], units: Sequence[str], options: ReadOptions) -> bool:
    """True where a column may be the time."""
    return bool(_Head.of(names, units, options).candidates("time"))


def channel_columns(names: Sequence[str], options: ReadOptions) -> dict[Channel, int]:
    """Columns of the channels by their names alone, the time perhaps not; empty where another is missing."""
    head = _Head.of(names, (), options)
    best = {
        channel: head.named(options.columns[channel]) if channel in options.columns
        else [column for _, column in head.candidates(channel)]
        for channel in CHANNELS
    }  # fmt: skip
    found = {channel: columns[0].index for channel, columns in best.items() if columns}
    return found if found.keys() >= {"displacement", "force"} else {}


def _asked(head: _Head, channel: Channel) -> float | None:
    """Interval of the samples that the user states in place of a column of time."""
    wanted = head.options.columns.get(channel, "") if channel == "time" else ""
    return None if head.named(wanted) else asked_interval(wanted)


def choose_columns(
    names: Sequence[str],
    units: Sequence[str],
    *,
    options: ReadOptions,
    place: Place,
    line: int | None,
    clock: int | None = None,
) -> ColumnChoice:
    """Find the three channels among the printed names; without a time, where the user states a rate.

    ``clock``: column of clock times as seconds: their unit is their own.
    """
    head = _Head.of(names, units, options)
    taken: dict[Channel, _Column] = {}
    flags: list[Flag] = []
    interval_s = _asked(head, "time")
    for channel in CHANNELS if interval_s is None else CHANNELS[1:]:
        if channel in options.columns:
            taken[channel] = _user_column(head, channel, place, line)
            continue
        found = head.candidates(channel)
        if not found:
            raise _none_found(head, channel, place, line)
        taken[channel] = found[0][1]
        part = _below_second(head, found[0][1]) if channel == "time" else None
        further = [column.name for _, column in found[1:] if part is None or column.index != part[0]]
        flags += _choice_flag(channel, found[0][1], further + head.ruled_out(channel, found))
    if "time" in taken and taken["time"].index == clock:
        taken["time"] = replace(taken["time"], units=("s", *taken["time"].units))
    indices = {channel: column.index for channel, column in taken.items()}
    printed = {channel: column.shown for channel, column in taken.items()}
    factors = {
        channel: _factor(head, column, channel, place, line, flags) for channel, column in taken.items()
    }
    if interval_s is not None:
        # another column is read in its place, and replaced
        indices, printed = {"time": indices["force"], **indices}, {"time": options.columns["time"], **printed}
        factors["time"] = 1.0
        message = f"no column is the time: it is counted, {interval_s:g} s a row"
        flags.append(Flag("time_counted", message, {"interval_s": interval_s}))
    stated = tuple(head.options.units)
    other = None if "time" in options.columns else _other_clock(head)
    part = _below_second(head, taken["time"]) if "time" in taken else None
    return ColumnChoice(
        indices, printed, factors, tuple(flags), head.options.axes, interval_s, stated, other, part
    )


def _choice_flag(channel: Channel, column: _Column, others: Sequence[str]) -> list[Flag]:
    """``column_choice`` of a column that was taken by its unit, or before others."""
    if not (others or column.by_unit):
        return []
    message = f"{channel} was taken from {column.name!r}" + " by its unit alone" * column.by_unit
    if others:
        message += f", not from {others[0]!r}" + f" or {len(others) - 1} more" * (len(others) > 1)
    values = {"quantity": channel, "taken": column.name, "alternatives": list(others)}
    return [Flag("column_choice", message, values)]


def _time_of_day(time_s: FloatArray) -> FloatArray | None:
    """Seconds of clock times like 101159.98 before 101200.00, which leap at minutes; ``None`` of others."""
    if time_s.size < FEWEST_TIMES:
        return None
    minutes, seconds = np.divmod(time_s, 100.0)
    hours, minute = np.divmod(minutes, 100.0)
    clock = 3600.0 * hours + 60.0 * minute + seconds
    if time_s.min() < LEAST_CLOCK or max(seconds.max(), minute.max()) >= 60.0 or hours.max() >= 24.0:
        return None
    steps, turns = np.diff(clock), np.diff(minutes) > 0.0
    usual = float(np.median(steps))
    even = turns.any() and (np.abs(steps[turns] - usual) <= 0.5 * usual).all()
    return clock if even else None


def _below_second(head: _Head, time: _Column) -> tuple[int, float] | None:
    """Column of the part of a second beside a time in whole ones, by its name, and its unit [s]."""
    whole = _WHOLE_SECONDS.fullmatch(plain_words(time.name))
    if whole is None:
        return None
    for column in head.columns:
        part = _BELOW_SECOND.fullmatch(plain_words(column.name))
        if part is not None and part[1] == whole[1]:
            return column.index, 1e-3 if part[2] else 1e-6 if part[3] else 1e-9
    return None


def _other_clock(head: _Head) -> int | None:
    """A second time of the same name as the first, or of another channel where the first is of one."""
    clocks = [column for _, column in head.candidates("time")]
    if len(clocks) < 2:
        return None

    def owner(column: _Column) -> Channel | None:
        words = plain_words(column.base).replace("time", " ").strip()
        of = (channel for channel in CHANNELS[1:] if rank_of(words, channel, loose=True) is not None)
        return next(of, None) if words else None

    name, channel = plain_words(clocks[0].base), owner(clocks[0])
    for column in (one for one in clocks[1:] if one.unit == clocks[0].unit):
        if plain_words(column.base) == name or (channel and owner(column) not in (None, channel)):
            return column.index
    return None


def _user_column(head: _Head, channel: Channel, place: Place, line: int | None) -> _Column:
    wanted = head.options.columns[channel]
    found = head.named(wanted)
    if len(found) != 1:
        numbers = ", ".join(f"#{column.index + 1}" for column in found)
        several = f"{len(found)} columns are named {wanted!r}: name one of them by its number, {numbers}"
        none = f"there is no column {wanted!r} for the {channel}; {head.seen()}"
        place.refuse("column_not_found", several if found else none, line=line)
    return found[0]


def _none_found(head: _Head, channel: Channel, place: Place, line: int | None) -> InputError:
    wanted = head.options.quantity(channel)
    for column in head.columns:
        if column.unit and head.may_be(column, channel) and quantity_of(column.unit) != wanted:
            message = (
                f"column {column.shown!r} is in {column.unit!r}, which does not measure {wanted}, and"
                f" there is no other; {_WAY_OUT}, or {_state(column, channel, INTERNAL_UNITS[wanted])}"
            )
            return place.refusal("wrong_unit", message, line=line, column=column.index + 1)
    either = [one.name for one in head.columns if _may_be_either(head, one, channel)]
    none = (
        f"the {channel} may be {either[0]!r} or {either[1]!r}"
        if either[1:]
        else f"no column is the {channel}"
    )
    message = f"{none}; {head.seen()}; {_way_out(head, channel)}"
    return place.refusal("no_columns", message, line=line)


def _may_be_either(head: _Head, column: _Column, channel: Channel) -> bool:
    """True of a letter or a sideways axis, which are none where there are two."""
    measured, wanted = quantity_of(column.unit or ""), head.options.quantity(channel)
    return measured in (None, wanted) and head.rank(column, channel, loose=measured == wanted) in _DOUBTFUL


def _way_out(head: _Head, channel: Channel) -> str:
    """Way out where no column is a channel."""
    found = [one for one in CHANNELS if one != channel and head.candidates(one)]
    named = [column for column in head.columns if column.name]
    count = len(named or head.columns)
    if channel != "time" and count <= len(found):
        return f"a recording is force over displacement: export the {channel} as well"
    results = [column for column in named if _NO_SERIES.search(plain_words(column.base))]
    if not found and len(results) > 1:
        return f"{results[0].name!r} and {results[1].name!r} are results, not samples: export the raw data"
    rate = head.options.columns["time"] if _asked(head, "time") else None
    if count < len(CHANNELS) or (rate and not named):
        numbers = "" if len(found) == len(CHANNELS) - 1 else ",displacement=#1,force=#2"
        lost = "relaxation can't be timed without it: export it as well, or state the rate"
        do = lost if channel == "time" else "name them by their numbers"
        return f"{do}, as in --columns time={rate or '100Hz'}{numbers}"
    if not named:
        return "name them by their numbers, as in --columns time=#1,displacement=#2,force=#3"
    way_out = _WAY_OUT.replace("NAME", rate or "NAME", 1)
    return f"{way_out}, or {'state the rate by time=100Hz' if channel == 'time' else 'export it as well'}"


def _state(column: _Column, channel: Channel, likely: str) -> str:
    """Way out for a column in a unit of something else: volts are none of any channel, whatever is stated."""
    measured = quantity_of(column.unit or "")
    if measured == "other":
        return f"export it as {INTERNAL_UNITS[channel]}, calibrated"
    declared = measured in AXES.get(channel, ())[1:]
    axis = f", or declare the axis with --axes {channel}={measured}" if declared else ""
    return f"state the one it is in, as with --units {channel}={likely}{axis}"


def _agrees(unit: str, quantity: Quantity, factor: float) -> bool:
    try:
        return factor_to(unit, quantity) == factor
    except ValueError:
        return False


def _factor(
    head: _Head, column: _Column, channel: Channel, place: Place, line: int | None, flags: list[Flag]
) -> float:
    """Factor that turns the column into s, mm or N (or a strain, or MPa, where that was declared)."""
    options = head.options
    quantity = options.quantity(channel)
    if channel in options.units:
        factor = factor_to(options.units[channel], quantity)
        if column.unit is not None and not _agrees(column.unit, quantity, factor):
            unit = options.units[channel]
            taken = f"column {column.shown!r} is in {column.unit!r}; {unit!r} was taken by --units"
            values = {"quantity": channel, "column": column.name, "unit": unit}
            flags.append(Flag("unit_overridden", taken, values))
        return factor
    internal = INTERNAL_UNITS[quantity]
    if column.unit is None:
        message = f"column {column.shown!r} has no unit; {internal} was assumed"
        if rank_of(column.base, channel, loose=True) == SYMBOL_RANK and channel in AXES:
            message += f" (a {AXES[channel][1]}? --axes {channel}={AXES[channel][1]})"
        values = {"quantity": channel, "column": column.name, "unit": internal}
        flags.append(Flag("units_assumed", message, values))
        return 1.0
    try:
        factors = [factor_to(unit, quantity) for unit in column.units]
    except ValueError as error:
        known = any(quantity_of(unit) not in (None, quantity) for unit in column.units)
        likely = _IN_CAPITALS.get(column.unit, internal if column.unit.isalpha() else "UNIT")
        message = f"column {column.shown!r}: {error}; or {_state(column, channel, likely)}"
        place.refuse("wrong_unit" if known else "unknown_unit", message, line=line, column=column.index + 1)
    if len(set(factors)) > 1:
        message = (
            f"column {column.shown!r} is in {column.units[0]!r} by the header and in {column.units[1]!r}"
            f" by its name; state the right one with --units {channel}={column.units[0]}"
        )
        place.refuse("unit_conflict", message, line=line, column=column.index + 1)
    return factors[0]
