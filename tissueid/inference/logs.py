"""A log that can be loaded again, with what is known of it, its blocks, and its unloading.

A tool that lets go leaves a surface that recovers along F_s(y) + sum K_j(y) s_j = 0 (derived).  Branch states
follow it, so that a log is summed on its path, the samples in air left out: first as the measured force
tells, then under the parameters found.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.errors import InputError
from tissueid.inference.blocks import Blocks, log_blocks
from tissueid.inference.channel_law import with_speed_ratio
from tissueid.inference.window import FittedLog, LogData, assign_folds, first_turn, fitted_log, with_holds_cut
from tissueid.model.channels import ChannelModel
from tissueid.model.grammar import Candidates
from tissueid.trial import Segmentation, Trial

#: Measured force, over the peak and in standard deviations of its noise, below which the tool is in air.
AIR_SHARE, AIR_SD = 0.01, 3.0
#: Samples of the running mean that is compared with it; shorter stays in air or contact are noise.
SMOOTHED = 5


@dataclass(frozen=True, slots=True, eq=False)
class FreeSurface:
    """The law that says where the surface of one log stands."""

    model: ChannelModel
    theta: FloatArray  # (p,), passive
    offset_mm: float = 0.0  # contact offset of the log against its contact frame

    def follow(self, time_s: FloatArray, tool_mm: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Depth of the surface [mm] in the frame of the log, and whether the tool touches it."""
        law_mm = tool_mm - self.offset_mm
        surface, _ = self.model.follow(self.theta, time_s, law_mm)
        return surface + self.offset_mm, surface <= law_mm


def air_limit(force_N: FloatArray, noise_N: float) -> float:
    """Mean force over :data:`SMOOTHED` samples below which the tool counts as in air [N]."""
    return max(AIR_SHARE * float(force_N.max()), AIR_SD * noise_N / float(np.sqrt(SMOOTHED)))


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Stretches ``[first, last)`` of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _measured_surface(
    time_s: FloatArray, tool_mm: FloatArray, force_N: FloatArray, turn: int, noise_N: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """The first path: in air where the force says so, the surface moving evenly from loss to contact."""
    limit = air_limit(force_N, noise_N)
    mean = np.convolve(force_N, np.ones(SMOOTHED) / SMOOTHED, mode="same")
    air = (mean < limit) & (np.arange(force_N.size) >= turn)
    for first, last in _runs(~air):
        if first > 0 and last - first < SMOOTHED:
            air[first:last] = True
    surface = tool_mm.copy()
    for first, last in _runs(air):
        if last - first < SMOOTHED:
            air[first:last] = False
            continue
        end = tool_mm[first - 1] if last == tool_mm.size else tool_mm[last]
        knots = time_s[[first - 1, min(last, time_s.size - 1)]]
        between = np.interp(time_s[first:last], knots, [tool_mm[first - 1], end])
        surface[first:last] = np.maximum(between, tool_mm[first:last])
    return surface, ~air


def with_unloading(segmentation: Segmentation, log: FittedLog, surface: FreeSurface | None) -> FittedLog:
    """A whole log on its surface's path, the samples in air left out; without one, as the force tells."""
    data = log.data
    tool = data.depth_mm
    if surface is None:
        ahead = log.first - int(log.inserted)
        depth = np.concatenate([np.full(ahead, tool[0]), tool])
        turn = first_turn(segmentation, depth, log.first) - ahead
        path, touching = _measured_surface(data.time_s, tool, data.force_N, turn, segmentation.force_noise_N)
    else:
        path, touching = surface.follow(data.time_s, tool)
    include = data.include & touching
    there = replace(data, depth_mm=np.ascontiguousarray(path), include=include)
    return replace(log, data=there, n_samples=int(include.sum()), tool_mm=tool)


#: Code of a log without a contact that its law could follow.
NO_CONTACT = "no_contact"
#: Smallest standard deviation of a contact point, as a fraction of the depth.
OFFSET_SD_FLOOR = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class LogHandle:
    """A trial that can be loaded again, with what is known of it."""

    load: Callable[[], Trial]  # returns the trial
    segmentation: Segmentation
    facts: FittedLog  # without its samples
    #: Standard deviation of the contact point as segmented: the prior of the fit's contact offset.
    contact_sd_mm: float
    contact_shift_mm: float = 0.0  # how far the fit has moved the contact point since
    guard: bool = False  # see :func:`tissueid.inference.window.fitted_log`
    unloading: bool = False  # true where samples after the tool first turned back take part
    #: The law whose surface is followed; ``None`` takes contact loss from the measured force.
    surface: FreeSurface | None = None
    hold_share: float = 1.0  # first share of every hold that takes part
    follows_speed: bool = False  # the speed ratio along the log is measured, and samples at corners stay out

    def window(self, trial: Trial, segmentation: Segmentation, *, guard: bool = False) -> FittedLog | None:
        """The part of a trial that is fitted under a segmentation; ``None`` where there is none."""
        log = fitted_log(trial, segmentation, guard=guard, whole=self.unloading)
        if log is not None and self.follows_speed:
            return with_speed_ratio(trial, segmentation, log)
        if log is None or not self.unloading:
            return log
        return with_unloading(segmentation, log, self.surface)

    def own_window(self, trial: Trial) -> FittedLog | None:
        """The part of its trial; as it is where the guard zone swallows a very shallow log."""
        guarded = self.window(trial, self.segmentation, guard=self.guard)
        return guarded or self.window(trial, self.segmentation)

    def fitted(self) -> tuple[Trial, FittedLog]:
        """The trial and its fitted part, loaded anew."""
        trial = self.load()
        log = self.own_window(trial)
        if log is None:
            msg = f"{trial.name} changed while it was being fitted"
            raise RuntimeError(msg)
        if self.hold_share < 1.0:
            log = with_holds_cut(log, self.segmentation.of_kind("hold"), self.hold_share)
        return trial, log


def blocks_of(handle: LogHandle, log: FittedLog, *, whole: bool = False) -> Blocks:
    """Blocks of the fitted part of a log; every sample of it where ``whole``."""
    contact = handle.segmentation.contact
    data: LogData = assign_folds(log, handle.segmentation.of_kind("hold"))
    return log_blocks(
        data,
        step_s=log.step_s,
        contact_sd_mm=max(handle.contact_sd_mm, OFFSET_SD_FLOOR * log.depth_mm),
        leads=contact is not None and contact.in_record and not (handle.unloading or handle.follows_speed),
        whole=whole,
    )


def speed_handles(handles: Sequence[LogHandle], laws: Candidates) -> list[LogHandle]:
    """The same logs with their speed ratio where a law follows it: to their ends where each of them does.

    Raises InputError: a log has no contact that begins at a speed.
    """
    named = [*laws.laws, *([laws.paper] if laws.paper is not None else [])]
    if not any(one.damped for one in named):
        return list(handles)
    whole, out = all(one.damped for one in named), []
    for handle in handles:
        trial = handle.load()
        now = replace(handle, follows_speed=True, unloading=whole)
        log = now.own_window(trial)
        if log is None:
            msg = (
                f"0 contacts begin at a speed, of which {named[0].name!r} is a law: record the approach, "
                "exclude the recording, or fit kelvin-voigt"
            )
            raise InputError(NO_CONTACT, msg, path=trial.source.path, sheet=trial.source.sheet)
        # a power and a contact are told by the same samples: a segmenter that took the power for another has
        # placed the contact elsewhere
        out.append(replace(now, facts=log.without_samples(), contact_sd_mm=log.depth_mm))
    return out
