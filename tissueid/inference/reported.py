"""From draws of the contact model to the numbers that are reported: one value a draw for each parameter."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.estimates import REFERENCE_DEPTH
from tissueid.model.base import branch_suffix
from tissueid.model.channels import TissueModel, viscous

#: Ends of the central 95 % interval, and the end of the one that begins at an active bound.
CENTRAL_95, FROM_BOUND_95 = (0.025, 0.975), 0.95
#: Lower end of the central interval over the median below which positive draws are densest at their bound:
#: of a normal that is cut where its density is that of the upper end (0.12).
CROWDED = 0.1


def reported_draws(model: TissueModel, theta: FloatArray) -> dict[str, FloatArray]:
    """Every reported parameter of each draw: theta by name, and the viscosities.

    ``theta`` (n, p).  Returns name -> ndarray, shape (n,), in the parameter's unit; viscosity at half depth
    where K varies.
    """
    out: dict[str, FloatArray] = {name: theta[:, k] for k, name in enumerate(model.parameter_names)}
    if not viscous(model):
        return out
    powers = (REFERENCE_DEPTH * model.depth_mm) ** np.arange(float(model.stiffness_degree + 1))
    for branch in range(model.branches):
        last = model.parameter_names.index(f"relaxation_time_s{branch_suffix(branch)}")
        stiffness = theta[:, last - powers.size : last] @ powers
        out[f"viscosity_N_s_per_mm{branch_suffix(branch)}"] = stiffness * theta[:, last]
    return out


def interval95(draws: Mapping[str, FloatArray]) -> dict[str, tuple[float, float]]:
    """The 95 % interval of each parameter's draws: central, or of highest density from an active bound of 0.

    Relaxation times have no bound at 0.
    """
    out = {}
    for name, values in draws.items():
        low, middle, high = np.quantile(values, (CENTRAL_95[0], 0.5, CENTRAL_95[1]))
        bounded = not name.startswith("relaxation_time") and float(values.min()) >= 0.0
        if bounded and low < CROWDED * middle:
            low, high = 0.0, np.quantile(values, FROM_BOUND_95)
        out[name] = (float(low), float(high))
    return out
