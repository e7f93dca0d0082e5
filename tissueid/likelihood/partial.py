"""The penalised Gaussian likelihood of several logs of one specimen, as quadratic forms.

Log i of a specimen is ``e^{gamma_i} [F_s(x - delta_i) + sum_j K_j(x - delta_i) s_j]`` plus white noise: one
tissue for all logs, times a gain, shifted by an error of the contact point (model.md 2b).  gamma_i
and delta_i are random effects with standard deviations sigma_g and sigma_i; maximised together with
the rest, they add ``sigma^2 (gamma_i^2 / sigma_g^2 + delta_i^2 / sigma_i^2)`` to the sum of squares.

Everything here works on reduced Gram matrices (:func:`tissueid.likelihood.sums.reduction`), whose
size is that of the model; nothing depends on the number of samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.compiled import kernel
from tissueid.likelihood.cone import cone_least_squares

__all__ = ["assemble", "coefficients", "marginal_terms", "objective", "solve"]

FloatArray = NDArray[np.float64]

STATIC_COLUMNS = 4
STATIC_PARAMETERS = 3
#: Random effects of a log: ln gain and contact offset.
NUISANCES = 2
#: Outer Gauss-Newton rounds; three to six are usual.
MAX_ROUNDS = 60
#: Ridge, relative to the scaled diagonal, for directions the data do not determine.
RIDGE = 1e-13
#: Relative fall of the objective that counts as none.
CONVERGED = 1e-14
#: The same, of the fall that a step promises: a sum of squares from a Gram matrix is known to some 1e-13.
EXHAUSTED = 1e-12
HALVINGS = 30
#: Rounding of the objective, a difference of numbers as large as the recorded forces squared, over their sum.
ROUNDING = 2.0**-48


@kernel()
def _fill_powers(
    factor: float, away: float, k: int, row: int, column: int, matrix: FloatArray, shifted: FloatArray
) -> None:
    """Write ``factor (x - delta)^k`` by powers of x, and its derivative ``-k (x - delta)^(k-1)``.

    ``away`` is minus delta; constants stand in ``row``.
    """
    binomial = 1.0
    power = 1.0
    before = 0.0
    for i in range(k + 1):
        matrix[row + k - i, column] = factor * binomial * power
        shifted[row + k - i, column] = -factor * binomial * i * before
        binomial = binomial * (k - i) / (i + 1)
        before = power
        power *= away


@kernel()
def _fill_coefficients(
    gamma: float, delta: float, scale: float, degree: int, branches: int, matrix: FloatArray,
    shifted: FloatArray,
) -> None:  # fmt: skip
    """Write what :func:`coefficients` returns, where it is not zero for all logs."""
    gain = np.exp(gamma)
    factor = gain
    for k in range(1, STATIC_PARAMETERS + 1):
        factor /= scale
        _fill_powers(factor, -delta, k, 0, k - 1, matrix, shifted)
    for j in range(branches):
        at = j * (degree + 1)
        factor = gain
        for k in range(degree + 1):
            _fill_powers(factor, -delta, k, STATIC_COLUMNS + at, STATIC_PARAMETERS + at + k, matrix, shifted)
            factor /= scale


@kernel()
def coefficients(
    gamma: float, delta: float, scale: float, degree: int, branches: int
) -> tuple[FloatArray, FloatArray]:
    """Weights of the design columns for one log, and the matrix that is linear in theta.

    Parameters
    ----------
    gamma, delta : float
        Log gain and contact offset [mm].
    scale : float
        Depth at which u = x / scale is 1 [mm]; theta holds the coefficients of F_s/x (3) and then of
        each K by powers of u.

    Returns
    -------
    matrix : ndarray, shape (4 + branches * (degree + 1), p)
        Column weights by theta.
    shifted : ndarray, same shape
        Its derivative by delta.
    """
    size = branches * (degree + 1)
    matrix = np.zeros((STATIC_COLUMNS + size, STATIC_PARAMETERS + size))
    shifted = np.zeros((STATIC_COLUMNS + size, STATIC_PARAMETERS + size))
    _fill_coefficients(gamma, delta, scale, degree, branches, matrix, shifted)
    return matrix, shifted


@kernel()
def objective(
    q: FloatArray,
    theta: FloatArray,
    gamma: FloatArray,
    delta: FloatArray,
    weight_gain: float,
    weight_offset: FloatArray,
    scale: float,
    degree: int,
    branches: int,
) -> float:
    """Penalised sum of squares [N^2].

    Parameters
    ----------
    q : ndarray, shape (logs, r, r)
        Reduced Gram matrices.
    weight_gain : float
        (sigma / sigma_g)^2 [N^2].
    weight_offset : ndarray, shape (logs,)
        (sigma / sigma_i)^2 [N^2/mm^2].
    """
    total = 0.0
    size = branches * (degree + 1)
    m = STATIC_COLUMNS + size
    y = q.shape[1] - 1
    matrix, shifted = np.zeros((2, m, STATIC_PARAMETERS + size))
    beta = np.empty(m)
    for i in range(q.shape[0]):
        _fill_coefficients(gamma[i], delta[i], scale, degree, branches, matrix, shifted)
        _times(matrix, theta, beta)
        left = q[i, y, y]
        for r in range(m):
            value = -2.0 * q[i, r, y]
            for k in range(m):
                value += q[i, r, k] * beta[k]
            left += beta[r] * value
        total += left
        total += weight_gain * gamma[i] ** 2 + weight_offset[i] * delta[i] ** 2
    return total


@kernel()
def _times(matrix: FloatArray, x: FloatArray, out: FloatArray) -> None:
    """Write a product with a vector; these are too small for BLAS, whose calls cost more than their work."""
    for i in range(matrix.shape[0]):
        total = 0.0
        for k in range(matrix.shape[1]):
            total += matrix[i, k] * x[k]
        out[i] = total


@kernel()
def _gram_times(q: FloatArray, i: int, rows: FloatArray, out: FloatArray) -> None:
    """Write ``rows @ q[i]`` where most entries of the rows are zero; the matrix is symmetric."""
    full = rows.shape[1]
    for r in range(rows.shape[0]):
        for k in range(full):
            out[r, k] = 0.0
        for k in range(full):
            w = rows[r, k]
            if w != 0.0:
                for c in range(full):
                    out[r, c] += w * q[i, k, c]


@kernel()
def _dot(x: FloatArray, y: FloatArray) -> float:
    total = 0.0
    for k in range(x.size):
        total += x[k] * y[k]
    return total


@kernel()
def _derivatives(
    theta: FloatArray, gamma: float, delta: float, scale: float, degree: int, branches: int,
    work: tuple[FloatArray, FloatArray, FloatArray], a: FloatArray, n: FloatArray,
) -> None:  # fmt: skip
    """Write the rows of one log's columns' weights, by (theta, ln tau) and by its two nuisances."""
    matrix, shifted, beta = work
    m, p = matrix.shape
    _fill_coefficients(gamma, delta, scale, degree, branches, matrix, shifted)
    _times(shifted, theta, beta)
    n[1, :m] = beta
    _times(matrix, theta, beta)
    n[0, :m] = beta
    for k in range(p):
        for r in range(m):
            a[k, r] = matrix[r, k]
    for j in range(branches):
        for k in range(degree + 1):
            at = j * (degree + 1) + k
            a[p + j, m + at] = beta[STATIC_COLUMNS + at]


@kernel()
def assemble(
    q: FloatArray,
    theta: FloatArray,
    gamma: FloatArray,
    delta: FloatArray,
    weight_gain: float,
    weight_offset: FloatArray,
    scale: float,
    degree: int,
    branches: int,
) -> tuple[FloatArray, FloatArray, float, FloatArray, float]:
    """Quadratic form in (theta, change of ln tau), the random effects eliminated.

    The model is linearised in gamma and delta at their current values and in ln tau at theta.

    Returns
    -------
    h : ndarray, shape (p + branches, p + branches)
    b : ndarray, shape (p + branches,)
    c : float
        The objective is ``c - 2 b'v + v'hv`` with ``v = (theta, change of ln tau)``.
    back : ndarray, shape (logs, 2, p + branches + 1)
        Nuisances of a log are ``back[:, :-1] @ v + back[:, -1]``.
    log_det : float
        Sum over logs of ln det(nuisance curvature), for the marginal likelihood.
    """
    logs, p, y = q.shape[0], theta.size, q.shape[1] - 1
    size = branches * (degree + 1)
    m, full, v = STATIC_COLUMNS + size, STATIC_COLUMNS + 2 * size, p + branches
    h, b, c, log_det = np.zeros((v, v)), np.zeros(v), 0.0, 0.0
    back = np.zeros((logs, NUISANCES, v + 1))
    matrix, shifted = np.zeros((2, m, p))
    work = (matrix, shifted, np.empty(m))
    a, n = np.zeros((v, full)), np.zeros((NUISANCES, full))
    ga, gn = np.empty((v, full)), np.empty((NUISANCES, full))
    target, cross = np.empty(full), np.empty((NUISANCES, v))
    for i in range(logs):
        _derivatives(theta, gamma[i], delta[i], scale, degree, branches, work, a, n)
        _gram_times(q, i, a, ga)
        _gram_times(q, i, n, gn)
        gain, offset = gamma[i], delta[i]
        yy = q[i, y, y]
        for k in range(full):
            explained = gain * gn[0, k] + offset * gn[1, k]
            yy += (gain * n[0, k] + offset * n[1, k]) * (2.0 * q[i, k, y] + explained)
            target[k] = q[i, k, y] + explained
        s00, s01, s11 = _dot(n[0], gn[0]), _dot(n[0], gn[1]), _dot(n[1], gn[1])
        s00 += weight_gain
        s11 += weight_offset[i]
        determinant = s00 * s11 - s01 * s01
        log_det += np.log(determinant)
        here0, here1 = _dot(n[0], target), _dot(n[1], target)
        back[i, 0, v] = (s11 * here0 - s01 * here1) / determinant
        back[i, 1, v] = (s00 * here1 - s01 * here0) / determinant
        for k in range(v):
            cross[0, k], cross[1, k] = _dot(a[k], gn[0]), _dot(a[k], gn[1])
            back[i, 0, k] = -(s11 * cross[0, k] - s01 * cross[1, k]) / determinant
            back[i, 1, k] = -(s00 * cross[1, k] - s01 * cross[0, k]) / determinant
        for k in range(v):
            b[k] += _dot(a[k], target) - cross[0, k] * back[i, 0, v] - cross[1, k] * back[i, 1, v]
            for r in range(k + 1):
                h[k, r] += _dot(a[k], ga[r]) + cross[0, k] * back[i, 0, r] + cross[1, k] * back[i, 1, r]
        c += yy - here0 * back[i, 0, v] - here1 * back[i, 1, v]
    for k in range(v):
        for r in range(k):
            h[r, k] = h[k, r]
    return h, b, c, back, log_det


@kernel()
def _nuisances(back: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Logarithmic gain and contact offset of every log that belong to theta, at the same relaxation times."""
    logs, p = back.shape[0], theta.size
    gamma = np.zeros(logs)
    delta = np.zeros(logs)
    for i in range(logs):
        gamma[i] = np.sum(back[i, 0, :p] * theta) + back[i, 0, back.shape[2] - 1]
        delta[i] = np.sum(back[i, 1, :p] * theta) + back[i, 1, back.shape[2] - 1]
    return gamma, delta


@kernel()
def solve(
    q: FloatArray,
    theta: FloatArray,
    gamma: FloatArray,
    delta: FloatArray,
    weight_gain: float,
    weight_offset: FloatArray,
    scale: float,
    degree: int,
    branches: int,
    blocks: NDArray[np.int64],
    start: FloatArray,
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Best passive theta and random effects at fixed relaxation times.

    Gauss-Newton rounds, each a passive least-squares problem with the random effects eliminated; the
    step is halved where the objective would rise.

    Returns
    -------
    value : float
        Penalised sum of squares [N^2].
    theta, gamma, delta : ndarray
    generators, weights : ndarray
        Support of theta (see :mod:`tissueid.likelihood.cone`).
    """
    p = theta.size
    value = np.inf
    generators = start
    weights = np.zeros(p)
    rounding = ROUNDING * np.sum(q[:, -1, -1])
    if np.abs(theta).max() > 0.0:
        value = objective(q, theta, gamma, delta, weight_gain, weight_offset, scale, degree, branches)
    for _ in range(MAX_ROUNDS):
        h, b, c, back, _ = assemble(
            q, theta, gamma, delta, weight_gain, weight_offset, scale, degree, branches
        )
        hp = np.ascontiguousarray(h[:p, :p])
        bp = np.ascontiguousarray(b[:p])
        new_theta, new_generators, new_weights = cone_least_squares(hp, bp, blocks, start)
        expected = c - 2.0 * np.sum(bp * new_theta) + np.sum(new_theta * (hp @ new_theta))
        new_gamma, new_delta = _nuisances(back, new_theta)
        fraction = 1.0
        best = np.inf
        trial_theta, trial_gamma, trial_delta = new_theta, new_gamma, new_delta
        # a step that promises no more than rounding is taken whole or not at all
        exhausted = np.isfinite(value) and value - expected <= max(EXHAUSTED * value, rounding)
        for _halving in range(1 if exhausted else HALVINGS):
            trial_theta = theta + fraction * (new_theta - theta)
            trial_gamma = gamma + fraction * (new_gamma - gamma)
            trial_delta = delta + fraction * (new_delta - delta)
            best = objective(
                q, trial_theta, trial_gamma, trial_delta, weight_gain, weight_offset, scale, degree,
                branches,
            )  # fmt: skip
            # a sum of squares below zero is rounding of numbers too large to subtract
            if 0.0 <= best <= value and np.isfinite(best):
                break
            fraction *= 0.5
        if not (0.0 <= best <= value and np.isfinite(best)):
            # no fall along the step, or numbers that are none: the last point stands
            if np.abs(weights).max() == 0.0:
                generators, weights = new_generators, new_weights
            break
        fall = value - best
        theta, gamma, delta = trial_theta, trial_gamma, trial_delta
        generators, weights = new_generators, new_weights
        value = best
        if fall <= CONVERGED * abs(best):
            break
    return value, theta, gamma, delta, generators, weights


def marginal_terms(
    q: FloatArray,
    theta: FloatArray,
    gamma: FloatArray,
    delta: FloatArray,
    sigma2: float,
    gain_sd: FloatArray,
    offset_sd: FloatArray,
    scale: float,
    degree: int,
    branches: int,
) -> FloatArray:
    """-2 ln of the restricted marginal likelihood for a series of sigma_g, the linearisation kept.

    Parameters
    ----------
    sigma2 : float
        Noise variance [N^2].
    gain_sd : ndarray, shape (k,)
        Candidate standard deviations of the log gain.
    offset_sd : ndarray, shape (logs,)
        Standard deviation of each contact point [mm].

    Returns
    -------
    ndarray, shape (k,)
    """
    logs = q.shape[0]
    out = np.empty(gain_sd.size)
    weight_offset = sigma2 / offset_sd**2
    for index, spread in enumerate(gain_sd):
        weight = sigma2 / spread**2
        h, b, c, _, log_det = assemble(q, theta, gamma, delta, weight, weight_offset, scale, degree, branches)
        unit = 1.0 / np.sqrt(np.maximum(np.diag(h), 1e-300))
        scaled = h * unit[:, None] * unit + RIDGE * np.eye(unit.size)
        solution = np.linalg.solve(scaled, b * unit) * unit
        least = c - 2.0 * b @ solution + solution @ (h @ solution)
        out[index] = least / sigma2 + log_det - logs * np.log(weight) - np.log(weight_offset).sum()
        out[index] += np.linalg.slogdet(scaled)[1] - 2.0 * np.log(unit).sum()
    return out
