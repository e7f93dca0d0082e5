"""The posterior of one specimen over its relaxation times and scales: density, mode, exact redraw.

Built at the joint optimum of the fit (:mod:`tissueid.likelihood.linearise`).  The sampled coordinates are
ln tau of each branch (ascending), ln sigma, arctanh phi where the noise is correlated, and the ln of the
gains' standard deviation where logs are pooled partially.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from tissueid.likelihood.basis import KernelBasis
from tissueid.likelihood.lag_sums import LagSums
from tissueid.likelihood.linearise import Columns, Optimum, TauNodes, linear_columns, tau_nodes
from tissueid.likelihood.marginal import Linearised, conditionals, draw_effects, log_marginals
from tissueid.likelihood.passive_normal import draw_passive, log_passive_mass, passive
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt
from tissueid.posterior.target import Redrawn
from tissueid.priors import WEAK_FACTOR, Priors

__all__ = ["Facts", "SpecimenTarget", "specimen_target"]

FloatArray = NDArray[np.float64]

#: Half width of the first range of ln tau around the optimum, in standard errors, and its limits.
RANGE_SD = 9.0
NARROWEST, WIDEST = 0.15, 20.0
#: Fall of the log density at the ends of a range that is wide enough.
DEEP = 30.0
#: ln of the range of noise that is possible where nothing is stated: twelve decades.
LOG_SIGMA_RANGE = 12.0 * math.log(10.0)
#: Standard deviation of a free static coefficient of a log, in forces.
FREE_FACTOR = 10.0
#: Rise of -log density at which a coordinate's scale is read off, and steps of the Hessian in that scale.
PROBE = 0.5
ARCTANH_LIMIT = 12.0
#: Smallest curvature along a ridge, relative to that of its coordinates: noise and phi near 1 have 1e-3.
LEAST_CURVATURE = 2e-3
#: A spread of the gains below this is none; far below, its square is lost to rounding.
LEAST_LN_GAIN_SD = math.log(1e-9)


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


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenTarget:
    """See :class:`tissueid.posterior.target.Target`.

    Attributes
    ----------
    data : Linearised
    optimum : Optimum
    model : KelvinVoigt
    priors : Priors
    facts : Facts
    effects : tuple of str
        Of every log.
    """

    data: Linearised
    optimum: Optimum
    model: KelvinVoigt
    priors: Priors
    facts: Facts
    effects: tuple[str, ...]
    mode: FloatArray = field(default_factory=lambda: np.zeros(0))
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def names(self) -> tuple[str, ...]:
        """Sampled coordinates."""
        names = [f"ln_tau_{j + 1}" for j in range(self.data.branches)]
        names.append("ln_sigma")
        if self.data.has_phi:
            names.append("arctanh_phi")
        if self.data.has_gain:
            names.append("ln_gain_sd")
        return tuple(names)

    def log_prior(self, points: FloatArray) -> FloatArray:
        """Ln of the prior density of the sampled coordinates; -inf outside their range."""
        branches = self.data.branches
        low, high = self.facts.log_tau_bounds
        tau = points[:, :branches]
        nodes = self.data.nodes
        value = np.zeros(points.shape[0])
        inside = np.isfinite(points).all(axis=1) & (np.diff(tau, axis=1) > 0.0).all(axis=1)
        for j in range(branches):
            reach = _reach(nodes[j])
            inside &= (tau[:, j] >= max(low, reach[0])) & (tau[:, j] <= min(high, reach[1]))
            if j < len(self.priors.relaxation_time_s):
                stated = self.priors.relaxation_time_s[j]
                value += _log_normal(tau[:, j], math.log(stated.median), stated.sd_ln)
            else:
                value -= math.log(high - low)
        sigma = points[:, branches]
        if self.priors.sigma_N is None:
            value -= LOG_SIGMA_RANGE
        else:
            value += _log_normal(sigma, math.log(self.priors.sigma_N.median), self.priors.sigma_N.sd_ln)
        at = branches + 1
        if self.data.has_phi:
            first, last = self.priors.phi
            a = points[:, at]
            inside &= (a >= math.atanh(first)) & (a <= (math.atanh(last) if last < 1.0 else ARCTANH_LIMIT))
            # d phi / d a = 1 / cosh(a)^2
            value += -2.0 * np.log(np.cosh(np.clip(a, -ARCTANH_LIMIT, ARCTANH_LIMIT))) - math.log(
                last - first
            )
            at += 1
        if self.data.has_gain:
            inside &= points[:, at] >= LEAST_LN_GAIN_SD
            spread = np.exp(np.clip(points[:, at], -60.0, 60.0)) / self.priors.gain_sd
            value += points[:, at] + 0.5 * math.log(2.0 / math.pi) - math.log(self.priors.gain_sd)
            value -= 0.5 * spread**2
        return np.where(inside, value, -np.inf)

    def log_density(self, points: FloatArray) -> FloatArray:
        """Log posterior density, all constants kept; -inf outside."""
        points = np.ascontiguousarray(np.atleast_2d(points), dtype=np.float64)
        out = self.log_prior(points)
        inside = np.isfinite(out)
        if inside.any():
            out[inside] += log_marginals(self.data, points[inside])
        return out

    def redraw(self, points: FloatArray, rng: np.random.Generator) -> Redrawn:
        """Draw theta and the effects of every log for points of shape (n, d)."""
        data = self.data
        points = np.ascontiguousarray(points, dtype=np.float64)
        n, (logs, q) = points.shape[0], data.effect_mean.shape
        theta, acceptance = draw_passive(*conditionals(data, points), data.blocks, rng)
        effects = draw_effects(data, points, theta, rng.standard_normal((n, logs, q)))
        gain = np.ones((n, logs))
        offset = np.zeros((n, logs))
        if "gain" in self.effects:
            # a change of all gains together is a change of theta: exactly, and not to first order
            common = effects[:, :, 0].mean(axis=1)
            exact = (theta + common[:, None] * self.optimum.theta) * np.exp(-common)[:, None]
            # at a bound the first order stands: it is passive, and differs by the square of the change
            theta = np.where(passive(exact, data.blocks)[:, None], exact, theta)
            gain = np.exp(self.optimum.gamma + effects[:, :, 0])
        if "offset" in self.effects:
            offset = effects[:, :, q - 1]
        at = data.branches
        phi = np.tanh(points[:, at + 1]) if data.has_phi else np.full(n, data.phi)
        return Redrawn(
            theta=self.in_field_units(theta, points[:, : data.branches]),
            gain=gain,
            offset_mm=offset,
            sigma_N=np.exp(points[:, at]),
            phi=phi,
            acceptance=acceptance,
        )

    def in_field_units(self, theta: FloatArray, log_tau: FloatArray) -> FloatArray:
        """Coefficients by powers of u and ln tau -> theta of the contact model, shape (n, p)."""
        scale, size, static = self.optimum.scale, self.optimum.degree + 1, self.optimum.static
        n = theta.shape[0]
        out = np.zeros((n, STATIC_DEGREE + self.optimum.branches * self.model.block))
        if static:
            out[:, :STATIC_DEGREE] = theta[:, :STATIC_DEGREE] * scale ** -np.arange(1.0, STATIC_DEGREE + 1)
        for j in range(self.optimum.branches):
            first = STATIC_DEGREE + j * self.model.block
            block = theta[:, static + j * size : static + (j + 1) * size]
            out[:, first : first + size] = block * scale ** -np.arange(float(size))
            out[:, first + size] = np.exp(log_tau[:, j])
        return out


def _reach(nodes: FloatArray) -> tuple[float, float]:
    """The range that Chebyshev nodes were made for."""
    edge = math.cos(math.pi / (2.0 * nodes.size))
    middle, half = 0.5 * (nodes[0] + nodes[-1]), 0.5 * (nodes[-1] - nodes[0]) / edge
    return middle - half, middle + half


def _log_normal(x: FloatArray, mean: float, sd: float) -> FloatArray:
    return np.asarray(-0.5 * ((x - mean) / sd) ** 2 - math.log(sd) - 0.5 * math.log(2.0 * math.pi))


def specimen_target(
    logs: Sequence[LagSums],
    basis: KernelBasis,
    optimum: Optimum,
    *,
    centred: Optimum,
    facts: Facts,
    priors: Priors,
    pooling: str,
    correlated: bool,
    start: FloatArray,
    start_sd: FloatArray,
) -> SpecimenTarget:
    """The posterior of a specimen, its mode found and its range of ln tau wide enough.

    Parameters
    ----------
    logs : sequence of LagSums
    basis : KernelBasis
    optimum : Optimum
        Where the specimen is linearised.
    centred : Optimum
        Whose residuals stand in the sums.
    facts : Facts
    priors : Priors
    pooling : str
        ``partial``, ``shared`` or ``per-log``.
    correlated : bool
        Sample phi.
    start, start_sd : ndarray, shape (d,)
        First guess of the coordinates and of their standard deviations.
    """
    low, high = facts.log_tau_bounds
    effects = _effects(pooling, facts)
    half = np.clip(RANGE_SD * start_sd[: optimum.branches], NARROWEST, WIDEST)
    while True:
        ends = np.array(
            [
                (max(low, tau - width), min(high, tau + width))
                for tau, width in zip(optimum.log_tau, half, strict=True)
            ]
        ).reshape(-1, 2)
        nodes = _nodes(ends, facts)
        few = _table([one.log_tau for one in nodes])
        columns = linear_columns(logs, basis, optimum, few, effects, centred=centred)
        built = _built(columns, nodes, optimum, facts, priors, effects, correlated=correlated)
        target = _with_mode(built, start, start_sd)
        short = _too_short(target, ends)
        if not short.any():
            return target
        half[short] *= 2.0


def _effects(pooling: str, facts: Facts) -> tuple[str, ...]:
    if pooling == "per-log":
        return ("static",)
    offset = ("offset",) if (facts.offset_sd_mm > 0.0).all() else ()
    return ("gain", *offset) if pooling == "partial" else offset


def _nodes(ends: FloatArray, facts: Facts) -> list[TauNodes]:
    """Nodes of ln tau for every branch, as many in each."""
    step, longest = math.exp(facts.log_tau_bounds[0]), math.exp(facts.log_tau_bounds[1])
    time = np.concatenate([[0.0], np.geomspace(step, longest, 120)])
    found = [tau_nodes(first, last, time) for first, last in ends]
    shape = max((one.mixing.shape[1] for one in found), default=0)
    found = [tau_nodes(first, last, time, shape=(0, shape)) for first, last in ends]
    most = max((one.log_tau.size for one in found), default=0)
    return [tau_nodes(first, last, time, shape=(most, shape)) for first, last in ends]


def _table(rows: list[FloatArray]) -> FloatArray:
    """One row a branch; without a branch there is none."""
    return np.ascontiguousarray(np.stack(rows)) if rows else np.zeros((0, 0))


def _stacked(nodes: Sequence[TauNodes]) -> FloatArray:
    """Mixing matrices of all branches, shape (branches, r, q)."""
    if not nodes:
        return np.zeros((0, 0, 0))
    return np.ascontiguousarray(np.stack([one.mixing for one in nodes]))


def _built(
    columns: Columns,
    nodes: Sequence[TauNodes],
    optimum: Optimum,
    facts: Facts,
    priors: Priors,
    effects: tuple[str, ...],
    *,
    correlated: bool,
) -> SpecimenTarget:
    """The target in given columns, its mode not yet found."""
    branches = optimum.branches
    model = KelvinVoigt(branches=branches, stiffness_degree=optimum.degree, depth_mm=optimum.scale)
    mean, precision, weak = linear_prior(priors, model, optimum, facts)
    blocks = np.array(
        [STATIC_DEGREE] * bool(optimum.static) + [optimum.degree + 1] * optimum.branches, dtype=np.int64
    )
    effect_mean, effect_sd = _effect_prior(optimum, facts, effects)
    data = Linearised(
        branches=optimum.branches,
        degree=optimum.degree,
        static=optimum.static,
        shared=columns.shared,
        cross=columns.cross,
        own=columns.own,
        ratio=columns.ratio,
        links=columns.links,
        samples=float(columns.count),
        best=np.ascontiguousarray(optimum.theta),
        best_tau=np.ascontiguousarray(optimum.log_tau),
        nodes=_table([one.nodes for one in nodes]),
        barycentric=_table([one.barycentric for one in nodes]),
        mixing=_stacked(nodes),
        prior_mean=mean,
        prior_precision=precision,
        weak=weak,
        prior_log_mass=0.0,
        speed_mm_s=facts.speed_mm_s,
        depth_mm=facts.depth_mm,
        effect_precision=1.0 / effect_sd**2,
        effect_mean=effect_mean,
        phi=0.0,
        has_phi=correlated,
        has_gain="gain" in effects,
        blocks=blocks,
    )
    mass = log_passive_mass(mean, np.ascontiguousarray(np.linalg.inv(precision), dtype=np.float64), blocks)
    return SpecimenTarget(
        data=data._replace(prior_log_mass=float(mass)),
        optimum=optimum,
        model=model,
        priors=priors,
        facts=facts,
        effects=effects,
    )


def _effect_prior(optimum: Optimum, facts: Facts, effects: tuple[str, ...]) -> tuple[FloatArray, FloatArray]:
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


def _with_mode(target: SpecimenTarget, start: FloatArray, start_sd: FloatArray) -> SpecimenTarget:
    """Find the mode from a first guess, and the curvature there."""

    def falls(z: FloatArray) -> float:
        value = float(target.log_density(start + z * start_sd)[0])
        return -value if math.isfinite(value) else 1e300

    simplex = np.vstack([np.zeros(start.size), np.eye(start.size)])
    found = minimize(
        falls,
        np.zeros(start.size),
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "xatol": 1e-3,
            "fatol": 1e-5,
            "maxiter": 400 * start.size,
            "adaptive": True,
        },
    )
    mode = start + found.x * start_sd
    # a mode at an end of phi's range has the curvature that goes on beyond it
    beyond = replace(target, priors=replace(target.priors, phi=(0.0, 1.0)))
    return replace(target, mode=mode, covariance=_laplace(beyond, mode, start_sd))


def _laplace(target: SpecimenTarget, mode: FloatArray, guess: FloatArray) -> FloatArray:
    """Inverse Hessian of -log density by central differences, in steps of the coordinates' own scale."""
    d = mode.size
    top = float(target.log_density(mode)[0])

    def value(at: FloatArray) -> float:
        return float(target.log_density(at)[0])

    step = guess.copy()
    for i in range(d):
        # step to where the density has fallen by about PROBE, on the side that is inside
        for _ in range(40):
            unit = np.zeros(d)
            unit[i] = step[i]
            fall = top - max(value(mode + unit), value(mode - unit))
            if not math.isfinite(fall) or fall > 4.0 * PROBE:
                step[i] *= 0.5
            elif fall < 0.25 * PROBE and step[i] < WIDEST:
                step[i] *= 1.6
            else:
                break
    hessian = np.zeros((d, d))
    grid = np.eye(d) * step
    for i in range(d):
        for j in range(i + 1):
            around = [value(mode + s * grid[i] + t * grid[j]) for s in (1.0, -1.0) for t in (1.0, -1.0)]
            if i == j:
                sides = [v for v in (value(mode + grid[i]), value(mode - grid[i])) if math.isfinite(v)]
                hessian[i, i] = (
                    2.0 * (top - float(np.mean(sides))) / step[i] ** 2 if sides else 1.0 / step[i] ** 2
                )
            elif np.isfinite(around).all():
                mixed = -(around[0] - around[1] - around[2] + around[3]) / (4.0 * step[i] * step[j])
                hessian[i, j] = hessian[j, i] = mixed
    diagonal = np.sqrt(np.maximum(np.diag(hessian), 1e-12))
    scaled = hessian / diagonal / diagonal[:, None]
    values, vectors = np.linalg.eigh(scaled)
    inverse = (vectors / np.maximum(values, LEAST_CURVATURE)) @ vectors.T
    return np.asarray(inverse / diagonal / diagonal[:, None])


def _too_short(target: SpecimenTarget, ends: FloatArray) -> NDArray[np.bool_]:
    """Branches whose density has not fallen far at an end of their range that is not a bound."""
    bounds = target.facts.log_tau_bounds
    sd = np.sqrt(np.diag(target.covariance))
    out = np.zeros(len(ends), dtype=np.bool_)
    for j, (first, last) in enumerate(ends):
        for end, bound in ((first, bounds[0]), (last, bounds[1])):
            if abs(end - bound) < 1e-9 or last - first >= 2.0 * WIDEST:
                continue
            # along the ridge: the other coordinates follow the end by their correlation with it
            move = target.covariance[:, j] / sd[j] ** 2 * (end - target.mode[j])
            at = target.mode + move
            at[j] = end - 1e-9 * np.sign(end - target.mode[j])
            fall = float(target.log_density(target.mode)[0] - target.log_density(at)[0])
            if fall < DEEP:
                out[j] = True
    return out
