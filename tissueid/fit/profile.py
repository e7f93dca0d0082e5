"""The profile likelihood of a relaxation time as a curve: how the fit worsens as tau moves, where K goes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.identifiability import on_ridge, ridge_of
from tissueid.likelihood.objective import Evaluation, Objective

__all__ = ["profile_curve"]

FloatArray = NDArray[np.float64]

#: Points of a curve, and how far it goes: to where the deviance has risen by so much (99.99 % of chi-square
#: with one degree of freedom is 15), or to the bounds of the search.
POINTS = 31
LARGEST_RISE = 15.0
#: Reach without a finite standard error, and the least and the most there is, in ln tau.
UNKNOWN_REACH = 2.0
LEAST_REACH, MOST_REACH = 1e-3, 4.0
HALVINGS = 12
DIGITS = 6


def profile_curve(
    objective: Objective,
    optimum: Evaluation,
    branch: int,
    *,
    sigma2: float,
    inverse: FloatArray,
    bounds: tuple[float, float],
    reference: FloatArray,
) -> dict[str, list[float]]:
    """Rise of the deviance and stiffness of one branch along its ln tau.

    Linear parameters and random effects are solved anew at each point; relaxation times of other branches
    move along the ridge of the Gauss-Newton curvature, as in
    :func:`tissueid.likelihood.identifiability.profile_interval`.

    Parameters
    ----------
    objective, optimum
        The fit.
    branch : int
    sigma2 : float
        Noise variance [N^2].
    inverse : ndarray, shape (branches, branches)
        Inverse curvature of ln tau.
    bounds : tuple of float
        Range of ln tau.
    reference : ndarray, shape (degree + 1,)
        Weights of this branch's coefficients in the stiffness that is quoted.

    Returns
    -------
    dict
        ``tau_s``, ``rise`` (of the deviance, in units of chi-square) and ``stiffness_N_per_mm``, ascending in
        tau; empty lists where the noise is none.
    """
    if not sigma2 > 0.0:
        return {"tau_s": [], "rise": [], "stiffness_N_per_mm": []}
    variance = inverse[branch, branch]
    known = bool(np.isfinite(variance)) and variance > 0.0
    ridge = ridge_of(inverse, branch)
    centre = float(optimum.log_tau[branch])
    size = reference.size
    first = optimum.theta.size - (optimum.log_tau.size - branch) * size

    def at(place: float, start: Evaluation) -> tuple[float, float, Evaluation]:
        found = objective.evaluate(on_ridge(optimum.log_tau, branch, ridge, place, bounds), start)
        rise = max((found.value - optimum.value) / sigma2, 0.0)
        return rise, float(found.theta[first : first + size] @ reference), found

    reach = float(np.sqrt(LARGEST_RISE * sigma2 * variance)) if known else UNKNOWN_REACH
    reach = float(np.clip(reach, LEAST_REACH, MOST_REACH))
    rows = [(centre, 0.0, float(optimum.theta[first : first + size] @ reference))]
    for end in (max(centre - reach, bounds[0]), min(centre + reach, bounds[1])):
        for _ in range(HALVINGS):
            if at(end, optimum)[0] <= 2.0 * LARGEST_RISE:
                break
            end = centre + 0.7 * (end - centre)
        last = optimum
        for place in np.linspace(centre, end, POINTS // 2 + 1)[1:].tolist():
            rise, stiffness, last = at(place, last)
            rows.append((place, rise, stiffness))
    rows.sort()
    tau, rise_of, stiffness_of = np.array(rows).T
    columns = {"tau_s": np.exp(tau), "rise": rise_of, "stiffness_N_per_mm": stiffness_of}
    return {
        name: [float(f"{value:.{DIGITS}g}") for value in values.tolist()] for name, values in columns.items()
    }
