"""Fit on the path of the surface, follow the surface under the fit, until the two agree.

The rounds are a fixed-point iteration: at its end the residual is orthogonal to the columns on the path
that those very parameters give, an unbiased estimating equation; the dependence of the path itself on the
parameters is not differentiated.  Whether the rounds settled is said, and the result is checked against a
direct simulation of every log.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Solution, SpecimenSums, fit_candidate
from tissueid.fit.estimates import TissueEstimate, in_field_units
from tissueid.fit.logs import LogHandle, specimen_sums
from tissueid.fit.selection import Choice
from tissueid.fit.trials import Adjustment
from tissueid.fit.unloading import FreeSurface, air_limit
from tissueid.flags import Flag
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.model.kernels import surface_path

__all__ = ["Followed", "follow_surfaces", "unloading_handles", "unloading_verdict"]

FloatArray = NDArray[np.float64]

#: Rounds, and the change of the parameters, in standard errors, that counts as none.
MAX_ROUNDS = 20
SETTLED_SD = 0.05
#: Rounds after which half a step is taken: an overshooting iteration is damped.
DAMPED_AFTER = 6
#: Times the model is chosen again on a path that it gave itself.
CHOICES = 2
#: Root mean square of the residual in air, over that in contact, beyond which the law of contact loss fails.
AIR_MISFIT = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A fit on the paths of its own surfaces.

    Attributes
    ----------
    handles : list of LogHandle
    sums : SpecimenSums
    choice : Choice
    rounds : int
    change_sd : float
        Largest change of a parameter in the last round, in its standard errors.
    """

    handles: list[LogHandle]
    sums: SpecimenSums
    choice: Choice
    rounds: int
    change_sd: float

    @property
    def settled(self) -> bool:
        """True where the last round changed nothing."""
        return self.change_sd < SETTLED_SD


@dataclass(frozen=True, slots=True, eq=False)
class _Point:
    """What a fit found, in the units of the field."""

    model: KelvinVoigt
    theta: FloatArray
    stderr: FloatArray
    offsets_mm: FloatArray

    def moved(self, other: _Point) -> float:
        """Largest difference in standard errors; infinite between different models."""
        if self.theta.shape != other.theta.shape:
            return float("inf")
        known = self.stderr > 0.0
        if not known.any():
            return 0.0
        return float((np.abs(self.theta - other.theta)[known] / self.stderr[known]).max())

    def halfway(self, other: _Point) -> _Point:
        """Between this point and another: passive as both are, for the cone is convex."""
        return replace(
            self,
            theta=0.5 * (self.theta + other.theta),
            offsets_mm=0.5 * (self.offsets_mm + other.offsets_mm),
        )


def unloading_handles(handles: Sequence[LogHandle]) -> list[LogHandle]:
    """The same logs to their ends, contact loss read off the measured force."""
    return [_refreshed(replace(handle, unloading=True, surface=None)) for handle in handles]


def _refreshed(handle: LogHandle) -> LogHandle:
    """A handle with the facts of the part it fits now."""
    _, log = handle.fitted()
    return replace(handle, facts=log.without_samples())


def _point(sums: SpecimenSums, solution: Solution, logs: int) -> _Point:
    model, theta, covariance, _, _ = in_field_units(sums, solution)
    variance = np.where(np.isfinite(np.diag(covariance)), np.maximum(np.diag(covariance), 0.0), 0.0)
    delta = solution.evaluation.delta
    offsets = delta if delta.size == logs else np.zeros(logs)
    return _Point(model=model, theta=theta, stderr=np.sqrt(variance), offsets_mm=offsets)


def _on_surfaces(handles: Sequence[LogHandle], point: _Point) -> list[LogHandle]:
    return [
        _refreshed(replace(handle, surface=FreeSurface(point.model, point.theta, float(offset))))
        for handle, offset in zip(handles, point.offsets_mm, strict=True)
    ]


def follow_surfaces(
    handles: Sequence[LogHandle],
    choose_for: Callable[[Sequence[LogHandle]], tuple[SpecimenSums, Choice]],
    tick: Callable[[str], None],
) -> Followed:
    """Fit logs with their unloading.

    Parameters
    ----------
    handles : sequence of LogHandle
        From :func:`unloading_handles`.
    choose_for : callable
        Sums logs and chooses a model for them.
    tick : callable

    Returns
    -------
    Followed
    """
    current = list(handles)
    sums, choice = choose_for(current)
    point = _point(sums, choice.solution, len(current))
    total, change = 0, float("inf")
    for _ in range(CHOICES):
        current, sums, choice, count, change = _settle(current, sums, choice, point, tick)
        total += count
        if not choice.table:
            break
        candidate = choice.solution.candidate
        again_sums, again = choose_for(current)
        if again.solution.candidate == candidate:
            choice = replace(choice, table=again.table)
            break
        sums, choice = again_sums, again
        point, change = _point(sums, choice.solution, len(current)), float("inf")
    return Followed(handles=current, sums=sums, choice=choice, rounds=total, change_sd=change)


def _settle(
    handles: Sequence[LogHandle],
    sums: SpecimenSums,
    choice: Choice,
    point: _Point,
    tick: Callable[[str], None],
) -> tuple[list[LogHandle], SpecimenSums, Choice, int, float]:
    """Rounds with one candidate until its parameters stay."""
    candidate = choice.solution.candidate
    current, change = list(handles), float("inf")
    for count in range(1, MAX_ROUNDS + 1):
        tick(f"free surface, round {count}")
        current = _on_surfaces(current, point)
        sums = specimen_sums(current, candidate.degree, tick)
        solution = fit_candidate(sums, candidate, seeds=[choice.solution.evaluation.log_tau])
        choice = replace(choice, solution=solution)
        found = _point(sums, solution, len(current))
        change = found.moved(point)
        if change < SETTLED_SD:
            break
        point = found.halfway(point) if count >= DAMPED_AFTER else found
    return current, sums, choice, count, change


def _residuals(
    handle: LogHandle, tissue: TissueEstimate, adjustment: Adjustment
) -> tuple[FloatArray, FloatArray, int]:
    """Measured less directly simulated force in contact and in air, and samples that are pulled."""
    _, log = handle.fitted()
    assert log.tool_mm is not None  # noqa: S101  (a handle of unloading)
    static, stiffness, tau = tissue.model.split(tissue.theta)
    law = log.tool_mm - adjustment.contact_offset_mm
    surface, force = surface_path(
        np.concatenate([[0.0], static]),
        np.ascontiguousarray(stiffness),
        np.ascontiguousarray(tau),
        tissue.model.depth_mm,
        log.data.time_s,
        np.ascontiguousarray(law),
    )
    residual = log.data.force_N - adjustment.gain * force
    air = surface > law
    air[: int(log.inserted)] = False
    limit = air_limit(log.data.force_N, handle.segmentation.force_noise_N)
    pulled = int((log.data.force_N < -limit).sum())
    return residual[log.data.include & ~air], residual[air], pulled


def unloading_verdict(
    followed: Followed, tissue: TissueEstimate, adjustments: Sequence[Adjustment], *, sigma_N: float
) -> tuple[dict[str, Any], list[Flag]]:
    """How the rounds went and what a direct simulation says, with the flags of it.

    Parameters
    ----------
    followed : Followed
    tissue : TissueEstimate
    adjustments : sequence of Adjustment
        One a log.
    sigma_N : float
        Noise standard deviation of the fit.

    Returns
    -------
    report : dict
        The ``unloading`` object of ``schemas/identification.schema.json``.
    flags : list of Flag
    """
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
    report = {
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
        why = (
            f"a parameter still moved by {followed.change_sd:.2g} standard errors"
            if not followed.settled
            else "the free surface has several positions"
        )
        flags.append(
            Flag(
                "unloading_not_settled",
                f"unloading did not converge in {followed.rounds} rounds: {why}",
                {"rounds": followed.rounds, "change_sd": report["change_sd"], "surface_unique": unique},
            )
        )
    if rms_air is not None and rms_air > AIR_MISFIT * sigma_N:
        flags.append(
            Flag(
                "contact_loss_misfit",
                f"while the model has the tool in air the force is {rms_air:.3g} N (noise {sigma_N:.3g} N)",
                {"rms_in_air_N": rms_air, "sigma_N": sigma_N, "samples_pulled": pulled},
            )
        )
    return report, flags
