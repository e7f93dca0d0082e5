"""Class (c): units, decimal marks and thousands marks made invalid or inconsistent."""

from __future__ import annotations

from collections.abc import Callable

from fuzz_mutant import Mutant, Mutation, Random, textual
from fuzz_seeds import OTHER_MARK, Seed, split_cells

UNKNOWN_UNITS = ("zork", "Nn", "sce", "mmm", "newtons per", "?", "m m", "1", "N*", "mu", "kgN", "mn2", "#")
WRONG_UNITS = {
    0: ("mm", "N", "mm/s", "MPa", "Hz"),
    1: ("s", "N", "mm/s", "mm2", "kN"),
    2: ("mm", "s", "MPa", "N/mm", "J", "mm/mm"),
}


def _with_unit(seed: Seed, channel: int, new: str | None) -> list[str]:
    """The lines with another unit text in its place; ``None`` leaves none."""
    lines = list(seed.lines)
    line = seed.names if seed.units is None else seed.units
    cells = split_cells(lines[line], seed.intent.delimiter)
    k, old = seed.intent.channels[channel], seed.intent.units[channel]
    if new is None:
        bare = cells[k].strip('"')
        new = "" if bare == old else bare.replace(f" ({old})", "").replace(f"({old})", "")
        cells[k] = f'"{new}"' if bare != cells[k] else new
    else:
        bracketed = f"({old})" in cells[k]
        cells[k] = cells[k].replace(f"({old})" if bracketed else old, f"({new})" if bracketed else new)
    lines[line] = seed.intent.delimiter.join(cells)
    return lines


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
    other = {0: "min", 1: "um", 2: "lbf"}[channel]
    lines = list(seed.lines)
    cells = split_cells(lines[seed.names], seed.intent.delimiter)
    k = seed.intent.channels[channel]
    bare = cells[k].strip('"')
    cells[k] = cells[k].replace(bare, f"{bare} ({other})")
    lines[seed.names] = seed.intent.delimiter.join(cells)
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
