"""Travel of the tip behind a compliant frame: ``x_tip = x - u(F)``, without the noise of F.

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
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.inference.channel_law import kelvin_voigt_law
from tissueid.inference.logs import LogHandle, blocks_of
from tissueid.inference.noise import Memory
from tissueid.inference.optimum import minimise, whitener_of
from tissueid.inference.prior import Scatter, prior_rows
from tissueid.inference.search import starting_points
from tissueid.inference.system import Effects, Point, System
from tissueid.inference.window import FittedLog
from tissueid.manifest import FrameCurve
from tissueid.model.frame import deflection, deflection_sd, tangent_stiffness
from tissueid.priors import Priors
from tissueid.trial import Phase, Trial

#: Branches and degree of K of the law that smooths the force.
SMOOTHING_BRANCHES, SMOOTHING_DEGREE = 2, 2
#: Unloading is smoothed by the mean of so many samples: it takes part in no fit unless that is asked for.
UNLOADING_SAMPLES = 11
#: Starts of the fit, each from the deflection that the one before found.
ROUNDS = 2
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
    """Test if a force lies so far beyond the calibrated ones that its deflection is unknown."""
    return frame.range_N is not None and force_N > BEYOND_LIMIT * frame.range_N[1]


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
    """Flag of the deflection taken off, with its sd and the calibration's reach."""
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

    ``handles``: crosshead displacement; ``tick``: told what is being done.  Returns their trials carry
    ``frame_corrected``; the measured force is untouched.
    """
    tick = tick or (lambda _: None)
    pairs = [handle.fitted() for handle in handles]
    with threadpool_limits(limits=1, user_api="blas"):
        depth = max(log.depth_mm for _, log in pairs)
        law = kelvin_voigt_law(SMOOTHING_BRANCHES, SMOOTHING_DEGREE, depth)
        effects = Effects(gain=len(handles) > 1)
        blocks = [blocks_of(handle, log) for handle, (_, log) in zip(handles, pairs, strict=True)]
        system = System(blocks, law, depth, effects, give=lambda force: deflection(frame, force))
        start = Point(np.zeros(2), np.zeros(3), np.zeros(law.linear), np.zeros((len(handles), effects.size)))
        tick("the frame")
        white = whitener_of(system, Memory())
        found = None
        for _ in range(ROUNDS):
            first = starting_points(system, law, start, white)[0]
            found = minimise(
                system,
                first,
                lambda point: prior_rows(system, law, point, Scatter(), Priors(), machine=False),
                machine=False,
            )
            system.guess = system.tip_force(found.point)[0]
        assert found is not None  # noqa: S101 -- there was a round
        return [
            _corrected(handle, trial, log, (system, found.point, i), frame)
            for i, (handle, (trial, log)) in enumerate(zip(handles, pairs, strict=True))
        ]


def _corrected(
    handle: LogHandle, trial: Trial, log: FittedLog, fit: tuple[System, Point, int], frame: FrameCurve
) -> LogHandle:
    """One log in the displacement of the tip, by the force of the fitted law along it."""
    system, point, index = fit
    contact = handle.segmentation.contact
    assert contact is not None  # noqa: S101 -- a handle has a fitted log
    alone = System(
        [blocks_of(handle, log, whole=True)], system.law, system.depth_mm, system.effects, give=system.give
    )
    own = replace(point, own=point.own[index : index + 1])
    alone.follow(own)
    samples = log.data.time_s[int(log.inserted) :]
    expected = alone.guess[np.searchsorted(alone.logs[0].time_s, samples)]
    measured = handle.segmentation.force_sign * (trial.force_N - contact.baseline_N)
    # the tool is in air before contact
    force = np.zeros_like(measured)
    stop = log.first + expected.size
    force[stop:] = _moving_mean(measured[stop:], UNLOADING_SAMPLES)
    force[log.first : stop] = expected
    flag = _flag(frame, float(force.max()))
    return _moved(handle, handle.segmentation.compression_sign * deflection(frame, force), (flag,))
