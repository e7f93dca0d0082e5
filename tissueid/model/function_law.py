"""Laws that are a user's function: ``def creep(t, tau, p=(0.1, 3.0)): return (1 + t / tau) ** -p``.

The first argument is the time [s] or the depth [mm]; the further ones are positive parameters, whose defaults
are their bounds, or a value that the search begins with.  The first of a relaxation's is its time.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.base import ParameterSpec
from tissueid.model.law import About, Shape

#: Bounds over and under a starting value, and that value where none is given.
WIDE, START = 1e3, 1.0
#: Places between the bounds, in the logarithm, that a search begins with.
STARTS = (0.25, 0.6)
#: Deviation from 1 of a relaxation at no time, and rise that is rounding.
ROUNDING = 1e-6
#: Relative step of the slope of a static law.
STEP = 1e-6


@dataclass(frozen=True, slots=True)
class FunctionRelaxation:
    """Relaxation by a function of time, its relaxation time and further shapes."""

    function: Callable[..., Any]
    about: About
    shapes: tuple[Shape, ...]
    branches: ClassVar[int] = 0

    def __call__(self) -> FunctionRelaxation:
        """Itself: it takes no argument."""
        return self

    def value(self, time_s: FloatArray, *shape: Any) -> FloatArray:
        """Relaxation at times [s]."""
        return np.asarray(self.function(time_s, *shape), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class FunctionStatic:
    """A coefficient times a function of depth and shapes."""

    function: Callable[..., Any]
    about: About
    shapes: tuple[Shape, ...]
    polynomial: ClassVar[bool] = False
    coefficients: ClassVar[tuple[ParameterSpec, ...]] = (
        ParameterSpec("static_scale", "c", "N", 0.0, np.inf, "factor of the static function"),
    )

    def __call__(self) -> FunctionStatic:
        """Itself: it takes no argument."""
        return self

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
    """A relaxation law from ``f(t, tau, ...)``.

    Raises ValueError: it has no relaxation time, does not begin at 1, or rises.
    """
    names = _parameters(function)
    if not names:
        msg = f"{function.__name__}: a relaxation is f(t, tau, ...), it has no relaxation time"
        raise ValueError(msg)
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
        msg = f"{function.__name__}: a relaxation does not rise; it does by {rises:.3g} with {at}"
        raise ValueError(msg)
    return law


def static_of(function: Callable[..., Any]) -> FunctionStatic:
    """A static law from ``f(x, ...)``.

    Raises ValueError: it is not 0 at the surface, falls, or gives no number.
    """
    law = FunctionStatic(
        function,
        _about(function, "static"),
        tuple(_shape(one, "static") for one in _parameters(function)),
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
    given = START if one.default is inspect.Parameter.empty else one.default
    try:
        low, high = (given[0], given[1]) if isinstance(given, tuple) else (given / WIDE, given * WIDE)
    except TypeError:
        low, high = 0.0, 0.0
    if not 0.0 < low < high:
        msg = f"{one.name} is {given!r}; a default is a positive number, or bounds (low, high)"
        raise ValueError(msg)
    starts = tuple(float(low ** (1.0 - at) * high**at) for at in STARTS)
    spec = ParameterSpec(f"{kind}_{one.name}", one.name, "1", float(low), float(high), "of the function")
    return Shape(spec, starts if isinstance(given, tuple) else (float(given),))
