"""The regularised relaxation spectrum of a hold, as seen after the ramp, without a contact model.

A Prony series on a logarithmic grid, non-negative, smoothed by second differences as far as it still fits
about as well (discrepancy principle).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar, nnls

from tissueid.arrays import FloatArray
from tissueid.documents.quantities import Spectrum
from tissueid.model.moduli import drained_share
from tissueid.trial import Segmentation, Trial, contact_frame

MIN_SAMPLES = 12
#: A force below so many standard deviations of its noise is none.
NOISE_FACTOR = 5.0
#: Relaxation times a decade, and bins a decade of the samples.
PER_DECADE, BINS_PER_DECADE = 8, 40
#: Nodes of a ramp whose parts drain, and points of the search in ln time.
RAMP_NODES, DRAINAGE_GRID = 16, 25
#: Grid of smoothing weights, strongest first.
SMOOTHINGS = np.geomspace(1e3, 1e-6, 28)


@dataclass(frozen=True, slots=True)
class HoldNumbers:
    """Numbers of the holds of one trial."""

    spectra: tuple[Spectrum, ...] = ()
    longest_s: float = 0.0  # longest hold; 0 without one
    speed_mm_s: float = 0.0  # of the ramp before the longest hold
    depth_mm: float = 0.0
    drainage_s: float = 0.0  # time a^2 / D of the drainage nearest to the longest hold; 0 without one


def drainage_time(time_s: FloatArray, force_N: FloatArray, ramp_s: float) -> float:
    """Time a^2 / D of drainage that comes nearest to a hold after a ramp [s].

    Under a sphere, F_e ~ x^1.5: each part of the ramp drains from its own moment.
    """
    if time_s.size < MIN_SAMPLES or not time_s[-1] > 2.0 * ramp_s:
        return 0.0
    step = float(np.median(np.diff(time_s)))
    time, force, weight = _binned(time_s, force_N, max(step, 1e-9))
    root = np.sqrt(weight)
    # x = s^2 along the ramp: d F_e ~ 3 s^2 ds
    node, share = np.polynomial.legendre.leggauss(RAMP_NODES)
    node = 0.5 * (node + 1.0)
    since, share = time[:, None] + ramp_s * (1.0 - node**2), 1.5 * share * node**2

    def misfit(ln_time: float) -> float:
        columns = np.column_stack([drained_share(since * np.exp(-ln_time)) @ share, np.ones(time.size)])
        left = np.linalg.lstsq(columns * root[:, None], force * root, rcond=None)[1]
        return float(left[0]) if left.size else 0.0

    span = np.log(max(float(time[0]), step)), np.log(10.0 * float(time[-1]))
    grid = np.linspace(*span, DRAINAGE_GRID)
    best = int(np.argmin([misfit(one) for one in grid]))
    if best in (0, DRAINAGE_GRID - 1):
        return 0.0
    found = minimize_scalar(misfit, bounds=(grid[best - 1], grid[best + 1]), method="bounded")
    return float(np.exp(found.x))


def relaxation_spectrum(
    time_s: FloatArray, force_N: FloatArray
) -> tuple[FloatArray, FloatArray, float, float, float]:
    """Regularised spectrum of a force that relaxes from the stop on.

    Returns ``tau_s, amplitude_N`` (k,), and ``plateau_N, smoothing, rmse_N``.
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


def hold_numbers(trial: Trial, segmentation: Segmentation) -> HoldNumbers:
    """Spectrum of every hold in contact, with the length of the longest and the ramp before it."""
    contact = segmentation.contact
    if contact is None:
        return HoldNumbers()
    depth, force = contact_frame(trial, segmentation)
    spectra: list[Spectrum] = []
    longest = (0.0, 0.0, 0.0, 0.0)
    for hold in segmentation.of_kind("hold"):
        time = trial.time_s[hold.start : hold.stop] - hold.start_s
        if hold.stop <= contact.index or time.size < MIN_SAMPLES or not time[-1] > 0.0:
            continue
        relaxing = force[hold.start : hold.stop]
        deep = float(depth[hold.start])
        if not relaxing[0] > NOISE_FACTOR * segmentation.force_noise_N or not deep > 0.0:
            # standing in air after a retract relaxes nothing
            continue
        ramps = [phase for phase in segmentation.of_kind("ramp") if phase.stop <= hold.start + 1]
        speed = ramps[-1].speed_mm_s if ramps else 0.0
        if float(time[-1]) > longest[0]:
            drains = drainage_time(time, relaxing, deep / speed if speed > 0.0 else 0.0)
            longest = (float(time[-1]), speed, deep, drains)
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
    return HoldNumbers(tuple(spectra), *longest)
