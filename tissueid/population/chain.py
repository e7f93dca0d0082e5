"""One sweep of the Markov chain over a population: moves of its specimens, and what it leaves; compiled.

A specimen **among its draws** moves to others of its stage-1 draws, accepted by ``population / reference``,
the prior of stage 1 (Lunn, Barrett, Sweeting & Thompson 2013, JRSS C 62:551, doi 10.1111/rssc.12007), or,
drawn with frozen weights ``pilot / reference``, by ``population / pilot``.  One **with a smooth likelihood**
moves by Metropolis: to a draw of the product of the population and one normal, then by steps of that
product's shape. The data say little of it, so that mean and spread of the population are moved together with
such specimens as well (Liu & Sabatti 2000, Biometrika 87:353, doi 10.1093/biomet/87.2.353), coordinate by
coordinate, and the mean along what their data leave open together: a gain leaves all forces open by one and
the same factor.
"""

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
    centres,
    correlation_factor,
    distance2,
    draw_coefficients,
    draw_effects,
    draw_scales,
    draw_weights,
    factor,
    inverse_factor,
    unit_factor,
)

#: A quantity is never looked at beyond e to this, times its typical value.
LARGEST = 50.0


@kernel()
def log_mixture(
    phi: FloatArray, linear: NDArray[np.bool_], centre: FloatArray, log_weight: FloatArray,
    mean: FloatArray, unit: FloatArray,
) -> float:  # fmt: skip
    """Ln of a mixture of normals at a point, up to a constant.

    ``phi`` (p,); ``linear`` (p,): coordinates that the mixture has in the quantity itself, over exp(centre),
    not in its logarithm; ``centre`` (p,); ``log_weight`` (c,): of each component, its determinant included;
    ``mean`` (c, p); ``unit`` (c, p, p): inverse Cholesky factors.
    """
    x = phi - centre
    for k in range(x.size):
        if linear[k]:
            x[k] = math.exp(min(x[k], LARGEST))
    value = np.array([log_weight[c] - 0.5 * distance2(x, mean[c], unit[c]) for c in range(log_weight.size)])
    best = value.max()
    if not best > -np.inf:
        return -np.inf
    return float(best + math.log(np.exp(value - best).sum()))


#: Proposals of a sweep for a specimen among its draws: with the frozen weights, and among all draws alike.
WEIGHTED_TRIES = 2
PLAIN_TRIES = 1
#: Steps of a sweep for a specimen with a smooth likelihood, and tails of its independent proposal.
STEPS = 3
PROPOSAL_NU = 5.0
#: Best length of a step over that of the distribution (Roberts, Gelman & Gilks 1997, times root p).
STEP_LENGTH = 2.38
#: Acceptance that joint moves are brought to while the chain settles.
WANTED_ACCEPTANCE = 0.4
#: Change of ln of a step's length for an acceptance too much.
ADAPTATION = 0.2
#: From so many specimens on, one coordinate a sweep is moved jointly.
MANY = 400


@kernel()
def _log_population(square: float, p: int, nu: float, heavy: bool) -> float:
    """Ln density of a specimen at a squared distance, up to a constant of all specimens."""
    if heavy:
        return -0.5 * (nu + p) * math.log1p(square / nu)
    return -0.5 * square


@kernel()
def smooth_likelihood(cohort: Cohort, i: int | np.int64, phi: FloatArray) -> float:
    """Ln of the smooth likelihood of specimen i; -inf where relaxation times do not ascend."""
    s = cohort.smooth[i]
    for k in range(cohort.ascending.size - 1):
        if not phi[cohort.ascending[k]] < phi[cohort.ascending[k + 1]]:
            return -np.inf
    return log_mixture(
        phi, cohort.linear, cohort.middle[s], cohort.log_weight[s], cohort.component[s], cohort.unit[s]
    )


@kernel()
def move_among_draws(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, unit: FloatArray,
    centre: FloatArray,
) -> None:  # fmt: skip
    """Propose other stage-1 draws to the specimens among theirs; weights of the mixture are integrated."""
    p, nu = unit.shape[0], state.nu[0]
    for i in np.flatnonzero(cohort.smooth < 0):
        mean = centre[i]
        first, end = cohort.start[i], cohort.start[i + 1]
        now = state.pick[i]
        value = _log_population(distance2(cohort.phi[now], mean, unit), p, nu, hyper.heavy)
        for attempt in range(WEIGHTED_TRIES + PLAIN_TRIES):
            weighted = attempt < WEIGHTED_TRIES
            if weighted:
                found = np.searchsorted(cohort.cumulative[first:end], rng.random())
                other = min(first + found, end - 1)
            else:
                other = first + min(int(rng.random() * (end - first)), end - first - 1)
            if other == now:
                continue
            proposed = _log_population(distance2(cohort.phi[other], mean, unit), p, nu, hyper.heavy)
            ratio = proposed - value
            if weighted:
                ratio -= cohort.log_pilot[other] - cohort.log_pilot[now]
            else:
                ratio -= cohort.log_reference[other] - cohort.log_reference[now]
            if ratio >= 0.0 or rng.random() < math.exp(ratio):
                now, value = other, proposed
                state.accepted[i] += 1
        state.pick[i] = now
        state.phi[i] = cohort.phi[now]


@kernel()
def move_smooth(
    rng: np.random.Generator, cohort: Cohort, state: State, unit: FloatArray, centre: FloatArray
) -> None:
    """Move the specimens with a smooth likelihood, given their weights in the mixture."""
    p, inverse = unit.shape[0], unit.T @ unit
    half = 0.5 * (PROPOSAL_NU + p)
    for i in np.flatnonzero(cohort.smooth >= 0):
        s, mean, weight, now = cohort.smooth[i], centre[i], state.weight[i], state.phi[i]
        low = factor(weight * inverse + cohort.precision[s])
        root = inverse_factor(low).T
        best = root @ (root.T @ (weight * (inverse @ mean) + cohort.precision[s] @ cohort.likely[s]))
        value = state.likelihood[i] - 0.5 * weight * distance2(now, mean, unit)
        for attempt in range(1 + STEPS):
            step = root @ rng.standard_normal(p)
            ratio = 0.0
            if attempt == 0:
                stretch = 1.0 / math.sqrt(rng.standard_gamma(0.5 * PROPOSAL_NU) / (0.5 * PROPOSAL_NU))
                other = best + stretch * step
                ratio += half * math.log1p(((low.T @ (other - best)) ** 2).sum() / PROPOSAL_NU)
                ratio -= half * math.log1p(((low.T @ (now - best)) ** 2).sum() / PROPOSAL_NU)
            else:
                other = now + STEP_LENGTH / math.sqrt(p) * step
            likelihood = smooth_likelihood(cohort, i, other)
            proposed = likelihood - 0.5 * weight * distance2(other, mean, unit)
            ratio += proposed - value
            if ratio >= 0.0 or rng.random() < math.exp(ratio):
                now[:] = other
                value = proposed
                state.likelihood[i] = likelihood
                state.accepted[i] += 1


@kernel()
def _try_together(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, unit: FloatArray,
    shift: FloatArray, k: int, stretch: float,
) -> float:  # fmt: skip
    """Try to move the mean by ``shift`` and ln D of coordinate k by ``stretch``, smooth specimens with both.

    Gives 1 where it did.  Of a smooth specimen the density in the population stays, ``unit`` follows D.
    """
    away, still = state.phi - centres(cohort, state), np.zeros(shift.size)
    moved, left = state.phi + shift, away - shift
    moved[:, k] += (math.exp(stretch) - 1.0) * away[:, k]
    left[:, k] *= math.exp(-stretch)
    mean, log_sd, (middle, sd) = state.coefficient[0], state.log_sd[k], hyper.scale[:2]
    ratio = -0.5 * ((mean + shift) ** 2 - mean**2).sum() / hyper.coefficient_sd[0] ** 2
    ratio -= 0.5 * ((log_sd + stretch - middle) ** 2 - (log_sd - middle) ** 2) / sd**2
    likelihood = state.likelihood.copy()
    for i in range(state.weight.size):
        if cohort.smooth[i] >= 0:
            likelihood[i] = smooth_likelihood(cohort, i, moved[i])
            ratio += likelihood[i] - state.likelihood[i]
        else:
            nearer = distance2(away[i], still, unit) - distance2(left[i], still, unit)
            ratio += 0.5 * state.weight[i] * nearer - stretch
    if not (ratio >= 0.0 or rng.random() < math.exp(ratio)):
        return 0.0
    for s in np.flatnonzero(cohort.smooth >= 0):
        state.phi[s] = moved[s]
    state.likelihood[:] = likelihood
    state.coefficient[0] += shift
    state.log_sd[k] += stretch
    unit[:, k] *= math.exp(-stretch)
    return 1.0


@kernel()
def move_together(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, unit: FloatArray,
    open_root: FloatArray, adapt: bool,
) -> None:  # fmt: skip
    """Move means and spreads together with the smooth specimens; ``unit`` follows the spreads."""
    p = unit.shape[0]
    gain = ADAPTATION if adapt else 0.0
    shift = open_root @ (math.exp(state.step[2, 0]) * rng.standard_normal(p))
    accepted = _try_together(rng, cohort, hyper, state, unit, shift, p - 1, 0.0)
    state.step[2, 0] += gain * (accepted - WANTED_ACCEPTANCE)
    only = min(int(rng.random() * p), p - 1) if state.weight.size >= MANY else -1
    for k in range(p):
        if only >= 0 and k != only:
            continue
        for kind in range(2):
            change = math.exp(state.step[kind, k]) * rng.standard_normal()
            shift = np.zeros(p)
            shift[k] = change if kind == 0 else 0.0
            stretch = change if kind == 1 else 0.0
            accepted = _try_together(rng, cohort, hyper, state, unit, shift, k, stretch)
            state.step[kind, k] += gain * (accepted - WANTED_ACCEPTANCE)


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
def _write(cohort: Cohort, hyper: Hyper, state: State, record: Record, step: int, low: FloatArray) -> None:
    """Keep a state of the chain."""
    record.nu[step] = state.nu[0]
    record.log_sd[step] = state.log_sd
    record.coefficient[step] = state.coefficient
    record.level_log_sd[step] = state.level_log_sd
    record.correlation[step] = low @ low.T
    record.effect[:] += state.effect
    record.weight[:] += state.weight
    centre, unit = centres(cohort, state), unit_factor(state.log_sd, low)
    record.deviation[:] += (state.phi - centre) * np.exp(-state.log_sd)
    for i in range(centre.shape[0]):
        record.far[i] += distance2(state.phi[i], centre[i], unit) > hyper.far
    kept = record.phi.shape[0]
    thin = max(record.nu.size // max(kept, 1), 1)
    if step % thin == 0 and step // thin < kept:
        record.phi[step // thin] = state.phi


@kernel()
def sweeps(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, record: Record, steps: int,
    keep: bool,
) -> None:  # fmt: skip
    """Go on for so many sweeps, ``state`` in place; without ``keep`` steps of joint moves are adapted."""
    smooth = np.flatnonzero(cohort.smooth >= 0)
    # what the data of the smooth specimens leave open of their common place
    open_root = np.zeros(state.partial.shape)
    if smooth.size:
        open_root[:] = inverse_factor(factor(cohort.precision.sum(axis=0))).T
    for i in smooth:
        state.likelihood[i] = smooth_likelihood(cohort, i, state.phi[i])
    for step in range(steps):
        unit = unit_factor(state.log_sd, correlation_factor(state.partial))
        centre = centres(cohort, state)
        move_among_draws(rng, cohort, hyper, state, unit, centre)
        if smooth.size:
            move_smooth(rng, cohort, state, unit, centre)
        if hyper.heavy:
            draw_weights(rng, hyper, state, unit, centre)
        if smooth.size:
            move_together(rng, cohort, hyper, state, unit, open_root, not keep)
        inverse = unit.T @ unit
        draw_coefficients(rng, cohort, hyper, state, inverse)
        draw_effects(rng, cohort, hyper, state, inverse)
        away, count = state.phi - centres(cohort, state), float(state.weight.size)
        squares = (away * state.weight[:, None]).T @ away
        low = draw_scales(rng, state.log_sd, state.partial, squares, count, hyper.scale)
        if keep:
            _write(cohort, hyper, state, record, step, low)
