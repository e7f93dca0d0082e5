"""A log that can be loaded again, the sums of a specimen's logs, and contact points found by the fit.

The segmenter sees a contact point in the first noisy samples; the fit sees it in the whole log, some ten
times better.  Where logs are pooled, a first fit with a wide guard zone finds every log's offset, the
contact points are moved there, and the branch states start where the tool really met the tissue.  A
state that starts 0.1 mm early biases the relaxation time by a quarter (model.md 2b).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Candidate, Solution, SpecimenSums, fit_candidate
from tissueid.fit.unloading import FreeSurface, with_unloading
from tissueid.fit.window import FittedLog, assign_folds, fitted_log, with_contact, with_holds_cut
from tissueid.likelihood import partial
from tissueid.likelihood.basis import kernel_basis
from tissueid.likelihood.objective import PartialObjective
from tissueid.likelihood.sums import LogData, LogSums, log_sums
from tissueid.processors import threads
from tissueid.trial import Segmentation, Trial

__all__ = ["LogHandle", "refine_contacts", "specimen_sums"]

FloatArray = NDArray[np.float64]

#: Smallest standard deviation of a contact point, as a fraction of the depth.
OFFSET_SD_FLOOR = 1e-5
#: Rounds of refinement; the second moves contact points by a tenth of the first.
ROUNDS = 2
#: A single log's contact point moves by no more than so many of its standard deviations.
REACH_SD = 3.0
#: Threads that sum logs.
MAX_WORKERS = 4


@dataclass(frozen=True, slots=True, eq=False)
class LogHandle:
    """A trial that can be loaded again, with what is known of it.

    Attributes
    ----------
    load : callable
        Returns the trial.
    segmentation : Segmentation
    facts : FittedLog
        Without its samples.
    contact_sd_mm : float
        Standard deviation of the contact point as segmented: the prior of the fit's contact offset.
    contact_shift_mm : float
        How far the fit has moved the contact point since.
    guard : bool
        See :func:`tissueid.fit.window.fitted_log`.
    unloading : bool
        True where samples after the tool first turned back take part.
    surface : FreeSurface or None
        The law whose surface is followed; ``None`` takes contact loss from the measured force.
    hold_share : float
        First share of every hold that takes part.
    """

    load: Callable[[], Trial]
    segmentation: Segmentation
    facts: FittedLog
    contact_sd_mm: float
    contact_shift_mm: float = 0.0
    guard: bool = False
    unloading: bool = False
    surface: FreeSurface | None = None
    hold_share: float = 1.0

    def window(self, trial: Trial, segmentation: Segmentation, *, guard: bool = False) -> FittedLog | None:
        """The part of a trial that is fitted under a segmentation; ``None`` where there is none."""
        log = fitted_log(trial, segmentation, guard=guard, whole=self.unloading)
        if log is None or not self.unloading:
            return log
        return with_unloading(segmentation, log, self.surface)

    def fitted(self) -> tuple[Trial, FittedLog]:
        """The trial and its fitted part, loaded anew."""
        trial = self.load()
        log = self.window(trial, self.segmentation, guard=self.guard)
        if log is None:
            # the guard zone may swallow a very shallow log: then it is fitted as it is
            log = self.window(trial, self.segmentation)
        if log is None:
            msg = f"{trial.name} changed while it was being fitted"
            raise RuntimeError(msg)
        if self.hold_share < 1.0:
            log = with_holds_cut(log, self.segmentation.of_kind("hold"), self.hold_share)
        return trial, log


def _thinned(data: LogData, thin: int) -> LogData:
    """Every ``thin``-th sample takes part; the branch states still run through all."""
    if thin == 1:
        return data
    return replace(data, include=data.include & (np.arange(data.include.size) % thin == 0))


def specimen_sums(
    handles: Sequence[LogHandle],
    degree: int,
    tick: Callable[[str], None],
    *,
    thin: int = 1,
    log_range: tuple[float, float] | None = None,
    cut: bool = True,
) -> SpecimenSums:
    """One pass over the logs of a specimen.

    Logs are loaded one after the other and summed in threads, one BLAS thread each: threads of BLAS
    would meet after every chunk, which a busy machine pays tenfold. The order of adding is fixed.

    Parameters
    ----------
    handles : sequence of LogHandle
    degree : int
        Highest degree of K that will be asked for.
    tick : callable
        Told what is being read.
    thin : int
        Only every ``thin``-th sample takes part (for a rough answer).
    log_range : tuple of float, optional
        Part of the range of ln(tau / s) that will be searched.
    cut : bool
        Cut the one log of a specimen into stretches that can be held out.
    """
    step = min(handle.facts.step_s for handle in handles)
    duration = max(handle.facts.duration_s for handle in handles)
    basis = kernel_basis(step_s=step, length_s=duration, log_range=log_range)
    single = cut and len(handles) == 1
    workers = threads(min(len(handles), MAX_WORKERS))
    running: deque[Future[LogSums]] = deque()
    sums: list[LogSums] = []
    depth = 0.0
    with ThreadPoolExecutor(workers) as pool:
        for handle in handles:
            trial, log = handle.fitted()
            tick(f"summing {trial.name}")
            data = assign_folds(log, handle.segmentation.of_kind("hold")) if single else log.data
            depth = max(depth, log.depth_mm)
            running.append(pool.submit(log_sums, _thinned(data, thin), basis, degree=degree))
            while len(running) > workers:
                sums.append(running.popleft().result())
        sums += [one.result() for one in running]
    offset_sd = np.array([max(handle.contact_sd_mm, OFFSET_SD_FLOOR * depth) for handle in handles])
    gram = np.concatenate([one.gram for one in sums])
    return SpecimenSums(
        gram=gram,
        count=np.concatenate([one.count for one in sums]),
        offset_sd_mm=np.full(gram.shape[0], offset_sd[0]) if single else offset_sd,
        basis=basis,
        columns_degree=degree,
        depth_mm=depth,
        step_s=step,
        duration_s=duration,
        single=single,
        logs=np.arange(gram.shape[0]),
        log_range=log_range,
    )


def _offset_sd(solution: Solution) -> FloatArray:
    """Posterior standard deviation of every contact offset, tissue held, gain free [mm]."""
    found, objective = solution.evaluation, solution.objective
    assert isinstance(objective, PartialObjective)  # noqa: S101
    q = objective.reduced(found.log_tau)
    columns = partial.STATIC_COLUMNS + objective.branches * (objective.degree + 1)
    sd = np.empty(found.delta.size)
    for i in range(sd.size):
        matrix, shifted = partial.coefficients(
            found.gamma[i], found.delta[i], objective.scale, objective.degree, objective.branches
        )
        moves = np.column_stack([matrix @ found.theta, shifted @ found.theta])
        curvature = moves.T @ q[i, :columns, :columns] @ moves
        curvature += np.diag([objective.weight_gain, objective.weight_offset[i]])
        sd[i] = np.sqrt(np.linalg.inv(curvature)[1, 1] * solution.noise.sigma2)
    return sd


def refine_contacts(
    handles: Sequence[LogHandle], candidate: Candidate, tick: Callable[[str], None]
) -> list[LogHandle]:
    """Move every log's contact point to where the fit of all logs puts it.

    Parameters
    ----------
    handles : sequence of LogHandle
        Logs of one specimen.
    candidate : Candidate
        A flexible model with ``partial`` pooling.
    tick : callable

    Returns
    -------
    list of LogHandle
        With contact points that are known to the fit's standard deviation.
    """
    current = [replace(handle, guard=True) for handle in handles]
    for round_ in range(ROUNDS):
        tick(f"contact points, round {round_ + 1}")
        sums = specimen_sums(current, candidate.degree, tick, cut=False)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            solution = fit_candidate(sums, candidate)
            offset_sd = _offset_sd(solution)
        if not (np.isfinite(solution.evaluation.delta) & np.isfinite(offset_sd)).all():
            # a log without noise or without shape: there is nothing to place the contact by
            return list(handles)
        refined = []
        for handle, delta, sd in zip(current, solution.evaluation.delta, offset_sd, strict=True):
            if len(handles) == 1 and abs(handle.contact_shift_mm + delta) > REACH_SD * handle.contact_sd_mm:
                # no other log speaks for it: a model that does not fit would move the contact anywhere
                return list(handles)
            trial = handle.load()
            segmentation = with_contact(trial, handle.segmentation, shift_mm=float(delta), sd_mm=float(sd))
            log = handle.window(trial, segmentation)
            if log is None:
                refined.append(handle)
                continue
            refined.append(
                replace(
                    handle,
                    segmentation=segmentation,
                    facts=log.without_samples(),
                    contact_shift_mm=handle.contact_shift_mm + float(delta),
                    guard=False,
                )
            )
        current = refined
    return current
