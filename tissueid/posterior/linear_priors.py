"""Priors of what is integrated: coefficients of F_s and K by powers of u, and the effects of every log."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.linearise import Optimum
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt
from tissueid.priors import WEAK_FACTOR, Priors

__all__ = ["FREE_FACTOR", "Facts", "effect_prior", "linear_prior"]

FloatArray = NDArray[np.float64]

#: Standard deviation of a free static coefficient of a log, in forces.
FREE_FACTOR = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Facts:
    """What the priors need to know of a specimen's logs.

    Attributes
    ----------
    force_N : float
        Largest measured force.
    speed_mm_s, depth_mm : ndarray, shape (ramps,)
        Of every ramp.
    log_tau_bounds : tuple of float
        ln h/5 and ln 10 T.
    offset_sd_mm, offset_mean_mm : ndarray, shape (logs,)
        Prior of each contact point's change against the sums; sd 0 where it is not free.
    """

    force_N: float
    speed_mm_s: FloatArray
    depth_mm: FloatArray
    log_tau_bounds: tuple[float, float]
    offset_sd_mm: FloatArray
    offset_mean_mm: FloatArray


def _bernstein(size: int) -> FloatArray:
    """Bernstein coefficients from coefficients by powers of u."""
    return np.array(
        [
            [math.comb(i, k) / math.comb(size - 1, k) if k <= i else 0.0 for k in range(size)]
            for i in range(size)
        ]
    )


def linear_prior(
    priors: Priors, model: KelvinVoigt, optimum: Optimum, facts: Facts
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Prior mean and precision of theta by powers of u, and which branches are weak (at a state of 1 mm)."""
    scale, size = optimum.scale, optimum.degree + 1
    spread = WEAK_FACTOR * max(facts.force_N, 1e-300)
    mean = np.zeros(optimum.theta.size)
    precision = np.zeros((mean.size, mean.size))
    weak = np.ones(optimum.branches, dtype=np.bool_)
    names = model.parameter_names
    blocks: list[tuple[int, list[str], FloatArray, int]] = []
    if optimum.static:
        blocks.append((0, list(names[:STATIC_DEGREE]), scale ** np.arange(1.0, STATIC_DEGREE + 1), -1))
    for j in range(optimum.branches):
        first = STATIC_DEGREE + j * model.block
        at = optimum.static + j * size
        blocks.append((at, list(names[first : first + size]), scale ** np.arange(float(size)), j))
    for first, block, unit, branch in blocks:
        part = slice(first, first + len(block))
        stated = [name in priors.linear for name in block]
        if not any(stated):
            to = _bernstein(len(block))
            precision[part, part] = to.T @ to / spread**2
            continue
        if branch >= 0:
            weak[branch] = False
        known = np.array([priors.linear.get(name, (0.0, np.inf)) for name in block])
        # beside stated coefficients an unstated one is weak by its largest force over the fitted depth
        sd = np.where(stated, known[:, 1] * unit, 4.0 * spread / (1.0 if branch < 0 else scale))
        mean[part] = known[:, 0] * unit
        precision[part, part] = np.diag(1.0 / sd**2)
    return mean, precision, weak


def effect_prior(optimum: Optimum, facts: Facts, effects: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
    """Prior mean and sd of each log's effects, which count from the optimum; shapes (logs, q)."""
    means, sds = [], []
    if "gain" in effects:
        means.append(-optimum.gamma)
        sds.append(np.ones_like(optimum.gamma))
    if "offset" in effects:
        means.append(facts.offset_mean_mm - optimum.delta)
        sds.append(facts.offset_sd_mm)
    if "static" in effects:
        unit = optimum.scale ** np.arange(float(optimum.own.shape[1]))
        means += list(-(optimum.own * unit).T)
        sds += [np.full(optimum.gamma.size, FREE_FACTOR * facts.force_N)] * optimum.own.shape[1]
    shape = (optimum.gamma.size, 0)
    if not means:
        return np.zeros(shape), np.ones(shape)
    return np.ascontiguousarray(np.array(means).T), np.ascontiguousarray(np.array(sds).T)
