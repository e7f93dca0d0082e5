"""Names of contact models, and their laws: of the folder ``laws``, and of other packages."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

from tissueid.extras import faults_of
from tissueid.model import laws
from tissueid.model.base import ParameterSpec
from tissueid.model.channels import ChannelModel, DampedModel
from tissueid.model.kelvin_voigt import kelvin_voigt
from tissueid.model.law import About
from tissueid.model.yardstick import YARDSTICK, yardstick_of
from tissueid.result import ModelChoice

KELVIN_VOIGT = "kelvin-voigt"
#: Choice among the Kelvin-Voigt law and what it is held against anyway, beside the yardstick.
AUTO = "auto"
HELD_AGAINST = ("polynomial * tangent * prony:1", "polynomial * tangent * prony:2")
#: Degrees of K by name, as the Kelvin-Voigt law takes them.
DEGREES = {"constant": 0, "linear": 1, "quadratic": 2}
KINDS = ("static", "stiffness", "relaxation", "damping")
#: Argument of a law in the grammar, and its default.
ARGUMENTS = {"polynomial": 3, "prony": 1, "spectrum": 8}
#: Way out for a law that a bundle or a report was fitted with.
MISSING_LAW = (
    "Install the package that has it (entry point tissueid.models); a notebook's is known there alone"
)


class ModelNameError(ValueError):
    """A name that is not of the grammar."""


@dataclass(frozen=True, slots=True)
class Named:
    """A contact model by its name."""

    name: str  # as it was asked for
    branches: int | None = None  # of a Kelvin-Voigt law; None where they are chosen, and of other laws
    degree: int | None = None
    #: Static, stiffness and relaxation or damping law; None where it is a Kelvin-Voigt law.
    parts: tuple[Any, Any, Any] | None = None
    mark: bool = False  # it is the yardstick

    @property
    def paper(self) -> bool:
        """True of a Kelvin-Voigt law."""
        return self.parts is None and not self.mark

    @property
    def damped(self) -> bool:
        """True of a law that follows the speed over that at contact."""
        return self.parts is not None and self.parts[2].about.kind == "damping"

    def model(self, depth_mm: float, resolution_s: float, window_s: float) -> ChannelModel:
        """The model of its parts for a depth and a range of times."""
        if self.parts is None:
            raise ValueError(f"{self.name} is not made of three parts")
        static, stiffness, relaxation = self.parts
        kind = DampedModel if self.damped else ChannelModel
        return kind(static, stiffness, relaxation, depth_mm, resolution_s, window_s, self.name)


@dataclass(frozen=True, slots=True)
class Candidates:
    """Laws of one fit."""

    paper: Named | None  # a Kelvin-Voigt law, whose order may be open
    laws: tuple[Named, ...]  # others
    #: The one that predicts best is fitted; else the Kelvin-Voigt law beside the others, or the only one.
    choose: bool = False


#: Laws of this process alone.
_OWN: dict[str, Any] = {}


def register(law: Any) -> None:
    """Make a law known to this process; ModelNameError where one that is installed has its key."""
    if law.about.key in _installed()[0]:
        raise ModelNameError(f"contact law {law.about.key!r} is registered already; choose another name")
    _OWN[law.about.key] = law


def known_laws() -> Mapping[str, Any]:
    """Every law by its key."""
    return {**_installed()[0], **_OWN}


@lru_cache
def _installed() -> tuple[Mapping[str, Any], Mapping[str, str]]:
    """Laws of the folder and of other packages, and entry points that are none: remarks by their names."""
    found: dict[str, Any] = {}
    for one in iter_modules(laws.__path__):
        found |= {law.about.key: law for law in import_module(f"{laws.__name__}.{one.name}").LAWS}

    def take(law: Any) -> None:
        """Take a law; raise what one likes where it is none, or its key is taken."""
        about = getattr(law, "about", None)
        if not isinstance(law, type) or not isinstance(about, About) or about.kind not in KINDS:
            raise TypeError(f"it is no class with an About of kind {', '.join(KINDS)}")
        if about.key in found:
            raise ModelNameError(f"contact law {about.key!r} is registered already; choose another key")
        _row(about, _specs(law))
        found[about.key] = law

    faults = faults_of("tissueid.models", take).items()
    return found, {name: f"the contact law {name!r} ({place}) {fault}" for name, (place, fault) in faults}


def faulty_laws() -> tuple[str, ...]:
    """Remarks on laws of other packages that were left out, a sentence each."""
    return tuple(_installed()[1].values())


def whole_names() -> tuple[About, ...]:
    """Names that stand for a whole model."""
    return (
        About(
            KELVIN_VOIGT, "whole",
            "F = a1 x + a2 x^2 + a3 x^3 + sum_j K_j(x) s_j, tau_j s_j' + s_j = tau_j x'",
            source="10.1109/ROBOT.2009.5152617", refuses="nothing of its own",
            purpose="the default: branches and the degree of K are chosen by what they predict",
        ),
        About(
            YARDSTICK, "whole",
            "F = G_0(x) + sum_j int e^(-(t-t')/tau_j) dG_j + sum_k K_k(x) s_k, G_j grow, K_k >= 0",
            source="10.1016/0022-5096(68)90016-1", refuses="to be quoted: it has no parameters, no intervals",
            purpose="the mark of what can be reached: one least squares with non-negative weights",
        ),
    )  # fmt: skip


def rebuilt(choice: ModelChoice, depth_mm: float) -> ChannelModel:
    """The contact model of a fit, for its largest depth; ValueError where what it needs is missing."""
    if choice.key == KELVIN_VOIGT:
        return kelvin_voigt(choice.branches, choice.stiffness_degree, depth_mm)
    if choice.key == YARDSTICK:
        return yardstick_of(depth_mm, choice.inside_s, choice.outside_s)
    if choice.range_s is None:
        raise ValueError(f"{choice.key}: the times that its relaxation was looked at are missing")
    try:
        named = parsed(choice.name or choice.key)
    except ModelNameError as error:
        raise ModelNameError(f"{error}. {MISSING_LAW}") from None
    return named.model(depth_mm, *choice.range_s)


def described() -> list[dict[str, Any]]:
    """Every law and whole name: key, kind, equation, parameters, source, purpose, what it refuses."""
    laws = sorted(known_laws().values(), key=lambda law: KINDS.index(law.about.kind))
    rows = [_row(law.about, _specs(law)) for law in laws]
    own: dict[str, Sequence[ParameterSpec]] = {KELVIN_VOIGT: kelvin_voigt(1, 2, 1.0).parameters}
    return [*rows, *(_row(about, own.get(about.key, ())) for about in whole_names())]


def _specs(law: Any) -> list[ParameterSpec]:
    """Parameters of a law by default."""
    made = law()
    shapes = (made.shape,) if law.about.kind == "damping" else getattr(made, "shapes", ())
    return [*getattr(made, "coefficients", ()), *(one.spec for one in shapes)]


def _row(about: About, specs: Sequence[ParameterSpec]) -> dict[str, Any]:
    """A law with its parameters behind its equation."""
    parameters = [
        {"name": one.name, "symbol": one.symbol, "unit": one.unit, "meaning": one.meaning} for one in specs
    ]
    rest = asdict(about)
    first = {key: rest.pop(key) for key in ("key", "kind", "equation")}
    return {**first, "parameters": parameters, **rest}


def stated_names() -> Mapping[str, bool]:
    """Parameters of all laws, beside their times, of which priors may be stated; true of coefficients."""
    of_kind = {kind: [key for key, one in known_laws().items() if one.about.kind == kind] for kind in KINDS}
    names = [f"{one} * tangent * prony:3" for one in of_kind["static"]]
    names += [f"flat * quadratic * {one}" for one in of_kind["relaxation"]]
    names += [f"flat * tangent * {one}" for one in of_kind["relaxation"] if one != "spectrum"]
    names += [f"flat * {one}" for one in of_kind["damping"]]
    found: dict[str, bool] = {}
    for model in (kelvin_voigt(3, 2, 1.0), *(parsed(one).model(1.0, 0.01, 1.0) for one in names)):
        linear = set(model.linear_places.tolist())
        found |= {one: place in linear for place, one in enumerate(model.parameter_names)}
    # times have a table of their own, a row a branch
    return {one: linear for one, linear in found.items() if not one.startswith("relaxation_time")}


def unused_priors(laws: Candidates, stated: Iterable[str]) -> list[str]:
    """Stated priors of parameters that none of some candidates has."""
    there = set(kelvin_voigt(3, 2, 1.0).parameter_names) if laws.paper is not None else set()
    for one in laws.laws:
        there |= set() if one.parts is None else set(one.model(1.0, 0.01, 1.0).parameter_names)
    return [name for name in stated if name not in there]


def _law(word: str, kind: str, name: str) -> Any:
    """A law by its word, with its argument."""
    key, colon, argument = word.partition(":")
    law = known_laws().get(key)
    if law is None or law.about.kind != kind:
        there = ", ".join(k for k, one in known_laws().items() if one.about.kind == kind)
        msg = f"{name!r}: no {kind} law {key!r}; there are {there}"
        raise ModelNameError("; ".join([msg, *filter(None, [_installed()[1].get(key)])]))
    if not colon:
        return law()
    if key not in ARGUMENTS or not argument.isdecimal():
        takes = f"a number, as in {key}:{ARGUMENTS[key]}" if key in ARGUMENTS else "no argument"
        raise ModelNameError(f"{name!r}: {key} takes {takes}, got {argument!r}")
    try:
        return law(int(argument))
    except ValueError as error:
        raise ModelNameError(f"{name!r}: {error}") from None


def parsed(name: str) -> Named:
    """A contact model by its name; ModelNameError, with what is known, where a word is not."""
    words = [word.strip() for word in name.split("*")]
    if words == [KELVIN_VOIGT]:
        return Named(name)
    if words == [YARDSTICK]:
        return Named(name, mark=True)
    if len(words) not in {2, 3} or not all(words):
        form = f"STATIC * [STIFFNESS *] RELAXATION, as in 'power * prony:2', {KELVIN_VOIGT} or {YARDSTICK}"
        raise ModelNameError(f"{name!r} is no model: {form}")
    last = known_laws().get(words[-1])
    damped = last is not None and last.about.kind == "damping"
    if damped and len(words) == 3:
        raise ModelNameError(f"{name!r}: {words[2]} damps the static law itself; leave {words[1]} out")
    if len(words) == 2:
        words.insert(1, "tangent" if damped else "constant")
    kinds = (*KINDS[:2], KINDS[2 + damped])
    static, stiffness, relaxation = (_law(word, kind, name) for word, kind in zip(words, kinds, strict=True))
    keys = [one.about.key for one in (static, stiffness, relaxation)]
    if keys[1] == "tangent" and keys[2] == "spectrum":
        msg = f"{name!r}: a spectrum has a stiffness at each time; take constant, linear or quadratic with it"
        raise ModelNameError(msg)
    if keys[0] == "polynomial" and static.degree == 3 and keys[1] in DEGREES and keys[2] == "prony":
        return Named(name, relaxation.branches, DEGREES[keys[1]])
    return Named(name, parts=(static, stiffness, relaxation))


def candidates(name: str) -> Candidates:
    """Laws that a fit is asked for: one, ``auto``, or several with ``|`` between them."""
    names = [one.strip() for one in name.split("|")]
    if names == [AUTO]:
        beside = tuple(parsed(one) for one in (*HELD_AGAINST, YARDSTICK))
        return Candidates(parsed(KELVIN_VOIGT), beside, choose=True)
    found = [parsed(one) for one in names]
    paper, laws = [one for one in found if one.paper], [one for one in found if not one.paper]
    if len(paper) > 1:
        msg = f"{name!r}: {paper[0].name} and {paper[1].name} are one law; {KELVIN_VOIGT} chooses its order"
        raise ModelNameError(msg)
    if len(found) == 1 and paper and paper[0].branches is None:
        return Candidates(paper[0], tuple(parsed(one) for one in HELD_AGAINST))
    return Candidates(paper[0] if paper else None, tuple(laws), choose=len(found) > 1)
