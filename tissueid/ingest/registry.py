"""The recipes, and the choice between them."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from tissueid.errors import InputError, UsageError
from tissueid.ingest.delimited import BLUEHILL_CSV, COLUMNS_TEXT, TESTXPERT_TRA
from tissueid.ingest.recipe import InputFile, Match, Recipe
from tissueid.ingest.refusals import Place
from tissueid.ingest.workbook import TESTXPERT_WORKBOOK, WORKBOOK

__all__ = ["RECIPES", "match_recipe"]

#: Key -> recipe, in the order in which equals win.
RECIPES: Mapping[str, Recipe] = MappingProxyType(
    {
        recipe.key: recipe
        for recipe in (BLUEHILL_CSV, TESTXPERT_TRA, TESTXPERT_WORKBOOK, WORKBOOK, COLUMNS_TEXT)
    }
)


def match_recipe(file: InputFile) -> Match:
    """The surest recipe for a file, or the one the user asked for.

    Raises
    ------
    UsageError
        The user asked for a recipe that does not exist.
    InputError
        No recipe knows the file.
    """
    wanted = file.options.recipe
    if wanted is not None:
        if wanted not in RECIPES:
            msg = f"unknown recipe {wanted!r}, one of {', '.join(RECIPES)}"
            raise UsageError(msg)
        return Match(RECIPES[wanted], 1.0, "the user asked for it")
    matches = [Match(recipe, *recipe.detect(file)) for recipe in RECIPES.values()]
    best = max(matches, key=lambda match: match.confidence)
    if best.confidence > 0.0:
        return best
    if isinstance(file.fault, InputError):
        raise file.fault
    message = "no reader knows this file; give the raw data export of the test machine"
    refusal = Place(file.path).refusal("not_an_export", message)
    raise refusal
