"""Fit on the path of the surface, follow the surface under the fit, until the two agree.

Gauss-Newton: forces answer to first order to the surface that moves with the law, in intervals too; in fits
of unloading, and where loops moved the contact, a fixed-point iteration.  What has not settled is said.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.inference.channel_law import ChannelLaw
from tissueid.inference.engine import Identified
from tissueid.inference.estimates import TissueEstimate
from tissueid.inference.logs import LogHandle
from tissueid.inference.system import Point
from tissueid.inference.trials import Adjustment
from tissueid.inference.window import SurfaceResponse
from tissueid.measured.pushes import air_limit

#: Rounds, each going half as far where the one before did not halve what was left; changes of the parameters,
#: in standard errors, that count as none and as too much.
MAX_ROUNDS, SETTLED_SD, ROUGH_SD = 12, 0.05, 0.5
#: Root mean square of the residual in air, over that in contact, beyond which the law of contact loss fails.
AIR_MISFIT = 3.0
#: Step of a response: of a ln time, of a coefficient over its size, or over that of the largest one.
RESPONSE, LEAST_COEFFICIENT = 1e-4, 1e-2

Identify = Callable[[Sequence[LogHandle]], tuple[Identified, list[LogHandle]]]


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A fit on the paths of its own surfaces."""

    handles: list[LogHandle]
    identified: Identified
    rounds: int
    change_sd: float  # largest change of a shared parameter in the last round, in its standard errors

    @property
    def settled(self) -> bool:
        """True where the last round changed nothing."""
        return self.change_sd < SETTLED_SD


@dataclass(frozen=True, slots=True, eq=False)
class LawSurface:
    """The law that says where the surface of one log stands."""

    law: ChannelLaw
    log_times: FloatArray  # (t,)
    linear: FloatArray  # (p,), passive
    offset: float = 0.0  # contact offset of the log against its contact frame, over the largest depth

    def follow(self, time_s: FloatArray, tool_mm: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Depth of the surface [mm] in the frame of the log, and whether the tool touches it."""
        offset_mm = self.offset * self.law.depth_mm
        law_mm = tool_mm - offset_mm
        theta = self.law.theta(self.log_times, self.linear)[0]
        surface, _ = self.law.model().follow(theta, time_s, law_mm)
        touching = surface <= law_mm
        return np.where(touching, tool_mm, surface + offset_mm), touching

    def response(self, time_s: FloatArray, tool_mm: FloatArray, path_mm: FloatArray) -> SurfaceResponse:
        """Response of the path by finite differences; ``path_mm`` is the path itself."""
        scale = np.maximum(np.abs(self.linear), LEAST_COEFFICIENT * np.abs(self.linear).max(initial=0.0))
        times = self.log_times
        moved = [replace(self, log_times=times + one) for one in RESPONSE * np.eye(times.size)]
        moved += [replace(self, linear=self.linear + one) for one in RESPONSE * np.diag(scale)]
        moved += [replace(self, offset=self.offset + RESPONSE)]
        changes = np.array([one.follow(time_s, tool_mm)[0] - path_mm for one in moved])
        steps = np.concatenate([np.full(self.log_times.size, RESPONSE), RESPONSE * scale, [RESPONSE]])
        return SurfaceResponse(self.law, self.log_times, self.linear, self.offset, changes / steps[:, None])


def _moved(before: Point, now: Identified) -> float:
    """Largest difference of shared parameters from those whose surface was followed, in standard errors."""
    error = np.sqrt(np.maximum(np.diag(now.optimum.covariance), 0.0))
    known = error > 0.0
    change = np.abs(now.optimum.point.shared - before.shared)
    return float((change[known] / error[known]).max(initial=0.0))


def follow_surfaces(
    found: Identified, current: list[LogHandle], identify: Identify, tick: Callable[[str], None]
) -> Followed:
    """Fit logs on the paths of their own surfaces; ``found``: on those that the measured force tells."""
    change, count, at = float("inf"), 0, found.optimum.point
    for count in range(1, MAX_ROUNDS + 1):
        tick(f"free surface, round {count}")
        law, offsets = (found.law, at.log_times, at.linear), found.system.offsets(at).tolist()
        on = zip(current, offsets, strict=True)
        found, current = identify([replace(handle, surface=LawSurface(*law, by)) for handle, by in on])
        if found.law.order != law[0].order:
            # another order is better on these surfaces: it is followed from where it stands
            change, at = float("inf"), found.optimum.point
            continue
        before, change = change, _moved(at, found)
        if change < SETTLED_SD:
            break
        # a point between two passive ones is passive: the cone is convex
        to, share = found.optimum.point, 1.0 if change < 0.5 * before else 0.5
        at = at.moved(at.shared + share * (to.shared - at.shared), at.own + share * (to.own - at.own))
    return Followed(handles=current, identified=found, rounds=count, change_sd=change)


def unsettled(followed: Followed | None) -> tuple[Flag, ...]:
    """Flag of a test after loops whose surface between them went on changing."""
    if followed is None or followed.change_sd < ROUGH_SD:
        return ()
    words = f"the surface between loops still moves a parameter by {followed.change_sd:.2g} standard errors"
    return (Flag("unloading_not_settled", words, {"change_sd": followed.change_sd}),)


def _residuals(
    handle: LogHandle, tissue: TissueEstimate, adjustment: Adjustment
) -> tuple[FloatArray, FloatArray, int]:
    """Measured less directly simulated force in contact and in air, and samples that are pulled."""
    _, log = handle.fitted()
    assert log.tool_mm is not None  # noqa: S101  (a handle of unloading)
    law = log.tool_mm - adjustment.contact_offset_mm
    surface, force = tissue.model.follow(tissue.theta, log.data.time_s, law)
    residual = log.data.force_N - adjustment.gain * force
    air = surface > law
    air[: int(log.inserted)] = False
    limit = air_limit(log.data.force_N, handle.segmentation.force_noise_N)
    pulled = int((log.data.force_N < -limit).sum())
    return residual[log.data.include & ~air], residual[air], pulled


def unloading_verdict(
    followed: Followed, tissue: TissueEstimate, adjustments: Sequence[Adjustment], *, sigma_N: float
) -> tuple[dict[str, Any], list[Flag]]:
    """Report (``unloading`` of identification.json) of the rounds and of a direct simulation, with flags."""
    parts = [
        _residuals(handle, tissue, one) for handle, one in zip(followed.handles, adjustments, strict=True)
    ]
    touching = np.concatenate([part[0] for part in parts])
    air = np.concatenate([part[1] for part in parts])
    pulled = sum(part[2] for part in parts)
    unique = tissue.model.contact_loss_is_unique(tissue.theta)

    def rms(values: FloatArray) -> float | None:
        return float(np.sqrt(np.mean(values**2))) if values.size else None

    rms_air = rms(air)
    report: dict[str, Any] = {
        "rounds": followed.rounds,
        "converged": followed.settled and unique,
        "change_sd": followed.change_sd if np.isfinite(followed.change_sd) else None,
        "samples_in_contact": int(touching.size),
        "samples_in_air": int(air.size),
        "samples_pulled": pulled,
        "rms_in_contact_N": rms(touching),
        "rms_in_air_N": rms_air,
        "surface_unique": unique,
    }
    flags = []
    if not followed.settled or not unique:
        why = "the free surface has several positions"
        if not followed.settled:
            why = f"a parameter still moved by {followed.change_sd:.2g} standard errors"
        if not np.isfinite(followed.change_sd):
            why = "the order of the law still changed"
        words = f"unloading did not converge in {followed.rounds} rounds: {why}"
        told = {name: report[name] for name in ("rounds", "change_sd", "surface_unique")}
        flags.append(Flag("unloading_not_settled", words, told))
    if rms_air is not None and rms_air > AIR_MISFIT * sigma_N:
        words = f"while the model has the tool in air the force is {rms_air:.3g} N (noise {sigma_N:.3g} N)"
        values = {"rms_in_air_N": rms_air, "sigma_N": sigma_N, "samples_pulled": pulled}
        flags.append(Flag("contact_loss_misfit", words, values))
    return report, flags
