"""A mutant, and the verdict on what the reader made of it."""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Literal

import fuzz_oracle
import numpy as np
from fuzz_seeds import FACTORS, Intent, Seed

from tissueid.errors import InputError
from tissueid.flags import Flag
from tissueid.ingest import REFUSAL_CODES
from tissueid.trial import Trial

Expectation = Literal["original", "oracle", "doubt", "refusal"]
Outcome = Literal["read", "flagged", "refused"]
Random = random.Random

#: Remarks that say to the user: look at the numbers of this file.
DOUBTS = {"units_assumed", "rows_skipped", "cut_row", "no_decimals", "spike", "column_choice", "zero_dt"}
#: Products of the same two doubles in another order may differ in the last bits.
RELATIVE = 1e-12


@dataclass(frozen=True)
class Mutant:
    """Bytes, what they are meant to be, and what a reader may make of them."""

    kind: str
    seed: Seed
    data: bytes
    intent: Intent
    expect: Expectation
    cut: bool = False
    #: The line behind which another dialect begins, and that dialect.
    turn: tuple[int, Intent] | None = None

    @cached_property
    def reading(self) -> fuzz_oracle.Reading:
        """The rows that are meant, and the lines that are neither rows nor free of numbers."""
        return fuzz_oracle.read(self.data, self.intent, self.turn)


#: kind -> what makes a mutant of a seed, or ``None`` where the seed has nothing to change.
Mutation = Callable[[Seed, Random], "Mutant | None"]


class WrongError(AssertionError):
    """The reader took a mutant for something that it is not."""


def textual(
    kind: str, seed: Seed, lines: Sequence[str], *, expect: Expectation, intent: Intent | None = None,
    newline: str | None = None, encoding: str | None = None, end: str | None = None,
) -> Mutant:  # fmt: skip
    newline = seed.newline if newline is None else newline
    text = newline.join(lines) + (newline if end is None else end)
    meant = seed.intent if intent is None else intent
    data = text.encode(encoding or meant.encoding, errors="replace")
    return Mutant(kind, seed, data, meant, expect)


@cache
def original(seed: Seed) -> tuple[tuple[float, float, float], ...]:
    reading = fuzz_oracle.read(seed.data, seed.intent)
    assert len(reading.rows) == len(seed.lines) - seed.first
    return tuple(row.values for row in reading.rows)


def remarks(trial: Trial) -> frozenset[tuple[str, str]]:
    """Remarks on a recording: the code of each flag, and which column or channel it speaks of."""
    return frozenset(
        (flag.code, str(flag.values.get("taken", flag.values.get("quantity", "")))) for flag in trial.flags
    )


def judge(mutant: Mutant, item: Trial | InputError, usual: frozenset[tuple[str, str]]) -> Outcome:
    """The outcome; raises :class:`WrongError` where values are wrong, rows are lost, or a doubt is unsaid."""
    if isinstance(item, InputError):
        if item.code not in REFUSAL_CODES:
            raise WrongError(f"unknown refusal code {item.code}")
        return "refused"
    unusual = {code for code, _ in remarks(item) - usual}
    if mutant.expect == "refusal":
        raise WrongError("read, though it can't be right")
    if mutant.cut and "cut_row" not in unusual:
        raise WrongError("the last row was cut, and nobody says so")
    if mutant.expect == "doubt":
        if not unusual & DOUBTS:
            raise WrongError("read without a doubt")
        return "flagged"
    compare(item, _expected(mutant, item))
    return "flagged" if unusual else "read"


def judge_parts(mutant: Mutant, items: Sequence[Trial | InputError]) -> Outcome:
    """The outcome of recordings below each other: the rows up to each fall of the time, up to a refusal."""
    if mutant.expect != "oracle":
        raise WrongError(f"{len(items)} recordings, though there is one")
    reading = mutant.reading
    turn = mutant.turn[0] if mutant.turn else 0
    parts: list[list[fuzz_oracle.Row]] = []
    for row in reading.rows:
        last = parts[-1][-1] if parts else None
        if last is None or row.values[0] < last.values[0] or last.line <= turn < row.line:
            parts.append([])
        parts[-1].append(row)
    for item, rows in zip(items, parts, strict=not any(isinstance(item, InputError) for item in items)):
        if isinstance(item, InputError):
            return "refused"
        left_out = _left_out(item.flags)
        kept = [row for row in rows if row.line not in left_out]
        if any(kept[0].line < line < kept[-1].line for line in set(reading.odd) - left_out):
            raise WrongError("a line is neither a row nor a remark, and was passed over")
        compare(item, _in_units(mutant, item, [row.values for row in kept]))
    if mutant.cut and not any(flag.code == "cut_row" for flag in items[-1].flags):
        raise WrongError("the last row was cut, and nobody says so")
    return "flagged"


def compare(trial: Trial, expected: Sequence[tuple[float, float, float]]) -> None:
    """Raise :class:`WrongError` where a recording has other rows."""
    channels = (trial.time_s.tolist(), trial.displacement_mm.tolist(), trial.force_N.tolist())
    got = list(zip(*channels, strict=True))
    if len(got) != len(expected):
        said = sorted({flag.code for flag in trial.flags})
        raise WrongError(f"{len(got)} rows read, {len(expected)} are there (flags: {said})")
    ticks = [flag.values["tick_s"] for flag in trial.flags if "tick_s" in flag.values]
    if ticks:  # times are spread between the ticks, which is said: they go on, by less than a tick
        assert np.all(np.diff(trial.time_s) > 0.0)
        late = np.subtract(channels[0], [time for time, _, _ in expected])
        assert np.all((late >= 0.0) & (late < ticks[0]))
    for i, (read, meant) in enumerate(zip(got, expected, strict=True)):
        first = 1 if ticks else 0
        if any(abs(a - b) > RELATIVE * abs(b) for a, b in zip(read[first:], meant[first:], strict=True)):
            raise WrongError(f"row {i} was read as {read}, it is {meant}")


def _expected(mutant: Mutant, trial: Trial) -> list[tuple[float, float, float]]:
    """The rows that the reader should have, given what it said that it left out or assumed."""
    left_out = _left_out(trial.flags)
    if mutant.expect == "original":
        rows = list(original(mutant.seed))
        if trial.time_s.size == len(rows) - 1 and any(_is_left_out(flag) for flag in trial.flags):
            rows.pop()
    else:
        reading = mutant.reading
        kept = [row for row in reading.rows if row.line not in left_out]
        rows = [row.values for row in kept]
        start = min((row.line for row in kept), default=0)
        passed_over = [line for line in reading.odd if line > start and line not in left_out]
        if passed_over:
            raise WrongError(f"line {passed_over[0]} is neither a row nor a remark, and was passed over")
    return _in_units(mutant, trial, rows)


def _in_units(
    mutant: Mutant, trial: Trial, rows: Sequence[tuple[float, float, float]]
) -> list[tuple[float, float, float]]:
    """Rows in the units that the reader assumed."""
    scale = [1.0, 1.0, 1.0]
    for flag in trial.flags:
        if flag.code == "units_assumed":
            channel = ("time", "displacement", "force").index(flag.values["quantity"])
            scale[channel] = 1.0 / FACTORS[mutant.intent.units[channel]]
    return [(t * scale[0], x * scale[1], f * scale[2]) for t, x, f in rows]


def _left_out(flags: Sequence[Flag]) -> set[int]:
    """Lines that the flags name as left out."""
    lines: set[int] = set()
    for flag in flags:
        if flag.code == "rows_skipped":
            named, count = flag.values["lines"], flag.values["count"]
            # a table of results is named by its first and last line
            lines.update(range(named[0], named[1] + 1) if len(named) == 2 and count > 2 else named)
        elif _is_left_out(flag):
            lines.add(flag.values["line"])
    return lines


def _is_left_out(flag: Flag) -> bool:
    return flag.code == "cut_row" and not flag.values["kept"]
