"""From an optimum to reported parameters, each with its standard error and its verdict.

Viscosity eta = K tau comes first in every verdict: a ramp determines K tau v long before it determines K
and tau (their correlation is -0.99 and worse).  Where K varies with depth, eta is taken at half the
fitted depth.  Standard errors are those of white noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Candidate, Noise, Solution, SpecimenSums, objective_for
from tissueid.fit.search import unbounded_covariance
from tissueid.likelihood.cone import cone_least_squares
from tissueid.likelihood.identifiability import MAX_WIDTH, ProfileInterval, profile_interval, width_of
from tissueid.likelihood.objective import PooledObjective, cone_start
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt
from tissueid.result import Estimate

__all__ = ["TissueEstimate", "estimate_tissue"]

FloatArray = NDArray[np.float64]


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


def _second_stage_static(sums: SpecimenSums, solution: Solution) -> tuple[FloatArray, FloatArray]:
    """Static curve of a per-log fit: one passive curve for all logs, K and tau as identified.

    Returns its coefficients by powers of u (3,) and their covariance (3, 3).
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
    b = q[:STATIC_DEGREE, -1] - q[:STATIC_DEGREE, STATIC_DEGREE:p] @ k
    theta, _, _ = cone_least_squares(np.ascontiguousarray(h), b, blocks, cone_start(blocks))
    full = np.concatenate([theta, k])
    value = q[-1, -1] - 2.0 * q[:p, -1] @ full + full @ q[:p, :p] @ full
    return theta, np.linalg.pinv(h, hermitian=True) * float(value) / max(sums.n - STATIC_DEGREE, 1)


def _in_field_units(
    sums: SpecimenSums, solution: Solution
) -> tuple[KelvinVoigt, FloatArray, FloatArray, FloatArray, bool]:
    """Model, theta, covariance, inverse curvature of ln tau, and whether a bound is active."""
    candidate, found = solution.candidate, solution.evaluation
    inverse, bounded = unbounded_covariance(found, solution.objective.blocks)
    branches, size = candidate.branches, candidate.degree + 1
    offset = found.theta.size - branches * size
    static, static_covariance = (
        (found.theta[:offset], inverse[:offset, :offset] * solution.noise.sigma2)
        if offset
        else _second_stage_static(sums, solution)
    )
    model = KelvinVoigt(branches=branches, stiffness_degree=candidate.degree, depth_mm=sums.depth_mm)
    powers = sums.depth_mm ** -np.arange(float(size))
    stiffness = found.theta[offset:].reshape(branches, size) * powers
    tau = np.exp(found.log_tau)
    theta = model.join(static * sums.depth_mm ** -np.arange(1.0, STATIC_DEGREE + 1), stiffness, tau)
    # d theta / d (u coefficients, ln tau)
    p = theta.size
    change = np.zeros((p, inverse.shape[0]))
    if offset:
        change[:STATIC_DEGREE, :STATIC_DEGREE] = np.diag(sums.depth_mm ** -np.arange(1.0, STATIC_DEGREE + 1))
    for j in range(branches):
        row = STATIC_DEGREE + j * (size + 1)
        for k in range(size):
            change[row + k, offset + j * size + k] = powers[k]
        change[row + size, found.theta.size + j] = tau[j]
    finite = np.where(np.isfinite(inverse), inverse, 0.0)
    covariance = change @ finite @ change.T * solution.noise.sigma2
    if not offset:
        scale = np.diag(sums.depth_mm ** -np.arange(1.0, STATIC_DEGREE + 1))
        covariance[:STATIC_DEGREE, :STATIC_DEGREE] = scale @ static_covariance @ scale
    for j in range(branches):
        if not np.isfinite(inverse[found.theta.size + j, found.theta.size + j]):
            at = STATIC_DEGREE + j * (size + 1) + size
            covariance[at, at] = np.inf
    return model, theta, covariance, inverse[found.theta.size :, found.theta.size :], bounded


def _estimate(
    name: str, symbol: str, unit: str, number: float, stderr: float, verdict: tuple[bool, float]
) -> Estimate:
    identified, width = verdict
    finite = bool(np.isfinite(stderr))
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
        },
    )


def _curve_verdict(values: FloatArray, basis: FloatArray, covariance: FloatArray) -> tuple[bool, float]:
    """Whether a curve is known to within a factor e, and its widest relative interval."""
    spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", basis, covariance, basis), 0.0))
    width = max(width_of(float(v), float(s)) for v, s in zip(values, spread, strict=True))
    return width <= MAX_WIDTH, width


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
    model, theta, covariance, inverse, bounded = _in_field_units(sums, solution)
    noise: Noise = solution.noise
    stderr = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    specs = model.parameters
    half = np.array([0.5, 1.0]) * sums.depth_mm
    static_basis = half[:, None] ** np.arange(1.0, STATIC_DEGREE + 1)
    static_verdict = _curve_verdict(
        model.static_force(theta, half), static_basis, covariance[:STATIC_DEGREE, :STATIC_DEGREE]
    )
    parameters = [
        _estimate(
            specs[k].name, specs[k].symbol, specs[k].unit, float(theta[k]), float(stderr[k]), static_verdict
        )
        for k in range(STATIC_DEGREE)
    ]
    intervals = []
    size = model.stiffness_degree + 1
    reference = 0.5 * sums.depth_mm if model.stiffness_degree else 0.0
    at_reference = reference ** np.arange(float(size))
    for j in range(model.branches):
        interval = profile_interval(
            solution.objective,
            solution.evaluation,
            j,
            sigma2=noise.sigma2,
            inverse=inverse,
            bounds=sums.log_tau_bounds,
        )
        intervals.append(interval)
        first = STATIC_DEGREE + j * (size + 1)
        span = slice(first, first + size)
        stiffness = float(theta[span] @ at_reference)
        k_verdict = _curve_verdict(np.array([stiffness]), at_reference[None], covariance[span, span])
        parameters += [
            _estimate(
                specs[i].name, specs[i].symbol, specs[i].unit, float(theta[i]), float(stderr[i]), k_verdict
            )
            for i in range(first, first + size)
        ]
        tau_index = first + size
        tau = float(theta[tau_index])
        tau_estimate = _estimate(
            specs[tau_index].name,
            specs[tau_index].symbol,
            "s",
            tau,
            float(stderr[tau_index]),
            (interval.identified, interval.width),
        )
        detail = dict(tau_estimate.detail) | {
            "profile_ci95": [float(np.exp(interval.low)), float(np.exp(interval.high))],
            "open_low": interval.open_low,
            "open_high": interval.open_high,
        }
        parameters.append(
            Estimate(
                name=tau_estimate.name,
                symbol=tau_estimate.symbol,
                unit="s",
                value=tau_estimate.value,
                stderr=tau_estimate.stderr,
                identified=tau_estimate.identified,
                detail=detail,
            )
        )
        suffix = "" if j == 0 else f"_b{j + 1}"
        slope = np.zeros(theta.size)
        slope[span] = at_reference * tau
        slope[tau_index] = stiffness
        with np.errstate(invalid="ignore"):
            variance = float(slope @ np.where(slope[:, None] * slope != 0.0, covariance, 0.0) @ slope)
        eta_stderr = float(np.sqrt(max(variance, 0.0)))
        width = width_of(stiffness * tau, eta_stderr)
        parameters.append(
            _estimate(
                f"viscosity_N_s_per_mm{suffix}",
                "eta" if j == 0 else f"eta{j + 1}",
                "N s/mm",
                stiffness * tau,
                eta_stderr,
                (width <= MAX_WIDTH, width),
            )
        )
    return TissueEstimate(
        model=model,
        theta=theta,
        covariance=np.where(np.isfinite(covariance), covariance, 0.0),
        parameters=tuple(parameters),
        intervals=tuple(intervals),
        bounded=bounded,
    )
