"""Fit on the path of the surface, follow the surface under the fit, until the two agree.

A fixed-point iteration: the path's dependence on the parameters is not differentiated.  Whether it settled is
said, and the result is checked against a direct simulation of every log.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.inference.engine import Identified
from tissueid.inference.estimates import TissueEstimate
from tissueid.inference.logs import LogHandle
from tissueid.inference.trials import Adjustment
from tissueid.inference.window import FreeSurface, air_limit

#: Rounds; changes of the parameters, in standard errors, that count as none and as too much; rounds after
#: which steps are halved: they may go back and forth over a sample that is in contact or not.
MAX_ROUNDS, SETTLED_SD, ROUGH_SD, DAMPED_AFTER = 12, 0.05, 0.5, 3
#: Root mean square of the residual in air, over that in contact, beyond which the law of contact loss fails.
AIR_MISFIT = 3.0


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


def _surfaces(found: Identified) -> list[FreeSurface]:
    """Laws of the surfaces under a fit."""
    point = found.optimum.point
    theta = found.law.theta(point.log_times, point.linear)[0]
    offset = found.system.offsets(point) * found.system.depth_mm
    return [FreeSurface(found.law.model(), theta, float(by)) for by in offset]


def _halfway(one: FreeSurface, other: FreeSurface | None) -> FreeSurface:
    """Between two laws of one order: passive as both are, for the cone is convex."""
    if other is None or other.theta.shape != one.theta.shape:
        return one
    theta, offset = 0.5 * (one.theta + other.theta), 0.5 * (one.offset_mm + other.offset_mm)
    return replace(one, theta=theta, offset_mm=offset)


def _moved(before: Identified, now: Identified) -> float:
    """Largest difference of shared parameters in standard errors; infinite between different orders."""
    if before.law != now.law:
        return float("inf")
    error = np.sqrt(np.maximum(np.diag(now.optimum.covariance), 0.0))
    known = error > 0.0
    change = np.abs(now.optimum.point.shared - before.optimum.point.shared)
    return float((change[known] / error[known]).max(initial=0.0))


def follow_surfaces(
    found: Identified, current: list[LogHandle], identify: Identify, tick: Callable[[str], None]
) -> Followed:
    """Fit logs on the paths of their own surfaces; ``found``: on those that the measured force tells."""
    change, count = float("inf"), 0
    for count in range(1, MAX_ROUNDS + 1):
        tick(f"free surface, round {count}")
        surfaces = _surfaces(found)
        if count > DAMPED_AFTER:
            pairs = zip(surfaces, current, strict=True)
            surfaces = [_halfway(surface, handle.surface) for surface, handle in pairs]
        on = zip(current, surfaces, strict=True)
        after, current = identify([replace(handle, surface=surface) for handle, surface in on])
        change, found = _moved(found, after), after
        if change < SETTLED_SD:
            break
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
        words = f"unloading did not converge in {followed.rounds} rounds: {why}"
        told = {name: report[name] for name in ("rounds", "change_sd", "surface_unique")}
        flags.append(Flag("unloading_not_settled", words, told))
    if rms_air is not None and rms_air > AIR_MISFIT * sigma_N:
        words = f"while the model has the tool in air the force is {rms_air:.3g} N (noise {sigma_N:.3g} N)"
        values = {"rms_in_air_N": rms_air, "sigma_N": sigma_N, "samples_pulled": pulled}
        flags.append(Flag("contact_loss_misfit", words, values))
    return report, flags
