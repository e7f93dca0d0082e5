"""From an optimum to reported parameters, each with its standard error and its verdict.

Viscosity eta = K tau comes first in every verdict: a ramp determines K tau v long before it determines K
and tau (their correlation is -0.99 and worse).  Where K varies with depth, eta is taken at half the
fitted depth.  Standard errors are those of white noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.inference.engine import Identified
from tissueid.inference.profile import LEVEL_95, ProfileInterval, profile
from tissueid.model.base import ParameterSpec
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt, branch_suffix
from tissueid.result import Estimate

__all__ = ["MAX_WIDTH", "REFERENCE_DEPTH", "TissueEstimate", "estimate_tissue", "width_of"]

FloatArray = NDArray[np.float64]

#: Widest 95 % interval in the logarithm that counts as identified.
MAX_WIDTH = 1.0
#: A standard error below this is the rounding of none.
BOUND_ROUNDING = 1e-12
#: Singular value of a row of an active bound that is none.
RANK = 1e-6
#: Depth, as a fraction of the fitted one, at which viscosity is quoted where K varies.
REFERENCE_DEPTH = 0.5
#: Depths, as fractions of the fitted one, at which a curve is judged.
CURVE_DEPTHS = (0.25, 0.5, 0.75, 1.0)


def width_of(estimate: float, stderr: float) -> float:
    """Width of the 95 % interval of the logarithm of a positive estimate, from its standard error."""
    if not (np.isfinite(stderr) and estimate > 0.0):
        return float("inf")
    return 2.0 * float(np.sqrt(LEVEL_95)) * stderr / estimate


@dataclass(frozen=True, slots=True, eq=False)
class TissueEstimate:
    """A tissue in the parameters of its contact model.

    Attributes
    ----------
    model : KelvinVoigt
    theta, covariance : ndarray
        In the order of ``model.parameter_names``, units of the field.
    parameters : tuple of Estimate
    intervals : tuple of ProfileInterval
        Of ln tau, a branch each.
    bounded : bool
        True where a passivity bound is active.
    """

    model: KelvinVoigt
    theta: FloatArray
    covariance: FloatArray
    parameters: tuple[Estimate, ...]
    intervals: tuple[ProfileInterval, ...]
    bounded: bool


def _estimate(
    name: str, symbol: str, unit: str, number: float, stderr: float, verdict: tuple[bool, float]
) -> Estimate:
    identified, width = verdict
    # across an active bound the covariance is zero: that is no knowledge of the parameter
    at_bound = stderr <= BOUND_ROUNDING * max(abs(number), 1.0)
    finite = bool(np.isfinite(stderr)) and not at_bound
    return Estimate(
        name=name,
        symbol=symbol,
        unit=unit,
        value=number if identified else None,
        stderr=stderr if identified and finite else None,
        identified=identified,
        detail={
            "estimate": number,
            "estimate_stderr": stderr if finite else None,
            "width_ln": width if np.isfinite(width) else None,
            "at_bound": at_bound,
        },
    )


def _curve_verdict(coefficients: FloatArray, basis: FloatArray, covariance: FloatArray) -> tuple[bool, float]:
    """Test if a curve's widest 95 % interval is narrower than the curve is high.

    A curve may start soft: an interval relative to its own height at each depth would condemn it there.

    Parameters
    ----------
    coefficients : ndarray, shape (p,)
    basis : ndarray, shape (n, p)
        Powers of the depths at which it is looked at.
    covariance : ndarray, shape (p, p)
    """
    spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", basis, covariance, basis), 0.0))
    width = width_of(float((basis @ coefficients).max()), float(spread.max()))
    return width <= MAX_WIDTH, width


def _static_estimates(model: KelvinVoigt, theta: FloatArray, covariance: FloatArray) -> list[Estimate]:
    """a1, a2, a3, with one verdict on the curve."""
    depths = np.array(CURVE_DEPTHS) * model.depth_mm
    basis = depths[:, None] ** np.arange(1.0, STATIC_DEGREE + 1)
    block = covariance[:STATIC_DEGREE, :STATIC_DEGREE]
    verdict = _curve_verdict(theta[:STATIC_DEGREE], basis, block)
    return [
        _estimate(spec.name, spec.symbol, spec.unit, float(theta[k]), float(np.sqrt(block[k, k])), verdict)
        for k, spec in enumerate(model.parameters[:STATIC_DEGREE])
    ]


def _time_estimate(
    spec: ParameterSpec, tau: float, stderr: float, interval: ProfileInterval, *, several: bool
) -> Estimate:
    """tau, with its profile interval.

    With several branches the profile runs along the ridge of the curvature only, which may be too short
    a cut: the wider of it and the interval from the standard error decides.
    """
    width = max(interval.width, width_of(tau, stderr)) if several else interval.width
    verdict = (interval.closed and width <= MAX_WIDTH, width)
    plain = _estimate(spec.name, spec.symbol, spec.unit, tau, stderr, verdict)
    detail = dict(plain.detail) | {
        "profile_ci95": [float(np.exp(interval.low)), float(np.exp(interval.high))],
        "open_low": interval.open_low,
        "open_high": interval.open_high,
    }
    return replace(plain, detail=detail)


def _branch_estimates(
    model: KelvinVoigt, theta: FloatArray, covariance: FloatArray, branch: int, interval: ProfileInterval
) -> list[Estimate]:
    """Stiffness coefficients, relaxation time and viscosity of one branch."""
    size = model.stiffness_degree + 1
    first = STATIC_DEGREE + branch * model.block
    span, last = slice(first, first + size), first + size
    specs = model.parameters[first : last + 1]
    powers = np.arange(float(size))
    curve = (np.array(CURVE_DEPTHS) * model.depth_mm)[:, None] ** powers
    stderr = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    verdict = _curve_verdict(theta[span], curve, covariance[span, span])
    tau = float(theta[last])
    estimates = [
        _estimate(
            spec.name, spec.symbol, spec.unit, float(theta[first + k]), float(stderr[first + k]), verdict
        )
        for k, spec in enumerate(specs[:-1])
    ]
    estimates.append(
        _time_estimate(specs[-1], tau, float(stderr[last]), interval, several=model.branches > 1)
    )
    reference = (REFERENCE_DEPTH * model.depth_mm) ** powers if model.stiffness_degree else np.ones(1)
    stiffness = float(theta[span] @ reference)
    slope = np.concatenate([reference * tau, [stiffness]])
    block = covariance[first : last + 1, first : last + 1]
    used = np.where(np.outer(slope, slope) != 0.0, block, 0.0)
    eta, eta_stderr = stiffness * tau, float(np.sqrt(max(slope @ used @ slope, 0.0)))
    width = width_of(eta, eta_stderr)
    name, symbol = (
        f"viscosity_N_s_per_mm{branch_suffix(branch)}",
        "eta" if branch == 0 else f"eta{branch + 1}",
    )
    estimates.append(_estimate(name, symbol, "N s/mm", eta, eta_stderr, (width <= MAX_WIDTH, width)))
    return estimates


def theta_covariance(identified: Identified) -> FloatArray:
    """Covariance of theta, machine held, (p, p); rows of what active bounds hold are zero."""
    optimum, law, t = identified.optimum, identified.law, identified.law.times
    shared = np.concatenate([np.arange(t), np.arange(t + 3, t + 3 + law.linear)])
    prior, normal = optimum.prior, optimum.normal
    hessian = normal.hessian[np.ix_(shared, shared)]
    free = np.eye(len(shared))
    rows = prior.cone[optimum.active][:, shared]
    if len(rows):
        size = np.linalg.norm(rows, axis=1)
        _, values, vectors = np.linalg.svd(rows[size > 0.0] / size[size > 0.0, None])
        free = vectors[int((values > RANK).sum()) :].T
    inner = free.T @ hessian @ free
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    inverse = (
        np.linalg.pinv(inner / scale / scale[:, None], rcond=1e-14, hermitian=True) / scale / scale[:, None]
    )
    covariance = free @ inverse @ free.T
    theta = law.theta(optimum.point.log_times, optimum.point.linear, exact=True)[0]
    change = np.zeros((theta.size, len(shared)))
    for k in range(len(shared)):
        step = 1e-6 * max(abs(float(optimum.point.shared[shared[k]])), 1e-3)
        moved = optimum.point.shared.copy()
        moved[shared[k]] += step
        change[:, k] = (law.theta(moved[:t], moved[t + 3 :], exact=True)[0] - theta) / step
    return np.asarray(change @ covariance @ change.T)


def estimate_tissue(identified: Identified) -> TissueEstimate:
    """Reported parameters of the chosen law at its optimum.

    Parameters
    ----------
    identified : Identified

    Returns
    -------
    TissueEstimate
    """
    model, point = identified.law.model(), identified.optimum.point
    theta = identified.law.theta(point.log_times, point.linear)[0]
    covariance = theta_covariance(identified)
    parameters = _static_estimates(model, theta, covariance)
    intervals = []
    for branch, at in enumerate(np.argsort(point.log_times).tolist()):
        interval, curve = profile(identified, at)
        intervals.append(interval)
        parameters += [
            replace(one, detail={**one.detail, "profile": curve})
            if one.name.startswith("relaxation_time")
            else one
            for one in _branch_estimates(model, theta, covariance, branch, interval)
        ]
    return TissueEstimate(
        model=model,
        theta=theta,
        covariance=np.where(np.isfinite(covariance), covariance, 0.0),
        parameters=tuple(parameters),
        intervals=tuple(intervals),
        bounded=bool(identified.optimum.active[: len(identified.law.cone())].any()),
    )
