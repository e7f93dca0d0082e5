"""Class (b): other values, all of them meant: read as edited, or refused."""

from __future__ import annotations

import re
from dataclasses import replace

from fuzz_mutant import Mutant, Mutation, Random, textual
from fuzz_seeds import UNITS_OF, Seed, split_cells

#: What a cell may come to hold: numbers of any size, and what is none.
STRANGE = (
    "0", "-0", "1", "-1", "00012{d}5", "1{d}", "{d}5", "+3{d}25", "1e3", "2{d}5E-4", "-1{d}5e+02", "1e-400",
    "1e308", "1e400", "9" * 30, "123456789012345678{d}5", "0{d}1000000000000000055511151231257827", "nan",
    "NaN", "inf", "-Infinity", "1.#IND", "#N/A", "#DIV/0!", "n/a", "TRUE", "text", "", " ", "-", "+", ".",
    ",", "--5{d}0", "+-3{d}0", "1 2", "1_000", "0x1F", "1e", "e5", "1e5e5", "5%", "$5{d}0", "(5{d}0)",
    "\u0663", "\uff11\uff12", "\u00bd", "\u2212" + "5{d}0", "2020-01-01", "00:01:30", "1/2", "=1+1", "1d5",
    "1e+", "5{d}0N", "5{d}0 mm", "\u221e",
)  # fmt: skip


def _body_cell(seed: Seed, rng: Random) -> tuple[list[str], int, list[str], int]:
    """Lines, a row of the body, its cells, and a cell of a channel."""
    lines = list(seed.lines)
    at = rng.randrange(seed.first, len(lines))
    if rng.random() < 0.1:
        at = rng.choice((seed.first, len(lines) - 1))
    return lines, at, split_cells(lines[at], seed.intent.delimiter), rng.choice(seed.intent.channels)


def _edited(kind: str, seed: Seed, rng: Random, change: object) -> Mutant:
    """Some cells changed by ``change(cell)``, quotes kept around."""
    lines, at, cells, k = _body_cell(seed, rng)
    for _ in range(rng.choice((1, 1, 1, 3))):
        quote = '"' if cells[k].startswith('"') else ""
        cells[k] = quote + change(cells[k].strip('"')) + quote  # type: ignore[operator]
        k = rng.choice(seed.intent.channels)
    lines[at] = seed.intent.delimiter.join(cells)
    return textual(kind, seed, lines, expect="oracle")


def digit(seed: Seed, rng: Random) -> Mutant:
    def change(cell: str) -> str:
        places = [i for i, letter in enumerate(cell) if letter.isdigit()]
        i = rng.choice(places or [0])
        return cell[:i] + rng.choice("0123456789") + cell[i + 1 :]

    return _edited("digit changed", seed, rng, change)


def digit_count(seed: Seed, rng: Random) -> Mutant:
    def change(cell: str) -> str:
        places = [i for i, letter in enumerate(cell) if letter.isdigit()]
        i = rng.choice(places or [0])
        new = rng.choice("0123456789") + cell[i : i + 1] if rng.random() < 0.5 else ""
        return cell[:i] + new + cell[i + 1 :]

    return _edited("digit added or removed", seed, rng, change)


def sign(seed: Seed, rng: Random) -> Mutant:
    def change(cell: str) -> str:
        return cell[1:] if cell.startswith("-") else rng.choice("-+") + cell

    return _edited("sign", seed, rng, change)


def exponent(seed: Seed, rng: Random) -> Mutant:
    power = rng.choice(("e0", "e1", "E3", "e-2", "E+02", "e-005", "e10", "e", "E+", "e1.5"))
    return _edited("exponent", seed, rng, lambda cell: cell + power)


def replaced(seed: Seed, rng: Random) -> Mutant:
    new = rng.choice(STRANGE).replace("{d}", seed.intent.decimal)
    return _edited("cell replaced", seed, rng, lambda _cell: new)


def other_number(seed: Seed, rng: Random) -> Mutant:
    """A number with its decimals, near or far."""
    places = rng.choice((0, 1, 2, 3, 5, 7, 12))
    text = f"{rng.uniform(-1, 1) * 10.0 ** rng.choice((0, 1, 3, 5)):.{places}f}"
    return _edited("another number", seed, rng, lambda _cell: text.replace(".", seed.intent.decimal))


def whole_column(seed: Seed, rng: Random) -> Mutant:
    """Every value of a column edited alike: one more digit, or the other sign."""
    k, new, flip = rng.choice(seed.intent.channels), rng.choice("0123456789"), rng.random() < 0.4

    def edited(cells: list[str]) -> list[str]:
        quote = '"' if cells[k].startswith('"') else ""
        bare = cells[k].strip('"')
        bare = (bare[1:] if bare.startswith("-") else "-" + bare) if flip else bare + new
        return [*cells[:k], quote + bare + quote, *cells[k + 1 :]]

    lines = seed.with_cells(range(seed.first, len(seed.lines)), edited)
    return textual("a column edited", seed, lines, expect="oracle")


def unit(seed: Seed, rng: Random) -> Mutant:
    """One valid unit for another: the values are in the new unit."""
    channel = rng.randrange(3)
    old = seed.intent.units[channel]
    new = rng.choice([u for u in UNITS_OF[channel] if u != old])
    lines = list(seed.lines)
    line = seed.names if seed.units is None else seed.units
    cells = split_cells(lines[line], seed.intent.delimiter)
    k = seed.intent.channels[channel]
    cells[k] = re.sub(rf"(?<![^\W_]){old}(?![^\W_])", new, cells[k])
    lines[line] = seed.intent.delimiter.join(cells)
    units = [*seed.intent.units]
    units[channel] = new
    meant = replace(seed.intent, units=tuple(units))
    return textual("another valid unit", seed, lines, expect="oracle", intent=meant)


def order_of_columns(seed: Seed, rng: Random) -> Mutant:
    """Columns change places with their names and units."""
    order = list(range(seed.intent.n_columns))
    rng.shuffle(order)
    rows = range(seed.names, len(seed.lines))
    lines = seed.with_cells(rows, lambda cells: [cells[k] for k in order])
    channels = tuple(order.index(k) for k in seed.intent.channels)
    words = frozenset(order.index(k) for k in seed.intent.words)
    meant = replace(seed.intent, channels=channels, words=words)
    return textual("order of columns", seed, lines, expect="oracle", intent=meant)


def names_swapped(seed: Seed, rng: Random) -> Mutant:
    """The names, with their units, of two channels change places over the same numbers."""
    i, j = rng.sample(range(3), 2)
    a, b = seed.intent.channels[i], seed.intent.channels[j]
    swapped = {a: b, b: a}
    lines = seed.with_cells(
        [at for at in (seed.names, seed.units) if at is not None],
        lambda cells: [cells[swapped.get(k, k)] for k in range(len(cells))],
    )
    channels = [*seed.intent.channels]
    channels[i], channels[j] = b, a
    meant = replace(seed.intent, channels=tuple(channels))
    return textual("names changed places", seed, lines, expect="oracle", intent=meant)


VALUES: tuple[Mutation, ...] = (
    digit, digit, digit_count, sign, exponent, replaced, replaced, other_number, whole_column, unit,
    order_of_columns, names_swapped,
)  # fmt: skip
