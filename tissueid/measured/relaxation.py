"""The relaxation table: what people quote, each number with the window it was taken from.

For every hold, ``F = c + sum_j A_j exp(-t / tau_j)`` with one, two and three exponentials, a free plateau c
and A_j >= 0, from the stop of the tool to the end of the hold: while a crosshead brakes it still loads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.identification import Relaxation
from tissueid.flags import Flag
from tissueid.measured.exponentials import ExponentialSums, curve_of
from tissueid.measured.pushes import peak_of, usable_until
from tissueid.trial import Segmentation, Trial, contact_frame

MIN_SAMPLES = 8
MAX_EXPONENTIALS = 3
#: Limits of the flags.
WINDOW_SHARE = 1.0 / 3.0
WINDOW_SHIFT = 0.2
RESIDUAL_SHARE = 0.05
NRMSD_RATIO = 2.0
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
    if (share > RESIDUAL_SHARE and found.worst_N > NOISE_FACTOR * noise_N) or ratio > NRMSD_RATIO:
        lost = f"one exponential leaves {100 * share:.2g} % of the hold's range"
        values = {"max_residual_fraction": share, "nrmsd_ratio": ratio}
        flags.append(Flag("one_tau_inadequate", f"{lost}; two fit {ratio:.2g} times better", values))
    return flags


def _row(trial: Trial, force: FloatArray, noise_N: float, window: slice, peak_N: float) -> Relaxation | None:
    time, window_force = trial.time_s[window], force[window]
    found = hold_ladder(time, window_force, MAX_EXPONENTIALS)
    if found is None:
        return None
    single, range_N = found.single_s, float(np.ptp(window_force))
    return Relaxation(
        path=trial.source.path,
        sheet=trial.source.sheet,
        window_s=(float(time[0]), float(time[-1])),
        peak_force_N=peak_N,
        tau_single_s=single,
        nrmsd_single=found.nrmsd[0],
        tau_double_s=found.taus_s[1],
        tau_triple_s=found.taus_s[2],
        flags=() if single is None else tuple(_flags(found, single, time, range_N, noise_N)),
    )


def relaxation_rows(trial: Trial, segmentation: Segmentation) -> tuple[Relaxation, ...]:
    """One row for every hold in contact; none where there is no hold."""
    if segmentation.contact is None:
        return ()
    _, force = contact_frame(trial, segmentation)
    last = usable_until(segmentation, trial.time_s.size)
    rows = []
    for number, hold in enumerate(segmentation.phases):
        if hold.kind == "hold" and segmentation.contact.index < hold.stop <= last:
            peak = peak_of(trial.time_s, force, segmentation, number)
            rows.append(
                _row(trial, force, segmentation.force_noise_N, slice(hold.start, hold.stop), peak.force_N)
            )
    return tuple(row for row in rows if row is not None)
