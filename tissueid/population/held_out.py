"""Prediction of a specimen by the typical tissue of others: NRMSD on specimens that took no part.

Each specimen (each tenth of a large cohort) is left out, the population is drawn from the others, and its
typical tissue at the left-out specimen's covariates is moved along that specimen's recorded depth.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.documents import plain
from tissueid.documents.population import Trial
from tissueid.model.base import ContactPath
from tissueid.population.coordinates import Coordinates
from tissueid.population.design import Described
from tissueid.population.members import Member, TrialRow
from tissueid.population.sampler import SamplerOptions, sample_population
from tissueid.population.stage_one import Design, StageOne
from tissueid.priors import PopulationPriors

#: Leave-one-out up to so many specimens, so many parts beyond.
MOST_SINGLE = 20
PARTS = 10
#: NRMSD of the population model in paper A [%]; its normaliser is not stated.
PAPER_A_PERCENT = (4.23, 10.95)
#: A typical tissue is needed, not its uncertainty: short chains do.
SHORT_CHAINS, SHORT_SETTLE, SHORT_SWEEPS = 2, 300, 700
FEWEST_SAMPLES = 5


@dataclass(frozen=True, slots=True)
class HeldOut:
    """All predictions."""

    folds: int
    rows: tuple[Trial, ...]

    def as_json(self) -> dict[str, Any]:
        """The ``held_out`` object of the schema."""
        document: dict[str, Any] = {"folds": self.folds, "paper_a_percent": list(PAPER_A_PERCENT)}
        for key in ("nrmsd_range", "nrmsd_mean"):
            values = np.array([getattr(row, key) for row in self.rows])
            low, middle, high = np.quantile(values, [0.16, 0.5, 0.84])
            document[key] = {"median": float(middle), "low68": float(low), "high68": float(high)}
        return document | {"trials": plain(self.rows)}


def prediction_error(
    coordinates: Coordinates, theta: FloatArray, trial: TrialRow
) -> tuple[float, float] | None:
    """NRMSD by range and by mean of one tissue on one log, where it was fitted and within the common depth.

    ``theta`` (p,).  Returns fractions; ``None`` where the log has no curve or no force there.
    """
    curve = trial.curve
    if curve is None:
        return None
    use = curve.fitted & (curve.depth_mm <= coordinates.depth_mm * (1.0 + 1e-9)) & (curve.depth_mm >= 0.0)
    if use.sum() < FEWEST_SAMPLES:
        return None
    model = coordinates.model.force(theta, ContactPath(curve.time_s, np.maximum(curve.depth_mm, 0.0)))
    force = curve.force_N[use]
    rmsd = float(np.sqrt(np.mean((model[use] - force) ** 2)))
    span, mean = float(np.ptp(force)), float(force.mean())
    if not (span > 0.0 and mean > 0.0):
        return None
    return rmsd / span, rmsd / mean


def _folds(count: int, rng: np.random.Generator) -> list[NDArray[np.int64]]:
    if count <= MOST_SINGLE:
        return [np.array([i]) for i in range(count)]
    return [np.sort(part) for part in np.array_split(rng.permutation(count), PARTS)]


def _without(stage: StageOne, design: Design, keep: NDArray[np.int64]) -> tuple[StageOne, Design]:
    """The same without some specimens; groups that are empty then stay, at their prior."""
    fewer = replace(
        stage,
        phi=tuple(stage.phi[i] for i in keep),
        log_reference=tuple(stage.log_reference[i] for i in keep),
    )
    return fewer, replace(design, columns=design.columns[keep], group=design.group[:, keep])


def held_out(
    members: Sequence[Member],
    stage: StageOne,
    described: Described,
    coordinates: Coordinates,
    priors: PopulationPriors,
    options: SamplerOptions,
    tick: Callable[[str], None],
) -> HeldOut | None:
    """Predict every specimen from the others.

    Returns ``None`` where no log has a curve within the common depth, or fewer than three specimens would be
    left.
    """
    if len(members) < 4 or not any(trial.curve is not None for one in members for trial in one.trials):
        return None
    short = replace(options, chains=SHORT_CHAINS, settle=SHORT_SETTLE, sweeps=SHORT_SWEEPS, blocks=1)
    folds = _folds(len(members), np.random.default_rng([options.seed, 3]))
    rows = []
    for done, fold in enumerate(folds):
        tick(f"predicting held-out specimens, {done + 1} of {len(folds)}")
        keep = np.setdiff1d(np.arange(len(members)), fold)
        fewer, design = _without(stage, described.design, keep)
        found = sample_population(fewer, design, priors, short)
        coefficient = np.median(found.coefficient.reshape(-1, *found.coefficient.shape[2:]), axis=0)
        for i in fold:
            theta = coordinates.to_theta(described.design.columns[i] @ coefficient)[0]
            for trial in members[i].trials:
                error = prediction_error(coordinates, theta, trial)
                if error is not None:
                    rows.append(Trial(members[i].specimen, trial.path, trial.sheet, *error))
    return HeldOut(len(folds), tuple(rows)) if rows else None
