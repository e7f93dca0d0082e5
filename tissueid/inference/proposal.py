"""Independent proposals: the normal at the optimum, cut to the passive set, and a mixture that learns.

Hit-and-run in the polytope (doi 10.1287/opre.32.6.1296); adaptive multiple importance sampling by Student's t
(doi 10.1111/j.1467-9469.2011.00756.x), weights tempered while few draws would carry them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import linprog
from scipy.special import gammaln, logsumexp, ndtr, ndtri

from tissueid.arrays import FloatArray, IntArray
from tissueid.inference.target import Target

#: Chains, steps of each for every coordinate, and width over that of the normal approximation.
CHAINS, STEPS_EACH, WIDER = 1000, 40, 1.06
#: Shares of the steps that change one slack of a likely constraint, and none.
ONE_SLACK, NO_SLACK = 0.6, 0.2
#: Half width of the box in which a start is sought; least share within walls that is drawn by rejection.
REACH, LEAST_LEFT = 2.0, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class CutNormal:
    """A normal in whitened coordinates, cut by half spaces."""

    centre: FloatArray  # (d,)
    width: float
    rows: FloatArray  # (c, d): half spaces ``rows @ z >= least``
    least: FloatArray  # (c,)
    left: float = 0.0  # share of the normal that the half spaces leave
    pool: FloatArray = field(default_factory=lambda: np.empty(0))  # (n, d), draws

    def whole(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws of the normal that is not cut, shape (count, d)."""
        return self.centre + self.width * rng.standard_normal((count, self.centre.size))

    def inside(self, z: FloatArray) -> FloatArray:
        """Those of some points that the half spaces leave, (n, d) -> (k, d)."""
        return z[(z @ self.rows.T >= self.least).all(axis=1)]

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws by rejection, shape (count, d)."""
        parts, known = [], 0
        while known < count:
            parts.append(self.inside(self.whole(2 * (count - known), rng)))
            known += len(parts[-1])
        return np.concatenate(parts)[:count]

    def log_density(self, z: FloatArray) -> FloatArray:
        """Up to a constant, within the polytope; (n, d) -> (n,)."""
        return np.asarray(-0.5 * ((z - self.centre) ** 2).sum(axis=-1) / self.width**2)


def _truncated(mean: FloatArray, sd: float, low: FloatArray, high: FloatArray, u: FloatArray) -> FloatArray:
    """Normal draws between bounds, by the tail that is nearer."""
    a, b = (low - mean) / sd, (high - mean) / sd
    flip = a > 0.0
    a, b = np.where(flip, -b, a), np.where(flip, -a, b)
    p, q = ndtr(a), ndtr(b)
    z = ndtri(np.clip(p + u * (q - p), 1e-300, 1.0 - 1e-16))
    far = q < 1e-290
    if far.any():
        # beyond this the normal's tail is exponential
        rate = np.maximum(-b[far], 1.0)
        z[far] = b[far] + np.log1p(-u[far] * -np.expm1(np.maximum(rate * (a[far] - b[far]), -700.0))) / rate
    z = np.clip(z, a, b)
    return np.asarray(mean + sd * np.where(flip, -z, z))


def _inside(rows: FloatArray, least: FloatArray) -> FloatArray:
    """Point of the polytope far from its walls, near zero."""
    c, d = rows.shape
    found = linprog(
        np.append(np.zeros(d), -1.0),
        A_ub=np.hstack([-rows, np.ones((c, 1))]),
        b_ub=-least,
        bounds=[(-REACH, REACH)] * d + [(0.0, 1.0)],
        method="highs",
    )
    return np.asarray(found.x[:d]) if found.x is not None else np.zeros(d)


def _directions(key: FloatArray, d: int, steps: int, rng: np.random.Generator) -> FloatArray:
    """Unit directions of the walk: one slack of ``key`` (k, d) at a time, none of them, or at random."""
    out = rng.standard_normal((steps, d))
    if len(key):
        dual = np.linalg.pinv(key, rcond=1e-10)
        kind = rng.random(steps)
        one = kind < ONE_SLACK
        out[one] = dual.T[rng.integers(len(key), size=int(one.sum()))]
        free = (kind >= ONE_SLACK) & (kind < ONE_SLACK + NO_SLACK)
        out[free] -= out[free] @ key.T @ dual.T
    size = np.linalg.norm(out, axis=1, keepdims=True)
    return np.asarray(out / np.maximum(size, 1e-300))


def cut_normal(
    centre: FloatArray, rows: FloatArray, least: FloatArray, likely: IntArray, rng: np.random.Generator
) -> CutNormal:
    """Draw from a normal of width :data:`WIDER` with ``rows @ z >= least``; ``likely``: may be active."""
    d = centre.size
    size = np.linalg.norm(rows, axis=1)
    likely = likely[size[likely] > 0.0]
    key = rows[likely] / size[likely, None]
    kept = size > 0.0
    rows, least = rows[kept] / size[kept, None], np.minimum(least[kept] / size[kept], -1e-9)
    cut = CutNormal(centre, WIDER, rows, least)
    inside = cut.inside(cut.whole(CHAINS, rng))
    if len(inside) >= LEAST_LEFT * CHAINS:
        return replace(cut, left=len(inside) / CHAINS, pool=cut.draw(CHAINS, rng))
    z = np.repeat(_inside(rows, least)[None], CHAINS, axis=0)
    slack = z @ rows.T - least
    for direction in _directions(key, d, STEPS_EACH * d, rng):
        along = rows @ direction
        up, down = along > 1e-12, along < -1e-12
        low = (-slack[:, up] / along[up]).max(axis=1, initial=-np.inf)
        high = (slack[:, down] / -along[down]).min(axis=1, initial=np.inf)
        mean = (centre - z) @ direction
        move = _truncated(mean, WIDER, np.minimum(low, 0.0), np.maximum(high, 0.0), rng.random(CHAINS))
        z += move[:, None] * direction
        slack += move[:, None] * along
    return replace(cut, pool=z)


#: Components at the most; degrees of freedom with the width over the spread of draws, the widest first.
COMPONENTS = 6
TAILS = ((5.0, 1.25), (12.0, 1.1), (40.0, 1.04))
#: Share of draws that keep the widest tails.
WIDE_SHARE = 0.15
#: Draws of a round, rounds at the most, the share of them that makes the mixture good enough, and that from
#: which rounds that gain nothing end it.
ROUND, ROUNDS, GOOD, FAIR = 400, 24, 0.6, 0.35
#: Effective draws that a fit of the mixture needs, for each coordinate, and steps of that fit.
EACH, EM_STEPS = 8.0, 12
#: Rounds without a better one after which no more is hoped for, of a poor mixture and of a fair one.
SETTLED, SETTLED_FAIR = 8, 3
#: Power of weights by which tails are chosen.
STUCK = 1.5
#: Rounds of proposals that the weights remember.
REMEMBERED = 6
#: Effective draws of a component, for each number of its mean and scale.
PER_NUMBER = 3
#: Share of a draw's spread that every component has at least.
RIDGE = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Mixture:
    """Student's t components."""

    weights: FloatArray  # (c,)
    means: FloatArray  # (c, d)
    roots: FloatArray  # (c, d, d), of the scale matrices
    tails: FloatArray  # (c,), degrees of freedom

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draws, shape (count, d)."""
        which = rng.choice(len(self.weights), size=count, p=self.weights)
        normal = rng.standard_normal((count, self.means.shape[1]))
        nu = self.tails[which]
        normal /= np.sqrt(rng.chisquare(nu) / nu)[:, None]
        return np.asarray(self.means[which] + np.einsum("nij,nj->ni", self.roots[which], normal))

    def distances(self, z: FloatArray) -> FloatArray:
        """Squared distances from the means, in units of the roots, (n, d) -> (c, n)."""
        return np.stack(
            [_squared(root, mean, z.T) for mean, root in zip(self.means, self.roots, strict=True)]
        )

    def log_density(self, z: FloatArray) -> FloatArray:
        """Normalised, (n, d) -> (n,)."""
        return self.log_density_at(self.distances(z))

    def log_density_at(self, distances: FloatArray) -> FloatArray:
        """Normalised, from squared distances, (c, n) -> (n,)."""
        d, nu = self.means.shape[1], self.tails
        norms = gammaln(0.5 * (nu + d)) - gammaln(0.5 * nu) - 0.5 * d * np.log(nu * np.pi)
        norms -= np.log(np.abs(np.diagonal(self.roots, axis1=1, axis2=2))).sum(axis=1)
        parts = norms[:, None] - (0.5 * (nu + d))[:, None] * np.log1p(distances / nu[:, None])
        with np.errstate(divide="ignore"):
            return np.asarray(logsumexp(parts + np.log(self.weights)[:, None], axis=0))


def _squared(root: FloatArray, mean: FloatArray, columns: FloatArray) -> FloatArray:
    """Squared lengths of columns from a mean in units of a root, (d, n) -> (n,)."""
    y = np.linalg.inv(root) @ (columns - mean[:, None])
    return np.asarray(np.einsum("ij,ij->j", y, y))


def _normalised(log_weight: FloatArray) -> tuple[FloatArray, float]:
    """Weights that add to one, and the draws they are worth."""
    top = log_weight.max()
    weight = np.exp(log_weight - top) if np.isfinite(top) else np.zeros(log_weight.size)
    total = weight.sum()
    if total <= 0.0:
        return weight, 0.0
    weight /= total
    return weight, float(1.0 / (weight**2).sum())


def tempered(log_weight: FloatArray, least: float) -> FloatArray:
    """Weights, raised to a power under one where they would be worth fewer than ``least`` draws."""
    weight, worth = _normalised(log_weight)
    if worth >= least:
        return weight
    low, high = 0.0, 1.0
    finite = np.where(np.isfinite(log_weight), log_weight, -np.inf)
    for _ in range(30):
        middle = 0.5 * (low + high)
        with np.errstate(invalid="ignore"):
            weight, worth = _normalised(np.where(np.isfinite(finite), middle * finite, -np.inf))
        low, high = (middle, high) if worth >= least else (low, middle)
    return weight


def _fitted(z: FloatArray, weight: FloatArray, rng: np.random.Generator) -> Mixture:
    """Components of weighted draws, by expectation maximisation from well separated means."""
    count, d = z.shape
    mean = weight @ z
    centred = z - mean
    whole = (centred * weight[:, None]).T @ centred + 1e-12 * np.eye(d)
    root = np.linalg.cholesky(whole)
    y = centred @ np.linalg.inv(root).T
    # as many as the draws they are worth can tell of: more would follow these draws, and not the density
    numbers = d * (d + 3) // 2
    components = int(np.clip(1.0 / (weight**2).sum() // (PER_NUMBER * numbers), 1, COMPONENTS))
    means = y[rng.choice(count, size=components, p=weight)]
    covs = np.repeat(np.eye(d)[None], components, axis=0)
    shares = np.full(components, 1.0 / components)
    for _ in range(EM_STEPS if components > 1 else 1):
        parts = np.empty((components, count))
        for k in range(components):
            factor = np.linalg.cholesky(covs[k])
            parts[k] = np.log(max(shares[k], 1e-300)) - np.log(np.diag(factor)).sum()
            parts[k] -= 0.5 * _squared(factor, means[k], y.T)
        belongs = np.exp(parts - logsumexp(parts, axis=0)) * weight
        shares = np.maximum(belongs.sum(axis=1), 1e-12)
        for k in range(components):
            means[k] = belongs[k] @ y / shares[k]
            off = y - means[k]
            own = (off * belongs[k][:, None]).T @ off / shares[k]
            few = min(1.0, shares[k] * float(1.0 / (weight**2).sum()) / (3.0 * d))
            covs[k] = few * own + (1.0 - few) * np.eye(d) * min(1.0, np.trace(own) / d) + RIDGE * np.eye(d)
        shares = shares / shares.sum()
    roots = np.stack([root @ np.linalg.cholesky(cov) for cov in covs])
    (tails, wider), *_ = TAILS
    return Mixture(shares, mean + means @ root.T, wider * roots, np.full(components, tails))


def _guarded(mixture: Mixture, tails: float, wider: float) -> Mixture:
    """Thin tails beside a share with the widest: a defensive mixture (doi 10.1080/00401706.1995.10484303)."""
    return Mixture(
        np.concatenate([(1.0 - WIDE_SHARE) * mixture.weights, WIDE_SHARE * mixture.weights]),
        np.concatenate([mixture.means, mixture.means]),
        np.concatenate([mixture.roots * (wider / TAILS[0][1]), mixture.roots]),
        np.concatenate([np.full(mixture.tails.size, tails), mixture.tails]),
    )


def _best_tails(mixture: Mixture, z: FloatArray, weight: FloatArray, levels: FloatArray) -> Mixture:
    """The mixture with the tails that suit weighted draws: the mean of a power of p / q under p is least."""
    used = weight > 0.0
    distances = mixture.distances(z[used])
    tried = [(mixture, distances)]
    for nu, wider in TAILS[1:]:
        thinner = distances * (TAILS[0][1] / wider) ** 2
        tried.append((_guarded(mixture, nu, wider), np.concatenate([thinner, distances])))

    def spread(one: tuple[Mixture, FloatArray]) -> float:
        apart = levels[used] - one[0].log_density_at(one[1])
        return float(logsumexp(STUCK * apart, b=weight[used]))

    return min(tried, key=spread)[0]


def _share(levels: FloatArray, log_density: FloatArray, proposed: FloatArray) -> float:
    """Share that draws of a density would be worth, by all points there are: (E_q w)^2 / E_q w^2."""
    apart = levels - proposed
    if not np.isfinite(total := logsumexp(apart)):
        return 0.0
    return float(np.exp(2.0 * total - np.log(levels.size) - logsumexp(apart + levels - log_density)))


def learn_mixture(target: Target, cut: CutNormal, rng: np.random.Generator) -> tuple[Mixture, float]:
    """Learn a density from the cut normal; the mixture, and the share that its draws are worth."""
    least = EACH * target.size
    first = target.bent(cut.pool[: 2 * ROUND])
    mixture = _fitted(first, np.full(len(first), 1.0 / len(first)), rng)
    z, levels = np.empty((0, target.size)), np.empty(0)
    used: list[tuple[Mixture, FloatArray]] = []
    fresh, found = list[float](), list[tuple[float, Mixture]]()
    for _ in range(ROUNDS):
        new = mixture.draw(ROUND, rng)
        value = target.densities(new)
        used = [(one, np.append(known, one.log_density(new))) for one, known in used]
        used = [*used, (mixture, mixture.log_density(np.vstack([z, new])))][-REMEMBERED:]
        fresh.append(_normalised(value - used[-1][1][-ROUND:])[1] / ROUND)
        z, levels = np.vstack([z, new]), np.append(levels, value)
        proposed = logsumexp([known for _, known in used], axis=0) - np.log(len(used))
        # a density that misses a part looks good until another has found that
        shares = [_share(levels, known, proposed) for _, known in used]
        now = zip(map(min, fresh[-len(used) :], shares), [one for one, _ in used], strict=True)
        found = [*found[: len(fresh) - len(used)], *now]
        recent, best = [one[0] for one in found], max(found, key=lambda one: one[0])
        settled = SETTLED_FAIR if best[0] >= FAIR else SETTLED
        # tails are known by the second time
        if min([0.0, *recent][-2:]) >= GOOD or max(recent[-settled:]) <= max(recent[:-settled], default=-1.0):
            break
        weight = tempered(levels - proposed, least)
        if not weight.any():
            break
        mixture = _best_tails(_fitted(z, weight, rng), z, weight, levels)
    return best[1], best[0]
