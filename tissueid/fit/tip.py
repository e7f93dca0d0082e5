"""Where the tip was behind a compliant frame: ``x_tip = x - u(F)``, without the noise of F.

The measured force is the tissue's plus noise n, and ``x - u(F + n)`` is wrong by ``n / k``: an error of the
depth that is the force's own noise again.  Both sides of the regression then carry it, and behind 200 N/mm,
with noise of 1 N, it moves tau of the named protocols tenfold.  So u is given a force that does not know n:
that of a flexible contact law (two branches, K of degree 2) through all logs of the specimen, which lets
through no more noise than its fifteen parameters.  It is fitted in the crosshead's travel first, which is
known exactly, and in which tissue and frame together come close to such a law; then in the tip's travel
that follows, until law and travel agree: ``F = law(x - u(F))``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from tissueid.fit.candidates import Candidate, Solution, fit_candidate
from tissueid.fit.logs import LogHandle, refine_contacts, specimen_sums
from tissueid.fit.trials import Adjustment, model_force
from tissueid.flags import Flag
from tissueid.manifest import FrameCurve
from tissueid.model.frame import deflection, deflection_sd, tangent_stiffness
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt
from tissueid.trial import Phase, Trial

__all__ = ["beyond_calibration", "tip_handles"]

FloatArray = NDArray[np.float64]

#: Branches and degree of K of the law that smooths the force.
SMOOTHING_BRANCHES, SMOOTHING_DEGREE = 2, 2
#: Unloading is smoothed by the mean of so many samples: it takes part in no fit unless that is asked for.
UNLOADING_SAMPLES = 11
#: Rounds: one in the crosshead's travel, the others in the tip's.  Each leaves a fifth of the error so far,
#: which moves tau of the named protocols by 3 % after the first at 200 N/mm.
ROUNDS = 3
#: A round that moves no tip by more than this [mm, root mean square] is the last.
SETTLED_MM = 1e-5
#: A force this many times the largest calibrated one can't be corrected.
BEYOND_LIMIT = 1.5


def _moving_mean(values: FloatArray, samples: int) -> FloatArray:
    """Mean over an odd number of samples about each, fewer where that is the whole of them."""
    half = min(samples, values.size - 1) // 2
    if half < 1:
        return values
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


def _tangent(law: tuple[KelvinVoigt, FloatArray], depth_mm: FloatArray) -> FloatArray:
    """Stiffness against a sudden move, F_s' + sum K_j [N/mm], shape (n,), not below zero."""
    model, theta = law
    static, _, _ = model.split(theta)
    slope = static[0] + depth_mm * (2.0 * static[1] + 3.0 * static[2] * depth_mm)
    return np.asarray(np.maximum(slope + model.stiffness(theta, depth_mm).sum(axis=0), 0.0))


@dataclass(slots=True, eq=False)
class _Smooth:
    """One log's compressive force without its noise, as it becomes known.

    Attributes
    ----------
    handle : LogHandle
        In the crosshead's displacement, contact point refined.
    force_N : ndarray, shape (n,) or None
        Over the whole trial; ``None`` before the first round.
    change_mm : float
        How much the tip moved in the last round, root mean square.
    """

    handle: LogHandle
    force_N: FloatArray | None = None
    change_mm: float = np.inf

    def tip(self, frame: FrameCurve) -> LogHandle:
        """The log in the tip's displacement, as far as it is known."""
        if self.force_N is None:
            return self.handle
        return _moved(
            self.handle, self.handle.segmentation.compression_sign * deflection(frame, self.force_N)
        )

    def learn(self, frame: FrameCurve, law: tuple[KelvinVoigt, FloatArray], adjustment: Adjustment) -> None:
        """Take over what a law fitted in these displacements says of the force.

        A law in the tip's displacement answers an error of the force with ``-T u'`` times it, T its tangent:
        the step is divided by ``1 + T u'``, which is Newton's for ``F = law(x - u(F))``.
        """
        handle = self.tip(frame)
        trial, log = handle.fitted()
        contact = handle.segmentation.contact
        assert contact is not None  # noqa: S101 -- a handle has a fitted log
        measured = handle.segmentation.force_sign * (trial.force_N - contact.baseline_N)
        inside = slice(log.first, log.first + log.data.time_s.size - int(log.inserted))
        expected = model_force(*law, log, adjustment)[int(log.inserted) :]
        if self.force_N is None:
            # the tool is in air before contact
            self.force_N = np.zeros_like(measured)
            self.force_N[inside.stop :] = _moving_mean(measured[inside.stop :], UNLOADING_SAMPLES)
            self.force_N[inside] = expected
            return
        before = self.force_N[inside]
        give = _compliance(frame, before)
        step = (expected - before) / (1.0 + _tangent(law, log.data.depth_mm[int(log.inserted) :]) * give)
        self.force_N[inside] = before + step
        self.change_mm = float(np.sqrt(np.mean((give * step) ** 2)))


def _compliance(frame: FrameCurve, force_N: FloatArray) -> FloatArray:
    return np.interp(force_N, frame.force_N, frame.compliance_mm_per_N)


def _phase(phase: Phase, depth_mm: FloatArray) -> Phase:
    """The same phase with the tip's speed."""
    span = phase.end_s - phase.start_s
    if phase.speed_mm_s == 0.0 or span <= 0.0:
        return phase
    return replace(phase, speed_mm_s=float(depth_mm[phase.stop - 1] - depth_mm[phase.start]) / span)


def _moved(handle: LogHandle, give_mm: FloatArray, flags: tuple[Flag, ...] = ()) -> LogHandle:
    """The same log with a deflection taken off its displacement."""
    load = handle.load

    def tip() -> Trial:
        raw = load()
        return replace(raw, displacement_mm=raw.displacement_mm - give_mm, flags=(*raw.flags, *flags))

    depth = handle.segmentation.compression_sign * tip().displacement_mm
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
    message = f"the frame's give of {give:.3g} mm (sd {sd:.2g}) under {peak_N:.3g} N was taken off"
    if frame.range_N is not None and peak_N > frame.range_N[1]:
        message = (
            f"the frame's give of {give:.3g} mm was taken off, beyond the {frame.range_N[1]:.3g} N calibrated"
        )
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
        logs = [_Smooth(handle) for handle in known]
        for round_ in range(ROUNDS):
            tick(f"frame, round {round_ + 1}")
            _learn(logs, frame, candidate, tick)
            if max(log.change_mm for log in logs) < SETTLED_MM:
                break
    corrected = []
    for handle, log in zip(handles, logs, strict=True):
        assert log.force_N is not None  # noqa: S101 -- there was a round
        flag = _flag(frame, float(log.force_N.max()))
        give = handle.segmentation.compression_sign * deflection(frame, log.force_N)
        corrected.append(_moved(handle, give, (flag,)))
    return corrected


def _learn(logs: list[_Smooth], frame: FrameCurve, candidate: Candidate, tick: Callable[[str], None]) -> None:
    """One round: fit the flexible law to all logs where they are known to be, and follow it."""
    handles = [log.tip(frame) for log in logs]
    # all samples: the law must know tau better than the fit that follows it
    sums = specimen_sums(handles, candidate.degree, tick)
    solution = fit_candidate(sums, candidate)
    law, found = _law(solution, sums.depth_mm), solution.evaluation
    for i, log in enumerate(logs):
        adjustment = Adjustment()
        if candidate.pooling == "partial":
            adjustment = Adjustment(float(np.exp(found.gamma[i])), float(found.delta[i]))
        log.learn(frame, law, adjustment)
