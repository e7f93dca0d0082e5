"""Synthetic recordings with a known truth: the oracle of the reader, the model and the fit.

Shares no code with any of them: closed forms instead of a recursion, its own writer of exports.
"""

from __future__ import annotations

from tissueid.synth.bluehill import DIALECTS, Dialect, bluehill_csv
from tissueid.synth.dataset import EXPORTS, Export, write_set
from tissueid.synth.recipe import (
    RECIPES,
    Branch,
    Hold,
    Log,
    Move,
    Recipe,
    Rupture,
    dump_recipe,
    load_recipe,
    recipe,
)
from tissueid.synth.simulate import SyntheticLog, as_trials, simulate

__all__ = [
    "DIALECTS",
    "EXPORTS",
    "RECIPES",
    "Branch",
    "Dialect",
    "Export",
    "Hold",
    "Log",
    "Move",
    "Recipe",
    "Rupture",
    "SyntheticLog",
    "as_trials",
    "bluehill_csv",
    "dump_recipe",
    "load_recipe",
    "recipe",
    "simulate",
    "write_set",
]
