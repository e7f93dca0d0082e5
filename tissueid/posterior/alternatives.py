"""Evidence of kernels that are compared and never rendered: stretched exponential and power law.

Every completely monotone kernel is a mixture of exponentials, so its branch state is a weighted sum of the
node states that are summed anyway (:meth:`tissueid.likelihood.basis.KernelBasis.weights_of`).  The linear
coefficients and the effects of the logs are integrated as for the exponential branches, the cut to the
passive set included; ln tau and the kernel's shape by Laplace's rule, under uniform priors.  The spread of
the gains is that of the chosen model, the noise each model's own.  Exponentials go through the same
arithmetic, so that a difference is meant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from tissueid.fit.candidates import Solution, SpecimenSums
from tissueid.likelihood import partial
from tissueid.likelihood.objective import PartialObjective, cone_start
from tissueid.likelihood.passive_normal import log_passive_mass
from tissueid.likelihood.sums import N_STATIC
from tissueid.priors import WEAK_FACTOR

__all__ = ["FAMILIES", "Family", "KernelEvidence", "kernel_evidence"]

FloatArray = NDArray[np.float64]

STATIC_PARAMETERS = 3
#: Weight of an effect that a pooling has not: it stays at zero.
RIGID = 1e18
#: Steps of the Hessian, as a fraction of a parameter's range, and starts along ln tau.
HESSIAN_STEP = 0.004
STARTS = 7
#: Smallest curvature: a parameter that the data leave free keeps its prior.
FLAT = 1.0


@dataclass(frozen=True, slots=True)
class Family:
    """A kernel with a relaxation time and a shape.

    Attributes
    ----------
    name : str
    kernel : callable
        Values at times [s], for ln tau and shape.
    shape : tuple of float
        Range of the shape, its uniform prior.
    """

    name: str
    kernel: Callable[[FloatArray, float, float], FloatArray]
    shape: tuple[float, float]


def _stretched(time_s: FloatArray, log_tau: float, beta: float) -> FloatArray:
    return np.asarray(np.exp(-((time_s * np.exp(-log_tau)) ** beta)))


def _power(time_s: FloatArray, log_tau: float, alpha: float) -> FloatArray:
    return np.asarray((1.0 + time_s * np.exp(-log_tau)) ** -alpha)


#: Kohlrausch 1854 and Nutting 1921 in the form that is finite at t = 0.
FAMILIES = (
    Family("stretched exponential", _stretched, (0.2, 1.0)),
    Family("power law", _power, (0.05, 2.0)),
)


@dataclass(frozen=True, slots=True, eq=False)
class KernelEvidence:
    """What a kernel's fit says.

    Attributes
    ----------
    log_evidence : float
        Comparable among results for the same sums.
    parameters : ndarray
        ln(tau / s) and shape at the optimum, or the ln tau of exponentials.
    sigma2 : float
        Noise variance [N^2].
    """

    log_evidence: float
    parameters: FloatArray
    sigma2: float


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """The marginal likelihood of kernels given as weights of the nodes, shape (nodes, kernels)."""

    sums: SpecimenSums
    solution: Solution
    degree: int
    speed_mm_s: FloatArray
    depth_mm: FloatArray
    force_N: float

    def _columns(self, weights: FloatArray) -> FloatArray:
        nodes, kernels = weights.shape
        size = kernels * (self.degree + 1)
        rows = N_STATIC + nodes * (self.sums.columns_degree + 1) + 1
        columns = np.zeros((rows, N_STATIC + 2 * size + 1))
        columns[range(N_STATIC), range(N_STATIC)] = 1.0
        columns[-1, -1] = 1.0
        for j in range(kernels):
            for p in range(self.degree + 1):
                span = slice(N_STATIC + p * nodes, N_STATIC + (p + 1) * nodes)
                columns[span, N_STATIC + j * (self.degree + 1) + p] = weights[:, j]
        return columns

    def _precision(self, weights: FloatArray) -> FloatArray:
        """Weak priors: each part alone would carry twice the largest force at its largest state."""
        tau = self.sums.basis.tau_s
        speed, depth = self.speed_mm_s[:, None], self.depth_mm[:, None]
        states = -speed * tau * np.expm1(-depth / (speed * tau))
        largest = np.abs(states @ weights).max(axis=0)
        spread = WEAK_FACTOR * self.force_N
        blocks = [_bernstein(STATIC_PARAMETERS)]
        blocks += [_bernstein(self.degree + 1) * max(float(one), 1e-12) for one in largest]
        size = sum(one.shape[0] for one in blocks)
        out, at = np.zeros((size, size)), 0
        for one in blocks:
            k = one.shape[0]
            out[at : at + k, at : at + k] = one.T @ one / spread**2
            at += k
        return out

    def log_marginal(self, weights: FloatArray, sigma2: float) -> tuple[float, float]:
        """Ln p(force | kernels, sigma) up to a constant, and the least sum of squares."""
        sums, kernels = self.sums, weights.shape[1]
        columns = self._columns(weights)
        q = np.ascontiguousarray(np.stack([columns.T @ (sums.gram[i] @ columns) for i in sums.logs]))
        logs = q.shape[0]
        blocks = np.array([STATIC_PARAMETERS] + [self.degree + 1] * kernels, dtype=np.int64)
        p = int(blocks.sum())
        objective = self.solution.objective
        gain, offset = RIGID * sums.power, np.full(logs, RIGID * sums.power)
        if isinstance(objective, PartialObjective):
            gain, offset = objective.weight_gain, objective.weight_offset
        found = partial.solve(
            q, np.zeros(p), np.zeros(logs), np.zeros(logs), gain, offset, sums.depth_mm, self.degree, kernels,
            blocks, cone_start(blocks),
        )  # fmt: skip
        h, b, c, _, log_det = partial.assemble(
            q, *found[1:4], gain, offset, sums.depth_mm, self.degree, kernels
        )
        precision = self._precision(weights)
        a = h[:p, :p] / sigma2 + precision
        covariance = np.linalg.inv(a)
        mean = covariance @ b[:p] / sigma2
        value = (c - b[:p] @ mean) / sigma2 + sums.n * np.log(sigma2)
        value += np.linalg.slogdet(a)[1] - np.linalg.slogdet(precision)[1]
        value += log_det - logs * np.log(gain) - np.log(offset).sum()
        mass = log_passive_mass(mean, np.ascontiguousarray(covariance), blocks)
        mass -= log_passive_mass(np.zeros(p), np.ascontiguousarray(np.linalg.inv(precision)), blocks)
        return float(mass - 0.5 * value), float(found[0])


def _bernstein(size: int) -> FloatArray:
    """Bernstein coefficients from coefficients by powers of u, of up to degree 2."""
    full = np.array([[1.0, 0.0, 0.0], [1.0, 0.5, 0.0], [1.0, 1.0, 1.0]])
    return full if size == full.shape[0] else np.tril(np.ones((size, size)))


def _laplace(
    log_density: Callable[[FloatArray], float], starts: FloatArray, bounds: FloatArray
) -> tuple[float, FloatArray]:
    """Ln of the mean of a density over a box, and its mode."""
    width = bounds[:, 1] - bounds[:, 0]

    def falls(z: FloatArray) -> float:
        return -log_density(bounds[:, 0] + np.clip(z, 0.0, 1.0) * width) + 1e3 * float(
            (np.maximum(z - 1.0, 0.0) + np.maximum(-z, 0.0)).sum()
        )

    scaled = (starts - bounds[:, 0]) / width
    first = min(scaled, key=falls)
    simplex = np.vstack([first, first + 0.05 * np.where(first < 0.5, 1.0, -1.0) * np.eye(first.size)])
    found = minimize(
        falls,
        first,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-3, "maxfev": 80 * first.size},
    )
    best = np.clip(found.x, 0.0, 1.0)
    middle = np.clip(best, HESSIAN_STEP, 1.0 - HESSIAN_STEP)
    k = best.size
    hessian = np.empty((k, k))
    steps = HESSIAN_STEP * np.eye(k)
    for i in range(k):
        for j in range(k):
            hessian[i, j] = (
                falls(middle + steps[i] + steps[j])
                - falls(middle + steps[i] - steps[j])
                - falls(middle - steps[i] + steps[j])
                + falls(middle - steps[i] - steps[j])
            ) / (4.0 * HESSIAN_STEP**2)
    curvature = np.maximum(np.linalg.eigvalsh(0.5 * (hessian + hessian.T)), FLAT)
    mean = -float(found.fun) + 0.5 * k * np.log(2.0 * np.pi) - 0.5 * float(np.log(curvature).sum())
    return mean, bounds[:, 0] + best * width


def kernel_evidence(
    sums: SpecimenSums,
    solution: Solution,
    family: Family | None,
    *,
    speed_mm_s: FloatArray,
    depth_mm: FloatArray,
    force_N: float,
) -> KernelEvidence:
    """Evidence of one kernel, or of the exponential branches of a solution.

    Parameters
    ----------
    sums : SpecimenSums
        Whitened for the noise.
    solution : Solution
        Of the chosen model, ``partial`` or ``shared``: its spread of gains, degree and noise.
    family : Family or None
        ``None`` takes the solution's own exponentials.
    speed_mm_s, depth_mm : ndarray, shape (ramps,)
    force_N : float
        Largest measured force.
    """
    problem = _Problem(sums, solution, solution.candidate.degree, speed_mm_s, depth_mm, force_N)
    low, high = sums.log_tau_bounds
    if family is None:
        branches = solution.candidate.branches
        starts = solution.evaluation.log_tau[None]
        bounds = np.array([(low, high)] * branches)
        used = branches * (solution.candidate.degree + 2) + STATIC_PARAMETERS

        def weights_at(psi: FloatArray) -> FloatArray:
            return sums.basis.weights(psi)[0]
    else:
        shape = family.shape
        tau = np.linspace(low, high, STARTS + 2)[1:-1]
        grid = [(one, shape[0] + part * (shape[1] - shape[0])) for one in tau for part in (0.3, 0.8)]
        starts = np.array([*grid, (float(solution.evaluation.log_tau[0]), 0.999 * shape[1])])
        bounds = np.array([(low, high), shape])
        used = STATIC_PARAMETERS + solution.candidate.degree + 3

        def weights_at(psi: FloatArray) -> FloatArray:
            return sums.basis.weights_of(lambda t: family.kernel(t, float(psi[0]), float(psi[1])))[0][:, None]

    sigma2 = solution.noise.sigma2
    for _ in range(2):
        # the second round with the noise that the first one leaves

        def density(at: FloatArray, variance: float = sigma2) -> float:
            return problem.log_marginal(weights_at(at), variance)[0]

        value, psi = _laplace(density, starts, bounds)
        starts = psi[None]
        left = problem.log_marginal(weights_at(psi), sigma2)[1]
        sigma2, last = max(left / max(sums.n - used, 1), 1e-300), sigma2
        if abs(np.log(sigma2 / last)) < 1.0 / sums.n:
            break
    if family is None:
        # the box of the prior holds every order of the branches
        value += float(np.log(np.arange(1.0, branches + 1)).sum())
    return KernelEvidence(value, psi, sigma2)
