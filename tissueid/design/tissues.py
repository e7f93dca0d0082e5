"""Tissues and protocols that are given before the experiment: by a bundle, a recipe, or plain guesses."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import norm, qmc

from tissueid.arrays import FloatArray
from tissueid.documents.design import Want
from tissueid.errors import refuse
from tissueid.inference.estimates import REFERENCE_DEPTH
from tissueid.inference.reported import reported_draws
from tissueid.model.base import branch_suffix
from tissueid.model.channels import ChannelModel
from tissueid.model.kelvin_voigt import STATIC_DEGREE, kelvin_voigt
from tissueid.selfcheck.protocol import of_recipe
from tissueid.store.bundle import load_bundle
from tissueid.synth import RECIPES, Recipe, load_recipe
from tissueid.synth import recipe as built_in

#: Short names that are understood; ``_b2`` and ``_b3`` may follow.
ALIASES = {
    "tau": "relaxation_time_s",
    "relaxation_time": "relaxation_time_s",
    "eta": "viscosity_N_s_per_mm",
    "viscosity": "viscosity_N_s_per_mm",
    "K": "stiffness_0_N_per_mm",
    "stiffness": "stiffness_0_N_per_mm",
}
#: Standard deviations that may be wanted, as shares: beyond the last a relaxation time is not identified.
FINEST_WANT, COARSEST_WANT = 1e-5, 0.25
#: Greatest spread of a guess, as a standard deviation of its logarithm.
WIDEST_GUESS = 2.0
_SUFFIX = re.compile(r"(_b[23])$")
_GUESS = re.compile(r"^\s*(\w+)\s*=\s*([^~±\s]+)\s*(?:(?:~|±)\s*([0-9.eE+-]+)\s*%)?\s*$")
_WANT = re.compile(r"^\s*(\w+)\s*=\s*([0-9.eE+-]+)\s*%\s*$")


@dataclass(frozen=True, slots=True)
class Guess:
    """A guessed parameter; ``sd_ln`` is the standard deviation of its logarithm."""

    name: str
    value: float
    sd_ln: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Tissues:
    """Tissues that a protocol must serve."""

    words: str  # where they come from
    name: str
    model: ChannelModel
    theta: FloatArray  # (draws, p)
    known_depth_mm: float | None = None  # beyond it the law is continued, not identified

    @property
    def middle(self) -> FloatArray:
        """Medians of the reported numbers' draws, by parameter."""
        return np.asarray(np.median(self.theta, axis=0))

    @property
    def longest_tau_s(self) -> float:
        """Longest relaxation time of any draw."""
        return float(self.tau_s.max(initial=0.0))

    @property
    def tau_s(self) -> FloatArray:
        """Relaxation times of each draw."""
        return np.array([self.model.times(one) for one in self.theta])

    def numbers(self) -> dict[str, FloatArray]:
        """Reported parameters of each draw."""
        return reported_draws(self.model, self.theta)

    def pilot(self, count: int) -> Tissues:
        """A few of them, spread evenly over the first relaxation time."""
        if self.theta.shape[0] <= count:
            return self
        order = np.argsort(self.tau_s[:, 0], kind="stable")
        at = np.round((np.arange(count) + 0.5) / count * order.size - 0.5).astype(int)
        return Tissues(self.words, self.name, self.model, self.theta[order[at]], self.known_depth_mm)

    def gradients(self, name: str) -> FloatArray:
        """Derivative of the logarithm of a reported number by (coefficients, ln shapes), shape (draws, p)."""
        model, out = self.model, np.zeros_like(self.theta)
        names = list(model.parameter_names)
        if name in names:
            at = names.index(name)
            out[:, at] = 1.0 if at in model.shape_places else 1.0 / np.abs(self.theta[:, at])
            return out
        part = model.parts[viscosities(model).index(name)]
        powers = (REFERENCE_DEPTH * model.depth_mm) ** np.arange(float(model.stiffness_degree + 1))
        stiffness = self.theta[:, part.stiffness] @ powers
        out[:, part.stiffness] = powers / stiffness[:, None]
        out[:, part.shapes.start] = 1.0
        return out


def viscosities(model: ChannelModel) -> list[str]:
    """Names of the viscosities of a model's branches; none where its relaxations are no exponentials."""
    count = model.branches if model.viscous else 0
    return [f"viscosity_N_s_per_mm{branch_suffix(branch)}" for branch in range(count)]


def usual_wants(model: ChannelModel) -> list[str]:
    """Numbers that are wanted where nobody says: shapes, and viscosity, stiffness or ratio of every part."""
    names, beside = list(model.parameter_names), viscosities(model)
    for part in model.parts:
        beside += names[part.shapes]
        if part.ratio is not None:
            beside.append(names[part.ratio])
        elif not model.viscous:
            beside.append(names[part.stiffness.start])
    return sorted(beside, key=lambda name: not name.startswith("relaxation_time"))


def full_name(named: str, model: ChannelModel) -> str:
    """The reported parameter that is meant."""
    suffix = _SUFFIX.search(named)
    base, ending = (named[: suffix.start()], suffix.group(1)) if suffix else (named, "")
    name = ALIASES.get(base, base) + ending
    known = [*model.parameter_names, *viscosities(model)]
    if name not in known:
        refuse(f"unknown number {named!r}; this tissue has {', '.join(known)} (tau, eta and K for short)")
    return name


def _number(text: str, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        refuse(f"{what}: {text!r} is no number")
    if not np.isfinite(value):
        refuse(f"{what}: {text!r} must be finite")
    return value


def parsed_want(text: str, model: ChannelModel) -> Want:
    """Want of ``relaxation_time_s=5%``."""
    match = _WANT.match(text)
    if match is None:
        refuse(f"--want {text!r}: write NAME=PERCENT%, as relaxation_time_s=5% or eta=2%")
    name, share = full_name(match.group(1), model), _number(match.group(2), f"--want {text}") / 100.0
    if not FINEST_WANT <= share <= COARSEST_WANT:
        refuse(
            f"--want {text}: a standard deviation of {100 * FINEST_WANT:g} to {100 * COARSEST_WANT:g} % can "
            "be wanted; with a wider one fit would call a relaxation time not identified"
        )
    return Want(name, share)


def parsed_guess(text: str) -> Guess:
    """Guess of ``relaxation_time_s=0.02~30%``, the spread being one standard deviation."""
    match = _GUESS.match(text)
    if match is None:
        refuse(f"--tissue {text!r}: write NAME=VALUE or NAME=VALUE~PERCENT%, as relaxation_time_s=0.02~30%")
    spread = _number(match.group(3) or "0", f"--tissue {text}") / 100.0
    if not 0.0 <= spread <= WIDEST_GUESS:
        refuse(f"--tissue {text}: a spread of 0 to {100 * WIDEST_GUESS:g} % can be stated")
    return Guess(match.group(1), _number(match.group(2), f"--tissue {text}"), float(np.log1p(spread)))


def of_draws(
    words: str, name: str, model: ChannelModel, theta: FloatArray, *, count: int, known_depth_mm: float | None
) -> Tissues:
    """At most ``count`` of the draws, evenly spaced."""
    if model.branches == 0:
        refuse(f"{name}: this tissue has no relaxing branch, so there is no relaxation time to plan for")
    theta = np.atleast_2d(theta)
    at = np.unique(np.linspace(0, theta.shape[0] - 1, min(count, theta.shape[0])).round().astype(int))
    return Tissues(words, name, model, theta[at], known_depth_mm)


def _guessed_model(guesses: Sequence[Guess], depth_mm: float) -> ChannelModel:
    """The smallest model that has every guessed parameter."""
    named = [ALIASES.get(_SUFFIX.sub("", one.name), _SUFFIX.sub("", one.name)) for one in guesses]
    branches = max([1] + [int(m.group(1)[2]) for one in guesses if (m := _SUFFIX.search(one.name))])
    degrees = [int(m.group(1)) for one in named if (m := re.match(r"stiffness_([0-2])_", one))]
    return kelvin_voigt(branches=branches, stiffness_degree=max([0, *degrees]), depth_mm=depth_mm)


def plain_guesses(guesses: Sequence[Guess], *, depth_mm: float | None, count: int) -> Tissues:
    """Draws around guesses: log-normal, by a fixed low-discrepancy sequence; what is not guessed is 0."""
    if depth_mm is None:
        refuse("guesses say nothing of the depth: add --max-depth, in mm")
    model = _guessed_model(guesses, depth_mm)
    known: dict[str, Guess] = {}
    for one in guesses:
        name = full_name(one.name, model)
        if name in known:
            refuse(f"--tissue {one.name} is given twice")
        if one.value <= 0.0 and not name.startswith(("static_2", "static_3", "stiffness_1", "stiffness_2")):
            refuse(f"--tissue {one.name}={one.value:g}: must be above 0")
        known[name] = one
    if not any(name.startswith("static") for name in known):
        refuse("--tissue says nothing of the static force: add --tissue static_1_N_per_mm=... (its slope)")
    for branch in range(model.branches):
        ending = branch_suffix(branch)
        if f"relaxation_time_s{ending}" not in known:
            refuse(f"--tissue relaxation_time_s{ending}=... is missing: nothing can be planned without it")
        either = [f"{base}{ending}" in known for base in ("viscosity_N_s_per_mm", "stiffness_0_N_per_mm")]
        if sum(either) != 1:
            both = f"viscosity_N_s_per_mm{ending} or stiffness_0_N_per_mm{ending}"
            refuse(f"--tissue needs one of {both}, {'and has both' if all(either) else 'and has none'}")
    theta = _guessed_draws(model, known, count)
    if not model.passive(theta).all():
        refuse(f"--tissue: such a tissue gives a negative force or stiffness within {depth_mm:g} mm")
    return Tissues("guesses", "guessed tissue", model, theta)


def _guessed_draws(model: ChannelModel, known: Mapping[str, Guess], count: int) -> FloatArray:
    spread = [name for name, one in known.items() if one.sd_ln > 0.0]
    draws = count if spread else 1
    normal = np.zeros((draws, max(len(spread), 1)))
    if spread:
        points = qmc.Sobol(len(spread), scramble=False).random_base2(int(np.ceil(np.log2(draws + 1))))
        # the first point of the sequence is the corner 0
        normal = norm.ppf(points[1 : draws + 1])
    values = {
        name: one.value
        * np.exp(one.sd_ln * normal[:, spread.index(name)] if name in spread else np.zeros(draws))
        for name, one in known.items()
    }
    theta = np.zeros((draws, len(model.parameter_names)))
    for k, name in enumerate(model.parameter_names):
        theta[:, k] = values.get(name, 0.0)
    for branch in range(model.branches):
        ending = branch_suffix(branch)
        if f"viscosity_N_s_per_mm{ending}" in values:
            first = STATIC_DEGREE + branch * model.block
            tau = theta[:, first + model.block - 1]
            depth = REFERENCE_DEPTH * model.depth_mm
            growing = theta[:, first + 1 : first + model.block - 1] @ depth ** np.arange(
                1.0, model.stiffness_degree + 1
            )
            theta[:, first] = values[f"viscosity_N_s_per_mm{ending}"] / tau - growing
    return theta


#: Samples a second for a recipe of which only the tissue is taken: its path is not looked at.
COARSE_HZ = 10.0


def given_recipe(named: str) -> Recipe:
    """A built-in recipe, or one of a file."""
    if named not in RECIPES and not Path(named).is_file():
        refuse(f"{named}: no such recipe or file; recipes are {', '.join(sorted(RECIPES))}")
    return built_in(named) if named in RECIPES else load_recipe(named)


def of_recipe_tissue(recipe: Recipe) -> Tissues:
    """The one tissue of a recipe."""
    _, centre = of_recipe(recipe, rate_Hz=COARSE_HZ)
    words = f"the truth of the recipe {recipe.name}"
    return of_draws(words, recipe.specimen, centre.model, centre.theta, count=1, known_depth_mm=None)


def of_bundle(path: Path, *, count: int) -> Tissues:
    """Posterior draws of a bundle, or specimens of the population it holds."""
    bundle = load_bundle(path)
    bundle.require_renderable()
    model = bundle.contact_model()
    if not bundle.parameters:
        refuse(f"{path}: {bundle.model.key} has no parameters to plan for; fit a law")
    kind = "specimens of the population in" if bundle.is_population else "posterior draws of"
    words = f"{kind} {path}" if bundle.draws is not None else f"the optimum of {path}: it holds no draws"
    theta = bundle.theta if bundle.draws is None else bundle.draws
    return of_draws(words, bundle.specimen, model, theta, count=count, known_depth_mm=bundle.depth_mm)
