"""Class (b): other values, all of them meant: read as edited, or refused; (c): units and marks spoilt."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from fuzz_mutant import Mutant, Mutation, Random, textual
from fuzz_seeds import OTHER_MARK, UNITS_OF, Seed, split_cells

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


def _a_digit(cell: str, rng: Random) -> int:
    """Place of one of its digits."""
    return rng.choice([i for i, letter in enumerate(cell) if letter.isdigit()] or [0])


def digit(seed: Seed, rng: Random) -> Mutant:
    def change(cell: str) -> str:
        i = _a_digit(cell, rng)
        return cell[:i] + rng.choice("0123456789") + cell[i + 1 :]

    return _edited("digit changed", seed, rng, change)


def digit_count(seed: Seed, rng: Random) -> Mutant:
    def change(cell: str) -> str:
        i = _a_digit(cell, rng)
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
    word = rf"(?<![^\W_]){old}(?![^\W_])"
    lines = seed.with_cell(seed.unit_line, seed.intent.channels[channel], partial(re.sub, word, new))
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


UNKNOWN_UNITS = ("zork", "Nn", "sce", "mmm", "newtons per", "?", "m m", "1", "N*", "mu", "kgN", "mn2", "#")
WRONG_UNITS = {
    0: ("mm", "N", "mm/s", "MPa", "Hz"),
    1: ("s", "N", "mm/s", "mm2", "kN"),
    2: ("mm", "s", "MPa", "N/mm", "J", "mm/mm"),
}


def _with_unit(seed: Seed, channel: int, new: str | None) -> list[str]:
    """The lines with another unit text in its place; ``None`` leaves none."""
    old = seed.intent.units[channel]

    def changed(cell: str) -> str:
        if new is not None:
            in_brackets = f"({old})" in cell
            return cell.replace(f"({old})", f"({new})") if in_brackets else cell.replace(old, new)
        bare = cell.strip('"')
        left = "" if bare == old else bare.replace(f" ({old})", "").replace(f"({old})", "")
        return f'"{left}"' if bare != cell else left

    return seed.with_cell(seed.unit_line, seed.intent.channels[channel], changed)


def unknown_unit(seed: Seed, rng: Random) -> Mutant:
    lines = _with_unit(seed, rng.randrange(3), rng.choice(UNKNOWN_UNITS))
    return textual("unknown unit", seed, lines, expect="doubt")


def wrong_unit(seed: Seed, rng: Random) -> Mutant:
    channel = rng.randrange(3)
    lines = _with_unit(seed, channel, rng.choice(WRONG_UNITS[channel]))
    return textual("unit of something else", seed, lines, expect="doubt")


def no_unit(seed: Seed, rng: Random) -> Mutant:
    if seed.units is not None and rng.random() < 0.4:
        lines = list(seed.lines)
        del lines[seed.units]
        return textual("no row of units", seed, lines, expect="doubt")
    return textual("no unit", seed, _with_unit(seed, rng.randrange(3), None), expect="doubt")


def conflict(seed: Seed, rng: Random) -> Mutant | None:
    """The name says another unit than the row of units."""
    if seed.units is None:
        return None
    channel = rng.randrange(3)
    other = ("min", "um", "lbf")[channel]

    def changed(cell: str) -> str:
        bare = cell.strip('"')
        return cell.replace(bare, f"{bare} ({other})")

    lines = seed.with_cell(seed.names, seed.intent.channels[channel], changed)
    return textual("two units", seed, lines, expect="doubt")


def _marked(
    kind: str, seed: Seed, rng: Random, change: Callable[[str], str], *, few: bool, column: bool = True
) -> Mutant | None:
    """Cells of one column, a few or all, changed where ``change`` finds something to change."""
    lines, k = list(seed.lines), rng.choice(seed.intent.channels)
    rows = list(range(seed.first, len(lines)))
    if few:
        rng.shuffle(rows)
    changed, wanted = 0, rng.choice((1, 1, 1, 2, 10)) if few else len(rows)
    for at in rows:
        cells = split_cells(lines[at], seed.intent.delimiter)
        for place in (k,) if column else seed.intent.channels:
            quote = '"' if cells[place].startswith('"') else ""
            bare = cells[place].strip('"')
            new = change(bare)
            if new != bare:
                cells[place] = quote + new + quote
                changed += 1
        lines[at] = seed.intent.delimiter.join(cells)
        if changed >= wanted and few:
            break
    return textual(kind, seed, lines, expect="doubt") if changed else None


def mark_changed(seed: Seed, rng: Random) -> Mutant | None:
    point = seed.intent.decimal
    others = (":", "'", " ", "_", "\u00b7", "..", ",,", ".,", ",.", "\u066b")
    new = rng.choice((OTHER_MARK[point],) * 4 + others)
    few = rng.random() < 0.7
    kind = f"decimal mark changed, {'few cells' if few else 'a column'}"
    return _marked(kind, seed, rng, lambda cell: cell.replace(point, new), few=few)


def mark_lost(seed: Seed, rng: Random) -> Mutant | None:
    def change(cell: str) -> str:
        return cell.replace(seed.intent.decimal, "") if len(cell) > 3 else cell

    how = rng.choice(("few cells", "few cells", "a column", "all columns"))
    few = how == "few cells"
    return _marked(f"decimal mark lost, {how}", seed, rng, change, few=few, column=how != "all columns")


def mark_doubled(seed: Seed, rng: Random) -> Mutant | None:
    point = seed.intent.decimal

    def change(cell: str) -> str:
        at = rng.randrange(len(cell) + 1)
        return cell[:at] + point + cell[at:] if point in cell else cell

    return _marked("a second decimal mark", seed, rng, change, few=True)


def group_misplaced(seed: Seed, rng: Random) -> Mutant | None:
    """A separator of thousands where there are no thousands, or two kinds of it in one number."""
    point = seed.intent.decimal
    mark = seed.intent.thousands or rng.choice((OTHER_MARK[point], "'", " ", "\u00a0"))

    def change(cell: str) -> str:
        bare = cell.replace(mark, "")
        whole = bare.partition(point)[0]
        start = len(whole) - len(whole.lstrip("+-"))
        right = {len(whole) - 3 * i for i in range(1, 9)}
        places = [i for i in range(start, len(bare) + 1) if i not in right or i == start]
        if not mark.strip():
            places = [i for i in places if start < i < len(bare) or (i == start > 0)]  # else it is padding
        if not places:
            return cell
        at = rng.choice(places)
        return bare[:at] + mark + bare[at:]

    return _marked("thousands mark misplaced", seed, rng, change, few=rng.random() < 0.7)


def group_mixed(seed: Seed, rng: Random) -> Mutant | None:
    """Another separator of thousands than in the rest of the file."""
    mark = seed.intent.thousands
    if not mark:
        return None
    others = (OTHER_MARK[seed.intent.decimal], "'", " ")
    new = rng.choice([m for m in others if m != mark.replace("\u00a0", " ")])
    return _marked("two kinds of thousands mark", seed, rng, lambda cell: cell.replace(mark, new), few=True)


def group_without_decimals(seed: Seed, rng: Random) -> Mutant | None:
    """Grouped, and the decimals gone: a thousand or a decimal number."""
    point = seed.intent.decimal
    mark = seed.intent.thousands or OTHER_MARK[point]

    def change(cell: str) -> str:
        whole = cell.partition(point)[0].replace(mark, "")
        return f"{whole[:-3]}{mark}{whole[-3:]}" if len(whole.lstrip("+-")) == 4 else cell

    return _marked("grouped without decimals", seed, rng, change, few=True)


MARKS: tuple[Mutation, ...] = (
    unknown_unit, wrong_unit, no_unit, conflict, mark_changed, mark_changed, mark_lost, mark_lost,
    mark_doubled, group_misplaced, group_mixed, group_without_decimals,
)  # fmt: skip
