"""Band that holds the whole force of another push: draws, sites, contact, and what a law misses.

Curves are simulated from the posterior; the band is their spread at each sample, as many times as 95 % of the
curves stay within at every sample (Montiel Olea & Plagborg-Moller 2019, doi 10.1002/jae.2656).
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.logs import LogHandle
from tissueid.inference.specimen import FittedSpecimen
from tissueid.inference.window import FittedLog
from tissueid.model.base import ContactPath
from tissueid.trial import Trial, contact_frame

#: Curves that are simulated, their seed, and quantiles of one standard deviation about the median.
CURVES, SEED, ONE_SD = 400, 5, (0.1587, 0.8413)


def half_width(
    fitted: FittedSpecimen, handle: LogHandle, log: FittedLog, draws: FloatArray, level: float
) -> FloatArray:
    """Half width of the band at the samples of a log that is not of the fit, (n,) [N].

    ``draws`` (m, p): tissues of the posterior, which have the error of the mean.  Gains spread as those of
    the fit's logs do (Student's t of their logarithms; none with one log), contact by its sd.
    """
    rng, data = np.random.default_rng(SEED), log.data
    theta = draws[np.linspace(0, len(draws) - 1, min(CURVES, len(draws))).astype(np.int64)]
    gain, shift = np.ones(len(theta)), rng.normal(0.0, handle.contact_sd_mm, len(theta))
    ln_gain = fitted.identified.optimum.point.own[:, 0] if fitted.identified.system.effects.gain else None
    if ln_gain is not None and len(ln_gain) > 1:
        gain = np.exp(ln_gain.std(ddof=1) * rng.standard_t(len(ln_gain) - 1, len(theta)))
    model, curves = fitted.tissue.model, np.empty((len(theta), data.time_s.size))
    for k, off in enumerate(shift):
        path = ContactPath(data.time_s, np.maximum(data.depth_mm - off, 0.0), data.speed_ratio)
        curves[k] = gain[k] * model.force(theta[k], path)
    sigma = fitted.noise.sigma_N
    # a law misses all along alike, noise at each sample anew
    left = sigma * rng.standard_normal((len(curves), 1 if fitted.noise.discrepant else data.time_s.size))
    low, high = np.quantile(curves, ONE_SD, axis=0)
    sd_N = np.maximum(np.hypot(0.5 * (high - low), sigma), 1e-300)
    away = np.abs(curves - np.median(curves, axis=0) + left) / sd_N
    return np.asarray(float(np.quantile(away.max(axis=1), level)) * sd_N)


def at_samples(trial: Trial, handle: LogHandle, log: FittedLog, values: FloatArray) -> FloatArray:
    """Values at the samples of a log as values at those of its recording: 0 in air, NaN after it."""
    values = values[int(log.inserted) :]
    depth, _ = contact_frame(trial, handle.segmentation)
    out = np.full(trial.time_s.size, np.nan)
    out[: log.first] = 0.0
    out[log.first : log.first + values.size] = values
    out[: log.first][depth[: log.first] > log.depth_mm] = np.nan
    return out
