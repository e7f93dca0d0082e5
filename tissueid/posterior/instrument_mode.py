"""The mode of tissue and instrument together: Gauss and Newton on knots, effects of the logs following.

Steps are damped (Levenberg-Marquardt) and stop at the cuts of the nuisances' priors; the effects are
linearised anew about their means after each.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.instrument_kernels import ALL, EFFECTS, INSTRUMENT, Packed
from tissueid.likelihood.knot_terms import log_terms, without_effects
from tissueid.likelihood.linearise import Optimum
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior.instrument import INSTRUMENT_NAMES, SMALLEST_GAIN, Behind, inverse
from tissueid.posterior.linear_priors import Facts, linear_prior
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


def _step(
    curvature: FloatArray, slope: FloatArray, free: NDArray[np.bool_], room: FloatArray, damping: float
) -> FloatArray:
    """Damped step that does not pass the cuts: what would is put onto its cut, and the others follow."""
    step = np.zeros(slope.size)
    moving = free.copy()
    for _ in range(slope.size):
        at = np.flatnonzero(moving)
        held = np.flatnonzero(~moving)
        part = curvature[np.ix_(at, at)]
        part = part + damping * np.diag(np.diag(part))
        step[at] = inverse(part) @ (slope[at] - curvature[np.ix_(at, held)] @ step[held])
        past = at[step[at] < room[at]]
        if past.size == 0:
            return step
        step[past] = room[past]
        moving[past] = False
    return step


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


def _climb(behind: Behind) -> Behind:
    """Gauss-Newton from the present mode to the highest joint density."""
    p, branches = behind.theta.size, behind.branches
    inner = branches + INSTRUMENT
    free = np.concatenate([np.ones(p, dtype=np.bool_), behind.free[:inner]])
    low, high = behind.facts.log_tau_bounds
    value = behind.log_density(behind.mode, behind.theta)
    damping = DAMPING
    for _ in range(MODE_ROUNDS):
        curvature, slope, back = _with_priors(behind, behind.mode, behind.theta)
        room = np.concatenate([np.full(p, -np.inf), behind.cuts[0][:inner] - behind.mode[:inner]])
        risen = 0.0
        while damping < STUCK:
            step = _step(curvature, slope, free, room, damping)
            step *= min(1.0, REACH / max(float(np.abs(step[p : p + branches]).max(initial=0.0)), REACH))
            mode = behind.mode.copy()
            mode[:inner] += step[p:]
            mode[:branches] = np.clip(mode[:branches], low, high)
            change = np.concatenate([step[:p], mode[:inner] - behind.mode[:inner]])
            trial = replace(_relinearised(behind, back, change), theta=behind.theta + step[:p], mode=mode)
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
    """
    branches = optimum.branches
    start = [
        max(one.mean, one.lower + INSIDE * one.sd)
        for one in (priors.calibration[name] for name in INSTRUMENT_NAMES)
    ]
    spread = [gain_sd] if "gain" in effects else []
    mode = np.array([*optimum.log_tau, *start, *spread])
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
        sigma2=max(float(data.square.sum()) / max(count - p, 1), 1e-300),
        theta=optimum.theta.copy(),
        mode=mode,
        slope=np.zeros((p, mode.size)),
        curvature=np.zeros((0, 0)),
        follow=np.zeros((0, 0)),
    )
    for _ in range(VARIANCE_ROUNDS):
        behind = _climb(behind)
        sigma2 = _variance(behind)
        settled = abs(math.log(sigma2 / behind.sigma2)) < 0.01
        behind = replace(behind, sigma2=sigma2)
        if settled:
            break
    curvature, _, back = _with_priors(behind, behind.mode, behind.theta)
    slope = np.zeros((p, mode.size))
    slope[:, : branches + INSTRUMENT] = -inverse(curvature[:p, :p]) @ curvature[:p, p:]
    follow = -back[:, 0, :-1] if "gain" in effects else np.zeros((0, 0))
    return replace(behind, slope=slope, curvature=curvature, follow=follow)
