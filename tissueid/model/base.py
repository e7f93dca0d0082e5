"""What every contact model offers, and the registry of models.

A contact model is a law that turns the history of a tool's depth into a force.  The same object is
fitted, sampled, simulated and felt; a contract test replays a recording through
:meth:`ContactModel.stepper` and compares it with :meth:`ContactModel.force`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "ContactModel",
    "ContactPath",
    "ParameterSpec",
    "Stepper",
    "build_model",
    "model_keys",
    "register",
    "scaled_theta",
]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """One parameter of a model.

    Attributes
    ----------
    name, symbol, unit : str
        Name as in identification.json, symbol as in an equation, unit as printed.
    lower, upper : float
        Bounds; the passivity constraint may bind several parameters more tightly.
    meaning : str
        One sentence.
    """

    name: str
    symbol: str
    unit: str
    lower: float
    upper: float
    meaning: str


@dataclass(frozen=True, slots=True)
class ContactPath:
    """What a tool did: the input of a contact model.

    Attributes
    ----------
    time_s, depth_mm : ndarray, shape (n,)
        Non-decreasing times [s] and depths below the contact point [mm]; linear in between.
    velocity_mm_s : ndarray, shape (n,), optional
        Velocity estimate [mm/s], for laws that need it.
    contact_starts : tuple of int
        Samples at which a contact starts, for laws that latch the speed of impact.
    """

    time_s: FloatArray
    depth_mm: FloatArray
    velocity_mm_s: FloatArray | None = None
    contact_starts: tuple[int, ...] = field(default=(0,))


class Stepper(Protocol):
    """A running copy of a model, for rendering."""

    def step(self, depth_mm: float, dt_s: float) -> float:
        """Force [N] after ``dt_s`` seconds of linear motion to ``depth_mm``."""
        ...

    def reset(self) -> None:
        """Tissue at rest."""
        ...


@runtime_checkable
class ContactModel(Protocol):
    """The law, its parameters, and the three forms in which it is used."""

    @property
    def key(self) -> str:
        """Registry key."""
        ...

    @property
    def parameters(self) -> tuple[ParameterSpec, ...]:
        """Parameters, in the order of theta."""
        ...

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Their names."""
        ...

    def force(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """Force [N] along a path, shape (n,)."""
        ...

    def jacobian(self, theta: FloatArray, path: ContactPath) -> FloatArray:
        """Derivative of the force by theta, shape (n, p)."""
        ...

    def linear_basis(self, nonlinear: FloatArray, path: ContactPath) -> FloatArray:
        """Columns whose weights are the linear parameters, shape (n, p_linear)."""
        ...

    def is_passive(self, theta: FloatArray) -> bool:
        """True where the law can only store and dissipate energy."""
        ...

    def stepper(self, theta: FloatArray) -> Stepper:
        """A running copy for rendering."""
        ...


def scaled_theta(
    parameters: Sequence[ParameterSpec], theta: FloatArray, force: FloatArray, travel: FloatArray
) -> FloatArray:
    """Theta of a tissue whose force and travel were read too large by gains.

    Parameters
    ----------
    parameters : sequence of ParameterSpec
        Their units say how they scale: N with the force, 1/mm with the travel.
    theta : ndarray, shape (n, p)
    force, travel : ndarray, shape (n,)
        Gains.
    """
    out, names = theta.copy(), [spec.name for spec in parameters]
    for k, spec in enumerate(parameters):
        top, per, power = spec.unit.partition("/mm")
        if power == "^n":
            out[:, k] *= travel ** theta[:, names.index("static_exponent")]
        elif per:
            out[:, k] *= travel ** float(power[1:] or 1.0)
        if top == "N":
            out[:, k] /= force
    return out


Factory = Callable[[int, int, float], ContactModel]
_MODELS: dict[str, Factory] = {}


def register(key: str, factory: Factory) -> None:
    """Enter a model under its key."""
    if key in _MODELS:
        msg = f"contact model {key!r} is registered already"
        raise ValueError(msg)
    _MODELS[key] = factory


def model_keys() -> tuple[str, ...]:
    """Keys of the registered models."""
    return tuple(sorted(_MODELS))


def build_model(key: str, *, branches: int, stiffness_degree: int, depth_mm: float) -> ContactModel:
    """The contact model of that key.

    Parameters
    ----------
    key : str
    branches : int
        Number of relaxation branches.
    stiffness_degree : int
        Degree of K(x).
    depth_mm : float
        Largest depth the model is claimed for [mm].

    Raises
    ------
    KeyError
        No such model; the message lists the keys there are.
    """
    if key not in _MODELS:
        msg = f"no contact model {key!r}; there are {', '.join(model_keys())}"
        raise KeyError(msg)
    return _MODELS[key](branches, stiffness_degree, depth_mm)
