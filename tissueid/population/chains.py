"""Many chains over a population at once: moves of its specimens, of its mean, effects, tails and scales.

The chains are an axis of every array, so that numpy does for all of them what it does for one.  The t
distribution is a scale mixture of normals: given its weights, mean and effects are normal.

A specimen **among its draws** moves to others of its stage-1 draws, accepted by ``population / reference``,
the prior of stage 1 (Lunn, Barrett, Sweeting & Thompson 2013, JRSS C 62:551, doi 10.1111/rssc.12007), or,
drawn with frozen weights ``pilot / reference``, by ``population / pilot``.  One **with a smooth likelihood**
moves by Metropolis: to a draw of the product of the population and one normal, then by steps of that
product's shape.  The data say little of it, so that mean and spread of the population are moved together with
such specimens as well (Liu & Sabatti 2000, Biometrika 87:353, doi 10.1093/biomet/87.2.353), by steps of the
shape that their data leave open: a gain leaves all forces open by one and the same factor.

A covariance is D R D with ln D_k normal and R of the LKJ distribution (Lewandowski, Kurowicka & Joe 2009, J
Multivariate Anal 100:1989, doi 10.1016/j.jmva.2009.04.008): its canonical partial correlations w are
independent, beta distributed on (-1, 1), and make the rows of R's Cholesky factor.  All of ln D and arctanh w
move together by Hamiltonian dynamics (Neal 2011, doi 10.1201/b10905-6), from sums of squares.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from tissueid.arrays import FloatArray, IntArray
from tissueid.population.stage_one import Cohort

#: arctanh of the largest partial correlation.
MOST_Z = 8.0
#: Share of a variance that rounding may hide.
ROUNDING = 1e-9
#: Steps of a trajectory: fewest, and one more than the most.
TRAJECTORY = (6, 16)
#: Acceptance that lengths of steps are brought to, and change of their logarithm for an acceptance too much.
WANTED_BY_SCALES = 0.8
SCALES_ADAPTATION = 0.5
#: Share of a covariance that is taken without its correlations.
RIDGE = 0.01
#: Each chain's steps are between these times the common length; a share is shorter, down to e to this.
JITTER = (0.4, 1.2)
SHORT, SHORTEST = 0.2, -7.0


def transposed(a: FloatArray) -> FloatArray:
    """Matrices of a stack, each transposed."""
    return np.swapaxes(a, -1, -2)


def factor(a: FloatArray) -> FloatArray:
    """Cholesky factors of a stack; all a little wider where rounding leaves one of them without."""
    try:
        return np.asarray(np.linalg.cholesky(a))
    except np.linalg.LinAlgError:
        wider = ROUNDING * np.einsum("...ii->...i", a)[..., None] * np.eye(a.shape[-1])
        return np.asarray(np.linalg.cholesky(a + wider))


def accepted(rng: np.random.Generator, ratio: FloatArray) -> NDArray[np.bool_]:
    """True where a move of that ln ratio of densities is made; never where it is no number."""
    return np.asarray(-rng.standard_exponential(ratio.shape) < ratio)


@dataclass(frozen=True, slots=True, eq=False)
class Scales:
    """Spreads and correlations of each chain: ln D (c, p), and arctanh w (c, p, p), strictly lower."""

    log_sd: FloatArray
    z: FloatArray

    def factors(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Partial correlations, root of what columns before leave of a row, and factors of R."""
        w = np.tanh(np.clip(self.z, -MOST_Z, MOST_Z))
        left = np.ones_like(w)
        np.cumprod(1.0 - w[..., :-1] ** 2, axis=-1, out=left[..., 1:])
        left = np.sqrt(left)
        return w, left, (w + np.eye(w.shape[-1])) * left

    @property
    def vector(self) -> FloatArray:
        """All numbers of a chain in a row; ln D stands on the diagonal."""
        i, j = np.tril_indices(self.z.shape[-1])
        return np.where(i == j, self.log_sd[:, i], self.z[:, i, j])

    @classmethod
    def of(cls, vector: FloatArray, size: int) -> Scales:
        """Scales from their numbers in a row."""
        all_of = np.zeros((len(vector), size, size))
        all_of[:, *np.tril_indices(size)] = vector
        return cls(np.einsum("cii->ci", all_of).copy(), np.tril(all_of, -1))

    @property
    def low(self) -> FloatArray:
        """Cholesky factors of R."""
        return self.factors()[2]

    @property
    def unit(self) -> FloatArray:
        """Inverse Cholesky factors of D R D."""
        return np.asarray(np.linalg.inv(self.low) * np.exp(-self.log_sd)[..., None, :])


@dataclass(frozen=True, slots=True, eq=False)
class ScalesDensity:
    """Density of scales given ``count`` normal deviations (c,) and their sums of squares (c, p, p)."""

    squares: FloatArray
    count: FloatArray
    prior: FloatArray  # mean and sd of ln D, shape of LKJ

    def __call__(self, at: Scales) -> tuple[FloatArray, Scales]:
        """Ln density, (c,), and its gradient."""
        p, (w, left, low) = at.z.shape[-1], at.factors()
        inverse: FloatArray = np.asarray(np.linalg.inv(low))
        unit = inverse * np.exp(-at.log_sd)[:, None, :]
        inner = unit @ self.squares @ transposed(unit)
        # Beta(b, b) of each w on (-1, 1), times d w / d arctanh w
        b, rest = self.prior[2] + 0.5 * (p - 2.0 - np.arange(p)), 1.0 - w**2
        away = (at.log_sd - self.prior[0]) / self.prior[1]
        ends = np.einsum("cii->ci", low)
        value = -self.count * (at.log_sd + np.log(ends)).sum(axis=1) - 0.5 * np.einsum("cii->c", inner)
        value = value + (np.log(rest) @ b).sum(axis=1) - 0.5 * (away**2).sum(axis=1)
        pull = transposed(inverse) @ inner
        along = np.tril(pull * low) - self.count[:, None, None] * np.eye(p)
        sums = np.cumsum(along, axis=2)
        slope = rest * left * pull - w * (sums[..., -1:] - sums + 2.0 * b)
        return value, Scales(sums[..., -1] - away / self.prior[1], np.tril(slope, -1))


class ScalesMove:
    """Hamiltonian moves of scales; steps follow acceptance as long as they are adapted."""

    def __init__(self, size: int, count: int, prior: FloatArray) -> None:
        """Moves of about what ``count`` specimens leave open."""
        i, j = np.tril_indices(size)
        known = np.where(i == j, 2.0 * count + prior[1] ** -2, count + 2.0 * prior[2] + size - 2.0 - j)
        #: (d, d), factor of the covariance of all numbers.
        self.root, self.log_step = np.diag(known**-0.5), -1.0

    def learn(self, vectors: FloatArray) -> None:
        """Take the covariance of numbers that chains showed, (m, d): forces that go together stay so."""
        seen = np.cov(vectors, rowvar=False).reshape(self.root.shape)
        self.root = factor((1.0 - RIDGE) * seen + RIDGE * np.diag(seen.diagonal() + 1e-12))

    def __call__(
        self, rng: np.random.Generator, scales: Scales, density: ScalesDensity, *, adapt: bool
    ) -> Scales:
        """Scales after one trajectory."""
        x, size, at = scales.vector, scales.log_sd.shape[1], scales
        # a chain in a corner, where all others' steps are too long, leaves it by short ones
        one = (len(x), 1)
        shorter = np.where(rng.random(one) < SHORT, np.exp(rng.uniform(SHORTEST, 0.0, one)), 1.0)
        step = np.exp(self.log_step) * rng.uniform(*JITTER, one) * shorter
        speed, (value, slope) = rng.standard_normal(x.shape), density(scales)
        begun = value - 0.5 * (speed**2).sum(axis=1)
        # a trajectory that runs away is no number, and is refused
        with np.errstate(all="ignore"):
            for _ in range(rng.integers(*TRAJECTORY)):
                speed = speed + 0.5 * step * (slope.vector @ self.root)
                x = x + step * (speed @ self.root.T)
                at = Scales.of(x, size)
                value, slope = density(at)
                speed = speed + 0.5 * step * (slope.vector @ self.root)
            ratio = value - 0.5 * (speed**2).sum(axis=1) - begun
        ratio[np.abs(at.z).max(axis=(1, 2)) > MOST_Z] = -np.inf
        moved = accepted(rng, ratio)
        if adapt:
            self.log_step += SCALES_ADAPTATION * (moved.mean() - WANTED_BY_SCALES)
        return Scales.of(np.where(moved[:, None], x, scales.vector), size)


#: Proposals of a sweep for a specimen among its draws: with the frozen weights, and among all draws alike.
WEIGHTED_TRIES = 2
PLAIN_TRIES = 1
#: Steps of a sweep for a specimen with a smooth likelihood, and tails of its independent proposal.
STEPS = 3
PROPOSAL_NU = 5.0
#: Best length of a step over that of the distribution (Roberts, Gelman & Gilks 1997, times root p).
STEP_LENGTH = 2.38
#: Joint moves of a sweep, the acceptance they are brought to while the chains settle, and the change of ln of
#: their length for an acceptance too much.
JOINT_MOVES = 4
WANTED_ACCEPTANCE = 0.3
ADAPTATION = 0.2
#: Lengths of steps of single numbers, in units of ln: one of them suits, however much is known.
LENGTHS = (1.0, 0.3, 0.1)
#: Ln of degrees of freedom: tails heavier than Cauchy's are no population, and 1e4 is a normal.
LOG_NU_RANGE = (0.0, float(np.log(1e4)))


@dataclass(frozen=True, slots=True, eq=False)
class Hyper:
    """Priors of the population: see :class:`tissueid.priors.PopulationPriors`."""

    coefficient_sd: FloatArray  # (q,)
    scale: FloatArray  # (3,), mean and sd of ln D, shape of LKJ
    level: FloatArray  # (2,), mean and sd of the ln SD of a level
    nu: FloatArray  # (2,), shape and rate of a gamma distribution
    heavy: bool  # false takes a normal instead of a t
    far: float  # squared distance beyond which a specimen is far from the population


@dataclass(slots=True, eq=False)
class State:
    """State of all chains, c of them."""

    phi: FloatArray  # (c, n, p), where each specimen is
    pick: IntArray  # (c, n), row of ``Cohort.phi`` of a specimen that is among its draws
    coefficient: FloatArray  # (c, q, p)
    effect: FloatArray  # (c, G, p), of the groups of all levels
    level_log_sd: FloatArray  # (c, L, p)
    scales: Scales
    log_nu: FloatArray  # (c,)
    weight: FloatArray  # (c, n), of the scale mixture


def squares(away: FloatArray, unit: FloatArray) -> FloatArray:
    """Squared distances (c, m) of deviations (c, m, p), in units of inverse Cholesky factors (c, p, p)."""
    return np.asarray(((away @ transposed(unit)) ** 2).sum(axis=2))


def _normal(rng: np.random.Generator, precision: FloatArray, pull: FloatArray) -> FloatArray:
    """Draws from normals of these precisions, and ``pull`` their products with the means."""
    root = np.asarray(np.linalg.inv(factor(precision)))
    z = root @ pull[..., None] + rng.standard_normal((*pull.shape, 1))
    return np.asarray((transposed(root) @ z)[..., 0])


def _walk(
    rng: np.random.Generator, value: FloatArray, log_density: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Numbers, each by itself, after steps of several lengths."""
    level = log_density(value)
    for length in LENGTHS:
        other = value + length * rng.standard_normal(value.shape)
        proposed = log_density(other)
        taken = accepted(rng, proposed - level)
        value, level = np.where(taken, other, value), np.where(taken, proposed, level)
    return value


class Chains:
    """Chains over one cohort; ``used`` (c, n) is false where a specimen tells a chain nothing."""

    def __init__(self, cohort: Cohort, hyper: Hyper, state: State, rng: np.random.Generator) -> None:
        (count, n, p), q = state.phi.shape, state.coefficient.shape[1]
        self.cohort, self.hyper, self.state, self.rng = cohort, hyper, state, rng
        self.used = np.ones((count, n), dtype=bool)
        self.moves = ScalesMove(p, n, hyper.scale)
        self.joint_root, self.log_joint = 0.1 * np.eye((q + 1) * p), 0.0

    @property
    def centre(self) -> FloatArray:
        """Centre of the population for each specimen, (c, n, p)."""
        state, cohort = self.state, self.cohort
        centre = cohort.design @ state.coefficient
        for group in cohort.group:
            centre = centre + state.effect[:, group]
        return np.asarray(centre)

    def sweep(self, *, adapt: bool) -> None:
        """Move everything once; ``adapt``: bring steps to their lengths."""
        unit, centre = self.state.scales.unit, self.centre
        if self.cohort.held.size:
            self._move_among_draws(unit, centre)
        if self.cohort.smooth.size:
            likelihood = self._move_smooth(unit, centre)
        self._draw_weights(unit, centre)
        if self.cohort.smooth.size:
            for _ in range(JOINT_MOVES):
                likelihood = self._move_together(likelihood, adapt=adapt)
            unit = self.state.scales.unit
        inverse = transposed(unit) @ unit
        for level in range(len(self.cohort.members)):
            self._draw_coefficients(inverse, level)
        away, weight = self.state.phi - self.centre, self.state.weight * self.used
        sums = transposed(away * weight[..., None]) @ away
        density = ScalesDensity(sums, self.used.sum(axis=1), self.hyper.scale)
        self.state.scales = self.moves(self.rng, self.state.scales, density, adapt=adapt)

    def branched(self, rows: IntArray, used: NDArray[np.bool_], rng: np.random.Generator) -> Chains:
        """Chains that begin where these are now, as many as rows."""
        state = self.state
        scales = Scales(state.scales.log_sd[rows], state.scales.z[rows])
        others = {one.name: getattr(state, one.name)[rows] for one in fields(state) if one.name != "scales"}
        other = copy(self)
        other.state, other.used, other.rng = State(scales=scales, **others), used, rng
        return other

    def aim(self) -> None:
        """Take the shape of joint moves from where the chains are."""
        if not self.cohort.smooth.size:
            return
        q, p = self.state.coefficient.shape[1:]
        # how smooth specimens go with mean and effects, and with a stretch about their centre
        away = (self.state.phi - self.centre)[:, self.cohort.smooth, None]
        given = np.broadcast_to(self.cohort.design[self.cohort.smooth, :, None], (*away.shape[:2], q, p))
        along = np.concatenate([given, away], axis=2)
        seen = np.einsum("skl,csek,csfl->ekfl", self.cohort.likelihoods.precision, along, along) / len(away)
        prior = np.repeat([*self.hyper.coefficient_sd, self.hyper.scale[1]], p) ** -2.0
        root = factor(seen.reshape(prior.size, -1) + np.diag(prior))
        self.joint_root = np.asarray(np.linalg.inv(root)).T

    def _move_among_draws(self, unit: FloatArray, centre: FloatArray) -> None:
        """Propose other stage-1 draws to the specimens among theirs, weights of the mixture integrated."""
        cohort, rng, held = self.cohort, self.rng, self.cohort.held
        first, size, mean = cohort.start[held], np.diff(cohort.start)[held], centre[:, held]
        nu, p = np.exp(self.state.log_nu)[:, None], mean.shape[2]

        def population(row: IntArray) -> FloatArray:
            square = squares(cohort.phi[row] - mean, unit)
            if not self.hyper.heavy:
                return np.asarray(-0.5 * square)
            return np.asarray(-0.5 * (nu + p) * np.log1p(square / nu))

        now = self.state.pick[:, held]
        value = population(now)
        for attempt in range(WEIGHTED_TRIES + PLAIN_TRIES):
            where = rng.random(now.shape)
            if attempt < WEIGHTED_TRIES:
                known, other = cohort.log_pilot, np.searchsorted(cohort.cumulative, held + where)
            else:
                known, other = cohort.log_reference, first + (where * size).astype(np.int64)
            other = np.clip(other, first, first + size - 1)
            proposed = population(other)
            taken = accepted(rng, proposed - value - (known[other] - known[now]))
            now, value = np.where(taken, other, now), np.where(taken, proposed, value)
        self.state.pick[:, held] = now
        self.state.phi[:, held] = cohort.phi[now]

    def _move_smooth(self, unit: FloatArray, centre: FloatArray) -> FloatArray:
        """Move the specimens with a smooth likelihood, given their weights in the mixture; its ln, (c, s)."""
        cohort, rng, smooth = self.cohort, self.rng, self.cohort.smooth
        now, mean = self.state.phi[:, smooth], centre[:, smooth]
        weight, p = self.state.weight[:, smooth], mean.shape[2]
        inverse = weight[..., None, None] * (transposed(unit) @ unit)[:, None]
        low, shape = factor(inverse + cohort.likelihoods.precision), cohort.likelihoods
        root = transposed(np.asarray(np.linalg.inv(low)))
        pull = inverse @ mean[..., None] + shape.precision @ shape.likely[..., None]
        best = (root @ (transposed(root) @ pull))[..., 0]

        def population(phi: FloatArray) -> FloatArray:
            return -0.5 * weight * squares(phi - mean, unit)

        def tails(phi: FloatArray) -> FloatArray:
            square = ((transposed(low) @ (phi - best)[..., None])[..., 0] ** 2).sum(axis=2)
            return np.asarray(0.5 * (PROPOSAL_NU + p) * np.log1p(square / PROPOSAL_NU))

        likelihood, value = cohort.likelihoods.log_density(now), population(now)
        for attempt in range(1 + STEPS):
            step = (root @ rng.standard_normal((*now.shape, 1)))[..., 0]
            if attempt == 0:
                tail = rng.standard_gamma(0.5 * PROPOSAL_NU, (*weight.shape, 1)) / (0.5 * PROPOSAL_NU)
                other = best + step / np.sqrt(tail)
                ratio = tails(other) - tails(now)
            else:
                other, ratio = now + STEP_LENGTH / np.sqrt(p) * step, np.zeros(weight.shape)
            seen, proposed = cohort.likelihoods.log_density(other), population(other)
            taken = accepted(rng, ratio + (seen - likelihood) + (proposed - value))
            now = np.where(taken[..., None], other, now)
            likelihood, value = np.where(taken, seen, likelihood), np.where(taken, proposed, value)
        self.state.phi[:, smooth] = now
        return likelihood

    def _move_together(self, likelihood: FloatArray, *, adapt: bool) -> FloatArray:
        """Try to shift mean and effects and stretch spreads, and smooth specimens; ln of their likelihood.

        Of a smooth specimen the density in the population stays.
        """
        cohort, state, scales, rng = self.cohort, self.state, self.state.scales, self.rng
        (count, q, p), prior, size = state.coefficient.shape, self.hyper.scale, len(self.joint_root)
        length = STEP_LENGTH / np.sqrt(size) * np.exp(self.log_joint)
        change = (length * rng.standard_normal((count, size)) @ self.joint_root.T).reshape(count, q + 1, p)
        shift, coefficient = cohort.design @ change[:, :q], state.coefficient + change[:, :q]
        stretch, away = change[:, q], state.phi - self.centre
        log_sd, moved = scales.log_sd + stretch, state.phi + shift + np.expm1(stretch)[:, None] * away
        smooth, held, used = cohort.smooth, cohort.held, self.used
        ratio = 0.5 * (state.coefficient**2 - coefficient**2).sum(axis=2) @ self.hyper.coefficient_sd**-2.0
        for value, sign in ((log_sd, -0.5), (scales.log_sd, 0.5)):
            ratio = ratio + sign * (((value - prior[0]) / prior[1]) ** 2).sum(axis=1)
        seen = cohort.likelihoods.log_density(moved[:, smooth])
        ratio = ratio + np.where(used[:, smooth], seen - likelihood, 0.0).sum(axis=1)
        if held.size:
            left = (away - shift)[:, held] * np.exp(-stretch)[:, None]
            nearer = squares(away[:, held], scales.unit) - squares(left, scales.unit)
            each = 0.5 * state.weight[:, held] * nearer - stretch.sum(axis=1)[:, None]
            ratio = ratio + (used[:, held] * each).sum(axis=1)
        taken = accepted(rng, ratio)
        if adapt:
            self.log_joint += ADAPTATION * (taken.mean() - WANTED_ACCEPTANCE)
        state.coefficient = np.where(taken[:, None, None], coefficient, state.coefficient)
        state.scales = Scales(np.where(taken[:, None], log_sd, scales.log_sd), scales.z)
        along = taken[:, None] & used[:, smooth]
        state.phi[:, smooth] = np.where(along[..., None], moved[:, smooth], state.phi[:, smooth])
        return np.where(along, seen, likelihood)

    def _draw_weights(self, unit: FloatArray, centre: FloatArray) -> None:
        """Degrees of freedom with the weights integrated, then the weights."""
        if not self.hyper.heavy:
            return
        state, p, (shape, rate) = self.state, centre.shape[2], self.hyper.nu
        square = squares(state.phi - centre, unit)

        def density(log_nu: FloatArray) -> FloatArray:
            nu = np.exp(np.clip(log_nu, *LOG_NU_RANGE))
            half = 0.5 * (nu + p)
            each = (gammaln(half) - gammaln(0.5 * nu) - 0.5 * p * log_nu)[:, None]
            each = each - half[:, None] * np.log1p(square / nu[:, None])
            value = (self.used * each).sum(axis=1) + shape * log_nu - rate * nu
            inside = (log_nu >= LOG_NU_RANGE[0]) & (log_nu <= LOG_NU_RANGE[1])
            return np.where(inside, value, -np.inf)

        state.log_nu = _walk(self.rng, state.log_nu, density)
        half = 0.5 * np.exp(state.log_nu)[:, None]
        drawn = self.rng.standard_gamma(half + 0.5 * p, square.shape) / (half + 0.5 * square)
        # a weight that is zero by rounding would never come back
        state.weight = np.maximum(drawn, 1e-12)

    def _draw_coefficients(self, inverse: FloatArray, level: int) -> None:
        """Draw mean and effects of covariates, those of the groups of a level integrated, then these.

        A covariate that is the same in each group is told from their effects by both together alone.
        """
        state, cohort, design = self.state, self.cohort, self.cohort.design
        (chains, q, p), weight = state.coefficient.shape, (state.weight * self.used)[..., None]
        rest = state.phi - self.centre + design @ state.coefficient
        own, member = np.flatnonzero(cohort.level_of == level), cohort.members[level]
        if own.size:
            rest = rest + state.effect[:, cohort.group[level]]
        sums = (
            np.concatenate([weight * design, weight * rest], axis=2).swapaxes(0, 1).reshape(len(design), -1)
        )
        x, y = np.split((member @ sums).reshape(-1, chains, q + p).swapaxes(0, 1), [q], axis=2)
        # the first column of a design is of ones
        prior = np.exp(-2.0 * state.level_log_sd[:, level : level + 1])[..., None] * np.eye(p)
        within = x[:, :, 0, None, None] * inverse[:, None] + prior[:, : own.size]
        lost = inverse[:, None] @ np.linalg.inv(within) @ inverse[:, None]
        outer = (x[..., None] * x[:, :, None]).reshape(chains, -1, q * q)
        between = transposed(outer) @ lost.reshape(chains, -1, p * p)
        gram = transposed(weight * design) @ design
        precision = gram.reshape(chains, -1, 1) * inverse.reshape(chains, 1, -1) - between
        precision = precision.reshape(chains, q, q, p, p).swapaxes(2, 3).reshape(chains, q * p, q * p)
        precision = precision + np.diag(np.repeat(self.hyper.coefficient_sd**-2.0, p))
        pull = transposed(weight * design) @ rest @ inverse - transposed(x) @ (lost @ y[..., None])[..., 0]
        drawn = _normal(self.rng, precision, pull.reshape(chains, q * p)).reshape(chains, q, p)
        state.coefficient = drawn
        if own.size:
            state.effect[:, own] = _normal(self.rng, within, (y - x @ drawn) @ inverse)
            self._draw_level(own, level)

    def _draw_level(self, own: IntArray, level: int) -> None:
        """Draw how far the groups of a level spread."""
        square, (mean, sd) = (self.state.effect[:, own] ** 2).sum(axis=1), self.hyper.level

        def density(log_sd: FloatArray) -> FloatArray:
            likelihood = -own.size * log_sd - 0.5 * square * np.exp(-2.0 * log_sd)
            return np.asarray(likelihood - 0.5 * ((log_sd - mean) / sd) ** 2)

        spread = self.state.level_log_sd
        spread[:, level] = _walk(self.rng, spread[:, level], density)
