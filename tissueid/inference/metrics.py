"""Distances of a model from a recording: NRMSD three ways, largest residual, correlation in time.

Range (default): RMSD over (max - min) of the measured force.  Mean: RMSD over its mean, which on a
ramp is about twice as large.  Papers seldom say which one they print (model.md 4).
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.result import Nrmsd


def nrmsd(force_N: FloatArray, model_N: FloatArray) -> Nrmsd:
    """NRMSD by range and by mean, and RMSE [N], as fractions.

    The mean is that of the absolute force, which is the mean of a compressive one.  A constant force has
    no range: the fraction is then ``inf`` unless the model is exact.
    """
    force = np.asarray(force_N)
    rmse = float(np.sqrt(np.mean((force - model_N) ** 2)))
    spread = float(np.ptp(force))
    mean = float(np.abs(force).mean())

    def over(denominator: float) -> float:
        if denominator > 0.0:
            return rmse / denominator
        return 0.0 if rmse == 0.0 else float("inf")

    return Nrmsd(range=over(spread), mean=over(mean), rmse_N=rmse)


def lag_one_correlation(residual: FloatArray) -> float:
    """Autocorrelation of a residual at one sample; 0 for fewer than three samples."""
    centred = np.asarray(residual) - np.mean(residual)
    power = float(centred @ centred)
    if centred.size < 3 or power == 0.0:
        return 0.0
    return float(centred[1:] @ centred[:-1]) / power
