"""Where the density of a specimen is highest, how it curves there, and whether its range is wide enough."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from tissueid.posterior.specimen_target import SpecimenTarget

__all__ = ["WIDEST", "too_short", "with_mode"]

FloatArray = NDArray[np.float64]

#: Largest half width of a range of ln tau.
WIDEST = 20.0
#: Fall of the log density at the ends of a range that is wide enough.
DEEP = 30.0
#: Rise of -log density at which a coordinate's scale is read off, and steps of the Hessian in that scale.
PROBE = 0.5
#: Smallest curvature along a ridge, relative to that of its coordinates: noise and phi near 1 have 1e-3.
LEAST_CURVATURE = 2e-3


def with_mode(target: SpecimenTarget, start: FloatArray, start_sd: FloatArray) -> SpecimenTarget:
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


def too_short(target: SpecimenTarget, ends: FloatArray) -> NDArray[np.bool_]:
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
