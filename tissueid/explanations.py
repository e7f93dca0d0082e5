"""Meaning of flags, parameters and exit codes: one table for ``tissueid explain`` and ``docs/flags.md``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from difflib import get_close_matches

from tissueid.errors import UsageError
from tissueid.flags import FLAGS
from tissueid.model.grammar import described
from tissueid.quantity_words import QUANTITIES, quantity_name

# fmt: off
#: Exit code -> what it means, and what to do.
EXIT_MEANINGS: Mapping[str, tuple[str, str]] = {
    "0": ("it worked", "Nothing."),
    "1": ("a bug in tissueid", "Run again with -v and report what it prints."),
    "2": ("wrong usage: an option, a path or a setting makes no sense",
        "The message names it and the way out."),
    "3": ("every input was refused",
        "Each file is named with its line; correct it, or state what is unclear."),
    "4": ("a required parameter is not identified, or something did not converge",
        "The result is written; look at its flags, test more, or choose with --require what you need."),
    "5": ("a device is missing, forbidden or lost, or safety refused",
        "The message says which; --device sim."),
    "6": ("an output folder or bundle is damaged, or can't be written",
        "`tissueid validate` says what; fit again."),
    "7": ("finished, but something was left out", "Each is named with its line."),
    "130": ("interrupted", "What was finished is kept; the same command goes on from there, or begins anew."),
}
# fmt: on
#: Gravity of a flag -> words.
GRAVITY = {
    "ok": "harmless",
    "note": "states what was assumed or done",
    "caution": "look at it before you quote a number",
    "serious": "puts the result in doubt",
}


@dataclass(frozen=True, slots=True)
class Explanation:
    """One entry."""

    kind: str  # ``flag``, ``parameter`` or ``exit code``
    name: str
    title: str
    meaning: str
    #: Empty where there is none.
    follows: str = ""
    remedy: str = ""
    #: Of a parameter: as printed, what moves it, and how its interval is read.
    symbol: str = ""
    unit: str = ""
    depends: str = ""
    interval: str = ""


def explanations() -> dict[str, Explanation]:
    """Every entry by its name; parameters and exit codes first, then flags in their order."""
    found = [Explanation("parameter", name, **asdict(one)) for name, one in QUANTITIES.items()]
    known = {one.name for one in found}
    for row in described():
        for one in row["parameters"]:
            if one["name"] not in known:
                known.add(one["name"])
                of = f"{one['meaning']}, of {row['key']} (tissueid models {row['key']})"
                symbol, unit = one["symbol"], one["unit"]
                found.append(Explanation("parameter", one["name"], "", of, symbol=symbol, unit=unit))
    found += [
        Explanation("exit code", code, "", meaning, remedy=way)
        for code, (meaning, way) in EXIT_MEANINGS.items()
    ]
    found += [
        Explanation("flag", code, kind.title, kind.means, kind.follows, kind.remedy)
        for code, kind in FLAGS.items()
    ]
    return {one.name: one for one in found}


def explain(name: str) -> Explanation:
    """The entry of a name."""
    known = explanations()
    quantity = quantity_name(name)
    if quantity is not None:
        return known[quantity]
    plain = name.strip().replace("-", "_")
    for branch in ("_b2", "_b3"):
        plain = plain.removesuffix(branch)
    if plain in known:
        return known[plain]
    near = get_close_matches(plain, known, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}?" if near else "`tissueid explain` lists what it knows"
    raise UsageError(f"{name!r} is no flag, parameter or exit code; {hint}")
