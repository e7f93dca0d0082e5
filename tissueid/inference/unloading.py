"""Samples after the tool first turned back: the surface it leaves behind, and a fit that follows it.

In contact the law is linear in its parameters on any path, in or out.  A tool that withdraws faster than
the tissue recovers lets go; the surface then recovers by itself along F_s(y) + sum K_j(y) s_j = 0
(derived) and the tool meets it again where it stands.  The branch states follow the
**surface**, so a log is summed on the path of its surface, with the samples in air left out: their force
is zero by construction.  That path depends on the parameters, hence rounds: the first path is read off
the measured force, each later one follows from the parameters found on the one before, until these stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.inference.window import FittedLog, first_turn
from tissueid.model.channels import ChannelModel
from tissueid.trial import Segmentation

#: Measured force, over the peak and in standard deviations of its noise, below which the tool is in air.
AIR_SHARE = 0.01
AIR_SD = 3.0
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
    """A whole log on the path of the tissue's surface, the samples in air left out.

    ``log``: as :func:`tissueid.inference.window.fitted_log` gives it with ``whole``; ``surface``: ``None``
    takes contact and its loss from the measured force.
    """
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
