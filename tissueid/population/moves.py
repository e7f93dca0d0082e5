"""Moves of specimens in the chain over a population, compiled.

A specimen **among its draws** is one of its stage-1 draws.  These are draws from ``likelihood x reference``
with a known reference density, the prior of stage 1, so that an independent proposal among them is accepted
by the ratio of ``population / reference`` (Lunn, Barrett, Sweeting & Thompson 2013, JRSS C 62:551, doi
10.1111/rssc.12007).  Where the population is narrow beside the prior such a proposal is seldom accepted;
others are therefore drawn with frozen weights ``pilot / reference`` and accepted by the ratio of
``population / pilot``.  Both leave the same distribution as it is.

A specimen **with a smooth likelihood** moves by Metropolis: once to a draw of the product of the population
and one normal, then by steps of that product's shape.  Of such specimens the data say little, so that they
follow the population and it follows them: its mean and its spread are therefore moved together with them as
well (translation and scaling; Liu & Sabatti 2000, Biometrika 87:353, doi 10.1093/biomet/87.2.353), coordinate
by coordinate, and the mean along what their data leave open together: a gain leaves all forces open, but by
one and the same factor.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.compiled import kernel
from tissueid.population.kernels import Cohort, Hyper, State, centre_of, factor, solved

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
    p = phi.size
    x = np.empty(p)
    for k in range(p):
        x[k] = phi[k] - centre[k]
        if linear[k]:
            x[k] = math.exp(min(x[k], LARGEST))
    best = -np.inf
    value = np.empty(log_weight.size)
    for c in range(log_weight.size):
        square = 0.0
        for i in range(p):
            z = 0.0
            for j in range(i + 1):
                z += unit[c, i, j] * (x[j] - mean[c, j])
            square += z * z
        value[c] = log_weight[c] - 0.5 * square
        best = max(best, value[c])
    if not best > -np.inf:
        return -np.inf
    total = 0.0
    for c in range(value.size):
        total += math.exp(value[c] - best)
    return best + math.log(total)


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
#: From so many specimens on, one coordinate a sweep is moved jointly.
MANY = 400


@kernel()
def distance2(phi, mean: FloatArray, unit: FloatArray) -> float:  # type: ignore[no-untyped-def]
    """Squared distance of a point from a centre, in units of an inverse Cholesky factor."""
    total = 0.0
    for i in range(mean.size):
        z = 0.0
        for j in range(i + 1):
            z += unit[i, j] * (phi[j] - mean[j])
        total += z * z
    return total


@kernel()
def _log_population(square: float, p: int, nu: float, heavy: bool) -> float:
    """Ln density of a specimen at a squared distance, up to a constant of all specimens."""
    if heavy:
        return -0.5 * (nu + p) * math.log1p(square / nu)
    return -0.5 * square


@kernel()
def smooth_likelihood(cohort: Cohort, i: int, phi: FloatArray) -> float:
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
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, unit: FloatArray
) -> None:
    """Propose other stage-1 draws to the specimens among theirs; weights of the mixture are integrated."""
    p = unit.shape[0]
    mean = np.zeros(p)
    nu = state.nu[0]
    for i in range(state.weight.size):
        if cohort.smooth[i] >= 0:
            continue
        centre_of(cohort, state, i, mean)
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
        for k in range(p):
            state.phi[i, k] = cohort.phi[now, k]


@kernel()
def _up(low: FloatArray, z: FloatArray) -> None:
    """Solve ``low.T @ x = z`` in place."""
    for i in range(z.size - 1, -1, -1):
        for k in range(i + 1, z.size):
            z[i] -= low[k, i] * z[k]
        z[i] /= low[i, i]


@kernel()
def _away2(low: FloatArray, phi: FloatArray, mean: FloatArray) -> float:
    """Squared distance in units of a precision's factor."""
    total = 0.0
    for j in range(mean.size):
        z = 0.0
        for i in range(j, mean.size):
            z += low[i, j] * (phi[i] - mean[i])
        total += z * z
    return total


@kernel()
def move_smooth(
    rng: np.random.Generator, cohort: Cohort, state: State, unit: FloatArray, inverse: FloatArray
) -> None:
    """Move the specimens with a smooth likelihood, given their weights in the mixture."""
    p = unit.shape[0]
    mean, best, other, z = np.zeros(p), np.zeros(p), np.zeros(p), np.zeros(p)
    precision = np.zeros((p, p))
    for i in range(state.weight.size):
        s = cohort.smooth[i]
        if s < 0:
            continue
        centre_of(cohort, state, i, mean)
        weight = state.weight[i]
        for k in range(p):
            best[k] = 0.0
            for j in range(p):
                precision[k, j] = weight * inverse[k, j] + cohort.precision[s, k, j]
                best[k] += weight * inverse[k, j] * mean[j] + cohort.precision[s, k, j] * cohort.likely[s, j]
        low = factor(precision)
        best[:] = solved(low, best)
        _up(low, best)
        now = state.phi[i]
        value = state.likelihood[i] - 0.5 * weight * distance2(now, mean, unit)
        for attempt in range(1 + STEPS):
            for k in range(p):
                z[k] = rng.standard_normal()
            _up(low, z)
            ratio = 0.0
            if attempt == 0:
                stretch = 1.0 / math.sqrt(rng.standard_gamma(0.5 * PROPOSAL_NU) / (0.5 * PROPOSAL_NU))
                half = 0.5 * (PROPOSAL_NU + p)
                for k in range(p):
                    other[k] = best[k] + stretch * z[k]
                ratio += half * math.log1p(_away2(low, other, best) / PROPOSAL_NU)
                ratio -= half * math.log1p(_away2(low, now, best) / PROPOSAL_NU)
            else:
                for k in range(p):
                    other[k] = now[k] + STEP_LENGTH / math.sqrt(p) * z[k]
            likelihood = smooth_likelihood(cohort, i, other)
            proposed = likelihood - 0.5 * weight * distance2(other, mean, unit)
            ratio += proposed - value
            if ratio >= 0.0 or rng.random() < math.exp(ratio):
                for k in range(p):
                    now[k] = other[k]
                value = proposed
                state.likelihood[i] = likelihood
                state.accepted[i] += 1


@kernel()
def _shifted(
    cohort: Cohort,
    state: State,
    i: int,
    k: int,
    kind: int,
    change: float,
    mean: FloatArray,
    other: FloatArray,
) -> None:
    """Place of a smooth specimen after a joint move, into ``other``."""
    for j in range(other.size):
        other[j] = state.phi[i, j]
    if kind == 0:
        other[k] += change
    else:
        centre_of(cohort, state, i, mean)
        other[k] = mean[k] + math.exp(change) * (other[k] - mean[k])


@kernel()
def _try_together(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, unit: FloatArray,
    which: tuple[int, int], adapt: bool, likelihood: FloatArray,
) -> None:  # fmt: skip
    """Move the mean (kind 0) or the spread (kind 1) of a coordinate with the smooth specimens.

    A translation keeps their density in the population; so does a scaling, but for its Jacobian, which the
    density's own change cancels.
    """
    p, (k, kind) = unit.shape[0], which
    mean, other = np.zeros(p), np.zeros(p)
    change = math.exp(state.step[kind, k]) * rng.standard_normal()
    ratio = 0.0
    if kind == 0:
        before = state.coefficient[0, k]
        after = before + change
        ratio -= 0.5 * (after * after - before * before) / hyper.coefficient_sd[0] ** 2
    else:
        before, after = state.log_sd[k], state.log_sd[k] + change
        ratio -= 0.5 * ((after - hyper.scale[0]) ** 2 - (before - hyper.scale[0]) ** 2) / hyper.scale[1] ** 2
    for i in range(state.weight.size):
        if cohort.smooth[i] >= 0:
            _shifted(cohort, state, i, k, kind, change, mean, other)
            likelihood[i] = smooth_likelihood(cohort, i, other)
            ratio += likelihood[i] - state.likelihood[i]
            continue
        centre_of(cohort, state, i, mean)
        for j in range(p):
            other[j] = state.phi[i, j] - mean[j]
            mean[j] = 0.0
        ratio += 0.5 * state.weight[i] * distance2(other, mean, unit)
        if kind == 0:
            other[k] -= change
        else:
            other[k] *= math.exp(-change)
            ratio -= change
        ratio -= 0.5 * state.weight[i] * distance2(other, mean, unit)
    accepted = ratio >= 0.0 or rng.random() < math.exp(ratio)
    if accepted:
        for i in range(state.weight.size):
            if cohort.smooth[i] >= 0:
                _shifted(cohort, state, i, k, kind, change, mean, other)
                state.phi[i, k] = other[k]
                state.likelihood[i] = likelihood[i]
        if kind == 0:
            state.coefficient[0, k] = after
        else:
            state.log_sd[k] = after
            for i in range(k, p):
                unit[i, k] *= math.exp(-change)
    if adapt:
        state.step[kind, k] += 0.2 * ((1.0 if accepted else 0.0) - WANTED_ACCEPTANCE)


@kernel()
def open_together(cohort: Cohort) -> FloatArray:
    """Cholesky factor of what the data of the smooth specimens say together of their common place."""
    together = np.zeros(cohort.precision.shape[1:])
    for s in range(cohort.precision.shape[0]):
        together += cohort.precision[s]
    return factor(together)


@kernel()
def _try_translation(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, unit: FloatArray,
    open_low: FloatArray, adapt: bool, likelihood: FloatArray,
) -> None:  # fmt: skip
    """Move the mean with the smooth specimens in all coordinates at once."""
    p = unit.shape[0]
    change, mean, other = np.zeros(p), np.zeros(p), np.zeros(p)
    for k in range(p):
        change[k] = math.exp(state.step[2, 0]) * rng.standard_normal()
    _up(open_low, change)
    ratio = 0.0
    for k in range(p):
        before = state.coefficient[0, k]
        ratio -= 0.5 * ((before + change[k]) ** 2 - before**2) / hyper.coefficient_sd[0] ** 2
    for i in range(state.weight.size):
        if cohort.smooth[i] >= 0:
            for k in range(p):
                other[k] = state.phi[i, k] + change[k]
            likelihood[i] = smooth_likelihood(cohort, i, other)
            ratio += likelihood[i] - state.likelihood[i]
            continue
        centre_of(cohort, state, i, mean)
        ratio += 0.5 * state.weight[i] * distance2(state.phi[i], mean, unit)
        for k in range(p):
            mean[k] += change[k]
        ratio -= 0.5 * state.weight[i] * distance2(state.phi[i], mean, unit)
    accepted = ratio >= 0.0 or rng.random() < math.exp(ratio)
    if accepted:
        for k in range(p):
            state.coefficient[0, k] += change[k]
        for i in range(state.weight.size):
            if cohort.smooth[i] >= 0:
                for k in range(p):
                    state.phi[i, k] += change[k]
                state.likelihood[i] = likelihood[i]
    if adapt:
        state.step[2, 0] += 0.2 * ((1.0 if accepted else 0.0) - WANTED_ACCEPTANCE)


@kernel()
def move_together(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, unit: FloatArray,
    open_low: FloatArray, adapt: bool,
) -> None:  # fmt: skip
    """Move means and spreads together with the smooth specimens; ``unit`` follows the spreads.

    ``open_low`` is of :func:`open_together`.
    """
    p = unit.shape[0]
    likelihood = np.zeros(state.weight.size)
    _try_translation(rng, cohort, hyper, state, unit, open_low, adapt, likelihood)
    only = min(int(rng.random() * p), p - 1) if state.weight.size >= MANY else -1
    for k in range(p):
        if only >= 0 and k != only:
            continue
        for kind in range(2):
            _try_together(rng, cohort, hyper, state, unit, (k, kind), adapt, likelihood)
