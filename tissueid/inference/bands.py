"""Predictive bands of the recordings under draws of the tissue."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.inference.estimates import TissueEstimate
from tissueid.inference.trials import kept_samples
from tissueid.model.base import ContactPath
from tissueid.result import SpecimenFit

__all__ = ["predictive_bands"]

FloatArray = NDArray[np.float64]

#: Draws and points that a band is made of.
BAND_DRAWS, BAND_POINTS = 200, 120
TWO_SIDED_95 = 1.959963984540054


def predictive_bands(
    fit: SpecimenFit, tissue: TissueEstimate, draws: FloatArray, *, sigma_N: float
) -> dict[tuple[str, str | None], FloatArray]:
    """The 95 % predictive band of every trial.

    Parameters
    ----------
    fit : SpecimenFit
    tissue : TissueEstimate
        Its centre.
    draws : ndarray, shape (n, p)
        Theta.
    sigma_N : float
        Standard deviation of the noise [N].

    Returns
    -------
    dict
        (path, sheet) -> ndarray, shape (3, m): low, middle, high [N] at the samples of the trial's curve.
    """
    model = tissue.model
    rows = np.linspace(0, len(draws) - 1, min(len(draws), BAND_DRAWS)).astype(np.int64)
    middle_theta = np.mean(draws, axis=0)
    bands = {}
    for trial in fit.trials:
        curve = trial.curve
        few = kept_samples(curve.force_N, curve.depth_mm, most=BAND_POINTS)
        depth = np.maximum(curve.depth_mm[few] - trial.contact_offset_mm, 0.0)
        path = ContactPath(curve.time_s[few], depth)
        base = model.force(middle_theta, path)
        change = np.stack([model.force(theta, path) for theta in draws[rows]]) - base
        # logs differ in level: their own gain takes up what all depths share
        weight = base / max(float(base @ base), 1e-300)
        if len(fit.trials) > 1:
            change = change - (change @ weight)[:, None] * base
        spread = np.interp(curve.time_s, curve.time_s[few], trial.gain**2 * change.var(axis=0))
        half = TWO_SIDED_95 * np.sqrt(spread + sigma_N**2)
        bands[trial.path, trial.sheet] = np.stack([curve.model_N - half, curve.model_N, curve.model_N + half])
    return bands
