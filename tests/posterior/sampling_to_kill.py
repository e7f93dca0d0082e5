"""Samples a slow density with a checkpoint until it is killed: ``python sampling_to_kill.py FILE``."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
from closed_form_targets import Normal
from numpy.typing import NDArray

from tissueid.posterior.ensemble import sample_ensemble


class Slow(Normal):
    """A normal that takes its time."""

    def log_density(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        time.sleep(0.006)
        return super().log_density(points)


if __name__ == "__main__":
    sample_ensemble(Slow(3), draws=8_000, seed=41, checkpoint=Path(sys.argv[1]), key="kill")
