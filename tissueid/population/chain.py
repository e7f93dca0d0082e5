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
    centre_of,
    correlation_factor,
    draw_coefficients,
    draw_effects,
    draw_nu,
    draw_scales,
    factor,
    solved,
    squares,
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
        state.phi[i] = cohort.phi[now]


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
                now[:] = other
                value = proposed
                state.likelihood[i] = likelihood
                state.accepted[i] += 1


@kernel()
def _shifted(
    cohort: Cohort, state: State, i: int, k: int, kind: int, change: float, mean: FloatArray,
    other: FloatArray,
) -> None:  # fmt: skip
    """Place of a smooth specimen after a joint move, into ``other``."""
    other[:] = state.phi[i]
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
    """Move the mean (kind 0) or the spread (kind 1) of a coordinate with the smooth specimens."""
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
            other[:] = state.phi[i] + change
            likelihood[i] = smooth_likelihood(cohort, i, other)
            ratio += likelihood[i] - state.likelihood[i]
            continue
        centre_of(cohort, state, i, mean)
        ratio += 0.5 * state.weight[i] * distance2(state.phi[i], mean, unit)
        mean += change
        ratio -= 0.5 * state.weight[i] * distance2(state.phi[i], mean, unit)
    accepted = ratio >= 0.0 or rng.random() < math.exp(ratio)
    if accepted:
        state.coefficient[0] += change
        for i in range(state.weight.size):
            if cohort.smooth[i] >= 0:
                state.phi[i] += change
                state.likelihood[i] = likelihood[i]
    if adapt:
        state.step[2, 0] += 0.2 * ((1.0 if accepted else 0.0) - WANTED_ACCEPTANCE)


@kernel()
def move_together(
    rng: np.random.Generator, cohort: Cohort, hyper: Hyper, state: State, unit: FloatArray,
    open_low: FloatArray, adapt: bool,
) -> None:  # fmt: skip
    """Move means and spreads together with the smooth specimens; ``unit`` follows the spreads."""
    p = unit.shape[0]
    likelihood = np.zeros(state.weight.size)
    _try_translation(rng, cohort, hyper, state, unit, open_low, adapt, likelihood)
    only = min(int(rng.random() * p), p - 1) if state.weight.size >= MANY else -1
    for k in range(p):
        if only >= 0 and k != only:
            continue
        for kind in range(2):
            _try_together(rng, cohort, hyper, state, unit, (k, kind), adapt, likelihood)


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
    record.log_sd[step] = state.log_sd
    record.coefficient[step] = state.coefficient
    record.level_log_sd[step] = state.level_log_sd
    record.effect[:] += state.effect
    for k in range(p):
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
    """Go on for so many sweeps, ``state`` in place; without ``keep`` steps of joint moves are adapted."""
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
