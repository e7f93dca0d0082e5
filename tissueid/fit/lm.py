"""Levenberg-Marquardt through lmfit, on a residual compressed to the size of the model.

The Gram matrix of a log has a factor R with ``R'R = gram``; ``R @ w`` for the column weights ``w`` of a
model has the same norm, and the same Gauss-Newton matrix, as the residual over all samples.  lmfit
sees a few hundred rows instead of millions; degrees of freedom are corrected to the number of samples.
Parameters are the cone coordinates of the passive polynomials, ln tau, and the random effects.

Beside it only :mod:`tissueid.fit.contact_law` sees lmfit.
"""

from __future__ import annotations

from dataclasses import dataclass

import lmfit
import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood import partial
from tissueid.likelihood.basis import KernelBasis
from tissueid.likelihood.objective import Evaluation, PartialObjective, PooledObjective
from tissueid.likelihood.sums import N_STATIC
from tissueid.model.polynomial import coordinates, coordinates_jacobian, from_coordinates, n_bounded

__all__ = ["LmResult", "levenberg_marquardt"]

FloatArray = NDArray[np.float64]

#: Relative change of the parameters, and of the sum of squares, that ends the iteration; the latter is
#: quadratic in the former and must be near rounding not to stop at half the digits.
TOLERANCE = 1e-11
VALUE_TOLERANCE = 1e-15
MAX_EVALUATIONS = 400
#: A cone coordinate at zero has no slope; the start is moved off it by this fraction.
START_LIFT = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class LmResult:
    """Where Levenberg-Marquardt ended.

    Attributes
    ----------
    value : float
        (Penalised) sum of squares [N^2].
    theta : ndarray
        Coefficients by powers of u.
    log_tau : ndarray
    evaluations : int
    converged : bool
    message : str
    """

    value: float
    theta: FloatArray
    log_tau: FloatArray
    evaluations: int
    converged: bool
    message: str


@dataclass(frozen=True, slots=True, eq=False)
class _Compressed:
    """Factor of each log and how parameters become column weights."""

    factors: tuple[FloatArray, ...]
    basis: KernelBasis
    blocks: tuple[int, ...]
    branches: int
    degree: int
    columns_degree: int
    scale: float
    static: int
    random_effects: bool
    weight_gain: float
    weight_offset: FloatArray

    def polynomials(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Theta and its derivative by the cone coordinates."""
        theta = np.empty(values.size)
        jacobian = np.zeros((values.size, values.size))
        first = 0
        for size in self.blocks:
            span = slice(first, first + size)
            theta[span] = from_coordinates(values[span])
            jacobian[span, span] = coordinates_jacobian(values[span])
            first += size
        return theta, jacobian

    def node_weights(
        self, columns: FloatArray, log_tau: FloatArray, c: FloatArray, dc: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Weights of the stored columns for column weights (.., p), and their slope by each ln tau."""
        nodes = self.basis.tau_s.size
        rows = self.static + nodes * (self.columns_degree + 1) + 1
        out = np.zeros((rows, *columns.shape[1:]))
        slope = np.zeros((rows, log_tau.size, *columns.shape[1:]))
        out[: self.static] = columns[: self.static]
        for j in range(log_tau.size):
            for p in range(self.degree + 1):
                weight = columns[self.static + j * (self.degree + 1) + p]
                span = slice(self.static + p * nodes, self.static + (p + 1) * nodes)
                out[span] += np.multiply.outer(c[:, j], weight)
                slope[span, j] += np.multiply.outer(dc[:, j], weight)
        return out, slope


def _factor(gram: FloatArray) -> FloatArray:
    """R with R'R = gram, directions lost in rounding dropped."""
    unit = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / unit[:, None] / unit)
    keep = values > values[-1] * 1e-15
    return np.asarray((vectors[:, keep] * np.sqrt(values[keep])).T * unit)


def _compress(objective: PooledObjective | PartialObjective) -> _Compressed:
    if isinstance(objective, PartialObjective):
        factors = tuple(_factor(objective.gram[i]) for i in objective.logs)
        static, random_effects = N_STATIC, True
        weight_gain, weight_offset = objective.weight_gain, objective.weight_offset
    else:
        factors = (_factor(objective.gram),)
        static, random_effects = (N_STATIC - 1 if objective.static else 0), False
        weight_gain, weight_offset = 0.0, np.zeros(1)
    return _Compressed(
        factors=factors,
        basis=objective.basis,
        blocks=tuple(int(size) for size in objective.blocks),
        branches=objective.branches,
        degree=objective.degree,
        columns_degree=objective.columns_degree,
        scale=objective.scale,
        static=static,
        random_effects=random_effects,
        weight_gain=weight_gain,
        weight_offset=weight_offset,
    )


def _column_scale(problem: _Compressed) -> FloatArray:
    """From powers of u to powers of x, for the pooled column weights."""
    static = problem.scale ** -np.arange(1.0, N_STATIC) if problem.static else np.zeros(0)
    return np.concatenate(
        [static, np.tile(problem.scale ** -np.arange(problem.degree + 1.0), problem.branches)]
    )


def _residual_and_jacobian(problem: _Compressed, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compressed residual and its derivative by (cone coordinates, ln tau, gamma, delta)."""
    p = sum(problem.blocks)
    branches = problem.branches
    theta, by_coordinate = problem.polynomials(vector[:p])
    log_tau = vector[p : p + branches]
    c, dc = problem.basis.weights(log_tau) if branches else (np.zeros((0, 0)), np.zeros((0, 0)))
    logs = len(problem.factors)
    gamma = vector[p + branches : p + branches + logs] if problem.random_effects else np.zeros(logs)
    delta = vector[p + branches + logs :] if problem.random_effects else np.zeros(logs)
    residuals, jacobians = [], []
    for i, factor in enumerate(problem.factors):
        jacobian = np.zeros((factor.shape[0], vector.size))
        if problem.random_effects:
            matrix, shifted = partial.coefficients(
                gamma[i], delta[i], problem.scale, problem.degree, branches
            )
        else:
            matrix, shifted = np.diag(_column_scale(problem)), np.zeros((p, p))
        columns = np.column_stack([matrix @ theta, shifted @ theta, matrix @ by_coordinate])
        weights, slope = problem.node_weights(columns, log_tau, c, dc)
        weights[-1, 0] = -1.0
        residuals.append(factor @ weights[:, 0])
        jacobian[:, :p] = factor @ weights[:, 2:]
        jacobian[:, p : p + branches] = factor @ slope[:, :, 0]
        if problem.random_effects:
            bare = weights[:, 0].copy()
            bare[-1] = 0.0
            jacobian[:, p + branches + i] = factor @ bare
            jacobian[:, p + branches + logs + i] = factor @ weights[:, 1]
        jacobians.append(jacobian)
    if problem.random_effects:
        root = np.concatenate([np.full(logs, np.sqrt(problem.weight_gain)), np.sqrt(problem.weight_offset)])
        prior = np.zeros((2 * logs, vector.size))
        prior[:, p + branches :] = np.diag(root)
        residuals.append(root * vector[p + branches :])
        jacobians.append(prior)
    return np.concatenate(residuals), np.concatenate(jacobians)


def _parameters(problem: _Compressed, start: Evaluation, bounds: tuple[float, float]) -> lmfit.Parameters:
    parameters = lmfit.Parameters()
    first = 0
    for block, size in enumerate(problem.blocks):
        values = coordinates(start.theta[first : first + size])
        lift = START_LIFT * max(np.abs(values).max(initial=0.0), 1e-6)
        bounded = n_bounded(size - 1)
        for k, value in enumerate(np.maximum(values, lift)):
            parameters.add(f"q{block}_{k}", value=value, min=0.0 if k in bounded else -np.inf)
        first += size
    for j, value in enumerate(start.log_tau):
        inside = float(np.clip(value, bounds[0] + 1e-6, bounds[1] - 1e-6))
        parameters.add(f"ln_tau_{j}", value=inside, min=bounds[0], max=bounds[1])
    if problem.random_effects:
        for i, value in enumerate(start.gamma):
            parameters.add(f"gamma_{i}", value=value)
        for i, value in enumerate(start.delta):
            parameters.add(f"delta_{i}", value=value)
    return parameters


def _at_least(rows: FloatArray, count: int) -> FloatArray:
    """Rows of zeros appended up to a count: leastsq wants as many residuals as parameters."""
    short = max(count - rows.shape[0], 0)
    return np.concatenate([rows, np.zeros((short, *rows.shape[1:]))])


def levenberg_marquardt(
    objective: PooledObjective | PartialObjective, start: Evaluation, bounds: tuple[float, float]
) -> LmResult:
    """Minimise the same objective as the variable projection, by lmfit's leastsq from a rough start.

    Parameters
    ----------
    objective : PooledObjective or PartialObjective
    start : Evaluation
        Anything in the basin; a scan point, not the polished optimum, so that the two are independent.
    bounds : tuple of float
        Range of ln tau.

    Returns
    -------
    LmResult
    """
    problem = _compress(objective)
    initial = _parameters(problem, start, bounds)

    def residual(parameters: lmfit.Parameters) -> FloatArray:
        rows = _residual_and_jacobian(problem, np.array([p.value for p in parameters.values()]))[0]
        return _at_least(rows, len(initial))

    def jacobian(parameters: lmfit.Parameters) -> FloatArray:
        rows = _residual_and_jacobian(problem, np.array([p.value for p in parameters.values()]))[1]
        return _at_least(rows, len(initial))

    found = lmfit.minimize(
        residual,
        initial,
        method="leastsq",
        Dfun=jacobian,
        ftol=VALUE_TOLERANCE,
        xtol=TOLERANCE,
        gtol=0.0,
        max_nfev=MAX_EVALUATIONS,
        calc_covar=False,
    )
    vector = np.array([p.value for p in found.params.values()])
    p = sum(problem.blocks)
    theta, _ = problem.polynomials(vector[:p])
    return LmResult(
        value=float(found.chisqr),
        theta=theta,
        log_tau=vector[p : p + problem.branches],
        evaluations=int(found.nfev),
        converged=bool(found.success) or int(getattr(found, "ier", 0)) in (1, 2, 3, 4, 6, 7, 8),
        message=str(getattr(found, "lmdif_message", found.message)),
    )
