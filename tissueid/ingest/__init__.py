"""Recordings in: files that test machines write become :class:`~tissueid.trial.Trial`.

A reader is a recipe in :data:`RECIPES`; the surest one reads a file, and what can't be trusted is
refused with line and column (:data:`REFUSAL_CODES`), never repaired.
"""

from tissueid.ingest.discovery import each_input, find_inputs
from tissueid.ingest.options import ReadOptions
from tissueid.ingest.reading import (
    RECIPES,
    forget_readers,
    known_recipe,
    match_of,
    read_each,
    read_one,
    read_trials,
    reader_faults,
)
from tissueid.ingest.recipe import InputFile, Match, Recipe, Table
from tissueid.ingest.refusals import REFUSAL_CODES, REFUSAL_MEANINGS

__all__ = [
    "RECIPES",
    "REFUSAL_CODES",
    "REFUSAL_MEANINGS",
    "InputFile",
    "Match",
    "ReadOptions",
    "Recipe",
    "Table",
    "each_input",
    "find_inputs",
    "forget_readers",
    "known_recipe",
    "match_of",
    "read_each",
    "read_one",
    "read_trials",
    "reader_faults",
]
