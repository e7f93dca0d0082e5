"""The recipes, those of other distributions too, and the choice between them.

Readers of other distributions, by the entry-point group ``tissueid.readers``.
An entry point names a :class:`~tissueid.ingest.recipe.Recipe`.  One that can't be loaded, or breaks while
it reads, is named in :func:`reader_faults` and never stops the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import entry_points
from types import MappingProxyType

from tissueid.errors import InputError, UsageError
from tissueid.ingest.archive import archive_recipe
from tissueid.ingest.chiaro import CHIARO
from tissueid.ingest.delimited import BLUEHILL_CSV, COLUMNS_TEXT, TESTXPERT_TRA
from tissueid.ingest.jpk import JPK_FORCE
from tissueid.ingest.mach1 import MACH_1
from tissueid.ingest.mts793 import MTS_793
from tissueid.ingest.recipe import Detection, InputFile, Match, Recipe, Table
from tissueid.ingest.refusals import Place
from tissueid.ingest.session import SESSION_LOG
from tissueid.ingest.shimadzu import SHIMADZU
from tissueid.ingest.vocabulary import CHANNELS
from tissueid.ingest.workbook import TESTXPERT_WORKBOOK, WORKBOOK
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


def match_recipe(file: InputFile) -> Match:
    """The surest recipe for a file, or the one the user asked for.

    Raises UsageError: the user asked for a recipe that does not exist; InputError: no recipe knows the file.
    """
    recipes = all_recipes()
    wanted = file.options.recipe
    if wanted is not None:
        if wanted not in recipes:
            msg = f"unknown recipe {wanted!r}, one of {', '.join(recipes)}"
            raise UsageError(msg)
        return Match(recipes[wanted], 1.0, "the user asked for it")
    matches = [Match(recipe, *_detect(recipe, file)) for recipe in recipes.values()]
    best = max(matches, key=lambda match: match.confidence)
    if best.confidence > 0.0:
        return best
    if isinstance(file.fault, InputError):
        raise file.fault
    message = "no reader knows this file; give the raw data export of the test machine"
    refusal = Place(file.path).refusal("not_an_export", message)
    raise refusal


def _detect(recipe: Recipe, file: InputFile) -> Detection:
    """Detection of a file by a recipe; one that breaks, and is not ours, knows nothing of it."""
    if recipe.key in RECIPES:
        return recipe.detect(file)
    try:
        confidence, reason = recipe.detect(file)
        return min(max(float(confidence), 0.0), 1.0), str(reason)
    except Exception as error:  # noqa: BLE001 - somebody else's code must not stop the others
        report_fault(recipe.key, f"could not look at {file.path}", error)
        return 0.0, "the reader broke"


#: Key -> recipe, in the order in which equals win.
RECIPES: Mapping[str, Recipe] = MappingProxyType(
    {
        recipe.key: recipe
        for recipe in (
            BLUEHILL_CSV,
            TESTXPERT_TRA,
            TESTXPERT_WORKBOOK,
            MACH_1,
            MTS_793,
            SHIMADZU,
            CHIARO,
            JPK_FORCE,
            SESSION_LOG,
            WORKBOOK,
            COLUMNS_TEXT,
            archive_recipe(match_recipe),
        )
    }
)


def all_recipes() -> Mapping[str, Recipe]:
    """Our recipes, and those that other distributions have installed."""
    return {**RECIPES, **installed_recipes(taken=frozenset(RECIPES))}
