"""Fitted samples of a trial, in the contact frame.

From contact to the end of the last ramp or hold before the tool first turns back, or to the first rupture.
Cycles before a test take no part, but their state is carried on: on the tool's path while it touches, on
that of the surface where it has let go, which recovers along F_s(y) + sum K_j(y) s_j = 0 (derived): first as
the measured force tells, then under the parameters found.  So are retracts, where they are fitted.
Samples within three sd of a contact that was found, or at the limit of the cell, are not in the likelihood.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.measured.pushes import first_of_test, first_turn, mean_speed, measured_surface, usable_until
from tissueid.signal_noise import chain_breaks, dropouts, steadied
from tissueid.trial import RENDERED, Phase, Segmentation, Trial, contact_frame

#: Contact standard deviations below contact that stay out of the likelihood.
GUARD_SD = 3.0
#: Fewest samples that are worth a fit.
MIN_SAMPLES = 6
#: Ratio of speeds, and of depths of holds, below which a set counts as one.
ONE_SPEED, ONE_DEPTH = 1.2, 1.2
#: A record begins in motion where the tool has gone half the way of this share of its travel, or of so many
#: samples, in this share of half the time; under a force where that is so many sd of noise.
BEGINS_SHARE, BEGINS_SAMPLES, EVEN_SHARE, FORCE_SD = 0.02, 2, 0.75, 4.0
#: Held-out groups of a specimen with one log, and stretches a phase is cut into for them.
FOLDS, STRETCHES = 6, 24


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceResponse:
    """First-order response of a path in air to the law whose surface it follows."""

    law: object
    log_times: FloatArray  # (t,)
    linear: FloatArray  # (p,)
    offset: float  # contact offset of the log over the largest depth
    #: (t + p + 1, n): depth by ln times, linear parameters and offset [mm].
    by: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class LogData:
    """One log in the contact frame, from contact to the end of its fitted part."""

    time_s: FloatArray  # (n,), from contact on
    depth_mm: FloatArray  # (n,)
    force_N: FloatArray  # (n,), compressive
    #: (n,): samples that take part in the likelihood (the branch state runs through all of them).
    include: NDArray[np.bool_]
    fold: NDArray[np.int64]  # (n,), held-out group of every sample; all zero where whole logs are held out
    #: (n,): true where a sample starts a new chain of noise (:func:`chain_breaks`); ``None``: by time stamps.
    breaks: NDArray[np.bool_] | None = None
    #: The travel is straight between samples and known exactly: a rendered law followed just it.
    exact: bool = False
    #: (n,): speed over that at which each contact began (:mod:`tissueid.inference.channel_law`).
    speed_ratio: FloatArray | None = None
    response: SurfaceResponse | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FittedLog:
    """The fitted part of a trial and what the fit needs to know about it."""

    data: LogData
    #: Trial sample of the first row of ``data`` that was recorded (an inserted contact comes before it).
    first: int
    inserted: bool  # true where ``data`` begins with a contact point between two samples
    contact_sd_mm: float
    depth_mm: float  # largest fitted depth
    step_s: float  # median sampling interval [s]
    speeds_mm_s: tuple[float, ...]  # loading speeds of its ramps
    has_hold: bool  # of a depth, or of a load
    n_samples: int  # samples that take part in the likelihood
    #: (n,): depth of a tool that turned back and may have let go: ``data.depth_mm`` is then that of the
    #: surface that it leaves behind.
    tool_mm: FloatArray | None = None
    #: Depth of the first sample by its force, where the tool moves there [mm]; zero where it does not.
    arrives_mm: float = 0.0

    def without_samples(self) -> FittedLog:
        """The facts alone: the first and last sample stand for all."""
        ends = np.array([0, -1])
        data = self.data
        kept = LogData(
            data.time_s[ends], data.depth_mm[ends], data.force_N[ends], data.include[ends], data.fold[ends],
            None if data.breaks is None else data.breaks[ends],
        )  # fmt: skip
        tool = None if self.tool_mm is None else self.tool_mm[ends]
        return replace(self, data=kept, tool_mm=tool)

    @property
    def duration_s(self) -> float:
        """From contact to the last fitted sample [s]."""
        return float(self.data.time_s[-1] - self.data.time_s[0])


class FreeSurface(Protocol):
    """The law that says where the surface of one log stands."""

    def follow(self, time_s: FloatArray, tool_mm: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Depth of the surface [mm] in the frame of the log, and whether the tool touches it."""

    def response(self, time_s: FloatArray, tool_mm: FloatArray, path_mm: FloatArray) -> SurfaceResponse:
        """Response of that depth to the law."""


def _crossed(time_s: FloatArray, depth_mm: FloatArray, *, exact: bool) -> float:
    """Time at which a tool crosses the surface between two samples; a rendered law starts from the first."""
    share = 1.0 if exact else depth_mm[1] / (depth_mm[1] - depth_mm[0])
    return float(time_s[1] - share * (time_s[1] - time_s[0]))


def _unmeasured(trial: Trial, segmentation: Segmentation) -> NDArray[np.bool_]:
    """Samples at the limit of the cell, and those in which its signal was lost."""
    limits = [flag.values["force_N"] for flag in trial.flags if flag.code == "clipped_force"]
    lost = dropouts(trial.force_N, trial.displacement_mm, noise=segmentation.force_noise_N)
    return np.isin(trial.force_N, limits) | lost


def _driving(trial: Trial, segmentation: Segmentation) -> tuple[FloatArray, FloatArray]:
    """Depth that drives a law, and force; a rendered law followed what it read, noise and all."""
    depth, force = contact_frame(trial, segmentation)
    if trial.protocol.kind == RENDERED:
        return depth, force
    return steadied(trial.time_s, depth, force, noise_N=segmentation.force_noise_N), force


def fitted_log(
    trial: Trial,
    segmentation: Segmentation,
    *,
    guard: bool = False,
    whole: bool = False,
    surface: FreeSurface | None = None,
) -> FittedLog | None:
    """The fitted part of a trial, or ``None`` where there is nothing to fit.

    ``guard``: leave the neighbourhood of contact out even where the record seems to start in contact;
    ``whole``: to the end, unloading and all; ``surface``: a law that follows it, else the force tells.
    """
    if (contact := segmentation.contact) is None:
        return None
    depth, force = _driving(trial, segmentation)
    first, begins = contact.index, first_of_test(segmentation)
    turn = first_turn(segmentation, depth, first)
    last = max(usable_until(segmentation, depth.size), turn) if whole else turn
    time, x, f = trial.time_s[first:last], depth[first:last], force[first:last]
    include = (np.arange(first, last) >= begins) & ~_unmeasured(trial, segmentation)[first:last]
    if (contact.in_record or guard) and begins <= first:
        include &= x >= GUARD_SD * contact.sd_mm
    exact = trial.protocol.kind == RENDERED
    inserted = contact.in_record and 0 < first < depth.size and bool(depth[first] > 0.0 >= depth[first - 1])
    if inserted:
        start = _crossed(trial.time_s[first - 1 : first + 1], depth[first - 1 : first + 1], exact=exact)
        time, x, f = np.append(start, time), np.append(0.0, x), np.append(0.0, f)
        include = np.append(False, include)
    tool, response, ahead = None, None, first - int(inserted)
    if whole or begins > first:
        # a tool that lets go leaves a surface behind, which comes back, and which the states follow
        turned = min([turn, *(one.peak for one in segmentation.phases if one.peak is not None)]) - ahead
        by_force = partial(measured_surface, force_N=f, turn=turned, noise_N=segmentation.force_noise_N)
        path, touching = (by_force if surface is None else surface.follow)(time, x)
        tool = x if whole or not touching.all() else None
        if surface is not None and not whole and contact.moved_mm == 0.0:
            # nobody knows how far tissue that is met elsewhere has set; in unloading, samples come and go
            response = surface.response(time, x, path)
        x, include = path, include & touching
    steps = np.diff(time[int(inserted) :])
    positive = steps[steps > 0.0]
    depth_mm = float(x[include].max(initial=0.0))
    if include.sum() < MIN_SAMPLES or positive.size == 0 or depth_mm <= 0.0 or np.ptp(f[include]) == 0.0:
        return None
    inside = [one for one in segmentation.phases if max(first, begins) < one.stop and one.start < last - 1]
    speeds = tuple(phase.speed_mm_s for phase in inside if phase.kind == "ramp")
    folds, breaks = np.zeros(time.size, dtype=np.int64), chain_breaks(time)
    return FittedLog(
        data=LogData(time, x, f, include, folds, breaks=breaks, exact=exact, response=response),
        first=first,
        inserted=inserted,
        contact_sd_mm=contact.first_sd_mm,
        depth_mm=depth_mm,
        step_s=float(np.median(positive)),
        speeds_mm_s=speeds or (mean_speed(time, x[: max(turn - first, 2)]),),
        has_hold=any(phase.kind in ("hold", "creep") for phase in inside),
        n_samples=int(include.sum()),
        tool_mm=tool,
        arrives_mm=0.0 if exact or begins or first or contact.in_record else _arrives(x, f, segmentation),
    )


def _arrives(depth_mm: FloatArray, force_N: FloatArray, segmentation: Segmentation) -> float:
    """Depth that force and stiffness of the first samples are worth [mm]; zero where the tool stood."""
    deepest, noise_N = float(depth_mm.max()), segmentation.force_noise_N
    begun = int(np.argmax(depth_mm >= depth_mm[0] + BEGINS_SHARE * (deepest - depth_mm[0])))
    last = max(begun, BEGINS_SAMPLES)
    half, travel = last // 2, float(depth_mm[last] - depth_mm[0])
    even = depth_mm[half] - depth_mm[0] >= EVEN_SHARE * travel * half / last
    if force_N[0] <= FORCE_SD * noise_N or travel <= 0.0 or not even:
        return 0.0
    if not any("sd_mm" in flag.values for flag in segmentation.flags if flag.code == "starts_in_contact"):
        return float(depth_mm[0])  # by a contact that is stated
    slope = max(float(force_N[last] - force_N[0]), noise_N) / travel
    return min(float(force_N[0]) / slope, deepest)


def with_holds_cut(log: FittedLog, holds: Sequence[Phase], share: float) -> FittedLog:
    """The same log with samples after the first ``share`` of each hold left out of the likelihood."""
    include = log.data.include.copy()
    time = log.data.time_s
    for hold in holds:
        end = hold.start_s + share * (hold.end_s - hold.start_s)
        include &= (time <= end) | (time > hold.end_s)
    return replace(log, data=replace(log.data, include=include), n_samples=int(include.sum()))


def assign_folds(log: FittedLog, holds: tuple[Phase, ...]) -> LogData:
    """The samples with the number of their stretch: of equal depth in a ramp, equal ln(time) in a hold."""
    data = log.data
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(data.depth_mm)))])
    progress = travelled / max(travelled[-1], 1e-300)
    offset = log.first - int(log.inserted)
    for hold in holds:
        start, stop = max(hold.start - offset, 0), min(hold.stop - offset, data.time_s.size)
        if stop - start < 2:
            continue
        since = data.time_s[start:stop] - data.time_s[start]
        fraction = np.log1p(since / log.step_s) / max(np.log1p(since[-1] / log.step_s), 1e-300)
        progress[start:stop] += fraction
        progress[stop:] += 1.0
    stretch = np.floor(progress * STRETCHES * (1 - 1e-12) / max(float(progress[-1]), 1e-300)).astype(np.int64)
    return replace(data, fold=np.clip(stretch, 0, STRETCHES - 1))


def one_program(facts: Sequence[FittedLog]) -> bool:
    """Test for one speed and one depth: only the form of ramps and holds tells F_s from K(x) then."""
    held = [log.depth_mm for log in facts if log.has_hold]
    steps = any(len(log.speeds_mm_s) > 1 for log in facts)
    same_depth = not held or max(held) < ONE_DEPTH * min(held)
    return one_speed(facts) is not None and same_depth and not steps


def one_speed(facts: Sequence[FittedLog]) -> float | None:
    """The one speed of all ramps [mm/s], ``None`` where there are several."""
    speeds = [speed for log in facts for speed in log.speeds_mm_s if speed > 0.0]
    return float(np.mean(speeds)) if speeds and max(speeds) < ONE_SPEED * min(speeds) else None
