"""From an optimum to reported parameters, each with its standard error and its verdict.

Viscosity eta = K tau comes first in every verdict: a ramp determines K tau v long before it determines K
and tau (their correlation is -0.99 and worse).  Where K varies with depth, eta is taken at half the
fitted depth.  Standard errors are those of white noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Candidate, Solution, SpecimenSums, objective_for
from tissueid.fit.profile import profile_curve
from tissueid.fit.search import unbounded_covariance
from tissueid.likelihood.cone import cone_least_squares
from tissueid.likelihood.identifiability import MAX_WIDTH, ProfileInterval, profile_interval, width_of
from tissueid.likelihood.objective import PooledObjective, cone_start
from tissueid.model.base import ParameterSpec
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt, branch_suffix
from tissueid.result import Estimate

__all__ = ["REFERENCE_DEPTH", "TissueEstimate", "estimate_tissue", "in_field_units", "second_stage_static"]

FloatArray = NDArray[np.float64]

#: A standard error below this is the rounding of none.
BOUND_ROUNDING = 1e-12
#: Depth, as a fraction of the fitted one, at which viscosity is quoted where K varies.
REFERENCE_DEPTH = 0.5
#: Depths, as fractions of the fitted one, at which a curve is judged.
CURVE_DEPTHS = (0.25, 0.5, 0.75, 1.0)


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


def second_stage_static(sums: SpecimenSums, solution: Solution) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Static curve of a per-log fit: one passive curve for all logs, K and tau as identified.

    Returns its coefficients by powers of u (3,), their covariance for given K and tau (3, 3), and how
    they follow K and ln tau (3, p + branches).  The two parts of their error are independent: K and tau
    come from what every log's own static block leaves, this curve from that block.
    """
    candidate = Candidate(
        branches=solution.candidate.branches, degree=solution.candidate.degree, pooling="shared"
    )
    objective = objective_for(sums, candidate, solution.noise)
    assert isinstance(objective, PooledObjective)  # noqa: S101
    k = solution.evaluation.theta
    blocks = np.array([STATIC_DEGREE], dtype=np.int64)
    q = objective.quadratic(solution.evaluation.log_tau)
    p = STATIC_DEGREE + k.size
    h = q[:STATIC_DEGREE, :STATIC_DEGREE]
    cross = q[:STATIC_DEGREE, STATIC_DEGREE:p]
    b = q[:STATIC_DEGREE, -1] - cross @ k
    theta, _, _ = cone_least_squares(np.ascontiguousarray(h), b, blocks, cone_start(blocks))
    full = np.concatenate([theta, k])
    value = q[-1, -1] - 2.0 * q[:p, -1] @ full + full @ q[:p, :p] @ full
    by_tau = (q[:STATIC_DEGREE, p:-1] * k).reshape(STATIC_DEGREE, candidate.branches, -1).sum(axis=2)
    inverse = np.linalg.pinv(h, hermitian=True)
    follows = -inverse @ np.concatenate([cross, by_tau], axis=1)
    return theta, inverse * float(value) / max(sums.n - STATIC_DEGREE, 1), follows


def in_field_units(
    sums: SpecimenSums, solution: Solution
) -> tuple[KelvinVoigt, FloatArray, FloatArray, FloatArray, bool]:
    """Model, theta, covariance, inverse curvature of ln tau, and whether a bound is active."""
    candidate, found = solution.candidate, solution.evaluation
    inverse, bounded = unbounded_covariance(found, solution.objective.blocks)
    branches, size = candidate.branches, candidate.degree + 1
    offset = found.theta.size - branches * size
    static, own, follows = (
        (found.theta[:offset], np.zeros((STATIC_DEGREE, STATIC_DEGREE)), np.eye(STATIC_DEGREE, len(inverse)))
        if offset
        else second_stage_static(sums, solution)
    )
    model = KelvinVoigt(branches=branches, stiffness_degree=candidate.degree, depth_mm=sums.depth_mm)
    powers = sums.depth_mm ** -np.arange(float(size))
    stiffness = found.theta[offset:].reshape(branches, size) * powers
    tau = np.exp(found.log_tau)
    theta = model.join(static * sums.depth_mm ** -np.arange(1.0, STATIC_DEGREE + 1), stiffness, tau)
    # d theta / d (u coefficients, ln tau)
    p = theta.size
    change = np.zeros((p, inverse.shape[0]))
    scale = np.diag(sums.depth_mm ** -np.arange(1.0, STATIC_DEGREE + 1))
    change[:STATIC_DEGREE] = scale @ follows
    for j in range(branches):
        row = STATIC_DEGREE + j * (size + 1)
        for k in range(size):
            change[row + k, offset + j * size + k] = powers[k]
        change[row + size, found.theta.size + j] = tau[j]
    finite = np.where(np.isfinite(inverse), inverse, 0.0)
    covariance = change @ finite @ change.T * solution.noise.sigma2
    covariance[:STATIC_DEGREE, :STATIC_DEGREE] += scale @ own @ scale
    for j in range(branches):
        if not np.isfinite(inverse[found.theta.size + j, found.theta.size + j]):
            at = STATIC_DEGREE + j * (size + 1) + size
            covariance[at, at] = np.inf
    return model, theta, covariance, inverse[found.theta.size :, found.theta.size :], bounded


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
    """Whether a curve's widest 95 % interval is narrower than the curve is high.

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
    verdict = (interval.identified and width <= MAX_WIDTH, width)
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


def _with_profile(
    estimates: list[Estimate],
    model: KelvinVoigt,
    solution: Solution,
    branch: int,
    inverse: FloatArray,
    bounds: tuple[float, float],
) -> list[Estimate]:
    """The same estimates; that of the relaxation time carries its profile likelihood."""
    size = model.stiffness_degree + 1
    # the solution's coefficients are by powers of depth over the fitted depth
    reference = (REFERENCE_DEPTH if size > 1 else 1.0) ** np.arange(float(size))
    curve = profile_curve(
        solution.objective,
        solution.evaluation,
        branch,
        sigma2=solution.noise.sigma2,
        inverse=inverse,
        bounds=bounds,
        reference=reference,
    )
    return [
        replace(one, detail={**one.detail, "profile": curve})
        if one.name.startswith("relaxation_time")
        else one
        for one in estimates
    ]


def estimate_tissue(sums: SpecimenSums, solution: Solution) -> TissueEstimate:
    """Reported parameters of the chosen model.

    Parameters
    ----------
    sums : SpecimenSums
    solution : Solution

    Returns
    -------
    TissueEstimate
    """
    model, theta, covariance, inverse, bounded = in_field_units(sums, solution)
    parameters = _static_estimates(model, theta, covariance)
    intervals = []
    for branch in range(model.branches):
        interval = profile_interval(
            solution.objective,
            solution.evaluation,
            branch,
            sigma2=solution.noise.sigma2,
            inverse=inverse,
            bounds=sums.log_tau_bounds,
        )
        intervals.append(interval)
        found = _branch_estimates(model, theta, covariance, branch, interval)
        parameters += _with_profile(found, model, solution, branch, inverse, sums.log_tau_bounds)
    return TissueEstimate(
        model=model,
        theta=theta,
        covariance=np.where(np.isfinite(covariance), covariance, 0.0),
        parameters=tuple(parameters),
        intervals=tuple(intervals),
        bounded=bounded,
    )
