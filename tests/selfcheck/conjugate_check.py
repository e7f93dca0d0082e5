"""A check with a posterior in closed form, right or wrong on purpose; run as a program it can be killed."""

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tissueid.selfcheck.records import DRAWS, Checkpoint, Replicate, run_simulations

PRIOR_SD = 2.0
NOISE_SD = 1.0


@dataclass(frozen=True)
class NormalMean:
    """A normal mean from one sample: prior N(0, 2^2), noise N(0, 1); the posterior distorted as told."""

    width: float = 1.0
    shift: float = 0.0
    fails_above: float = np.inf
    pause_s: float = 0.0

    def __call__(self, rng: np.random.Generator) -> Replicate:
        truth = PRIOR_SD * rng.standard_normal()
        if truth > self.fails_above:
            raise ArithmeticError("no posterior here")
        time.sleep(self.pause_s)
        seen = truth + NOISE_SD * rng.standard_normal()
        weight = PRIOR_SD**2 / (PRIOR_SD**2 + NOISE_SD**2)
        sd = np.sqrt(weight) * NOISE_SD
        draws = weight * seen + sd * (self.shift + self.width * rng.standard_normal(DRAWS))
        return Replicate(
            truth={"mean": truth, "twice": 2.0 * truth}, draws={"mean": draws, "twice": 2.0 * draws}
        )


if __name__ == "__main__":
    with Checkpoint(Path(sys.argv[1]), "killed") as checkpoint:
        simulations, workers = map(int, sys.argv[2:4])
        check = NormalMean(pause_s=0.02)
        run_simulations(check, checkpoint, simulations=simulations, seed=5, workers=workers)
