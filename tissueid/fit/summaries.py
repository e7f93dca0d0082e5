"""The second pass over the logs of a specimen: everything that needs samples and the fitted tissue."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tissueid.fit.cycles import cycle_rows
from tissueid.fit.estimates import TissueEstimate
from tissueid.fit.holds import HoldNumbers, hold_numbers
from tissueid.fit.logs import LogHandle
from tissueid.fit.loop_area import with_model_viscosity
from tissueid.fit.relaxation import relaxation_rows
from tissueid.fit.residual_blocks import ResidualBlocks, residual_blocks
from tissueid.fit.trials import Adjustment, ResidualTotals, model_force, summarise_trial
from tissueid.likelihood.knots import KnotSums, knot_sums
from tissueid.quantities import CycleRow, RelaxationRow
from tissueid.result import Nrmsd, TrialFit
from tissueid.uncertainty import NoiseFit

__all__ = ["Summaries", "second_pass"]


@dataclass(frozen=True, slots=True)
class Summaries:
    """What the logs of a specimen say beside its tissue.

    Attributes
    ----------
    trials : tuple of TrialFit
    relaxation : tuple of RelaxationRow
    cycles : tuple of CycleRow
    holds : tuple of HoldNumbers
        One a trial.
    nrmsd : Nrmsd
        Over all fitted samples.
    blocks : tuple of ResidualBlocks
        One a log: what a check for misfit looks at.
    knots : tuple of KnotSums
        One a log: what a posterior with the instrument is taken over.
    """

    trials: tuple[TrialFit, ...]
    relaxation: tuple[RelaxationRow, ...]
    cycles: tuple[CycleRow, ...]
    holds: tuple[HoldNumbers, ...]
    nrmsd: Nrmsd
    blocks: tuple[ResidualBlocks, ...]
    knots: tuple[KnotSums, ...]


def second_pass(
    handles: Sequence[LogHandle],
    adjustments: Sequence[Adjustment],
    tissue: TissueEstimate,
    tick: Callable[[str], None],
    *,
    noise: NoiseFit,
    depths_mm: Sequence[float] = (),
) -> Summaries:
    """Load every log once more and keep what a report needs of it.

    Parameters
    ----------
    handles : sequence of LogHandle
    adjustments : sequence of Adjustment
        One a log.
    tissue : TissueEstimate
    tick : callable
        Told what is being read.
    noise : NoiseFit
        Held at its estimate where residuals are summed over knots.
    depths_mm : sequence of float
        Depths at which the stiffness of each loop is wanted.
    """
    totals = ResidualTotals()
    trials: list[TrialFit] = []
    rows: list[RelaxationRow] = []
    cycles: list[CycleRow] = []
    holds: list[HoldNumbers] = []
    blocks: list[ResidualBlocks] = []
    knots: list[KnotSums] = []
    for handle, adjustment in zip(handles, adjustments, strict=True):
        trial, log = handle.fitted()
        segmentation = handle.segmentation
        tick(f"residuals of {trial.name}")
        trials.append(
            summarise_trial(
                trial,
                segmentation,
                log,
                model=tissue.model,
                theta=tissue.theta,
                adjustment=adjustment,
                totals=totals,
            )
        )
        rows += relaxation_rows(trial, segmentation)
        found = cycle_rows(trial, segmentation, depths_mm=depths_mm)
        cycles += with_model_viscosity(trial, segmentation, found, tissue.model, tissue.theta, adjustment)
        holds.append(hold_numbers(trial, segmentation))
        blocks.append(residual_blocks(segmentation, log, tissue.model, tissue.theta, adjustment))
        knots.append(
            knot_sums(
                log.data,
                log.data.force_N - model_force(tissue.model, tissue.theta, log, adjustment),
                phi=noise.phi,
                reference_step_s=noise.reference_step_s,
                moving_average=noise.moving_average,
            )
        )
    rmse = float(np.sqrt(totals.squares / totals.count))
    spread, mean = totals.high - totals.low, abs(totals.force / totals.count)
    overall = Nrmsd(
        range=rmse / spread if spread > 0.0 else float("inf"),
        mean=rmse / mean if mean > 0.0 else float("inf"),
        rmse_N=rmse,
    )
    return Summaries(
        tuple(trials), tuple(rows), tuple(cycles), tuple(holds), overall, tuple(blocks), tuple(knots)
    )
