"""Where a new recording of the same trial would lie: predictive bands along the curves that are kept.

Each draw's force is worked out along some hundred samples of a curve and compared there with the force of the
optimum; only the difference is used, so that what is left out of the path cancels, and it is straight in time
between them.  The spread of the draws and the noise of the force make the band, as variances::

    model + mean difference +- 1.96 sqrt(variance of the differences + sigma^2)

Where logs have a static curve of their own each, that curve follows every draw of K and tau: the noise alone
makes the band.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.trials import Adjustment, kept_samples
from tissueid.model.base import ContactPath
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior.target import Redrawn
from tissueid.result import Curve, TrialFit

__all__ = ["predictive_bands"]

FloatArray = NDArray[np.float64]

#: Draws behind a band: its spread is then known to 9 %, and the noise is the larger part.
BAND_DRAWS = 64
#: Samples of a curve at which draws are compared.
BAND_POINTS = 700
TWO_SIDED_95 = 1.96


def _forces(
    model: KelvinVoigt, theta: FloatArray, curve: Curve, gain: FloatArray, offset_mm: FloatArray
) -> FloatArray:
    """Force along a curve of theta of shape (n, p), each with its gain and offset, shape (n, m)."""
    static, stiffness, tau = (np.stack(one) for one in zip(*map(model.split, theta), strict=True))
    path = ContactPath(curve.time_s, curve.depth_mm)
    states = model.states(tau.ravel(), path).reshape(*tau.shape, -1)
    x = curve.depth_mm - offset_mm[:, None]
    dynamic = (stiffness @ x[:, None] ** np.arange(stiffness.shape[2])[:, None] * states).sum(axis=1)
    return np.asarray(gain[:, None] * (_cubic(static, x) + dynamic))


def _at(curve: Curve, index: NDArray[np.int64]) -> Curve:
    """Some samples of a curve."""
    time, depth, force, model = (
        part[index] for part in (curve.time_s, curve.depth_mm, curve.force_N, curve.model_N)
    )
    return Curve(time, depth, force, model, curve.fitted[index])


def _cubic(static: FloatArray, x: FloatArray) -> FloatArray:
    a1, a2, a3 = static.T[:, :, None]
    return np.asarray(x * (a1 + x * (a2 + x * a3)))


def predictive_bands(
    model: KelvinVoigt,
    theta: FloatArray,
    trials: Sequence[TrialFit],
    adjustments: Sequence[Adjustment],
    drawn: Redrawn,
    *,
    sigma_N: float,
) -> dict[tuple[str, str | None], FloatArray]:
    """The 95 % predictive band of every trial.

    Parameters
    ----------
    model : KelvinVoigt
    theta : ndarray, shape (p,)
        Of the optimum.
    trials : sequence of TrialFit
    adjustments : sequence of Adjustment
        Gain and offset of each trial at the optimum.
    drawn : Redrawn
    sigma_N : float
        Standard deviation of the noise [N].

    Returns
    -------
    dict
        (path, sheet) -> ndarray, shape (3, m): low, middle, high [N] at the samples of the trial's curve.
    """
    size = drawn.theta.shape[0]
    rows = np.linspace(0, size - 1, min(size, BAND_DRAWS)).astype(np.int64)
    bands = {}
    for i, (trial, adjustment) in enumerate(zip(trials, adjustments, strict=True)):
        curve, own = trial.curve, adjustment.contact_offset_mm
        shift, spread = np.zeros(curve.time_s.size), np.zeros(curve.time_s.size)
        if adjustment.static is None:
            few = _at(curve, kept_samples(curve.force_N, curve.depth_mm, most=BAND_POINTS))
            best = _forces(model, theta[None], few, np.array([adjustment.gain]), np.array([own]))
            change = _forces(model, drawn.theta[rows], few, drawn.gain[rows, i], drawn.offset_mm[rows, i])
            change -= best
            shift = np.interp(curve.time_s, few.time_s, change.mean(axis=0))
            spread = np.interp(curve.time_s, few.time_s, change.var(axis=0))
        half = TWO_SIDED_95 * np.sqrt(spread + sigma_N**2)
        middle = curve.model_N + shift
        bands[trial.path, trial.sheet] = np.stack([middle - half, middle, middle + half])
    return bands
