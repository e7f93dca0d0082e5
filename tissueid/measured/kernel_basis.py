"""A few relaxation times whose branch states span those of every other.

The branch state is a linear functional of the kernel exp(-t/tau), so an approximation

    exp(-t/tau) = sum_k c_k(tau) exp(-t/tau_k)          on 0 <= t <= T, at steps of h

carries over to the state of **any** recording of that step and length.  The nodes tau_k are the
pivots of a rank-revealing QR factorisation of the kernels on a fine grid, the weights a triangular
solve.  58 nodes give states to 1e-10 relative for h = 1 ms and T = 48 s, over tau from h/5 to 10 T;
Chebyshev nodes in log tau need about 110 for that, because they do not know that the functions are
exponentials.  The weights' derivative by ln(tau) follows from the derivative of the kernel.

Everything that the likelihood needs is then a quadratic form in c(tau): one Gram matrix of the node
states serves one, two or three branches and their derivatives, and is positive semi-definite by
construction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import qr
from scipy.linalg.blas import dtrsm

from tissueid.arrays import FloatArray

#: Relaxation times are sought between h / TAU_BELOW_STEP and TAU_ABOVE_LENGTH * T.
TAU_BELOW_STEP = 5.0
TAU_ABOVE_LENGTH = 10.0
#: Pivots below this fraction of the first are dropped; the states' relative error follows it.
TOLERANCE = 1e-10
TIMES = 360
CANDIDATES = 240
#: Points of the Gauss rule that averages a kernel over a step.
AVERAGED = 8
#: Step and length are rounded outwards to this step in their logarithm, so that bases are reused.
QUANTUM = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class KernelBasis:
    """Nodes and weights for recordings of one step and length."""

    tau_s: FloatArray  # (n,), nodes, ascending [s]
    log_bounds: tuple[float, float]  # range of ln(tau / s) in which weights are given
    _time_s: FloatArray
    _weight: FloatArray
    _step_s: float
    _q: FloatArray
    _r: FloatArray

    def mean_over_step(self, tau_s: FloatArray) -> FloatArray:
        """Mean of exp(-t / tau) over the step that the kernels are averaged over."""
        ratio = self._step_s / np.asarray(tau_s)
        return np.asarray(-np.expm1(-ratio) / ratio)

    def weights(self, log_tau: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights c and their derivative by ln(tau).

        ``log_tau`` (m,): ln(tau / s), within ``log_bounds``.  Returns ``c, dc`` (n, m).
        """
        columns = [_weights(self, float(value)) for value in log_tau]
        return np.column_stack([c for c, _ in columns]), np.column_stack([dc for _, dc in columns])

    def weights_of(self, kernel: Callable[[FloatArray], FloatArray]) -> tuple[FloatArray, float]:
        """Weights of any kernel of relaxation: a completely monotone one is a mixture of the nodes'.

        ``kernel``: its values at times of any shape [s].  Returns ``c`` (n,); ``error``: root mean square of
        what is left, relative to the kernel's.
        """
        point, share = np.polynomial.legendre.leggauss(AVERAGED)
        inner = self._time_s[:, None] + self._step_s * 0.5 * (point + 1.0)
        right = (kernel(inner) @ (0.5 * share)) * self._weight
        solved = dtrsm(1.0, self._r, (self._q.T @ right)[:, None])[:, 0]
        left = right - self._q @ (self._q.T @ right)
        norm = _norm(np.log(self.tau_s), float(self._time_s[-1]))
        whole = max(float(np.linalg.norm(right)), 1e-300)
        return np.asarray(solved / norm), float(np.linalg.norm(left)) / whole


@lru_cache(maxsize=8192)
def _weights(basis: KernelBasis, log_tau: float) -> tuple[FloatArray, FloatArray]:
    """Weights of one ln(tau); kept, because a scan comes back to the same points for every model."""
    value, slope = _kernel(np.array([log_tau]), basis._time_s, basis._step_s)  # noqa: SLF001
    right = np.concatenate([value, slope], axis=1) * basis._weight[:, None]  # noqa: SLF001
    # LAPACK's triangular solve wakes every thread for two columns, which a busy machine pays in ms
    solved = dtrsm(1.0, basis._r, basis._q.T @ right)  # noqa: SLF001
    solved /= _norm(np.log(basis.tau_s), float(basis._time_s[-1]))[:, None]  # noqa: SLF001
    return solved[:, 0], solved[:, 1]


def _kernel(log_tau: FloatArray, time_s: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Kernel averaged over one step, and its derivative by ln(tau); shape (times, m)."""
    tau = np.exp(log_tau)
    ratio = step_s / tau
    mean = -np.expm1(-ratio) / ratio
    decay = np.exp(-time_s[:, None] / tau)
    value = mean * decay
    slope = value * (time_s[:, None] / tau) + decay * (mean - np.exp(-ratio))
    return value, slope


def _norm(log_tau: FloatArray, length_s: float) -> FloatArray:
    """Root of the kernel's energy, which makes errors relative to the state of the same tau."""
    return np.sqrt(np.minimum(np.exp(log_tau), length_s))


@lru_cache(maxsize=64)
def _build(step_key: int, length_key: int, range_keys: tuple[int, int] | None) -> KernelBasis:
    step = math.exp(step_key * QUANTUM)
    length = math.exp(length_key * QUANTUM)
    if range_keys is None:
        low, high = math.log(step / TAU_BELOW_STEP), math.log(length * TAU_ABOVE_LENGTH)
    else:
        low, high = range_keys[0] * QUANTUM, range_keys[1] * QUANTUM
    half = step / 2.0
    time = np.concatenate([[0.0], np.geomspace(half / 4.0, length, TIMES)])
    weight = np.sqrt(np.gradient(time))
    candidates = np.linspace(low, high, CANDIDATES)
    columns = _kernel(candidates, time, half)[0] * weight[:, None] / _norm(candidates, length)
    _, r, pivots = qr(columns, mode="economic", pivoting=True, check_finite=False)
    diagonal = np.abs(np.diag(r))
    rank = int((diagonal > TOLERANCE * diagonal[0]).sum())
    nodes = np.sort(candidates[pivots[:rank]])
    chosen = _kernel(nodes, time, half)[0] * weight[:, None] / _norm(nodes, length)
    q, r = np.linalg.qr(chosen)
    return KernelBasis(
        tau_s=np.exp(nodes), log_bounds=(low, high), _time_s=time, _weight=weight, _step_s=half, _q=q, _r=r
    )


def kernel_basis(
    *, step_s: float, length_s: float, log_range: tuple[float, float] | None = None
) -> KernelBasis:
    """The basis for recordings whose finest step is ``step_s`` and longest duration ``length_s``.

    ``step_s``, ``length_s``: both positive, ``length_s > step_s`` [s]; ``log_range``: part of the range of
    ln(tau / s) that is needed; a factor of five takes some fifteen nodes.  Raises ValueError: step or length
    are not positive and in order.
    """
    if not 0.0 < step_s < length_s < math.inf:
        msg = f"a basis needs 0 < step < length, got step {step_s} s and length {length_s} s"
        raise ValueError(msg)
    keys = None
    if log_range is not None:
        keys = math.floor(log_range[0] / QUANTUM), math.ceil(log_range[1] / QUANTUM)
    return _build(math.floor(math.log(step_s) / QUANTUM), math.ceil(math.log(length_s) / QUANTUM), keys)
