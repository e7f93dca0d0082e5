"""emcee's sampler, and three ways to move its walkers, each a whole batch at a time.

*Differential evolution* (ter Braak 2006, doi 10.1007/s11222-006-8769-1) and the *snooker update* (ter Braak
and Vrugt 2008, doi 10.1007/s11222-008-9104-9) need nothing but the other walkers: they follow any shape of
the posterior.  *Independence* proposes from a fixed Student-t (Tierney 1994, doi 10.1214/aos/1176325750),
whatever the walker's place: where the posterior is close to it, nearly every step is a new draw.

The moves are written here and not taken from emcee for two reasons: emcee 3.1.6 accepts walker by walker in
Python, and its snooker update divides by the square root of the distance instead of the distance, so that it
does not leave the posterior as it is (variance 0.75 to 0.95 of the truth on a normal of two to four
dimensions).

This module imports emcee: import it inside functions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from emcee import EnsembleSampler
from emcee.moves.move import Move
from numpy.typing import NDArray

__all__ = ["DifferentialEvolution", "Independence", "Sampler", "Snooker", "StudentProposal"]

FloatArray = NDArray[np.float64]
RandomState = np.random.RandomState

#: Jump of differential evolution in units of the difference of two walkers: 2.38 / sqrt(2 d) is the best for
#: a normal (ter Braak 2006, section 2), and a little spread keeps the moves off a lattice.
_DE_FACTOR = 2.38
_DE_JITTER = 1e-5

#: Jump of the snooker update (ter Braak and Vrugt 2008, section 2.2).
_SNOOKER_FACTOR = 1.7


class Sampler(EnsembleSampler):  # type: ignore[misc]
    """emcee's sampler without a copy of the random state at every step, which takes longer than a move."""

    @property
    def random_state(self) -> None:
        """Nothing: see :meth:`random_numbers`."""
        return

    @random_state.setter
    def random_state(self, state: tuple[Any, ...] | None) -> None:
        if state is not None:
            self._random.set_state(state)

    def random_numbers(self) -> tuple[Any, ...]:
        """The state of the random numbers now."""
        return tuple(self._random.get_state())


@dataclass(frozen=True, slots=True, eq=False)
class StudentProposal:
    """A multivariate Student-t.

    Attributes
    ----------
    centre : ndarray, shape (d,)
    root : ndarray, shape (d, d)
        Lower triangular; ``root @ root.T`` is the scale matrix.
    dof : float
        Degrees of freedom: the tails fall as the power ``-(dof + d)``, heavier than those of the posterior.
    """

    centre: FloatArray
    root: FloatArray
    dof: float
    _inverse: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_inverse", np.linalg.inv(self.root))

    def draw(self, count: int, random: RandomState) -> FloatArray:
        """Draw points, shape (count, d)."""
        normal = random.standard_normal((count, self.centre.size))
        scale = np.sqrt(self.dof / random.chisquare(self.dof, (count, 1)))
        return np.asarray(self.centre + scale * (normal @ self.root.T))

    def log_density(self, points: FloatArray) -> FloatArray:
        """Logarithm of the density, up to a constant, at points of shape (n, d)."""
        whitened = (points - self.centre) @ self._inverse.T
        distance = np.einsum("ij,ij->i", whitened, whitened)
        return np.asarray(-0.5 * (self.dof + self.centre.size) * np.log1p(distance / self.dof))


class _HalvesMove(Move):  # type: ignore[misc]
    """Moves one random half of the ensemble by the other half, then the other by the first."""

    def propose(self, model: Any, state: Any) -> tuple[Any, NDArray[np.bool_]]:
        """Advance all walkers once, as emcee asks a move to."""
        order = model.random.permutation(len(state.coords))
        accepted = np.zeros(len(order), dtype=bool)
        for moved, fixed in (np.array_split(order, 2), np.array_split(order, 2)[::-1]):
            points, factors = self._proposal(state.coords[moved], state.coords[fixed], model.random)
            accepted[moved] = _accept(model, state, moved, points, factors)
        return state, accepted

    def _proposal(
        self, points: FloatArray, others: FloatArray, random: RandomState
    ) -> tuple[FloatArray, FloatArray]:
        raise NotImplementedError


class DifferentialEvolution(_HalvesMove):
    """A step along the difference of two other walkers."""

    def _proposal(
        self, points: FloatArray, others: FloatArray, random: RandomState
    ) -> tuple[FloatArray, FloatArray]:
        first, second = _two_of(len(others), len(points), random)
        jitter = 1.0 + _DE_JITTER * random.standard_normal((len(points), 1))
        factor = _DE_FACTOR / math.sqrt(2.0 * points.shape[1])
        return points + factor * jitter * (others[first] - others[second]), np.zeros(len(points))


class Snooker(_HalvesMove):
    """A step along the line to another walker, as far as two more differ in that direction."""

    def _proposal(
        self, points: FloatArray, others: FloatArray, random: RandomState
    ) -> tuple[FloatArray, FloatArray]:
        anchor = others[random.randint(len(others), size=len(points))]
        first, second = _two_of(len(others), len(points), random)
        line = points - anchor
        squared = np.einsum("ij,ij->i", line, line)
        apart = squared > 0.0
        squared[~apart] = 1.0
        shift = _SNOOKER_FACTOR * np.einsum("ij,ij->i", line, others[first] - others[second]) / squared
        # the walker's distance to the anchor changes by the factor |1 + shift|, its volume element by the
        # power d - 1 of it (equation 4); a walker on top of its anchor has no line to move along
        with np.errstate(divide="ignore"):
            stretch = np.where(apart, np.log(np.abs(1.0 + shift)), -np.inf)
        factors = (points.shape[1] - 1) * stretch if points.shape[1] > 1 else np.where(apart, 0.0, -np.inf)
        return points + shift[:, None] * line, factors


class Independence(Move):  # type: ignore[misc]
    """A fresh point from a fixed proposal, accepted by the ratio of importance weights."""

    def __init__(self, proposal: StudentProposal) -> None:
        self._proposal = proposal

    def propose(self, model: Any, state: Any) -> tuple[Any, NDArray[np.bool_]]:
        """Advance all walkers once, as emcee asks a move to."""
        everybody = np.arange(len(state.coords))
        points = self._proposal.draw(len(everybody), model.random)
        factors = self._proposal.log_density(state.coords) - self._proposal.log_density(points)
        return state, _accept(model, state, everybody, points, factors)


def _two_of(available: int, count: int, random: RandomState) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """``count`` ordered pairs of different indices below ``available``, uniform over all such pairs."""
    first = random.randint(available, size=count)
    return first, (first + 1 + random.randint(available - 1, size=count)) % available


def _accept(
    model: Any, state: Any, moved: NDArray[np.int_], points: FloatArray, factors: FloatArray
) -> NDArray[np.bool_]:
    """Metropolis-Hastings for some walkers at once; changes ``state`` and says who moved."""
    log_density = model.log_prob_fn(points)
    with np.errstate(divide="ignore"):
        threshold = np.log(model.random.random_sample(len(moved)))
    accepted = np.asarray(threshold < factors + log_density - state.log_prob[moved])
    state.coords[moved[accepted]] = points[accepted]
    state.log_prob[moved[accepted]] = log_density[accepted]
    return accepted
