"""A passive tissue under a moving tool, stepped as a servo steps it."""

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.model.channels import ChannelModel
from tissueid.model.kernels import STATE_SIZE, tissue_step_in
from tissueid.model.servo_law import servo_law


class TissueStepper:
    """A passive tissue under a moving tool: pushes, lets go, recovers, is pushed again."""

    def __init__(self, model: ChannelModel, theta: FloatArray) -> None:
        if not model.is_passive(theta):
            raise ValueError("theta is not passive (F_s or K negative somewhere): it can't be rendered")
        self._law = servo_law(model, theta).packed()
        self._state = np.zeros(STATE_SIZE)

    @property
    def surface_mm(self) -> float:
        """Level of the tissue surface [mm below its rest level]."""
        return float(self._state[0])

    def step(self, depth_mm: float, dt_s: float) -> float:
        """Force [N], never negative, after ``dt_s`` s of linear motion to ``depth_mm`` (< 0: in air)."""
        return float(tissue_step_in(self._law, 0, self._state, 0, depth_mm, dt_s))
