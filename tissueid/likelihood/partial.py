"""The penalised Gaussian likelihood of several logs of one specimen, as quadratic forms.

Log i of a specimen is ``e^{gamma_i} [F_s(x - delta_i) + sum_j K_j(x - delta_i) s_j]`` plus white noise: one
tissue for all logs, times a gain, shifted by an error of the contact point (model.md 2b).  gamma_i
and delta_i are random effects with standard deviations sigma_g and sigma_i; maximised together with
the rest, they add ``sigma^2 (gamma_i^2 / sigma_g^2 + delta_i^2 / sigma_i^2)`` to the sum of squares.

Everything here works on reduced Gram matrices (:func:`tissueid.likelihood.sums.reduction`), whose
size is that of the model; nothing depends on the number of samples.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

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


@nb.njit(cache=True, nogil=True, error_model="numpy")
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
    offset = STATIC_PARAMETERS
    matrix = np.zeros((STATIC_COLUMNS + size, offset + size))
    shifted = np.zeros((STATIC_COLUMNS + size, offset + size))
    gain = np.exp(gamma)
    for k in range(1, offset + 1):
        factor = gain / scale**k
        # (x - delta)^k by powers of x, and its derivative -k (x - delta)^(k-1)
        binomial = 1.0
        for i in range(k + 1):
            matrix[k - i, k - 1] += factor * binomial * (-delta) ** i
            if i > 0:
                shifted[k - i, k - 1] += -factor * binomial * i * (-delta) ** (i - 1)
            binomial = binomial * (k - i) / (i + 1)
    for j in range(branches):
        for k in range(degree + 1):
            factor = gain / scale**k
            column = offset + j * (degree + 1) + k
            base = STATIC_COLUMNS + j * (degree + 1)
            binomial = 1.0
            for i in range(k + 1):
                matrix[base + k - i, column] += factor * binomial * (-delta) ** i
                if i > 0:
                    shifted[base + k - i, column] += -factor * binomial * i * (-delta) ** (i - 1)
                binomial = binomial * (k - i) / (i + 1)
    return matrix, shifted


@nb.njit(cache=True, nogil=True, error_model="numpy")
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
    m = STATIC_COLUMNS + branches * (degree + 1)
    y = q.shape[1] - 1
    for i in range(q.shape[0]):
        matrix, _ = coefficients(gamma[i], delta[i], scale, degree, branches)
        beta = matrix @ theta
        g = np.ascontiguousarray(q[i, :m, :m])
        total += q[i, y, y] - 2.0 * beta @ np.ascontiguousarray(q[i, :m, y]) + beta @ (g @ beta)
        total += weight_gain * gamma[i] ** 2 + weight_offset[i] * delta[i] ** 2
    return total


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _derivatives(
    theta: FloatArray, gamma: float, delta: float, scale: float, degree: int, branches: int
) -> tuple[FloatArray, FloatArray]:
    """Of one log's columns' weights, by (theta, ln tau) and by its two nuisances."""
    size = branches * (degree + 1)
    m = STATIC_COLUMNS + size
    p = theta.size
    matrix, shifted = coefficients(gamma, delta, scale, degree, branches)
    beta = matrix @ theta
    a = np.zeros((m + size, p + branches))
    a[:m, :p] = matrix
    for j in range(branches):
        for k in range(degree + 1):
            at = j * (degree + 1) + k
            a[m + at, p + j] = beta[STATIC_COLUMNS + at]
    n = np.zeros((m + size, NUISANCES))
    n[:m, 0] = beta
    n[:m, 1] = shifted @ theta
    return a, n


@nb.njit(cache=True, nogil=True, error_model="numpy")
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
    logs = q.shape[0]
    full = STATIC_COLUMNS + 2 * branches * (degree + 1)
    y = q.shape[1] - 1
    v = theta.size + branches
    h = np.zeros((v, v))
    b = np.zeros(v)
    c = 0.0
    back = np.zeros((logs, NUISANCES, v + 1))
    log_det = 0.0
    for i in range(logs):
        a, n = _derivatives(theta, gamma[i], delta[i], scale, degree, branches)
        g = np.ascontiguousarray(q[i, :full, :full])
        qy = np.ascontiguousarray(q[i, :full, y])
        ga = g @ a
        gn = g @ n
        nt = np.ascontiguousarray(n.T)
        now = np.array([gamma[i], delta[i]])
        pull = gn @ now
        target = qy + pull
        s = nt @ gn
        yy = q[i, y, y] + 2.0 * (nt @ qy) @ now + now @ (s @ now)
        s[0, 0] += weight_gain
        s[1, 1] += weight_offset[i]
        determinant = s[0, 0] * s[1, 1] - s[0, 1] * s[1, 0]
        log_det += np.log(determinant)
        inverse = np.empty((NUISANCES, NUISANCES))
        inverse[0, 0] = s[1, 1] / determinant
        inverse[1, 1] = s[0, 0] / determinant
        inverse[0, 1] = -s[0, 1] / determinant
        inverse[1, 0] = inverse[0, 1]
        cross = np.ascontiguousarray(gn.T) @ a
        here = nt @ target
        slope = inverse @ cross
        level = inverse @ here
        at_ = np.ascontiguousarray(a.T)
        ct = np.ascontiguousarray(cross.T)
        h += at_ @ ga - ct @ slope
        b += at_ @ target - ct @ level
        c += yy - here @ level
        back[i, :, :v] = -slope
        back[i, :, v] = level
    return h, b, c, back, log_det


@nb.njit(cache=True, nogil=True, error_model="numpy")
def _nuisances(back: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Logarithmic gain and contact offset of every log that belong to theta, at the same relaxation times."""
    logs, p = back.shape[0], theta.size
    gamma = np.zeros(logs)
    delta = np.zeros(logs)
    for i in range(logs):
        gamma[i] = np.sum(back[i, 0, :p] * theta) + back[i, 0, back.shape[2] - 1]
        delta[i] = np.sum(back[i, 1, :p] * theta) + back[i, 1, back.shape[2] - 1]
    return gamma, delta


@nb.njit(cache=True, nogil=True, error_model="numpy")
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
        # where the step promises no more than rounding, a long line search would chase it in vain
        halvings = 2 if np.isfinite(value) and value - expected <= EXHAUSTED * value else HALVINGS
        for _halving in range(halvings):
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
