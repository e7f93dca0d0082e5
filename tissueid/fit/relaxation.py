"""The relaxation table: what people quote, each number with the window it was taken from.

For every hold, ``F = c + sum_j A_j exp(-t / tau_j)`` with one, two and three exponentials, a free
plateau c and A_j >= 0, uniform weights, from the force peak to the end of the hold.  A relaxation
time moves with its window, the ramp before it and the weights (statistics.md 4, formats.md 3), so the
flags say when it did.  This table describes a hold; the contact model is not fitted from it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.metrics import nrmsd
from tissueid.fit.search import global_minimum
from tissueid.fit.window import usable_until
from tissueid.flags import Flag
from tissueid.likelihood.basis import TAU_ABOVE_LENGTH, TAU_BELOW_STEP, KernelBasis, kernel_basis
from tissueid.likelihood.objective import PooledObjective, eliminate_static
from tissueid.result import RelaxationRow
from tissueid.trial import Phase, Segmentation, Trial, contact_frame

__all__ = ["exponential_ladder", "fit_exponentials", "relaxation_rows"]

FloatArray = NDArray[np.float64]

MIN_SAMPLES = 8
MAX_EXPONENTIALS = 3
#: A relaxing force below this fraction of the largest is rounding, not relaxation.
MIN_AMPLITUDE = 1e-9
#: Limits of the flags (statistics.md 4).
WINDOW_SHARE = 1.0 / 3.0
WINDOW_SHIFT = 0.2
RESIDUAL_SHARE = 0.05
NRMSD_RATIO = 2.0
#: A residual below this many standard deviations of the noise says nothing of the model.
NOISE_FACTOR = 5.0


def _columns(time_s: FloatArray, force_N: FloatArray, basis: KernelBasis) -> FloatArray:
    """Constant, node exponentials and force."""
    columns = np.empty((time_s.size, basis.tau_s.size + 2))
    columns[:, 0] = 1.0
    columns[:, 1:-1] = np.exp(-time_s[:, None] / basis.tau_s)
    # the basis interpolates kernels averaged over half a step, which differ by a factor in tau
    columns[:, 1:-1] *= basis.mean_over_step(basis.tau_s)
    columns[:, -1] = force_N
    return columns


def _basis_of(time_s: FloatArray) -> tuple[KernelBasis, tuple[float, float]]:
    """Basis of a window, and the range of ln tau that is searched."""
    steps = np.diff(time_s)
    step = float(np.median(steps[steps > 0.0]))
    length = float(time_s[-1])
    basis = kernel_basis(step_s=step, length_s=length)
    return basis, (np.log(step / TAU_BELOW_STEP), np.log(length * TAU_ABOVE_LENGTH))


def exponential_ladder(
    time_s: FloatArray, force_N: FloatArray, count: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Fits with 1, 2, ... ``count`` exponentials, each started from the one before.

    Returns
    -------
    list of (tau_s, model_N)
        As :func:`fit_exponentials` gives them.
    """
    basis, bounds = _basis_of(time_s)
    columns = _columns(time_s, force_N, basis)
    gram = eliminate_static(columns.T @ columns, 1)
    return _ladder(gram, basis, bounds, time_s, force_N, count)


def _ladder(
    gram: FloatArray,
    basis: KernelBasis,
    bounds: tuple[float, float],
    time_s: FloatArray,
    force_N: FloatArray,
    count: int,
) -> list[tuple[FloatArray, FloatArray]]:
    fits: list[tuple[FloatArray, FloatArray]] = []
    seeds: list[FloatArray] = []
    for branches in range(1, count + 1):
        objective = PooledObjective(
            gram=gram, basis=basis, scale=1.0, branches=branches, degree=0, columns_degree=0, static=False
        )
        best = global_minimum(objective, bounds, seeds=seeds)
        seeds = [best.log_tau]
        used = best.theta > MIN_AMPLITUDE * max(float(np.ptp(force_N)), 1e-300)
        tau = np.exp(best.log_tau[used])
        design = np.column_stack([np.ones(time_s.size), *(np.exp(-time_s / value) for value in tau)])
        weights = np.linalg.lstsq(design, force_N, rcond=None)[0]
        fits.append((tau, design @ weights))
    return fits


def fit_exponentials(time_s: FloatArray, force_N: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Least squares of a plateau and ``count`` decaying exponentials with amplitudes >= 0.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        From the start of the window [s], 0 first.
    force_N : ndarray, shape (n,)
    count : int
        1 to 3.

    Returns
    -------
    tau_s : ndarray
        Ascending; shorter than ``count`` where an amplitude is zero.
    model_N : ndarray, shape (n,)
    """
    return exponential_ladder(time_s, force_N, count)[-1]


def _window(segmentation: Segmentation, hold: Phase, force: FloatArray) -> tuple[int, int]:
    """From the force peak, which may come shortly before displacement stops, to the end of the hold."""
    before = [phase for phase in segmentation.of_kind("ramp") if phase.stop <= hold.start + 1]
    first = before[-1].start + 2 * (before[-1].stop - before[-1].start) // 3 if before else hold.start
    peak = first + int(np.argmax(force[first : hold.stop]))
    return peak, hold.stop


def _flags(
    tau: float, half_tau: float | None, window: float, step: float, misfit: tuple[float, float, bool]
) -> list[Flag]:
    share, ratio, beyond_noise = misfit
    flags = []
    if tau > WINDOW_SHARE * window:
        flags.append(
            Flag(
                "tau_exceeds_window",
                f"one exponential gives {tau:.3g} s, over a third of its window of {window:.3g} s",
                {"tau_s": tau, "window_length_s": window},
            )
        )
    if half_tau is not None and abs(half_tau - tau) > WINDOW_SHIFT * tau:
        flags.append(
            Flag(
                "window_dependent",
                f"half the window gives {half_tau:.3g} s instead of {tau:.3g} s",
                {"tau_s": tau, "tau_half_window_s": half_tau},
            )
        )
    if tau < 2.0 * step:
        flags.append(
            Flag(
                "tau_below_resolution",
                f"one exponential gives {tau:.3g} s at a sampling interval of {step:.3g} s",
                {"tau_s": tau, "step_s": step},
            )
        )
    if (share > RESIDUAL_SHARE and beyond_noise) or ratio > NRMSD_RATIO:
        flags.append(
            Flag(
                "one_tau_inadequate",
                f"one exponential leaves {100 * share:.2g} % of the hold's range; "
                f"two fit {ratio:.2g} times better",
                {"max_residual_fraction": share, "nrmsd_ratio": ratio},
            )
        )
    return flags


def _row(trial: Trial, segmentation: Segmentation, hold: Phase, force: FloatArray) -> RelaxationRow | None:
    start, stop = _window(segmentation, hold, force)
    time = trial.time_s[start:stop] - trial.time_s[start]
    window_force = force[start:stop]
    if time.size < MIN_SAMPLES or time[-1] <= 0.0 or np.ptp(window_force) == 0.0:
        return None
    basis, bounds = _basis_of(time)
    columns = _columns(time, window_force, basis)
    half = int(np.searchsorted(time, time[-1] / 2.0))
    first = columns[:half].T @ columns[:half]
    whole = first + columns[half:].T @ columns[half:]
    fits = _ladder(eliminate_static(whole, 1), basis, bounds, time, window_force, MAX_EXPONENTIALS)
    single = float(fits[0][0][0]) if fits[0][0].size else None
    one, two = (nrmsd(window_force, fit[1]).range for fit in fits[:2])
    flags: list[Flag] = []
    if single is not None:
        half_tau = None
        if half >= MIN_SAMPLES and np.ptp(window_force[:half]) > 0.0:
            part = eliminate_static(first, 1)
            found = _ladder(part, basis, bounds, time[:half], window_force[:half], 1)[0][0]
            half_tau = float(found[0]) if found.size else None
        worst = float(np.abs(window_force - fits[0][1]).max())
        share = worst / float(np.ptp(window_force))
        ratio = one / two if two > 0.0 else 1.0
        steps = np.diff(time)
        step = float(np.median(steps[steps > 0.0]))
        beyond_noise = worst > NOISE_FACTOR * segmentation.force_noise_N
        flags = _flags(single, half_tau, float(time[-1]), step, (share, ratio, beyond_noise))
    return RelaxationRow(
        path=trial.source.path,
        sheet=trial.source.sheet,
        window_s=(float(trial.time_s[start]), float(trial.time_s[stop - 1])),
        peak_force_N=float(window_force[0]),
        tau_single_s=single,
        nrmsd_single=one,
        tau_double_s=tuple(float(value) for value in fits[1][0]),
        tau_triple_s=tuple(float(value) for value in fits[2][0]),
        flags=tuple(flags),
    )


def relaxation_rows(trial: Trial, segmentation: Segmentation) -> tuple[RelaxationRow, ...]:
    """One row for every hold in contact; none where there is no hold.

    Parameters
    ----------
    trial : Trial
    segmentation : Segmentation
    """
    if segmentation.contact is None:
        return ()
    _, force = contact_frame(trial, segmentation)
    rows = (
        _row(trial, segmentation, hold, force)
        for hold in segmentation.of_kind("hold")
        if segmentation.contact.index < hold.stop <= usable_until(segmentation, trial.time_s.size)
    )
    return tuple(row for row in rows if row is not None)
