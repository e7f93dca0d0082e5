"""Where the tip was behind a compliant frame: ``x_tip = x - u(F)``, without the noise of F.

The measured force is the tissue's plus noise n, and ``x - u(F + n)`` is wrong by ``n / k``: an error of the
depth that is the force's own noise again.  Both sides of the regression then carry it, and at 200 N/mm and
1 N it moves tau of the named protocols tenfold.  So u is given a force that does not know n: the crosshead's
travel is known exactly, tissue and frame together follow a contact law in it as well, and a flexible one
(two branches, K of degree 2) through all logs of a specimen has no more noise than its fifteen parameters
let through.  What it misses is slow, and comes back by the mean of its residual over many samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tissueid.fit.candidates import Candidate, Solution, fit_candidate
from tissueid.fit.logs import LogHandle, refine_contacts, specimen_sums
from tissueid.fit.trials import Adjustment, model_force
from tissueid.fit.window import FittedLog
from tissueid.flags import Flag
from tissueid.manifest import FrameCurve
from tissueid.model.frame import deflection, deflection_sd, tangent_stiffness
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt
from tissueid.trial import Phase, Trial

__all__ = ["beyond_calibration", "moving_mean", "tip_handles"]

FloatArray = NDArray[np.float64]

#: Branches and degree of K of the law that smooths the force.
SMOOTHING_BRANCHES, SMOOTHING_DEGREE = 2, 2
#: Samples over which its residual is averaged: 1 % of the noise's variance is let through.
RESIDUAL_SAMPLES = 101
#: ... and at most this share of a stretch.
RESIDUAL_SHARE = 0.25
#: Samples the smoothing law is fitted to; more would not make it smoother.
THINNED_TO = 50_000
#: A force this many times the largest calibrated one can't be corrected.
BEYOND_LIMIT = 1.5


def moving_mean(values: FloatArray, samples: int) -> FloatArray:
    """Mean over a window of so many samples about each, reflected at the ends; zero for fewer than three.

    Parameters
    ----------
    values : ndarray, shape (n,)
    samples : int
        Made odd; at most :data:`RESIDUAL_SHARE` of n.
    """
    half = min(samples, int(RESIDUAL_SHARE * values.size)) // 2
    if half < 1:
        return np.zeros_like(values)
    padded = np.pad(values, half, mode="reflect")
    total = np.concatenate([[0.0], np.cumsum(padded)])
    return np.asarray((total[2 * half + 1 :] - total[: -2 * half - 1]) / (2 * half + 1))


def beyond_calibration(frame: FrameCurve, force_N: float) -> bool:
    """Whether a force lies so far beyond the calibrated ones that its deflection is unknown."""
    return frame.range_N is not None and force_N > BEYOND_LIMIT * frame.range_N[1]


def _law(solution: Solution, depth_mm: float) -> tuple[KelvinVoigt, FloatArray]:
    """Model and theta of a solution, from coefficients by powers of depth over the largest depth."""
    candidate, found = solution.candidate, solution.evaluation
    size = candidate.degree + 1
    model = KelvinVoigt(candidate.branches, candidate.degree, depth_mm)
    static = found.theta[:STATIC_DEGREE] * depth_mm ** -np.arange(1.0, STATIC_DEGREE + 1)
    stiffness = found.theta[STATIC_DEGREE:].reshape(-1, size) * depth_mm ** -np.arange(float(size))
    return model, model.join(static, stiffness, np.exp(found.log_tau))


def _smooth_force(
    trial: Trial,
    log: FittedLog,
    law: tuple[KelvinVoigt, FloatArray],
    adjustment: Adjustment,
    handle: LogHandle,
) -> FloatArray:
    """Compressive force of a whole trial [N], shape (n,): the law where it was fitted, else its own mean."""
    contact = handle.segmentation.contact
    assert contact is not None  # noqa: S101 -- a handle has a fitted log
    force = handle.segmentation.force_sign * (trial.force_N - contact.baseline_N)
    first = log.first
    last = first + log.data.time_s.size - int(log.inserted)
    expected = model_force(*law, log, adjustment)[int(log.inserted) :]
    smooth = np.empty_like(force)
    smooth[:first] = moving_mean(force[:first], RESIDUAL_SAMPLES)
    smooth[first:last] = expected + moving_mean(force[first:last] - expected, RESIDUAL_SAMPLES)
    # unloading takes part in no regression that its noise could bias
    smooth[last:] = force[last:]
    return smooth


def _phase(phase: Phase, depth_mm: FloatArray) -> Phase:
    """The same phase with the tip's speed."""
    span = phase.end_s - phase.start_s
    if phase.speed_mm_s == 0.0 or span <= 0.0:
        return phase
    return replace(phase, speed_mm_s=float(depth_mm[phase.stop - 1] - depth_mm[phase.start]) / span)


def _corrected(handle: LogHandle, trial: Trial, force_N: FloatArray, frame: FrameCurve) -> LogHandle:
    """The handle of the same log in the tip's displacement."""
    sign = handle.segmentation.compression_sign
    give = sign * deflection(frame, force_N)
    peak = float(force_N.max())
    flag = _flag(frame, peak)
    load = handle.load

    def tip() -> Trial:
        raw = load()
        return replace(raw, displacement_mm=raw.displacement_mm - give, flags=(*raw.flags, flag))

    depth = sign * (trial.displacement_mm - give)
    phases = tuple(_phase(phase, depth) for phase in handle.segmentation.phases)
    moved = replace(handle, load=tip, segmentation=replace(handle.segmentation, phases=phases))
    _, log = moved.fitted()
    return replace(moved, facts=log.without_samples())


def _flag(frame: FrameCurve, peak_N: float) -> Flag:
    """What was taken off, with its sd, and whether the calibration reaches so far."""
    at = np.array([peak_N])
    give, sd = float(deflection(frame, at)[0]), float(deflection_sd(frame, at)[0])
    stiffness = tangent_stiffness(frame, peak_N)
    values = {"deflection_mm": give, "sd_mm": sd, "force_N": peak_N, "frame_stiffness_N_per_mm": stiffness}
    message = (
        f"the frame gives {give:.3g} mm (sd {sd:.2g} mm) under {peak_N:.3g} N ({stiffness:.3g} N/mm there); "
        "it was taken off the displacement"
    )
    if frame.range_N is not None and peak_N > frame.range_N[1]:
        message += f"; beyond the calibrated {frame.range_N[1]:.3g} N the last compliance was taken"
        values["calibrated_to_N"] = frame.range_N[1]
    return Flag("frame_corrected", message, values)


def tip_handles(
    handles: Sequence[LogHandle], frame: FrameCurve, tick: Callable[[str], None] | None = None
) -> list[LogHandle]:
    """The logs of one specimen with the deflection of the frame taken off their displacement.

    Parameters
    ----------
    handles : sequence of LogHandle
        Crosshead displacement.
    frame : FrameCurve
    tick : callable, optional
        Told what is being done.

    Returns
    -------
    list of LogHandle
        Their trials carry ``frame_corrected``; the measured force is untouched.
    """
    tick = tick or (lambda _: None)
    pooling = "partial" if len(handles) > 1 else "shared"
    candidate = Candidate(SMOOTHING_BRANCHES, SMOOTHING_DEGREE, pooling)
    with threadpool_limits(limits=1, user_api="blas"):
        known = list(handles)
        if pooling == "partial":
            known = refine_contacts(handles, replace(candidate, degree=1), tick)
        samples = sum(handle.facts.n_samples for handle in known)
        sums = specimen_sums(known, candidate.degree, tick, thin=max(1, samples // THINNED_TO))
        solution = fit_candidate(sums, candidate)
    law = _law(solution, sums.depth_mm)
    out = []
    for i, (handle, fine) in enumerate(zip(handles, known, strict=True)):
        trial, log = fine.fitted()
        tick(f"frame behind {trial.name}")
        adjustment = Adjustment()
        if pooling == "partial":
            found = solution.evaluation
            adjustment = Adjustment(float(np.exp(found.gamma[i])), float(found.delta[i]))
        out.append(_corrected(handle, trial, _smooth_force(trial, log, law, adjustment, fine), frame))
    return out
