"""Priors in words, beside what the data made of them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tissueid.model.kelvin_voigt import STATIC_DEGREE
from tissueid.posterior.specimen_target import LOG_SIGMA_RANGE, SpecimenTarget
from tissueid.posterior.target import Redrawn
from tissueid.priors import WEAK_FACTOR, Priors
from tissueid.uncertainty import PriorRow

__all__ = ["prior_rows"]

FloatArray = NDArray[np.float64]

#: Standard deviation of a half-normal in its scale.
HALF_NORMAL_SD = math.sqrt(1.0 - 2.0 / math.pi)


def _row(name: str, words: str, stated: bool, draws: FloatArray, prior_sd: float) -> PriorRow:
    after = float(draws.std(ddof=1))
    return PriorRow(
        name=name,
        prior=words,
        stated=stated,
        posterior_mean=float(draws.mean()),
        posterior_sd=after,
        shrinkage=max(1.0 - after / prior_sd, 0.0) if prior_sd > 0.0 else 0.0,
    )


def _linear_rows(target: SpecimenTarget, theta: FloatArray) -> list[PriorRow]:
    """Coefficients of F_s and K."""
    model, optimum, priors = target.model, target.optimum, target.priors
    spread = WEAK_FACTOR * target.facts.force_N
    size = optimum.degree + 1
    state = _largest_states(target)
    rows = []
    for k, spec in enumerate(model.parameters):
        branch, power = divmod(k - STATIC_DEGREE, model.block) if k >= STATIC_DEGREE else (-1, k + 1)
        if (branch < 0 and not optimum.static) or (power == size and branch >= 0):
            continue
        if spec.name in priors.linear:
            mean, sd = priors.linear[spec.name]
            words = f"normal, {mean:.4g} ± {sd:.3g} {spec.unit}, cut to the passive set"
            rows.append(_row(spec.name, words, True, theta[:, k], sd))
            continue
        unit = optimum.scale**-power * (1.0 if branch < 0 else 1.0 / state[branch])
        # of the power's coefficient, from independent Bernstein coefficients
        degree = STATIC_DEGREE - 1 if branch < 0 else optimum.degree
        at = power - 1 if branch < 0 else power
        sd = spread * unit * _power_sd(degree, at)
        words = f"weak: every part of the curve up to some {spread:.3g} N, cut to the passive set"
        rows.append(_row(spec.name, words, False, theta[:, k], sd))
    return rows


def _power_sd(degree: int, power: int) -> float:
    """Standard deviation of the coefficient of u^power where Bernstein coefficients have one of 1."""
    weights = [
        math.comb(degree, power) * math.comb(power, i) * (-1.0) ** (power - i) for i in range(power + 1)
    ]
    return math.sqrt(sum(w * w for w in weights))


def _largest_states(target: SpecimenTarget) -> FloatArray:
    """Largest state of each branch at the mode [mm], as the weak prior takes it."""
    tau = np.exp(target.mode[: target.optimum.branches])
    length = np.multiply.outer(tau, target.facts.speed_mm_s)
    return np.asarray((-length * np.expm1(-target.facts.depth_mm / length)).max(axis=1))


def prior_rows(target: SpecimenTarget, points: FloatArray, drawn: Redrawn) -> tuple[PriorRow, ...]:
    """Every prior of a specimen, its posterior and the shrinkage between them.

    Parameters
    ----------
    target : SpecimenTarget
    points : ndarray, shape (n, d)
        Sampled coordinates.
    drawn : Redrawn
        What was drawn for them.
    """
    priors, optimum = target.priors, target.optimum
    rows = _linear_rows(target, drawn.theta)
    low, high = target.facts.log_tau_bounds
    for j in range(optimum.branches):
        name = f"ln_relaxation_time_{j + 1}"
        if j < len(priors.relaxation_time_s):
            one = priors.relaxation_time_s[j]
            words = f"log-normal, median {one.median:.4g} s, sd {one.sd_ln:.3g} in ln"
            rows.append(_row(name, words, True, points[:, j], one.sd_ln))
        else:
            words = f"uniform in ln tau from {math.exp(low):.3g} s to {math.exp(high):.3g} s"
            rows.append(_row(name, words, False, points[:, j], (high - low) / math.sqrt(12.0)))
    sigma = points[:, optimum.branches]
    if priors.sigma_N is None:
        rows.append(
            _row(
                "ln_sigma", "uniform in ln sigma over twelve decades", False, sigma, LOG_SIGMA_RANGE / 12**0.5
            )
        )
    else:
        words = f"log-normal, median {priors.sigma_N.median:.4g} N, sd {priors.sigma_N.sd_ln:.3g} in ln"
        rows.append(_row("ln_sigma", words, True, sigma, priors.sigma_N.sd_ln))
    at = optimum.branches + 1
    if target.data.has_phi:
        first, last = priors.phi
        words = f"uniform from {first:.3g} to {last:.3g}"
        stated = priors.phi != (0.0, 1.0)
        rows.append(_row("phi", words, stated, np.tanh(points[:, at]), (last - first) / 12**0.5))
        at += 1
    if target.data.has_gain:
        words = f"half-normal, scale {priors.gain_sd:.3g}"
        scale = priors.gain_sd * HALF_NORMAL_SD
        stated = priors.gain_sd != Priors().gain_sd
        rows.append(_row("gain_sd", words, stated, np.exp(points[:, at]), scale))
    return tuple(rows)
