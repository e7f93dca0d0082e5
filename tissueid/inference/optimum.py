"""Constrained Gauss-Newton steps with Levenberg-Marquardt damping, the logs' own parameters eliminated.

A step solves its quadratic model within the passive cone (Lawson & Hanson 1974, ch. 23).
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import nnls

from tissueid.arrays import FloatArray
from tissueid.inference.noise import Memory, Whitener, whitener
from tissueid.inference.prior import PriorRows
from tissueid.inference.system import MACHINE, SHAPE, Deflection, Derivatives, Point, System

#: Noise without memory.
WHITE = Memory()
#: Steps at the most; the largest change in standard errors and the gain of the objective that count as none.
MOST_STEPS, STILL, NO_GAIN = 40, 0.01, 1e-3
#: Shares of the diagonal that are added to a matrix until it is positive to its rounding.
STEADIED = (1e-13, 1e-10, 1e-7, 1e-4, 1e-2, 1.0)
#: Damping: where it starts, how it changes, and where it gives up.
DAMPING, RAISED, LOWERED, HOPELESS = 1e-4, 8.0, 0.2, 1e9
#: Rise of the criterion, the frame's deflection followed, with which a step is taken back, and damping then.
WORSE, BACK = 1.0, 64.0
#: Gain of a step of a search that only compares: at least this, and this share of what it is behind another
#: optimum; steps in turn that gain less end it.
LITTLE, CATCHING_UP, SLOW_STEPS = 0.02, 0.2, 2
#: Derivative, in standard deviations of the noise, that no data have.
RUNAWAY = 1e12
#: Curvature of a direction that has none: the relaxation time of a branch without stiffness.
FLAT = 1e-6
#: Constraint slack, relative to the row's size, that counts as active.
ACTIVE = 1e-7
#: Distance behind a wall that counts as on it, and singular value of a row of an active bound that is none.
ON_WALL, RANK = 1e-12, 1e-6


@dataclass(frozen=True, slots=True)
class Noise:
    """Scale and correlation of the force's noise."""

    sigma_N: float
    memory: Memory = WHITE


def whitener_of(system: System, memory: Memory) -> Whitener:
    """Whitening of all observations of a system."""
    end = system.mid + 0.5 * (system.count - 1.0) * system.obs_step
    start = system.mid - 0.5 * (system.count - 1.0) * system.obs_step
    gap = np.append(0.0, start[1:] - end[:-1])
    # rounding that samples share is one more source of white errors, which correlated noise would hide
    count = system.worth if memory.time_s <= 0.0 else system.count
    return whitener(count, system.obs_step, gap, system.chain, memory)


def nearest_inside(points: FloatArray, rows: FloatArray, walls: FloatArray) -> FloatArray:
    """Points (n, d) moved to the nearest with ``rows @ x >= walls``; NaN where none is found.

    A least distance problem (Lawson & Hanson 1974, chapter 23).
    """
    size = np.linalg.norm(rows, axis=1)
    rows, walls = rows[size > 0.0] / size[size > 0.0, None], walls[size > 0.0] / size[size > 0.0]
    out, last = points.copy(), np.append(np.zeros(points.shape[1]), 1.0)
    slack = points @ rows.T - walls
    for i in np.flatnonzero((slack < -ON_WALL).any(axis=1)):
        matrix = np.vstack([rows.T, -slack[i]])
        try:
            dual, norm = nnls(matrix, last, maxiter=60 * len(rows))
        except RuntimeError:
            dual, norm = np.zeros(len(rows)), np.float64(0.0)
        rest = matrix @ dual - last
        out[i] = out[i] - rest[:-1] / rest[-1] if norm > 1e-12 and rest[-1] < 0.0 else np.nan
    return out


def root_of(covariance: FloatArray) -> FloatArray:
    """Square root of a covariance whose coordinates may be of any size, and nearly dependent."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / scale / scale[:, None])
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 1e-14 * values[-1])))


def nearest_in_cone(
    centre: FloatArray, covariance: FloatArray, cone: FloatArray, least: FloatArray
) -> FloatArray:
    """Point (n,) of ``cone @ x >= least`` nearest to a centre in the metric of a covariance."""
    missing = least - cone @ centre
    if not (missing > 0.0).any():
        return centre
    root, used = root_of(covariance), least > -1e200
    step = nearest_inside(np.zeros((1, centre.size)), (cone @ root)[used], missing[used])[0]
    return np.asarray(centre + root @ step) if np.isfinite(step).all() else centre


def free_of(rows: FloatArray) -> FloatArray:
    """Orthonormal directions (d, free) that active bounds, rows (c, d) of any size, leave free."""
    size = np.linalg.norm(rows, axis=1)
    if not size.any():
        return np.eye(rows.shape[1])
    _, values, vectors = np.linalg.svd(rows[size > 0.0] / size[size > 0.0, None])
    return np.asarray(vectors[int((values > RANK).sum()) :].T)


class Reduced(NamedTuple):
    """Half the objective's Hessian and downhill gradient, the logs' own parameters eliminated."""

    hessian: FloatArray  # (s, s)
    gradient: FloatArray  # (s,)
    cross: FloatArray  # (logs, q, s)
    own_gradient: FloatArray  # (logs, q)


@dataclass(frozen=True, slots=True, eq=False)
class Normal:
    """Normal equations at a point, in units of the noise."""

    residual: FloatArray  # (k,), whitened, over sigma
    shared: FloatArray  # (k, s), whitened derivatives over sigma
    own: FloatArray  # (k, q)
    hessian: FloatArray  # (s, s), of half the objective, own parameters eliminated
    gradient: FloatArray  # (s,), downhill
    own_inverse: FloatArray  # (logs, q, q)
    cross: FloatArray  # (logs, q, s)
    own_gradient: FloatArray  # (logs, q)
    objective: float  # |residual|^2 and priors
    loose: Reduced  # Hessian, gradient and the like with shapes that need not have mean zero


def about_mean(own: FloatArray) -> FloatArray:
    """Own parameters (logs, q) with shapes about their mean, which is the specimen's."""
    out = own.copy()
    out[:, -SHAPE:] -= own[:, -SHAPE:].mean(axis=0)
    return out


def _by_log(system: System, products: FloatArray) -> FloatArray:
    """Sums over each log's observations."""
    return np.asarray(np.add.reduceat(products, system.begins, axis=0))


def prior_cost(prior: PriorRows, point: Point) -> float:
    """Twice the negative log prior of shared and own parameters."""
    off = prior.rows @ point.shared - prior.target
    return float(off @ off + (prior.own * point.own**2).sum())


def criterion(system: System, noise_N: float, prior: PriorRows, point: Point) -> float:
    """Twice the negative log density of a point, the scale of the noise integrated."""
    freedom = system.force.size + system.within_freedom
    return float(freedom * 2.0 * np.log(noise_N) + prior_cost(prior, point))


def _bound(loose: Reduced, inverse: FloatArray, point: Point) -> Reduced:
    """The same under the constraint that shapes have mean zero; ``inverse``: of the logs' own blocks."""
    shape = slice(-SHAPE, None)
    stiff = np.linalg.inv(inverse[:, shape, shape].sum(axis=0))
    follow = np.einsum("lqr,lrs->qs", inverse[:, shape], loose.cross)
    off = np.einsum("lqr,lr->q", inverse[:, shape], loose.own_gradient) + point.own[:, shape].sum(axis=0)
    cross, own_gradient = loose.cross.copy(), loose.own_gradient.copy()
    cross[:, shape] -= stiff @ follow
    own_gradient[:, shape] -= stiff @ off
    hessian, gradient = loose.hessian + follow.T @ stiff @ follow, loose.gradient + follow.T @ stiff @ off
    return Reduced(hessian, gradient, cross, own_gradient)


def normal_equations(
    system: System, point: Point, parts: Derivatives, white: Whitener, sigma_N: float, prior: PriorRows
) -> Normal:
    """Assemble the quadratic model at a point."""
    residual = white(system.force - parts.force) / sigma_N
    shared = white(parts.shared) / sigma_N
    own = np.clip(white(parts.own) / sigma_N, -RUNAWAY, RUNAWAY) if parts.own.shape[1] else parts.own
    off = prior.rows @ point.shared - prior.target
    hessian = shared.T @ shared + prior.rows.T @ prior.rows
    gradient = shared.T @ residual - prior.rows.T @ off
    q = own.shape[1]
    if q:
        inner = _by_log(system, own[:, :, None] * own[:, None, :])
        inner = inner + prior.own[:, :, None] * np.eye(q)
        cross = _by_log(system, own[:, :, None] * shared[:, None, :])
        own_gradient = _by_log(system, own * residual[:, None]) - prior.own * point.own
        inverse = np.asarray(np.linalg.inv(inner))
        hessian = hessian - np.einsum("lqs,lqr,lrt->st", cross, inverse, cross)
        gradient = gradient - np.einsum("lqs,lqr,lr->s", cross, inverse, own_gradient)
    else:
        logs = len(system.logs)
        inverse, cross = np.zeros((logs, 0, 0)), np.zeros((logs, 0, shared.shape[1]))
        own_gradient = np.zeros((logs, 0))
    objective = float(residual @ residual) + prior_cost(prior, point)
    loose = Reduced(hessian, gradient, cross, own_gradient)
    hessian, gradient, cross, own_gradient = _bound(loose, inverse, point) if system.centred else loose
    return Normal(residual, shared, own, hessian, gradient, inverse, cross, own_gradient, objective, loose)


def pinned(normal: Normal, point: Point, *, centred: bool) -> FloatArray:
    """Hessian of the shared parameters with the logs' gains held where they are."""
    inner = np.linalg.inv(normal.own_inverse)
    inverse = np.zeros_like(inner)
    inverse[:, 1:, 1:] = np.linalg.inv(inner[:, 1:, 1:])
    cross, more = normal.loose.cross, normal.own_inverse - inverse
    hessian = normal.loose.hessian + np.einsum("lqs,lqr,lrt->st", cross, more, cross)
    return _bound(normal.loose._replace(hessian=hessian), inverse, point).hessian if centred else hessian


def covariance_of(hessian: FloatArray) -> FloatArray:
    """Inverse of a Hessian; directions without curvature get the largest variance there is."""
    hessian = hessian + FLAT * np.eye(len(hessian))
    scale = np.sqrt(np.maximum(np.diag(hessian), FLAT))
    values, vectors = np.linalg.eigh(hessian / scale / scale[:, None])
    values = np.maximum(values, 1e-13 * max(float(values[-1]), 1e-300))
    return np.asarray((vectors / values) @ vectors.T / scale / scale[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class Optimum:
    """A minimum of the objective."""

    point: Point
    normal: Normal
    prior: PriorRows
    noise: Noise
    covariance: FloatArray  # (s, s), inverse Hessian of the shared parameters, bounds not known to it
    converged: bool
    active: NDArray[np.bool_]  # (c,), constraints that hold with equality


class _At(NamedTuple):
    """The quadratic model at a point, and the deflection of the frame there."""

    point: Point
    prior: PriorRows
    noise_N: float
    normal: Normal
    frame: Deflection


def _factor(scaled: FloatArray) -> tuple[FloatArray, bool]:
    """Cholesky factor of a matrix with a diagonal of ones, steadied as far as its rounding takes."""
    for share in STEADIED:
        with suppress(np.linalg.LinAlgError):
            return cho_factor(scaled + share * np.eye(len(scaled)))
    raise np.linalg.LinAlgError("no direction of a step is known")


def _step(
    normal: Normal, prior: PriorRows, point: Point, damping: float, frozen: FloatArray, centred: bool
) -> Point:
    """One damped step within the cone, of shared and own parameters alike."""
    (hessian, gradient, cross, own_gradient), own_inverse = normal.loose, normal.own_inverse
    if normal.own.shape[1]:
        inner = np.linalg.inv(own_inverse)
        own_inverse = np.asarray(np.linalg.inv(inner * (1.0 + damping * np.eye(inner.shape[1]))))
        stiffer = normal.own_inverse - own_inverse
        hessian = hessian + np.einsum("lqs,lqr,lrt->st", cross, stiffer, cross)
        gradient = np.asarray(gradient + np.einsum("lqs,lqr,lr->s", cross, stiffer, own_gradient))
    if centred:
        loose = Reduced(hessian, gradient, cross, own_gradient)
        hessian, gradient, cross, own_gradient = _bound(loose, own_inverse, point)
    hessian = hessian + np.diag(damping * np.maximum(np.diag(hessian), FLAT) + frozen + FLAT)
    scale = 1.0 / np.sqrt(np.diag(hessian))
    factor = _factor(hessian * scale * scale[:, None])
    move = scale * cho_solve(factor, scale * gradient)
    shared = point.shared + move
    if ((prior.cone @ shared) < prior.least).any():
        covariance = scale[:, None] * cho_solve(factor, np.diag(scale))
        shared = nearest_in_cone(shared, covariance, prior.cone, prior.least)
        move = shared - point.shared
    if normal.own.shape[1]:
        rest = own_gradient - np.einsum("lqs,s->lq", cross, move)
        own = point.own + np.einsum("lqr,lr->lq", own_inverse, rest)
    else:
        own = point.own
    return point.moved(shared, own)


def _scale_of(
    system: System, residual: FloatArray, white: Whitener, memory: Memory, parameters: int
) -> float:
    """Standard deviation of the noise that a residual shows [N]."""
    e = white(residual)
    total, freedom = float(e @ e), residual.size - parameters
    if memory.time_s <= 0.0:
        total, freedom = total + system.within_N2, freedom + system.within_freedom
    return float(np.sqrt(max(total, 0.0) / max(freedom, 1)))


def _change(normal: Normal, point: Point, moved: Point, free: NDArray[np.bool_]) -> float:
    """Largest change in standard errors: of free shared parameters, of own ones where none is free."""
    if free.any():
        variance = np.diag(covariance_of(normal.hessian))[free]
        change = np.abs(moved.shared - point.shared)[free]
    else:
        variance = np.diagonal(normal.own_inverse, axis1=1, axis2=2)
        change = np.abs(moved.own - point.own)
    return float((change / np.sqrt(np.maximum(variance, 1e-300))).max())


def _frozen(system: System, machine: bool, held: NDArray[np.int64] | None) -> FloatArray:
    """Curvature that keeps shared parameters where they are: those held, and a machine that is closed."""
    out, t = np.zeros(system.size), system.law.times
    if not machine:
        out[t : t + len(MACHINE)] = 1e30
    if held is not None:
        out[held] = 1e30
    return out


def _active(prior: PriorRows, shared: FloatArray) -> NDArray[np.bool_]:
    """Constraints that hold with equality."""
    size = np.abs(prior.cone) @ np.maximum(np.abs(shared), 1e-12)
    return np.asarray(prior.cone @ shared - prior.least <= ACTIVE * size)


def minimise(
    system: System,
    point: Point,
    prior_at: Callable[[Point], PriorRows],
    *,
    noise: Noise | Memory = WHITE,
    machine: bool,
    least_sigma_N: float = 0.0,
    steps: int = MOST_STEPS,
    held: NDArray[np.int64] | None = None,
    rival: float | None = None,
) -> Optimum:
    """Minimise the objective from a point.

    ``noise``: held at its scale, or a memory whose scale follows the residuals; ``held``: shared parameters
    that stay; ``rival``: criterion of another optimum, for a search that ends where it gains little.
    """
    memory, sigma_N = (noise, None) if isinstance(noise, Memory) else (noise.memory, noise.sigma_N)
    white = whitener_of(system, memory)
    if system.centred:
        point = replace(point, own=about_mean(point.own))
    frozen = _frozen(system, machine, held)
    parameters = min(system.law.freedom + point.own.size, system.force.size // 2)
    floor = max(least_sigma_N, 1e-9 * float(np.abs(system.force).max()), 1e-15)

    def at(point: Point) -> _At:
        """The quadratic model at a point, the frame's deflection followed to it."""
        parts = system.derivatives(point, machine=machine, follow=True)
        left = system.force - parts.force
        noise_N = sigma_N or max(_scale_of(system, left, white, memory, parameters), floor)
        prior = prior_at(point)
        normal = normal_equations(system, point, parts, white, noise_N, prior)
        return _At(point, prior, noise_N, normal, system.deflection)

    damping, converged, here, slow = DAMPING, False, at(point), 0
    for _ in range(steps):
        moved, damping, gain = _descend(system, here, white, damping, frozen)
        if moved is None:
            converged = True
            break
        there = at(moved)
        if (rise := _rise(system, here, there, scaled=not sigma_N)) > WORSE:
            system.deflection, damping = here.frame, damping * BACK
            continue
        largest = _change(here.normal, here.point, moved, frozen == 0.0)
        gain, here = min(gain, -rise), there
        # what shared parameters no longer gain, those of the logs may
        if largest < STILL and gain < NO_GAIN:
            converged = True
            break
        # a search that only compares ends where steps gain little
        behind = np.inf if rival is None else CATCHING_UP * (_criterion(system, here) - rival)
        slow = slow + 1 if rival is not None and gain < max(LITTLE, behind) else 0
        if slow == SLOW_STEPS:
            break
    return Optimum(
        point=here.point, normal=here.normal, prior=here.prior, noise=Noise(here.noise_N, memory),
        covariance=covariance_of(here.normal.hessian + np.diag(frozen)), converged=converged,
        active=_active(here.prior, here.point.shared),
    )  # fmt: skip


def _rise(system: System, here: _At, there: _At, *, scaled: bool) -> float:
    """Rise by a step that is up with its own deflection; ``scaled``: the noise follows the residuals."""
    # behind a frame softer than the tissue derivatives may run away while the force has not
    curved = np.diag(there.normal.loose.hessian)
    lost = not (curved.min() > -FLAT and curved.max() < RUNAWAY**2)
    if lost or (here.frame.settled and not there.frame.settled):
        return float("inf")
    if not scaled:
        return there.normal.objective - here.normal.objective
    return _criterion(system, there) - _criterion(system, here)


def _criterion(system: System, at: _At) -> float:
    """Criterion of a quadratic model's point."""
    return criterion(system, at.noise_N, at.prior, at.point)


def _descend(
    system: System, here: _At, white: Whitener, damping: float, frozen: FloatArray
) -> tuple[Point | None, float, float]:
    """A point with a smaller objective or ``None``, the damping that reached it, and the gain."""
    normal = here.normal
    while damping < HOPELESS:
        moved = _step(normal, here.prior, here.point, damping, frozen, system.centred)
        moved, value = _with_best_linear(system, here, moved, white, frozen)
        if value <= normal.objective * (1.0 + 1e-12) and np.isfinite(value):
            if normal.objective - value <= 1e-7 * max(1.0, 1e-6 * normal.objective):
                return None, damping, 0.0
            return moved, max(damping * LOWERED, 1e-10), normal.objective - value
        damping *= RAISED
    return None, DAMPING, 0.0


def _with_best_linear(
    system: System, here: _At, point: Point, white: Whitener, frozen: FloatArray
) -> tuple[Point, float]:
    """The point with the linear parameters that suit its others, as a valley that bends needs; its objective.

    Variable projection (Golub & Pereyra 1973, doi 10.1137/0710036); logs that have gains do without.
    """
    prior, first = here.prior, system.law.times + len(MACHINE)
    force, columns = system.tip_force(point)
    both = force[None] if system.effects.gain else np.concatenate([force[None], system.soft * columns])
    seen = system.carrying(system.means(system.recorded(both, point.machine)), point)
    residual = white(system.force - seen[0]) / here.noise_N
    value = float(residual @ residual) + prior_cost(prior, point)
    if system.effects.gain:
        return point, value
    basis, rows = white(seen[1:].T) / here.noise_N, prior.rows[:, first:]
    hessian = basis.T @ basis + rows.T @ rows + np.diag(frozen[first:] + FLAT)
    gradient = basis.T @ residual + rows.T @ (prior.target - prior.rows @ point.shared)
    covariance, cone = covariance_of(hessian), prior.cone[:, first:]
    shared, least = point.shared, prior.least - prior.cone[:, :first] @ point.shared[:first]
    shared[first:] = nearest_in_cone(shared[first:] + covariance @ gradient, covariance, cone, least)
    better = point.moved(shared, point.own)
    left = residual - basis @ (better.linear - point.linear)
    found = float(left @ left) + prior_cost(prior, better)
    return (better, found) if found < value else (point, value)
