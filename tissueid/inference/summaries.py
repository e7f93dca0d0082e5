"""The second pass over the logs of a specimen: everything that needs samples and the fitted tissue."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.estimates import TissueEstimate
from tissueid.inference.holds import HoldNumbers, hold_numbers
from tissueid.inference.logs import LogHandle
from tissueid.inference.loop_area import with_model_viscosity
from tissueid.inference.residual_blocks import ResidualBlocks, residual_blocks
from tissueid.inference.residual_summary import residual_summary
from tissueid.inference.trials import Adjustment, ResidualTotals, summarise_trial
from tissueid.inference.window import FittedLog
from tissueid.measured import measure
from tissueid.measured.cycles import cycle_rows
from tissueid.measured.geometry import NO_TIP, TipOf
from tissueid.measured.relaxation import relaxation_rows
from tissueid.processors import threads
from tissueid.quantities import CycleRow, RelaxationRow
from tissueid.result import Nrmsd, TrialFit
from tissueid.trial import Segmentation, Trial
from tissueid.uncertainty import NoiseFit

#: Threads that look at logs.
MAX_WORKERS = 4


@dataclass(frozen=True, slots=True)
class _Known:
    """Facts of the specimen that the summary of each log needs."""

    tissue: TissueEstimate
    noise: NoiseFit
    depths_mm: Sequence[float]
    tip: TipOf


@dataclass(frozen=True, slots=True)
class Summaries:
    """Summaries of a specimen's logs beside its tissue."""

    trials: tuple[TrialFit, ...]
    relaxation: tuple[RelaxationRow, ...]
    cycles: tuple[CycleRow, ...]
    holds: tuple[HoldNumbers, ...]  # one a trial
    nrmsd: Nrmsd  # over all fitted samples
    blocks: tuple[ResidualBlocks, ...]  # one a log: what a check for misfit looks at


class _OneLog(NamedTuple):
    """Summary of one log."""

    totals: ResidualTotals
    trial: TrialFit
    relaxation: tuple[RelaxationRow, ...]
    cycles: tuple[CycleRow, ...]
    holds: HoldNumbers
    blocks: ResidualBlocks


def second_pass(
    handles: Sequence[LogHandle],
    adjustments: Sequence[Adjustment],
    tissue: TissueEstimate,
    tick: Callable[[str], None],
    *,
    noise: NoiseFit,
    force_of: Callable[[int, FittedLog], FloatArray],
    depths_mm: Sequence[float] = (),
    tip: TipOf = NO_TIP,
) -> Summaries:
    """Load every log once more and keep what a report needs of it; the logs are looked at in threads.

    ``adjustments``: one a log; ``tick``: told what is being read; ``force_of``: modelled force at the samples
    of a log, by its place among the handles; ``depths_mm``: depths at which the stiffness of each loop is
    wanted; ``tip``: for the moduli of what is measured.
    """
    known = _Known(tissue, noise, depths_mm, tip)
    workers = threads(min(len(handles), MAX_WORKERS))
    running: deque[Future[_OneLog]] = deque()
    found: list[_OneLog] = []
    with ThreadPoolExecutor(workers) as pool:
        for i, (handle, adjustment) in enumerate(zip(handles, adjustments, strict=True)):
            trial, log = handle.fitted()
            tick(f"residuals of {trial.name}")
            fitted = force_of(i, log)
            running.append(pool.submit(_one_log, trial, handle.segmentation, log, fitted, adjustment, known))
            while len(running) > workers:
                found.append(running.popleft().result())
        found += [one.result() for one in running]
    totals = ResidualTotals()
    for one in found:
        totals.merge(one.totals)
    rmse = float(np.sqrt(totals.squares / totals.count))
    spread, mean = totals.high - totals.low, abs(totals.force / totals.count)
    overall = Nrmsd(
        range=rmse / spread if spread > 0.0 else float("inf"),
        mean=rmse / mean if mean > 0.0 else float("inf"),
        rmse_N=rmse,
    )
    return Summaries(
        trials=tuple(one.trial for one in found),
        relaxation=tuple(row for one in found for row in one.relaxation),
        cycles=tuple(row for one in found for row in one.cycles),
        holds=tuple(one.holds for one in found),
        nrmsd=overall,
        blocks=tuple(one.blocks for one in found),
    )


def _one_log(
    trial: Trial,
    segmentation: Segmentation,
    log: FittedLog,
    fitted: FloatArray,
    adjustment: Adjustment,
    known: _Known,
) -> _OneLog:
    """Summarise one log; it touches nothing else, so that logs may be looked at in threads."""
    model, theta = known.tissue.model, known.tissue.theta
    totals = ResidualTotals()
    cycles = cycle_rows(trial, segmentation, depths_mm=known.depths_mm)
    blocks = residual_blocks(segmentation, log, model, theta, adjustment, fitted)
    summary = residual_summary(log, fitted, blocks, sigma_N=known.noise.sigma_N)
    told = summarise_trial(trial, segmentation, log, fitted=fitted, adjustment=adjustment, totals=totals)
    return _OneLog(
        totals=totals,
        trial=replace(
            told, residual=summary, measured=measure(trial, segmentation, geometry=known.tip.of(trial))
        ),
        relaxation=relaxation_rows(trial, segmentation),
        cycles=tuple(with_model_viscosity(trial, segmentation, cycles, model, theta, adjustment)),
        holds=hold_numbers(trial, segmentation),
        blocks=blocks,
    )
