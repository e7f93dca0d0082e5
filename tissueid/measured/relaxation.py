"""The relaxation table: what people quote, each number with the window it was taken from.

For every hold, ``F = c + sum_j A_j exp(-t / tau_j)`` with one, two and three exponentials, a free plateau c
and A_j >= 0, from the stop of the tool to the end of the hold: while a crosshead brakes it still loads.

Exponentials of a window are mixtures of those of a basis, so that the samples are summed once and every
relaxation time is then tried on a small matrix.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np
from scipy.linalg import qr
from scipy.linalg.blas import dtrsm

from tissueid.arrays import FloatArray
from tissueid.documents.identification import Relaxation
from tissueid.flags import Flag
from tissueid.measured.pushes import after_rupture, peak_of
from tissueid.trial import Segmentation, Trial, contact_frame

# A basis is a few relaxation times whose kernels span those of every other,
#     exp(-t/tau) = sum_k c_k(tau) exp(-t/tau_k)          on 0 <= t <= T, at steps of h.
# The nodes tau_k are the pivots of a rank-revealing QR factorisation of the kernels on a fine grid, the
# weights a triangular solve: 58 nodes give states to 1e-10 relative for h = 1 ms and T = 48 s; Chebyshev
# nodes in log tau need about 110 for that.
#: Relaxation times are sought between h / TAU_BELOW_STEP and TAU_ABOVE_LENGTH * T.
TAU_BELOW_STEP = 5.0
TAU_ABOVE_LENGTH = 10.0
#: Pivots below this fraction of the first are dropped; the states' relative error follows it.
TOLERANCE = 1e-10
TIMES = 360
CANDIDATES = 240
#: Step and length are rounded outwards to this step in their logarithm, so that bases are reused.
QUANTUM = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class KernelBasis:
    """Nodes and weights for recordings of one step and length."""

    tau_s: FloatArray  # (n,), nodes, ascending [s]
    log_bounds: tuple[float, float]  # range of ln(tau / s) in which weights are given
    time_s: FloatArray
    weight: FloatArray
    step_s: float
    q: FloatArray
    r: FloatArray

    def mean_over_step(self, tau_s: FloatArray) -> FloatArray:
        """Mean of exp(-t / tau) over the step that the kernels are averaged over."""
        ratio = self.step_s / np.asarray(tau_s)
        return np.asarray(-np.expm1(-ratio) / ratio)

    def weights(self, log_tau: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Weights c and their derivative by ln(tau)."""
        columns = [_weights(self, float(value)) for value in log_tau]
        return np.column_stack([c for c, _ in columns]), np.column_stack([dc for _, dc in columns])


@lru_cache(maxsize=8192)
def _weights(basis: KernelBasis, log_tau: float) -> tuple[FloatArray, FloatArray]:
    """Weights of one ln(tau); kept, because a scan comes back to the same points for every model."""
    value, slope = _kernel(np.array([log_tau]), basis.time_s, basis.step_s)
    right = np.concatenate([value, slope], axis=1) * basis.weight[:, None]
    # LAPACK's triangular solve wakes every thread for two columns, which a busy machine pays in ms
    solved = dtrsm(1.0, basis.r, basis.q.T @ right)
    solved /= _norm(np.log(basis.tau_s), float(basis.time_s[-1]))[:, None]
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
def _build(step_key: int, length_key: int) -> KernelBasis:
    step = math.exp(step_key * QUANTUM)
    length = math.exp(length_key * QUANTUM)
    low, high = math.log(step / TAU_BELOW_STEP), math.log(length * TAU_ABOVE_LENGTH)
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
        tau_s=np.exp(nodes), log_bounds=(low, high), time_s=time, weight=weight, step_s=half, q=q, r=r
    )


def kernel_basis(*, step_s: float, length_s: float) -> KernelBasis:
    """The basis for a finest step and a longest duration; raises ValueError unless 0 < step < length."""
    if not 0.0 < step_s < length_s < math.inf:
        raise ValueError(f"a basis needs 0 < step < length, got step {step_s} s and length {length_s} s")
    return _build(math.floor(math.log(step_s) / QUANTUM), math.ceil(math.log(length_s) / QUANTUM))


#: Spacing of the scan in ln tau, for one exponential and for several.
SCAN_SINGLE, SCAN_SEVERAL = 0.25, 0.6
#: Minima of a scan that are polished.
POLISHED = 3
#: Exponentials closer than this in ln tau describe one relaxation.
MIN_SEPARATION = 0.3
#: Gauss-Newton steps, the longest in ln tau, its halvings, and the step that ends them.
STEPS, LONGEST_STEP, HALVINGS, FINISHED = 60, 0.7, 6, 1e-10
#: Ridge over the trace that keeps equal exponentials apart from a division by zero.
RIDGE = 1e-14
#: A relaxing force below this fraction of the range is rounding, not relaxation.
MIN_AMPLITUDE = 1e-9
#: Rows summed at once: memory stays small however long the hold.
BLOCK = 1 << 15


def _amplitudes(gram: FloatArray, product: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Non-negative least squares of a few columns, at many points: all of them, else every set is tried."""
    points, m = product.shape
    best, gained, left = np.zeros((points, m)), np.zeros(points), np.arange(points)
    for size in range(m, 0, -1):
        for chosen in combinations(range(m), size):
            at = np.array(chosen)
            inner = gram[left[:, None, None], at[:, None], at]
            trace = np.trace(inner, axis1=1, axis2=2)
            inner = inner + (RIDGE * trace + 1e-300)[:, None, None] * np.eye(size)
            right = product[left[:, None], at]
            found = np.linalg.solve(inner, right[:, :, None])[:, :, 0]
            gain = (found * right).sum(axis=1)
            better = (found >= 0.0).all(axis=1) & (gain > gained[left])
            gained[left[better]] = gain[better]
            row = np.zeros((int(better.sum()), m))
            row[:, at] = found[better]
            best[left[better]] = row
        # all columns together leave no less to any of them
        left = left[gained[left] == 0.0] if size == m else left
        if left.size == 0:
            break
    return best, gained


@dataclass(frozen=True, slots=True, eq=False)
class ExponentialSums:
    """Sums of a window's samples over all exponentials."""

    basis: KernelBasis
    bounds: tuple[float, float]  # range of ln tau
    count: int
    total: FloatArray  # (k,), sums of the basis' columns and the force
    gram: FloatArray  # (k, k), sums of their products

    @classmethod
    def of(cls, time_s: FloatArray, force_N: FloatArray, basis: KernelBasis | None = None) -> ExponentialSums:
        """Sums of a window; times grow from 0."""
        steps = np.diff(time_s)
        step, length = float(np.median(steps[steps > 0.0])), float(time_s[-1])
        basis = basis or kernel_basis(step_s=step, length_s=length)
        size = basis.tau_s.size + 1
        total, gram = np.zeros(size), np.zeros((size, size))
        mean = basis.mean_over_step(basis.tau_s)
        offset = float(force_N.mean())
        for first in range(0, time_s.size, BLOCK):
            block = slice(first, first + BLOCK)
            # the basis interpolates kernels averaged over half a step, which differ by a factor in tau
            columns = np.exp(-time_s[block, None] / basis.tau_s) * mean
            columns = np.column_stack([columns, force_N[block] - offset])
            total += columns.sum(axis=0)
            gram += columns.T @ columns
        bounds = (float(np.log(step / TAU_BELOW_STEP)), float(np.log(length * TAU_ABOVE_LENGTH)))
        return cls(basis, bounds, time_s.size, total, gram)

    def ladder(self, branches: int) -> list[FloatArray]:
        """Relaxation times of fits with 1, 2, ... exponentials, ascending; fewer where data support fewer."""
        centred = _Centred(self.basis, self.gram - np.outer(self.total, self.total) / self.count)
        low = max(self.bounds[0], self.basis.log_bounds[0])
        high = min(self.bounds[1], self.basis.log_bounds[1])
        found: list[FloatArray] = []
        best = np.zeros(0)
        for number in range(1, branches + 1):
            starts = centred.starts(number, best)
            polished = [centred.polished(start, (low, high)) for start in starts]
            best = np.sort(min(polished, key=centred.left_over))
            found.append(np.exp(centred.used(best)))
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Centred:
    """Sums with the plateau taken out."""

    basis: KernelBasis
    gram: FloatArray

    def left_over(self, log_tau: FloatArray) -> float:
        """Sum of squares that exponentials leave, up to a constant."""
        return -float(self._gains([log_tau])[0])

    def _gains(self, points: Sequence[FloatArray]) -> FloatArray:
        weights = np.stack([self.basis.weights(point)[0] for point in points])
        gram = weights.transpose(0, 2, 1) @ (self.gram[:-1, :-1] @ weights)
        return _amplitudes(gram, self.gram[:-1, -1] @ weights)[1]

    def _amplitudes(self, log_tau: FloatArray) -> FloatArray:
        weights = self.basis.weights(log_tau)[0]
        inner = weights.T @ self.gram[:-1, :-1] @ weights
        return np.asarray(_amplitudes(inner[None], (weights.T @ self.gram[:-1, -1])[None])[0][0])

    def used(self, log_tau: FloatArray) -> FloatArray:
        """Those with an amplitude."""
        weights = self._amplitudes(log_tau)
        scale = float(np.sqrt(max(self.gram[-1, -1], 0.0)))
        return np.asarray(log_tau[weights > MIN_AMPLITUDE * max(scale, 1e-300)])

    def starts(self, number: int, before: FloatArray) -> list[FloatArray]:
        """Best points of a scan."""
        low, high = self.basis.log_bounds
        spacing = SCAN_SINGLE if number == 1 else SCAN_SEVERAL
        grid = np.linspace(low, high, max(int(np.ceil((high - low) / spacing)), 4) + 1)
        points = list(_points(number, grid, before))
        if not points:
            return [np.linspace(low, high, number + 2)[1:-1]]
        gains = self._gains(points)
        apart = SCAN_SINGLE if number == 1 else 2.0 * SCAN_SEVERAL
        chosen: list[FloatArray] = []
        for i in np.argsort(-gains, kind="stable"):
            if all(np.abs(points[i] - other).max() > apart for other in chosen):
                chosen.append(points[i])
            if len(chosen) == POLISHED:
                break
        return chosen

    def polished(self, log_tau: FloatArray, bounds: tuple[float, float]) -> FloatArray:
        """The local minimum that a start leads to, amplitudes following."""
        log_tau = np.clip(log_tau, *bounds)
        value = self.left_over(log_tau)
        for _ in range(STEPS):
            step = self._step(log_tau)
            for _halving in range(HALVINGS):
                trial = np.clip(log_tau + step, *bounds)
                reached = self.left_over(trial)
                if reached < value:
                    break
                step = 0.5 * step
            else:
                break
            done = float(np.abs(trial - log_tau).max()) < FINISHED
            log_tau, value = trial, reached
            if done:
                break
        return log_tau

    def _step(self, log_tau: FloatArray) -> FloatArray:
        """Gauss-Newton step of the relaxation times and amplitudes together."""
        weights, slopes = self.basis.weights(log_tau)
        amplitude = self._amplitudes(log_tau)
        on = amplitude > 0.0
        step = np.zeros(log_tau.size)
        if not on.any():
            return step
        frame = np.column_stack([weights[:, on], slopes[:, on] * amplitude[on]])
        left = self.gram[:-1, -1] - self.gram[:-1, :-1] @ (weights @ amplitude)
        normal = frame.T @ self.gram[:-1, :-1] @ frame
        size = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        solved = np.linalg.lstsq(normal * size[:, None] * size, (frame.T @ left) * size, rcond=1e-14)[0]
        step[on] = np.clip((solved * size)[int(on.sum()) :], -LONGEST_STEP, LONGEST_STEP)
        return step


def _points(number: int, grid: FloatArray, before: FloatArray) -> Iterator[FloatArray]:
    """Points of a scan: the grid, its pairs, or the best so far and one more."""
    if number == 1:
        yield from (grid[i : i + 1] for i in range(grid.size))
    elif number == 2:
        yield from (np.array(pair) for pair in combinations(grid, 2))
    else:
        yield from (
            np.sort(np.append(before, extra))
            for extra in grid
            if np.abs(before - extra).min(initial=np.inf) > MIN_SEPARATION
        )


def curve_of(time_s: FloatArray, force_N: FloatArray, tau_s: FloatArray) -> FloatArray:
    """The least-squares curve with these relaxation times, shape (n,)."""
    design = np.column_stack([np.ones(time_s.size), *(np.exp(-time_s / value) for value in tau_s)])
    return np.asarray(design @ np.linalg.lstsq(design, force_N, rcond=None)[0])


MIN_SAMPLES = 8
MAX_EXPONENTIALS = 3
#: Limits of the flags.
WINDOW_SHARE = 1.0 / 3.0
WINDOW_SHIFT = 0.2
RESIDUAL_SHARE = 0.05
NRMSD_RATIO = 2.0
#: ... and what a second exponential must gain at the least, where single samples leave one far.
LEAST_RATIO = 1.05
#: A residual below this many standard deviations of the noise says nothing of the model.
NOISE_FACTOR = 5.0


@dataclass(frozen=True, slots=True)
class Ladder:
    """Fits of one window with one, two, ... exponentials."""

    taus_s: tuple[tuple[float, ...], ...]  # relaxation times of each fit
    nrmsd: tuple[float, ...]  # of each fit, over the range of the force
    worst_N: float  # largest residual of the single exponential
    half_s: float | None  # single relaxation time of the first half of the window

    @property
    def single_s(self) -> float | None:
        """The single relaxation time; ``None`` where the force does not relax."""
        return self.taus_s[0][0] if self.taus_s[0] else None


def hold_ladder(time_s: FloatArray, force_N: FloatArray, count: int) -> Ladder | None:
    """Fit a window with one to ``count`` exponentials; ``None`` where it is too short or constant."""
    time = time_s - time_s[0]
    if time.size < MIN_SAMPLES or time[-1] <= 0.0 or np.ptp(force_N) == 0.0:
        return None
    sums = ExponentialSums.of(time, force_N)
    taus = sums.ladder(count)
    residuals = [force_N - curve_of(time, force_N, tau) for tau in taus]
    half = int(np.searchsorted(time, time[-1] / 2.0))
    half_s = None
    if taus[0].size and half >= MIN_SAMPLES and np.ptp(force_N[:half]) > 0.0:
        (early,) = ExponentialSums.of(time[:half], force_N[:half], sums.basis).ladder(1)
        half_s = float(early[0]) if early.size else None
    return Ladder(
        taus_s=tuple(tuple(tau.tolist()) for tau in taus),
        nrmsd=tuple(float(np.sqrt(np.mean(left**2)) / np.ptp(force_N)) for left in residuals),
        worst_N=float(np.abs(residuals[0]).max()),
        half_s=half_s,
    )


def _flags(found: Ladder, tau: float, time: FloatArray, range_N: float, noise_N: float) -> list[Flag]:
    """Flags of a single relaxation time."""
    window, steps, half_tau = float(time[-1] - time[0]), np.diff(time), found.half_s
    step = float(np.median(steps[steps > 0.0]))
    one, two = found.nrmsd[:2]
    share, ratio = found.worst_N / range_N, one / two if two > 0.0 else 1.0
    flags = []
    if tau > WINDOW_SHARE * window:
        message = f"one exponential gives {tau:.3g} s, over a third of its window of {window:.3g} s"
        flags.append(Flag("tau_exceeds_window", message, {"tau_s": tau, "window_length_s": window}))
    if half_tau is not None and abs(half_tau - tau) > WINDOW_SHIFT * tau:
        message = f"half the window gives {half_tau:.3g} s instead of {tau:.3g} s"
        flags.append(Flag("window_dependent", message, {"tau_s": tau, "tau_half_window_s": half_tau}))
    if tau < 2.0 * step:
        message = f"one exponential gives {tau:.3g} s at a sampling interval of {step:.3g} s"
        flags.append(Flag("tau_below_resolution", message, {"tau_s": tau, "step_s": step}))
    far = share > RESIDUAL_SHARE and found.worst_N > NOISE_FACTOR * noise_N
    if (far and ratio > LEAST_RATIO) or ratio > NRMSD_RATIO:
        lost = f"one exponential leaves {100 * share:.2g} % of the hold's range"
        values = {"max_residual_fraction": share, "nrmsd_ratio": ratio}
        flags.append(Flag("one_tau_inadequate", f"{lost}; two fit {ratio:.2g} times better", values))
    return flags


#: Fits of the holds of a recording, by the number of their phase.
Ladders = Mapping[int, Ladder | None]


def hold_ladders(trial: Trial, segmentation: Segmentation) -> Ladders:
    """Fits of all holds with one to three exponentials."""
    force = segmentation.force_sign * trial.force_N
    return {
        number: hold_ladder(trial.time_s[one.start : one.stop], force[one.start : one.stop], MAX_EXPONENTIALS)
        for number, one in enumerate(segmentation.phases)
        if one.kind == "hold" and one.end_s > one.start_s
    }


def relaxation_rows(
    trial: Trial, segmentation: Segmentation, ladders: Ladders | None = None
) -> tuple[Relaxation, ...]:
    """One row for every hold in contact that was fitted; none where there is no hold."""
    if segmentation.contact is None:
        return ()
    _, force = contact_frame(trial, segmentation)
    rows = []
    for number, found in (hold_ladders(trial, segmentation) if ladders is None else ladders).items():
        hold = segmentation.phases[number]
        if found is None or hold.stop <= segmentation.contact.index or after_rupture(segmentation, hold):
            continue
        window, single = slice(hold.start, hold.stop), found.single_s
        time, range_N = trial.time_s[window], float(np.ptp(force[window]))
        told = () if single is None else _flags(found, single, time, range_N, segmentation.force_noise_N)
        rows.append(
            Relaxation(
                path=trial.source.path,
                sheet=trial.source.sheet,
                window_s=(float(time[0]), float(time[-1])),
                peak_force_N=peak_of(trial.time_s, force, segmentation, number).force_N,
                tau_single_s=single,
                nrmsd_single=found.nrmsd[0],
                tau_double_s=found.taus_s[1],
                tau_triple_s=found.taus_s[2],
                flags=tuple(told),
            )
        )
    return tuple(rows)
