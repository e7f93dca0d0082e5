"""The mode of tissue and instrument together: Gauss and Newton on knots, effects of the logs following.

Steps are damped (Levenberg-Marquardt) and stop at the cuts of the nuisances' priors; the effects are
linearised anew about their means after each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.cone import cone_least_squares, support_directions
from tissueid.likelihood.instrument_kernels import ALL, EFFECTS, INSTRUMENT, Packed
from tissueid.likelihood.knot_terms import log_terms, without_effects
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.objective import cone_start
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior.instrument import INSTRUMENT_NAMES, SMALLEST_GAIN, Behind, inverse
from tissueid.posterior.linear_priors import Facts, linear_prior
from tissueid.posterior.loose_noise import LooseNoise
from tissueid.priors import Priors

__all__ = ["instrument_mode"]

FloatArray = NDArray[np.float64]

#: Rounds of Gauss and Newton for the mode, and of the noise's variance.
MODE_ROUNDS = 60
VARIANCE_ROUNDS = 3
#: A rise of the log density that is none.
RISEN = 1e-6
#: First damping, its factors after a good and a bad step, and where it is given up.
DAMPING, EASIER, HARDER, STUCK = 1e-3, 0.2, 8.0, 1e8
#: Largest step in ln tau.
REACH = 0.5
#: Where a search for a nuisance that is cut at its mean begins, in standard deviations.
INSIDE = 0.3


def _with_priors(
    behind: Behind, point: FloatArray, theta: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Normal equations in theta, ln tau and instrument with all priors, and the effects' means there."""
    tau, instrument, gain_sd = behind.split(point)
    terms = log_terms(behind.data, np.ascontiguousarray(theta), tau, instrument, ALL)
    ones = np.ones(behind.data.gamma.size)
    prior = behind.effect_prior(gain_sd)
    curvature, slope, _, back = without_effects(*terms, ones, *prior, behind.sigma2)
    p, branches = theta.size, behind.branches
    mean, precision = behind.tissue_prior(tau)
    curvature[:p, :p] += precision
    slope[:p] += precision @ (mean - theta)
    for j, stated in enumerate(behind.priors.relaxation_time_s[:branches]):
        curvature[p + j, p + j] += stated.sd_ln**-2.0
        slope[p + j] -= (tau[j] - math.log(stated.median)) * stated.sd_ln**-2.0
    for k, one in enumerate(behind.calibration):
        at = p + branches + k
        if one.sd > 0.0:
            curvature[at, at] += one.sd**-2.0
            slope[at] -= (instrument[k] - one.mean) * one.sd**-2.0
    return curvature, slope, back


@dataclass(frozen=True, slots=True, eq=False)
class _Quadratic:
    """Minus the log density about a point: ``0.5 d' C d - g' d`` in theta, ln tau and instrument."""

    curvature: FloatArray
    slope: FloatArray
    theta: FloatArray
    blocks: NDArray[np.int64]

    def best_theta(self, moved: FloatArray, damping: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Passive theta after a step of the coordinates, and directions it can move in there."""
        p = self.theta.size
        part = np.ascontiguousarray(self.curvature[:p, :p])
        part = part + damping * np.diag(np.diag(part))
        pull = part @ self.theta + self.slope[:p] - self.curvature[:p, p:] @ moved
        theta, generators, weights = cone_least_squares(part, pull, self.blocks, cone_start(self.blocks))
        return theta, support_directions(generators, weights, self.blocks)[0]

    def coordinates(
        self, directions: FloatArray, free: NDArray[np.bool_], room: FloatArray, damping: float
    ) -> FloatArray:
        """Damped step of the coordinates, theta following in its directions; none passes its cut.

        What would pass is put onto its cut, and the others follow.
        """
        p, d = self.theta.size, directions.shape[1]
        turn = np.zeros((self.slope.size, d + self.slope.size - p))
        turn[:p, :d], turn[p:, d:] = directions, np.eye(self.slope.size - p)
        curvature, slope = turn.T @ self.curvature @ turn, turn.T @ self.slope
        step = np.zeros(slope.size)
        moving = np.concatenate([np.ones(d, dtype=np.bool_), free])
        room = np.concatenate([np.full(d, -np.inf), room])
        for _ in range(slope.size):
            at, held = np.flatnonzero(moving), np.flatnonzero(~moving)
            part = curvature[np.ix_(at, at)]
            part = part + damping * np.diag(np.diag(part))
            step[at] = inverse(part) @ (slope[at] - curvature[np.ix_(at, held)] @ step[held])
            past = at[step[at] < room[at]]
            if past.size == 0:
                break
            step[past] = room[past]
            moving[past] = False
        return step[d:]


def _relinearised(behind: Behind, back: FloatArray, change: FloatArray) -> Behind:
    """Effects linearised about their means after a change of everything else."""
    effect = back[:, :, -1] - back[:, :, :-1] @ change
    data, at = behind.data, 0
    gamma, delta, own = data.gamma, data.delta, data.own
    if "gain" in behind.effects:
        gamma = gamma + np.log1p(np.maximum(effect[:, 0], SMALLEST_GAIN - 1.0))
        at = 1
    if "offset" in behind.effects:
        delta = delta + effect[:, at]
        at += 1
    if "static" in behind.effects:
        own = own + effect[:, at:]
    return replace(
        behind,
        data=data._replace(gamma=gamma, delta=np.ascontiguousarray(delta), own=np.ascontiguousarray(own)),
    )


def _quadratic(behind: Behind) -> tuple[_Quadratic, FloatArray]:
    """The quadratic at the present mode, and the effects' means there."""
    curvature, slope, back = _with_priors(behind, behind.mode, behind.theta)
    return _Quadratic(curvature, slope, behind.theta, behind.blocks), back


def _climb(behind: Behind) -> Behind:
    """Gauss-Newton from the present mode to the highest joint density of a passive tissue."""
    branches = behind.branches
    inner = branches + INSTRUMENT
    low, high = behind.facts.log_tau_bounds
    value = behind.log_density(behind.mode, behind.theta)
    damping = DAMPING
    for _ in range(MODE_ROUNDS):
        quadratic, back = _quadratic(behind)
        room = behind.cuts[0][:inner] - behind.mode[:inner]
        directions = quadratic.best_theta(np.zeros(inner))[1]
        risen = 0.0
        while damping < STUCK:
            step = quadratic.coordinates(directions, behind.free[:inner], room, damping)
            step *= min(1.0, REACH / max(float(np.abs(step[:branches]).max(initial=0.0)), REACH))
            mode = behind.mode.copy()
            mode[:inner] += step
            mode[:branches] = np.clip(mode[:branches], low, high)
            moved = mode[:inner] - behind.mode[:inner]
            theta, _ = quadratic.best_theta(moved, damping)
            change = np.concatenate([theta - behind.theta, moved])
            trial = replace(_relinearised(behind, back, change), theta=theta, mode=mode)
            there = trial.log_density(trial.mode, trial.theta)
            if math.isfinite(there) and there >= value - RISEN:
                behind, risen, value = trial, there - value, there
                damping *= EASIER
                break
            damping *= HARDER
        if risen < RISEN:
            break
    return behind


def _variance(behind: Behind) -> float:
    """Noise variance left at the mode."""
    tau, instrument, gain_sd = behind.split(behind.mode)
    gram, pull, square = log_terms(behind.data, behind.theta, tau, instrument, EFFECTS)
    ones = np.ones(square.size)
    back = without_effects(gram, pull, square, ones, *behind.effect_prior(gain_sd), behind.sigma2)[3]
    effect = back[:, :, 0]
    left = square - 2.0 * (effect * pull).sum(axis=1) + np.einsum("iq,iqr,ir->i", effect, gram, effect)
    used = behind.theta.size + behind.branches + 1
    return max(float(left.sum()) / max(behind.count - used, 1), 1e-300)


def _with_variance(behind: Behind, sigma2: float) -> Behind:
    """The same with another noise variance, as a coordinate too where it is one."""
    mode = behind.mode.copy()
    if behind.noise is not None:
        mode[mode.size - behind.noise.mode.size] = 0.5 * math.log(sigma2)
    return replace(behind, sigma2=sigma2, mode=mode)


def instrument_mode(
    data: Packed,
    optimum: Optimum,
    facts: Facts,
    model: KelvinVoigt,
    priors: Priors,
    effects: tuple[str, ...],
    *,
    count: int,
    gain_sd: float,
    start: Optimum | None = None,
    noise: LooseNoise | None = None,
) -> Behind:
    """The density of a specimen behind its instrument, its mode found.

    Parameters
    ----------
    data : Packed
    optimum : Optimum
        Of a fit that knows of no instrument.
    facts : Facts
    model : KelvinVoigt
    priors : Priors
    effects : tuple of str
    count : int
        Samples.
    gain_sd : float
        Estimate of the spread of the gains, where they are effects.
    start : Optimum, optional
        Where to begin, if not at ``optimum``.
    noise : LooseNoise, optional
        Scale and correlation as coordinates.
    """
    start = optimum if start is None else start
    data = data._replace(gamma=start.gamma.copy(), delta=start.delta.copy())
    if noise is not None:
        data = noise.at(data, noise.mode)
    branches = optimum.branches
    instrument = [
        max(one.mean, one.lower + INSIDE * one.sd)
        for one in (priors.calibration[name] for name in INSTRUMENT_NAMES)
    ]
    spread = [gain_sd] if "gain" in effects else []
    scales = np.zeros(0) if noise is None else noise.mode
    mode = np.array([*start.log_tau, *instrument, *spread, *scales])
    p = optimum.theta.size
    behind = Behind(
        data=data,
        optimum=optimum,
        facts=facts,
        model=model,
        priors=priors,
        effects=effects,
        linear=linear_prior(priors, model, optimum, facts),
        count=count,
        sigma2=max(float(data.square.sum()) / max(count - p, 1), 1e-300)
        if noise is None
        else math.exp(2.0 * noise.mode[0]),
        theta=start.theta.copy(),
        mode=mode,
        slope=np.zeros((p, mode.size)),
        curvature=np.zeros((0, 0)),
        follow=np.zeros((0, 0)),
        noise=noise,
    )
    for _ in range(VARIANCE_ROUNDS):
        behind = _climb(behind)
        sigma2 = _variance(behind)
        settled = abs(math.log(sigma2 / behind.sigma2)) < 0.01
        behind = _with_variance(behind, sigma2)
        if settled:
            break
    quadratic, back = _quadratic(behind)
    directions = quadratic.best_theta(np.zeros(branches + INSTRUMENT))[1]
    curvature = quadratic.curvature
    slope = np.zeros((p, mode.size))
    slope[:, : branches + INSTRUMENT] = -directions @ (
        inverse(directions.T @ curvature[:p, :p] @ directions) @ (directions.T @ curvature[:p, p:])
    )
    follow = -back[:, : ("gain" in effects) + ("offset" in effects), :-1]
    return replace(behind, slope=slope, curvature=curvature, follow=follow)
