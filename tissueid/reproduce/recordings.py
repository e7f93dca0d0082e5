"""A protocol simulated, written as the machine's export, read by the reader, fitted by the fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import NotIdentifiedError
from tissueid.inference.posterior import PosteriorOptions
from tissueid.inference.specimen import FitOptions
from tissueid.ingest import read_trials
from tissueid.pipeline import IdentifyOptions, identify
from tissueid.result import SpecimenFit
from tissueid.synth.dataset import EXPORTS, write_set
from tissueid.synth.recipe import Recipe
from tissueid.synth.simulate import SyntheticLog
from tissueid.trial import Trial
from tissueid.uncertainty import Posterior

#: Tails of a 99 % interval.
TAILS_99 = (0.005, 0.995)


@dataclass(frozen=True, slots=True)
class Effort:
    """Effort of a recomputation."""

    rate_Hz: float = 1000.0  # sampling rate of simulated recordings
    draws: int = 10_000  # effective draws of a posterior; 0 leaves posteriors out
    specimens: int = 17  # simulated specimens of the cohort
    seed: int = 20_261_122
    progress: Callable[[str], None] = lambda _message: None  # ``progress(message)``


def read_back(recipe: Recipe, *, seed: int) -> list[Trial]:
    """Simulate a recipe, write its exports, and read them.

    The files lie in a folder of their own for as long as it takes.
    """
    with TemporaryDirectory(prefix="tissueid-reproduce-") as folder:
        write_set(recipe, folder, seed=seed)
        return read_trials(folder)


def read_logs(logs: Sequence[SyntheticLog]) -> list[Trial]:
    """Write recordings as exports, and read them."""
    with TemporaryDirectory(prefix="tissueid-reproduce-") as folder:
        for log in logs:
            Path(folder, f"{log.name}.csv").write_bytes(EXPORTS["bare"].write(log))
        return read_trials(folder)


def fitted(
    trials: Sequence[Trial], effort: Effort, *, stiffness_degree: int, static: str = "shared"
) -> tuple[SpecimenFit, ...]:
    """Fit every specimen among trials of white noise, the model's order known.

    Raises NotIdentifiedError: the fit refused one of them.
    """
    options = IdentifyOptions(
        fit=FitOptions(branches=1, stiffness_degree=stiffness_degree, static=static, noise="white"),
        posterior=(
            PosteriorOptions(draws=effort.draws, seed=effort.seed, workers=2) if effort.draws else None
        ),
        seed=effort.seed,
    )
    found = identify(trials, options=options)
    if found.exit.code in (3, 7):
        msg = f"a simulated recording was refused: {'; '.join(found.exit.reasons)}"
        raise NotIdentifiedError(msg)
    return found.specimens


def interval_of(fit: SpecimenFit, name: str) -> tuple[float, float] | None:
    """99 % interval of a parameter, the machine as unknown as it was to the fit; ``None`` without draws."""
    if fit.posterior is None or name not in fit.posterior.theta_names:
        return None
    low, high = np.quantile(total_draws(fit.posterior)[:, fit.posterior.theta_names.index(name)], TAILS_99)
    return float(low), float(high)


def total_draws(posterior: Posterior) -> FloatArray:
    """Draws of theta with the machine open, or held where it can't be."""
    return posterior.draws if posterior.draws_total is None else posterior.draws_total
