"""The second pass over the logs of a specimen: everything that needs samples and the fitted tissue."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from msgspec import structs
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from tissueid.arrays import FloatArray
from tissueid.documents.identification import NoiseFit, Relaxation
from tissueid.documents.measured import Measured
from tissueid.documents.quantities import Cycle, Measure
from tissueid.inference.estimates import REFERENCE_DEPTH, TissueEstimate
from tissueid.inference.logs import LogHandle
from tissueid.inference.residual_blocks import HOLD_BLOCKS_PER_DECADE, ResidualBlocks, residual_blocks
from tissueid.inference.trials import Adjustment, ResidualTotals, over_force, summarise_trial
from tissueid.inference.window import FittedLog
from tissueid.measured import measure
from tissueid.measured.cycles import closed_area, cycle_rows
from tissueid.measured.geometry import TipOf
from tissueid.measured.relaxation import hold_ladders, relaxation_rows
from tissueid.measured.spectrum import HoldNumbers, hold_numbers
from tissueid.model.channels import ChannelModel
from tissueid.own_process import threads
from tissueid.result import Nrmsd, ResidualSummary, TrialFit
from tissueid.trial import Segmentation, Trial, contact_frame

#: Factors of K that are tried: outside, the model has another kind of loop than the tissue.
FACTORS = np.geomspace(0.1, 10.0, 13)


def with_model_viscosity(
    trial: Trial,
    segmentation: Segmentation,
    rows: Sequence[Cycle],
    model: ChannelModel,
    theta: FloatArray,
    adjustment: Adjustment,
) -> tuple[Cycle, ...]:
    """Loops of one trial with ``viscosity_model_N_s_per_mm`` filled where the model reaches their area."""
    if not rows or not (model.viscous and model.static.polynomial) or model.branches == 0:
        return tuple(rows)
    assert segmentation.contact is not None  # noqa: S101  (there are loops)
    depth, _ = contact_frame(trial, segmentation)
    begins = np.searchsorted(trial.time_s, [row.start_s for row in rows]).tolist()
    ends = np.searchsorted(trial.time_s, [row.end_s for row in rows], "right").tolist()
    ranges = [slice(*one) for one in zip(begins, ends, strict=True)]
    # from the last sample in air, so that the surface starts at rest where it is
    first = max(segmentation.contact.index - 1, 0)
    if ranges[0].start < first:  # preconditioning comes before the contact of the test
        air = np.flatnonzero(depth[: ranges[0].start + 1] <= 0.0)
        first = int(air[-1]) if air.size else 0
    weights = [closed_area(depth[one]) for one in ranges]
    law = depth - adjustment.contact_offset_mm
    areas = np.empty((FACTORS.size, len(rows)))
    force = np.zeros(depth.size)
    for k, factor in enumerate(FACTORS):
        _, force[first:] = model.follow(theta, trial.time_s[first:], law[first:], relaxing=factor)
        areas[k] = [adjustment.gain * float(w @ force[one]) for w, one in zip(weights, ranges, strict=True)]
    reference = np.array([REFERENCE_DEPTH * model.depth_mm])
    eta = float((model.stiffness(theta, reference)[:, 0] * model.times(theta)).sum())
    return tuple(_filled(row, areas[:, k], eta) for k, row in enumerate(rows))


def _filled(row: Cycle, areas: FloatArray, eta: float) -> Cycle:
    """One loop: the factor at which the area is the measured one, by interpolation in ln(area)."""
    wanted, spread = row.dissipated_mJ.value, row.dissipated_mJ.stderr
    grows = bool((np.diff(areas) > 0.0).all()) and areas[0] > 0.0
    if wanted is None or spread is None or not grows or not areas[0] <= wanted <= areas[-1]:
        return row
    logs, at = np.log(areas), float(np.log(wanted))
    curve = PchipInterpolator(logs, np.log(FACTORS))
    factor, slope = float(np.exp(curve(at))), float(curve(at, 1))
    error = eta * factor * slope * spread / wanted
    return structs.replace(row, viscosity_model_N_s_per_mm=Measure(eta * factor, error))


#: Bins of the histogram, and half its width in standard deviations of the noise.
BINS, HALF_WIDTH_SD = 40, 5.0
#: Lags grow geometrically, the same for every log, to a quarter of it.
LAGS_PER_DECADE, LARGEST_LAG_SHARE = 6, 0.25


def _correlation(residual: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Lags in samples and the autocorrelation there; none for fewer than eight samples."""
    largest = int(LARGEST_LAG_SHARE * residual.size)
    centred = residual - residual.mean() if residual.size else residual
    power = float(centred @ centred)
    if largest < 2 or power == 0.0:
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    places = np.arange(int(LAGS_PER_DECADE * np.log10(largest)) + 1) / LAGS_PER_DECADE
    lags = np.unique((10.0**places).round().astype(np.int64))
    found = [float(centred[lag:] @ centred[: centred.size - lag]) / power for lag in lags.tolist()]
    return lags, np.array(found)


def residual_summary(
    log: FittedLog, fitted: FloatArray, blocks: ResidualBlocks, *, sigma_N: float
) -> ResidualSummary:
    """Summarise what the model leaves of one log; ``sigma_N``: scale of the histogram."""
    data = log.data
    residual = (data.force_N - fitted)[data.include]
    # a fit without noise has no scale but the residual's own
    scale = sigma_N if sigma_N > 0.0 else float(np.abs(residual).max(initial=0.0)) or 1.0
    edges = np.linspace(-HALF_WIDTH_SD * scale, HALF_WIDTH_SD * scale, BINS + 1)
    places = np.searchsorted(edges, residual, side="right")
    lags, correlation = _correlation(residual)
    held = blocks.hold
    return ResidualSummary(
        start_s=float(data.time_s[0]),
        step_s=log.step_s,
        edges_N=edges,
        counts=np.bincount(places, minlength=BINS + 2).astype(np.int64),
        lags=lags,
        correlation=correlation,
        hold_since_s=10.0 ** ((blocks.place[held] + 0.5) / HOLD_BLOCKS_PER_DECADE),
        hold_mean_N=blocks.mean_N[held],
        hold_count=blocks.count[held].astype(np.int64),
    )


#: Threads that look at logs.
MAX_WORKERS = 4


@dataclass(frozen=True, slots=True)
class Known:
    """Facts of the specimen that the summary of each log needs."""

    tissue: TissueEstimate
    noise: NoiseFit
    depths_mm: Sequence[float]
    tip: TipOf


class Look(NamedTuple):
    """A recording by itself, whatever is fitted to it."""

    cycles: tuple[Cycle, ...]
    measured: Measured | None
    relaxation: tuple[Relaxation, ...]
    holds: HoldNumbers


@dataclass(frozen=True, slots=True)
class Summaries:
    """Summaries of a specimen's logs beside its tissue."""

    trials: tuple[TrialFit, ...]
    cycles: tuple[Cycle, ...]
    looks: tuple[Look, ...]  # one a trial
    nrmsd: Nrmsd  # over all fitted samples
    blocks: tuple[ResidualBlocks, ...]  # one a log: what a check for misfit looks at


class _OneLog(NamedTuple):
    """Summary of one log."""

    totals: ResidualTotals
    trial: TrialFit
    cycles: tuple[Cycle, ...]
    look: Look
    blocks: ResidualBlocks


def second_pass(
    handles: Sequence[LogHandle],
    adjustments: Sequence[Adjustment],
    known: Known,
    tick: Callable[[str], None],
    *,
    force_of: Callable[[int, FittedLog], FloatArray],
    looks: Sequence[Look] = (),
) -> Summaries:
    """Load every log once more and keep what a report needs of it; the logs are looked at in threads.

    ``looks``: of an earlier pass over the same logs.
    """
    workers = threads(min(len(handles), MAX_WORKERS))
    running: deque[Future[_OneLog]] = deque()
    found: list[_OneLog] = []
    with ThreadPoolExecutor(workers) as pool:
        for i, (handle, adjustment) in enumerate(zip(handles, adjustments, strict=True)):
            trial, log = handle.fitted()
            tick(f"residuals of {trial.name}")
            fitted = force_of(i, log)
            told = (trial, handle.segmentation, log, fitted, adjustment, looks[i] if looks else None, known)
            running.append(pool.submit(_one_log, *told))
            while len(running) > workers:
                found.append(running.popleft().result())
        found += [one.result() for one in running]
    squares, force, samples, low, high = zip(*(one.totals for one in found), strict=True)
    rmse = float(np.sqrt(sum(squares) / sum(samples)))
    return Summaries(
        trials=tuple(one.trial for one in found),
        cycles=tuple(row for one in found for row in one.cycles),
        looks=tuple(one.look for one in found),
        nrmsd=over_force(rmse, max(high) - min(low), sum(force) / sum(samples)),
        blocks=tuple(one.blocks for one in found),
    )


def _one_log(
    trial: Trial,
    segmentation: Segmentation,
    log: FittedLog,
    fitted: FloatArray,
    adjustment: Adjustment,
    look: Look | None,
    known: Known,
) -> _OneLog:
    """Summarise one log; it touches nothing else, so that logs may be looked at in threads."""
    model, theta = known.tissue.model, known.tissue.theta
    if look is None:
        ladders = hold_ladders(trial, segmentation)
        look = Look(
            cycles=tuple(cycle_rows(trial, segmentation, depths_mm=known.depths_mm)),
            measured=measure(trial, segmentation, geometry=known.tip.of(trial), ladders=ladders),
            relaxation=relaxation_rows(trial, segmentation, ladders),
            holds=hold_numbers(trial, segmentation),
        )
    blocks = residual_blocks(segmentation, log, model, theta, adjustment, fitted)
    summary = residual_summary(log, fitted, blocks, sigma_N=known.noise.sigma_N)
    told, totals = summarise_trial(trial, segmentation, log, fitted=fitted, adjustment=adjustment)
    told = replace(told, residual=summary, measured=look.measured)
    cycles = with_model_viscosity(trial, segmentation, look.cycles, model, theta, adjustment)
    return _OneLog(totals, told, cycles, look, blocks)
