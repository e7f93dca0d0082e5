"""Readers of other distributions, by the entry-point group ``tissueid.readers``.

An entry point names a :class:`~tissueid.ingest.recipe.Recipe`.  One that can't be loaded, or breaks while
it reads, is named in :func:`reader_faults` and never stops the others.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from importlib.metadata import entry_points

from tissueid.errors import InputError
from tissueid.ingest.recipe import InputFile, Recipe, Table
from tissueid.ingest.refusals import Place
from tissueid.ingest.vocabulary import CHANNELS
from tissueid.trial import Trial

#: Entry-point group.
GROUP = "tissueid.readers"

_faults: dict[str, None] = {}


def reader_faults() -> tuple[str, ...]:
    """Faults of installed readers so far, one sentence each, naming the reader."""
    return tuple(_faults)


def report_fault(name: str, what: str, error: Exception) -> None:
    """Remember that a reader broke."""
    _faults[f"the installed reader {name!r} {what}: {type(error).__name__}: {str(error)[:200]}"] = None


def forget_readers() -> None:
    """Look for installed readers again, after distributions were added or removed."""
    installed_recipes.cache_clear()
    _faults.clear()


@cache
def installed_recipes(taken: frozenset[str]) -> dict[str, Recipe]:
    """The recipes of other distributions.

    ``taken``: keys that are not to be had.  Returns key -> recipe, guarded: a failure of its code is a
    refusal of the file.
    """
    found: dict[str, Recipe] = {}
    for point in entry_points(group=GROUP):
        try:
            recipe = _checked(point.load(), taken | found.keys())
        except Exception as error:  # noqa: BLE001 - somebody else's code must not stop the others
            report_fault(f"{point.name} ({point.value})", "can't be used", error)
            continue
        found[recipe.key] = _guarded(recipe)
    return found


def _checked(recipe: object, taken: frozenset[str]) -> Recipe:
    if not isinstance(recipe, Recipe):
        msg = f"it is a {type(recipe).__name__}, not a tissueid.ingest.Recipe"
        raise TypeError(msg)
    if not recipe.key or recipe.key in taken:
        msg = f"its key {recipe.key!r} is taken; choose another"
        raise ValueError(msg)
    return recipe


def _table(item: object) -> Table | InputError:
    if not isinstance(item, Table | InputError):
        msg = f"it gave a {type(item).__name__}, not a Table"
        raise TypeError(msg)
    if isinstance(item, Table):
        missing = [channel for channel in CHANNELS if channel not in item.columns]
        if missing:
            msg = f"its table names no column of {' and '.join(missing)}"
            raise ValueError(msg)
        # a trial is made of it later; what that would refuse is the reader's fault
        Trial("", item.time_s, item.displacement_mm, item.force_N)
    return item


def _guarded(recipe: Recipe) -> Recipe:
    def read(file: InputFile) -> Iterator[Table | InputError]:
        try:
            for item in recipe.read(file):
                yield _table(item)
        except InputError as error:
            yield error
        except Exception as error:  # noqa: BLE001 - a bug of theirs is a refusal of this file
            report_fault(recipe.key, f"broke on {file.path}", error)
            yield Place(file.path).refusal(
                "reader_failed",
                f"the installed reader {recipe.key!r} broke on this file ({type(error).__name__}:"
                f" {str(error)[:160]}); choose another with --recipe, or tell its author",
            )

    return Recipe(recipe.key, recipe.description, recipe.detect, read)
