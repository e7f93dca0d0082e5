"""Contact models put together in Python: ``ContactModel(static=, stiffness=, relaxation=, damping=)``.

Of a user's function the first argument is the time [s] or the depth [mm]; the further ones are positive
parameters whose defaults are bounds, or a value to begin with, the first of a relaxation's its time: ``def
creep(t, tau, p=(0.1, 3.0)): return (1 + t / tau) ** -p``.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.grammar import DEGREES, parsed, register
from tissueid.model.law import About, Shape

#: Bounds over and under a starting value, and that value where none is given.
WIDE, START = 1e3, 1.0
#: Places between the bounds, in the logarithm, that a search begins with.
STARTS = (0.25, 0.6)
#: Deviation from 1 of a relaxation at no time, and rise that is rounding.
ROUNDING = 1e-6
#: Names of parameters that a model with a function has anyway.
TAKEN = ("static_scale", "relaxation_time_s", "relaxation_ratio")
#: Relative step of the slope of a static law.
STEP = 1e-6


@dataclass(frozen=True, slots=True)
class _OfFunction:
    """A law by a function."""

    function: Callable[..., Any]
    about: About
    shapes: tuple[Shape, ...]

    def __call__(self) -> Self:
        """Itself: it takes no argument."""
        return self


class FunctionRelaxation(_OfFunction):
    """Relaxation by a function of time, its relaxation time and further shapes."""

    branches: ClassVar[int] = 0

    def value(self, time_s: FloatArray, *shape: Any) -> FloatArray:
        """Relaxation at times [s]."""
        return np.asarray(self.function(time_s, *shape), dtype=np.float64)


class FunctionStatic(_OfFunction):
    """A coefficient times a function of depth and shapes."""

    polynomial: ClassVar[bool] = False
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("static_scale", "c", "N", 0.0, np.inf, "factor of the static function"),
    )

    def basis(self, depth_mm: FloatArray, *shape: Any) -> FloatArray:
        """The function, at depths of 0 and more."""
        return np.asarray(self.function(depth_mm, *shape), dtype=np.float64)[None]

    def slope(self, depth_mm: FloatArray, *shape: Any) -> FloatArray:
        """Its derivative by differences; one-sided at the surface."""
        step = STEP * np.maximum(depth_mm, 1.0)
        low = np.maximum(depth_mm - step, 0.0)
        rise = self.basis(depth_mm + step, *shape) - self.basis(low, *shape)
        return np.asarray(rise / (depth_mm + step - low))


def relaxation_of(function: Callable[..., Any]) -> FunctionRelaxation:
    """A relaxation law from ``f(t, tau, ...)``; ValueError where it has no time, is not 1 at 0, or rises."""
    names = _parameters(function)
    if not names:
        raise ValueError(f"{function.__name__}: a relaxation is f(t, tau, ...), it has no relaxation time")
    tau = ParameterSpec("relaxation_time_s", names[0].name, "s", 0.0, np.inf, f"time of {function.__name__}")
    law = FunctionRelaxation(
        function,
        _about(function, "relaxation"),
        (Shape(tau), *(_shape(one, "relaxation") for one in names[1:])),
    )
    time = np.append(0.0, np.logspace(-3.0, 3.0, 200))
    at = [1.0, *(one.starts[0] for one in law.shapes[1:])]
    values = law.value(time, *at)
    if values.shape != time.shape or not np.isfinite(values).all() or abs(values[0] - 1.0) > ROUNDING:
        msg = f"{function.__name__}: a relaxation is finite and 1 at t = 0, not {values.flat[0]:.4g}"
        raise ValueError(msg)
    rises = float(np.diff(values).max())
    if rises > ROUNDING:
        raise ValueError(f"{function.__name__}: a relaxation does not rise; it does by {rises:.3g} with {at}")
    return law


def static_of(function: Callable[..., Any]) -> FunctionStatic:
    """A static law from ``f(x, ...)``; ValueError where it falls, or is not 0 at the surface."""
    law = FunctionStatic(
        function, _about(function, "static"), tuple(_shape(one, "static") for one in _parameters(function))
    )
    depth = np.linspace(0.0, 10.0, 101)
    values = law.basis(depth, *(one.starts[0] for one in law.shapes))[0]
    if values.shape != depth.shape or not np.isfinite(values).all() or abs(values[0]) > ROUNDING:
        msg = f"{function.__name__}: a static force is finite and 0 at x = 0, not {values.flat[0]:.4g}"
        raise ValueError(msg)
    if float(values.min()) < 0.0:
        msg = f"{function.__name__}: a static force pushes back; it is {values.min():.4g} within 10 mm"
        raise ValueError(msg)
    return law


def _parameters(function: Callable[..., Any]) -> list[inspect.Parameter]:
    """Parameters behind the first argument."""
    return list(inspect.signature(function).parameters.values())[1:]


def _about(function: Callable[..., Any], kind: str) -> About:
    words = (inspect.getdoc(function) or f"user's function {function.__name__}").splitlines()[0]
    return About(
        key=function.__name__, kind=kind, equation=words, source="user's function", purpose=words,
        refuses="nothing of its own",
    )  # fmt: skip


def _shape(one: inspect.Parameter, kind: str) -> Shape:
    """A shape with the bounds, or the start, that its default is."""
    given, name = START if one.default is inspect.Parameter.empty else one.default, f"{kind}_{one.name}"
    try:
        low, high = map(float, given) if isinstance(given, tuple) else (given / WIDE, given * WIDE)
    except (TypeError, ValueError):
        low, high = 0.0, 0.0
    if not 0.0 < low < high < np.inf:
        raise ValueError(f"{one.name} is {given!r}; a default is a positive number, or bounds (low, high)")
    if name in TAKEN:
        raise ValueError(f"{one.name}: {name} is another parameter of the model; take another name")
    starts = tuple(low ** (1.0 - at) * high**at for at in STARTS)
    spec = ParameterSpec(name, one.name, "1", low, high, "of the function")
    return Shape(spec, starts if isinstance(given, tuple) else (float(given),))


@dataclass(frozen=True, slots=True)
class Polynomial:
    """Polynomial of depth: a1 x + a2 x^2 + ... as static law, b0 + b1 x + ... as stiffness.

    Attributes
    ----------
    degree : int
        1 and more of a static law, 0 to 2 of a stiffness.
    """

    degree: int = 3


@dataclass(frozen=True, slots=True)
class Prony:
    """Exponentials, each with a stiffness of its own.

    Attributes
    ----------
    branches : int
    """

    branches: int = 1


Part = str | Polynomial | Prony | Callable[..., Any]


@dataclass(frozen=True, slots=True, init=False)
class ContactModel:
    """A contact model: a static law, and a stiffness that relaxes or a damping.

    Parameters
    ----------
    name : str, optional
        Of the grammar, as ``"power * prony:2"``, or ``kelvin-voigt``; parts are then left out.
    static, stiffness, relaxation : str, Polynomial, Prony or function
        A law's word, or, of static law and relaxation, a function: of depth [mm], 0 at the surface, or of
        time [s], 1 at its beginning, with positive parameters behind (:mod:`tissueid.model.composed`).
    damping : str, optional
        A law's word, in the place of stiffness and relaxation.

    Raises
    ------
    ModelNameError
        A word is no law; the message lists those that are known.
    ValueError
        A function is no law, with its number; something relaxes beside a damping.

    Examples
    --------
    >>> ContactModel(static=Polynomial(3), stiffness=Polynomial(0), relaxation=Prony(2)).name
    'polynomial:3 * constant * prony:2'
    """

    name: str

    def __init__(
        self,
        name: str | None = None,
        *,
        static: Part = Polynomial(3),
        stiffness: Part = Polynomial(0),
        relaxation: Part = Prony(1),
        damping: str | None = None,
    ) -> None:
        if damping is not None and (stiffness, relaxation) != (Polynomial(0), Prony(1)):
            raise ValueError(f"{damping} damps the static law itself: leave stiffness and relaxation out")
        moving = (stiffness, "stiffness"), (relaxation, "relaxation")
        words = [_word(part, kind) for part, kind in moving] if damping is None else [damping]
        words.insert(0, _word(static, "static"))
        name = " * ".join(words) if name is None else name
        parsed(name)
        object.__setattr__(self, "name", name)

    def __str__(self) -> str:
        return self.name


def _word(part: Part, kind: str) -> str:
    """The word of a part of a kind; a function is registered under its own name."""
    if isinstance(part, str):
        return part
    if isinstance(part, Polynomial) and kind == "static":
        return f"polynomial:{part.degree}"
    if isinstance(part, Prony) and kind == "relaxation":
        return f"prony:{part.branches}"
    if isinstance(part, Polynomial) and kind == "stiffness":
        if not 0 <= part.degree < len(DEGREES):
            msg = f"a stiffness is a polynomial of degree 0 to {len(DEGREES) - 1}, got {part.degree}"
            raise ValueError(msg)
        return tuple(DEGREES)[part.degree]
    of = {"static": static_of, "relaxation": relaxation_of}.get(kind)
    if of is None or isinstance(part, Polynomial | Prony):
        raise ValueError(f"{part!r} can't stand here; `tissueid models` lists the laws and their places")
    law = of(part)
    register(law)
    return str(law.about.key)
