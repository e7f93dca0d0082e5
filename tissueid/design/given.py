"""Protocols and tissues that are given: a recipe, a bundle, guesses."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tissueid.design.information import Indentation
from tissueid.design.precision import Protocol
from tissueid.design.tissues import Guess, Tissues, of_draws, of_guesses
from tissueid.errors import UsageError
from tissueid.selfcheck.protocol import of_recipe
from tissueid.store.bundle import load_bundle
from tissueid.synth import RECIPES, Hold, Move, Recipe, load_recipe
from tissueid.synth import recipe as built_in

#: Samples a second for a recipe of which only the tissue is taken: its path is not looked at.
COARSE_HZ = 10.0


def given_recipe(named: str) -> Recipe:
    """A built-in recipe, or one of a file.

    Raises UsageError, InputError.
    """
    if named not in RECIPES and not Path(named).is_file():
        msg = f"{named}: no such recipe or file; recipes are {', '.join(sorted(RECIPES))}"
        raise UsageError(msg)
    return built_in(named) if named in RECIPES else load_recipe(named)


def given_protocol(recipe: Recipe) -> Protocol:
    """Ramps and holds of a recipe.

    Raises UsageError: a log is something else.
    """
    out: dict[Indentation, int] = {}
    for log in recipe.logs:
        match log.moves:
            case (Move() as move,):
                hold = 0.0
            case (Move() as move, Hold() as stop):
                hold = stop.hold_s
            case _:
                msg = f"{recipe.name}: log {log.name!r} is not one ramp, with or without a hold: not compared"
                raise UsageError(msg)
        test = Indentation(move.speed_mm_min, move.to_mm, hold)
        out[test] = out.get(test, 0) + log.repeats
    return out


def of_recipe_tissue(recipe: Recipe) -> Tissues:
    """The one tissue of a recipe."""
    _, centre = of_recipe(recipe, rate_Hz=COARSE_HZ)
    words = f"the truth of the recipe {recipe.name}"
    return of_draws(words, recipe.specimen, centre.model, centre.theta, count=1, known_depth_mm=None)


def of_bundle(path: Path, *, count: int) -> Tissues:
    """Posterior draws of a bundle, or specimens of the population it holds.

    Raises UsageError: it holds no law; BundleError.
    """
    bundle = load_bundle(path)
    bundle.require_renderable()
    model = bundle.contact_model()
    if not bundle.parameters:
        msg = f"{path}: {bundle.model.key} has no parameters to plan for; fit a law"
        raise UsageError(msg)
    kind = "specimens of the population in" if bundle.is_population else "posterior draws of"
    words = f"{kind} {path}" if bundle.draws is not None else f"the optimum of {path}: it holds no draws"
    theta = bundle.theta if bundle.draws is None else bundle.draws
    return of_draws(words, bundle.specimen, model, theta, count=count, known_depth_mm=bundle.depth_mm)


def plain_guesses(guesses: Sequence[Guess], *, depth_mm: float | None, count: int) -> Tissues:
    """Tissues around plain guesses.

    Raises UsageError.
    """
    if depth_mm is None:
        msg = "guesses say nothing of the depth: add --max-depth, in mm"
        raise UsageError(msg)
    return of_guesses(guesses, depth_mm=depth_mm, count=count)
