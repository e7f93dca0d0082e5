"""Contact models put together in Python: ``ContactModel(static=, stiffness=, relaxation=, damping=)``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tissueid.model.function_law import relaxation_of, static_of
from tissueid.model.grammar import parsed, register

STIFFNESSES = ("constant", "linear", "quadratic")


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
        time [s], 1 at its beginning, with positive parameters behind (:mod:`tissueid.model.function_law`).
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
            msg = f"{damping} damps the static law itself: leave stiffness and relaxation out"
            raise ValueError(msg)
        moving = (_stiffness(stiffness), _relaxation(relaxation)) if damping is None else (damping,)
        words = (_static(static), *moving)
        name = " * ".join(words) if name is None else name
        parsed(name)
        object.__setattr__(self, "name", name)

    def __str__(self) -> str:
        return self.name


def _static(part: Part) -> str:
    if isinstance(part, Polynomial):
        return f"polynomial:{part.degree}"
    return _word(part, static_of)


def _stiffness(part: Part) -> str:
    if not isinstance(part, Polynomial):
        return _word(part, None)
    if not 0 <= part.degree < len(STIFFNESSES):
        msg = f"a stiffness is a polynomial of degree 0 to {len(STIFFNESSES) - 1}, got {part.degree}"
        raise ValueError(msg)
    return STIFFNESSES[part.degree]


def _relaxation(part: Part) -> str:
    if isinstance(part, Prony):
        return f"prony:{part.branches}"
    return _word(part, relaxation_of)


def _word(part: Part, of: Callable[[Callable[..., Any]], Any] | None) -> str:
    """The word of a part; a function is registered under its own name."""
    if isinstance(part, str):
        return part
    if of is None or isinstance(part, Polynomial | Prony):
        msg = f"{part!r} can't stand here; `tissueid models` lists the laws and their places"
        raise ValueError(msg)
    law = of(part)
    register(law)
    return str(law.about.key)
