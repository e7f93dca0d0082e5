"""Predictive bands of the recordings under draws of the posterior."""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.target import SpecimenTarget
from tissueid.result import SpecimenFit

#: Draws that a band is made of.
BAND_DRAWS = 120
TWO_SIDED_95 = 1.959963984540054


def predictive_bands(
    fit: SpecimenFit, target: SpecimenTarget, vectors: FloatArray, *, sigma_N: float
) -> dict[tuple[str, str | None], FloatArray]:
    """The 95 % predictive band of every trial.

    ``vectors`` (n, size): draws, machine and contact with them: what they share moves no force; ``sigma_N``:
    standard deviation of the noise [N].  Returns (path, sheet) -> ndarray, shape (3, m): low, middle, high
    [N] at the samples of the trial's curve.
    """
    system = target.system
    rows = np.linspace(0, len(vectors) - 1, min(len(vectors), BAND_DRAWS)).astype(np.int64)
    force = target.forces(vectors[rows])
    change = force - np.median(force, axis=0)
    bands = {}
    for i, trial in enumerate(fit.trials):
        mine, curve = system.log == i, trial.curve
        own = change[:, mine]
        if len(fit.trials) > 1:
            # logs differ in level: their own gain takes up what all depths share
            base = np.median(force[:, mine], axis=0)
            own = own - ((own @ base) / max(float(base @ base), 1e-300))[:, None] * base
        # a few draws far out would be the whole of a variance
        sd = np.subtract(*np.quantile(own, [0.84, 0.16], axis=0)) / 2.0
        since = system.mid[mine] - system.logs[i].time_s[0]
        spread = np.interp(curve.time_s, since - since[0], sd)
        half = TWO_SIDED_95 * np.sqrt(spread**2 + sigma_N**2)
        bands[trial.path, trial.sheet] = np.stack([curve.model_N - half, curve.model_N, curve.model_N + half])
    return bands
