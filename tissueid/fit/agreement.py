"""Two optimisers at one optimum: Levenberg-Marquardt beside variable projection, and whether they agree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tissueid.fit.candidates import Solution, SpecimenSums
from tissueid.fit.lm import levenberg_marquardt
from tissueid.fit.search import polish, unbounded_covariance

__all__ = ["both_optimisers"]

#: Levenberg-Marquardt starts from the optimum moved to this grid in ln tau.
LM_START_GRID = 0.25
#: Agreement of the two optimisers: relative sum of squares, and standard errors of ln tau.
AGREE_VALUE = 1e-7
AGREE_SD = 0.02


def both_optimisers(sums: SpecimenSums, solution: Solution) -> tuple[Solution, dict[str, object]]:
    """Run Levenberg-Marquardt beside the variable projection and keep the better optimum.

    Parameters
    ----------
    sums : SpecimenSums
    solution : Solution
        Found by variable projection.

    Returns
    -------
    solution : Solution
        At the better optimum.
    report : dict
        The ``optimisers`` object of ``schemas/identification.schema.json``.
    """
    bounds = sums.log_tau_bounds
    found = solution.evaluation
    rough = np.clip(np.round(found.log_tau / LM_START_GRID) * LM_START_GRID, *bounds)
    lm = levenberg_marquardt(solution.objective, solution.objective.evaluate(rough, found), bounds)
    if lm.value < found.value * (1.0 - AGREE_VALUE):
        better = polish(solution.objective, np.sort(lm.log_tau), bounds, warm=found)
        if better.value < found.value:
            found = better
            solution = replace(solution, evaluation=found)
    inverse, bounded = unbounded_covariance(found, solution.objective.blocks)
    variance = np.diag(inverse)[found.theta.size :] * solution.noise.sigma2
    sd = np.sqrt(np.where(np.isfinite(variance), np.maximum(variance, 1e-24), 1.0))
    difference = (lm.value - found.value) / found.value if found.value > 0.0 else 0.0
    apart = float((np.abs(np.sort(lm.log_tau) - found.log_tau) / sd).max(initial=0.0))
    agree = bool(abs(difference) <= AGREE_VALUE and apart <= AGREE_SD)
    return solution, {
        "method": "Levenberg-Marquardt (lmfit) and variable projection",
        "lm_sum_of_squares_N2": lm.value,
        "vp_sum_of_squares_N2": found.value,
        "relative_difference": float(difference),
        "lm_evaluations": lm.evaluations,
        "lm_converged": lm.converged,
        "agree": None if bounded and not agree else agree,
        "bound_active": bounded,
        "sigma_gain": solution.noise.gain_sd if solution.candidate.pooling == "partial" else None,
    }
