"""What a hold shows without a contact model: fraction relaxed, and a regularised relaxation spectrum.

The force from which relaxation is counted is that at the end of loading, by least squares over its last
stretch.  The spectrum is a Prony series on a logarithmic grid with non-negative amplitudes, smoothed by
second differences (Tikhonov); the strongest smoothing is taken that fits about as well as none
(discrepancy principle).  It is the spectrum **as seen after the ramp**: a branch that relaxed within the
ramp shows little of its stiffness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from tissueid.measured.cycles import end_of_loading, polynomial_at
from tissueid.quantities import Quantity, Spectrum
from tissueid.trial import Phase, Segmentation, Trial, contact_frame

__all__ = ["RELAXED_TIMES_S", "HoldNumbers", "hold_numbers", "relaxation_spectrum"]

FloatArray = NDArray[np.float64]

#: Times after the corner at which the fraction relaxed is quoted [s].
RELAXED_TIMES_S = (0.1, 1.0, 10.0, 100.0)
#: Force at a time is that of a parabola through a window of this relative half width.
TIME_SHARE = 0.2
MIN_SAMPLES = 12
#: A force below so many standard deviations of its noise is none.
NOISE_FACTOR = 5.0
#: Relaxation times a decade, and bins a decade of the samples.
PER_DECADE = 8
BINS_PER_DECADE = 40
#: Grid of smoothing weights, strongest first.
SMOOTHINGS = np.geomspace(1e3, 1e-6, 28)


@dataclass(frozen=True, slots=True)
class HoldNumbers:
    """Numbers of the holds of one trial.

    Attributes
    ----------
    measured : tuple of Quantity
    spectra : tuple of Spectrum
    longest_s : float
        Longest hold; 0 without one.
    speed_mm_s, depth_mm : float
        Of the ramp before the longest hold.
    """

    measured: tuple[Quantity, ...] = ()
    spectra: tuple[Spectrum, ...] = ()
    longest_s: float = 0.0
    speed_mm_s: float = 0.0
    depth_mm: float = 0.0


def relaxation_spectrum(
    time_s: FloatArray, force_N: FloatArray
) -> tuple[FloatArray, FloatArray, float, float, float]:
    """Regularised spectrum of a relaxing force.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        From the corner on, growing [s].
    force_N : ndarray, shape (n,)

    Returns
    -------
    tau_s, amplitude_N : ndarray, shape (k,)
        Grid from two sampling intervals to the window, and force that relaxes at each.
    plateau_N, smoothing, rmse_N : float
    """
    steps = np.diff(time_s)
    step = float(np.median(steps[steps > 0.0]))
    length = float(time_s[-1] - time_s[0])
    low, high = np.log10(2.0 * step), np.log10(length)
    tau = 10.0 ** np.linspace(low, high, max(int(np.ceil((high - low) * PER_DECADE)) + 1, 3))
    time, force, weight = _binned(time_s - time_s[0], force_N, step)
    root = np.sqrt(weight)
    # a plateau of either sign beside amplitudes that can't be negative
    design = np.column_stack([np.exp(-time[:, None] / tau), np.ones(time.size), -np.ones(time.size)])
    scale = max(float(np.ptp(force)), 1e-300)
    columns, target = design * root[:, None], force * root / scale
    second = np.diff(np.eye(tau.size), 2, axis=0)
    roughness = np.column_stack([second, np.zeros((second.shape[0], 2))])
    norm = float(np.sqrt(weight.sum()))

    def solve(smoothing: float) -> tuple[FloatArray, float]:
        stacked = np.vstack([columns, smoothing * norm * roughness])
        found = nnls(stacked, np.concatenate([target, np.zeros(second.shape[0])]))[0]
        return found, float(((columns @ found - target) ** 2).sum())

    _, least = solve(0.0)
    allowed = least * (1.0 + 2.0 * np.sqrt(2.0 / time.size)) + 1e-12
    found, smoothing = solve(0.0)[0], 0.0
    for candidate in SMOOTHINGS:
        trial, squares = solve(float(candidate))
        if squares <= allowed:
            found, smoothing = trial, float(candidate)
            break
    model = np.exp(-(time_s - time_s[0])[:, None] / tau) @ found[:-2] + found[-2] - found[-1]
    rmse = float(np.sqrt(np.mean((force_N - scale * model) ** 2)))
    return tau, scale * found[:-2], scale * float(found[-2] - found[-1]), smoothing, rmse


def _binned(
    time_s: FloatArray, force_N: FloatArray, step_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means over bins of equal ln(time), with the samples in each: single samples early on."""
    key = np.floor(np.log10(np.maximum(time_s / step_s, 1e-3) + 1.0) * BINS_PER_DECADE).astype(np.int64)
    _, index = np.unique(key, return_inverse=True)
    count = np.bincount(index).astype(np.float64)
    return np.bincount(index, time_s) / count, np.bincount(index, force_N) / count, count


def _force_at(time: FloatArray, force: FloatArray, at: float, noise: float) -> tuple[float, float]:
    """Force at a time and its standard error: a local parabola, or between two samples."""
    near = np.abs(time - at) <= TIME_SHARE * at
    found, _ = polynomial_at(time[near], force[near], at, noise)
    if found.value is None or found.stderr is None:
        return float(np.interp(at, time, force)), noise
    return found.value, found.stderr


def _fractions(
    times_s: Sequence[float],
    time: FloatArray,
    force: FloatArray,
    peak: tuple[float, float],
    noise: float,
    at: dict[str, float | str],
) -> list[Quantity]:
    """Fraction of the force at the corner that is gone, at each time that the hold reaches."""
    rows = []
    for wanted in times_s:
        where = {**at, "time_s": wanted}
        if wanted > time[-1]:
            reason = f"the hold lasts {time[-1]:.4g} s"
            rows.append(Quantity("fraction_relaxed", "1", where, None, None, reason))
            continue
        if wanted < 2.0 * float(np.median(np.diff(time))):
            reason = "earlier than two sampling intervals"
            rows.append(Quantity("fraction_relaxed", "1", where, None, None, reason))
            continue
        value, sd = _force_at(time, force, wanted, noise)
        share = value / peak[0]
        stderr = float(np.hypot(sd, share * peak[1])) / peak[0]
        rows.append(Quantity("fraction_relaxed", "1", where, 1.0 - share, stderr))
    return rows


def _corner(
    depth: FloatArray, force: FloatArray, segmentation: Segmentation, hold: Phase
) -> tuple[float, float, float, float]:
    """Force at the end of the loading before a hold, its error, and speed and depth of that loading."""
    noise = segmentation.force_noise_N
    ramps = [phase for phase in segmentation.of_kind("ramp") if phase.stop <= hold.start + 1]
    top = float(force[hold.start]), noise
    if not ramps:
        return (*top, 0.0, float(depth[hold.start]))
    found, _ = end_of_loading(depth, force, hold.start, ramps[-1].start, noise)
    if found.value is not None and found.stderr is not None:
        top = found.value, found.stderr
    return (*top, ramps[-1].speed_mm_s, float(depth[hold.start]))


def hold_numbers(
    trial: Trial, segmentation: Segmentation, *, times_s: Sequence[float] = RELAXED_TIMES_S
) -> HoldNumbers:
    """Fraction relaxed and spectrum of every hold in contact.

    Parameters
    ----------
    trial : Trial
    segmentation : Segmentation
    times_s : sequence of float
        After the corner.
    """
    contact = segmentation.contact
    if contact is None:
        return HoldNumbers()
    depth, force = contact_frame(trial, segmentation)
    measured: list[Quantity] = []
    spectra: list[Spectrum] = []
    longest = (0.0, 0.0, 0.0)
    for hold in segmentation.of_kind("hold"):
        time = trial.time_s[hold.start : hold.stop] - hold.start_s
        if hold.stop <= contact.index or time.size < MIN_SAMPLES or not time[-1] > 0.0:
            continue
        relaxing = force[hold.start : hold.stop]
        top, top_sd, speed, deep = _corner(depth, force, segmentation, hold)
        if not top > NOISE_FACTOR * segmentation.force_noise_N or not deep > 0.0:
            # standing in air after a retract relaxes nothing
            continue
        longest = max(longest, (float(time[-1]), speed, deep))
        name = trial.source.path if trial.source.sheet is None else trial.name
        at: dict[str, float | str] = {"path": "measured", "file": name, "depth_mm": deep, "speed_mm_s": speed}
        noise = segmentation.force_noise_N
        measured += _fractions(times_s, time, relaxing, (top, top_sd), noise, at)
        if np.ptp(relaxing) > 0.0:
            tau, amplitude, plateau, smoothing, rmse = relaxation_spectrum(time, relaxing)
            spectra.append(
                Spectrum(
                    path=trial.source.path,
                    sheet=trial.source.sheet,
                    start_s=hold.start_s,
                    end_s=hold.end_s,
                    plateau_N=plateau,
                    tau_s=tuple(tau.tolist()),
                    amplitude_N=tuple(amplitude.tolist()),
                    smoothing=smoothing,
                    rmse_N=rmse,
                )
            )
    return HoldNumbers(tuple(measured), tuple(spectra), *longest)
