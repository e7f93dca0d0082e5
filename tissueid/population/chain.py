"""One sweep of the Markov chain over a population, and what it leaves; compiled."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.compiled import kernel
from tissueid.population.kernels import (
    Cohort,
    Hyper,
    State,
    centre_of,
    draw_coefficients,
    draw_effects,
    squares,
    unit_factor,
)
from tissueid.population.moves import (
    distance2,
    move_among_draws,
    move_smooth,
    move_together,
    open_together,
    smooth_likelihood,
)
from tissueid.population.scale_kernels import correlation_factor, draw_nu, draw_scales


class Record(NamedTuple):
    """Record of a chain: draws of the population, and running sums over its specimens."""

    coefficient: FloatArray  # (steps, q, p)
    level_log_sd: FloatArray  # (steps, L, p)
    log_sd: FloatArray  # (steps, p)
    correlation: FloatArray  # (steps, p, p)
    nu: FloatArray  # (steps,)
    phi: NDArray[np.float32]  # (kept, n, p), places of the specimens, evenly over the steps
    #: (n,): sums over all steps of how often a specimen was far, and of its weight.
    far: FloatArray
    weight: FloatArray  # (n,)
    deviation: FloatArray  # (n, p), sums of its deviations over D
    effect: FloatArray  # (G, p), sums of the groups' effects


@kernel()
def _write_population(state: State, record: Record, step: int, low: FloatArray) -> None:
    p = state.log_sd.size
    record.nu[step] = state.nu[0]
    for k in range(p):
        record.log_sd[step, k] = state.log_sd[k]
        for a in range(state.coefficient.shape[0]):
            record.coefficient[step, a, k] = state.coefficient[a, k]
        for level in range(state.level_log_sd.shape[0]):
            record.level_log_sd[step, level, k] = state.level_log_sd[level, k]
        for g in range(state.effect.shape[0]):
            record.effect[g, k] += state.effect[g, k]
        for j in range(p):
            total = 0.0
            for i in range(min(j, k) + 1):
                total += low[k, i] * low[j, i]
            record.correlation[step, k, j] = total


@kernel()
def _write_specimens(
    cohort: Cohort, hyper: Hyper, state: State, record: Record, step: int, low: FloatArray
) -> None:
    n, p = state.phi.shape
    kept = record.phi.shape[0]
    thin = max(record.nu.size // max(kept, 1), 1)
    row = step // thin if step % thin == 0 and step // thin < kept else -1
    mean = np.zeros(p)
    unit = unit_factor(state.log_sd, low)
    for i in range(n):
        centre_of(cohort, state, i, mean)
        record.weight[i] += state.weight[i]
        if distance2(state.phi[i], mean, unit) > hyper.far:
            record.far[i] += 1.0
        for k in range(p):
            record.deviation[i, k] += (state.phi[i, k] - mean[k]) * math.exp(-state.log_sd[k])
            if row >= 0:
                record.phi[row, i, k] = state.phi[i, k]


@kernel()
def _draw_weights(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, unit: FloatArray
) -> None:
    """Degrees of freedom with the weights integrated, then the weights."""
    p = unit.shape[0]
    mean = np.zeros(p)
    for i in range(state.weight.size):
        centre_of(cohort, state, i, mean)
        state.distance2[i] = distance2(state.phi[i], mean, unit)
    state.nu[0] = draw_nu(rng, state.nu[0], state.distance2, p, hyper.nu[0], hyper.nu[1])
    half = 0.5 * state.nu[0]
    for i in range(state.weight.size):
        drawn = rng.standard_gamma(half + 0.5 * p) / (half + 0.5 * state.distance2[i])
        # a weight that is zero by rounding would never come back
        state.weight[i] = max(drawn, 1e-12)


@kernel()
def sweeps(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, record: Record, steps: int,
    keep: bool,
) -> None:  # fmt: skip
    """Go on for so many sweeps.

    ``state``: changed in place; ``record``: written to where ``keep``; it has room for ``steps``; ``keep``:
    without it the chain settles: steps of joint moves are adapted.
    """
    p = state.log_sd.size
    inverse = np.zeros((p, p))
    any_smooth = False
    for i in range(cohort.smooth.size):
        if cohort.smooth[i] >= 0:
            any_smooth = True
            state.likelihood[i] = smooth_likelihood(cohort, i, state.phi[i])
    open_low = open_together(cohort) if any_smooth else np.zeros((p, p))
    for step in range(steps):
        unit = unit_factor(state.log_sd, correlation_factor(state.partial))
        move_among_draws(rng, cohort, hyper, state, unit)
        if any_smooth:
            _inverse(unit, inverse)
            move_smooth(rng, cohort, state, unit, inverse)
        if hyper.heavy:
            _draw_weights(rng, cohort, hyper, state, unit)
        if any_smooth:
            move_together(rng, cohort, hyper, state, unit, open_low, not keep)
        _inverse(unit, inverse)
        draw_coefficients(rng, cohort, hyper, state, inverse)
        draw_effects(rng, cohort, hyper, state, inverse)
        count = float(state.weight.size)
        low = draw_scales(rng, state.log_sd, state.partial, squares(cohort, state), count, hyper.scale)
        if keep:
            _write_population(state, record, step, low)
            _write_specimens(cohort, hyper, state, record, step, low)


@kernel()
def _inverse(unit: FloatArray, out: FloatArray) -> None:
    """Precision from the inverse of its covariance's Cholesky factor."""
    p = unit.shape[0]
    for k in range(p):
        for j in range(p):
            total = 0.0
            for i in range(max(k, j), p):
                total += unit[i, k] * unit[i, j]
            out[k, j] = total
