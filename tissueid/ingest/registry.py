"""The recipes, and the choice between them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from tissueid.errors import InputError, UsageError
from tissueid.ingest.archive import archive_recipe
from tissueid.ingest.chiaro import CHIARO
from tissueid.ingest.delimited import BLUEHILL_CSV, COLUMNS_TEXT, TESTXPERT_TRA
from tissueid.ingest.jpk import JPK_FORCE
from tissueid.ingest.mach1 import MACH_1
from tissueid.ingest.mts793 import MTS_793
from tissueid.ingest.plugins import installed_recipes, report_fault
from tissueid.ingest.recipe import Detection, InputFile, Match, Recipe
from tissueid.ingest.refusals import Place
from tissueid.ingest.session import SESSION_LOG
from tissueid.ingest.shimadzu import SHIMADZU
from tissueid.ingest.workbook import TESTXPERT_WORKBOOK, WORKBOOK


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
