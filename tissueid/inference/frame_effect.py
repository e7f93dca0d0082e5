"""A compliant frame: taken off the travel where it is known, else its effect on the numbers.

``x - u(F + n)`` carries the force's noise n into the depth: u is given the force of a flexible law instead,
fitted until law and travel agree, ``F = law(x - u(F))``.  Behind a rigid frame's fit, ``tau_app = tau (1 + K
/ (k_f + k_0))`` and ``eta_app = eta (k_f / (k_f + k_0))^2`` (derived about half depth).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.ndimage import uniform_filter1d
from threadpoolctl import threadpool_limits

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.inference.channel_law import kelvin_voigt_law
from tissueid.inference.logs import LogHandle, blocks_of
from tissueid.inference.noise import Memory
from tissueid.inference.optimum import minimise, whitener_of
from tissueid.inference.prior import Scatter, prior_rows
from tissueid.inference.search import starting_points
from tissueid.inference.system import MACHINE, Effects, Point, System
from tissueid.inference.verdict import INSTRUMENT_TAU_S
from tissueid.inference.window import FittedLog
from tissueid.manifest import FrameCurve
from tissueid.model.frame import deflection, deflection_sd, tangent_stiffness, tangent_stiffness_sd
from tissueid.model.grammar import rebuilt
from tissueid.priors import CalibrationPrior, Priors
from tissueid.result import SpecimenFit
from tissueid.trial import Phase, Trial

#: Branches and degree of K of the law that smooths the force.
SMOOTHING_BRANCHES, SMOOTHING_DEGREE = 2, 2
#: Unloading is smoothed by the mean of so many samples: it takes part in no fit unless that is asked for.
UNLOADING_SAMPLES = 11
#: Starts of the fit, each from the deflection that the one before found.
ROUNDS = 2
#: A force this many times the largest calibrated one can't be corrected.
BEYOND_LIMIT = 1.5


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
        reach = f"beyond the {frame.range_N[1]:.3g} N calibrated"
        message = f"the frame's give of {give:.3g} mm was taken off, {reach}"
        values["calibrated_to_N"] = frame.range_N[1]
    return Flag("frame_corrected", message, values)


def tip_handles(
    handles: Sequence[LogHandle], frame: FrameCurve, tick: Callable[[str], None] | None = None
) -> list[LogHandle]:
    """The logs of one specimen with the deflection of the frame taken off their crosshead displacement."""
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
        priors = partial(prior_rows, system, Scatter(), Priors(), machine=False)
        point = start
        for _ in range(ROUNDS):
            first = starting_points(system, law, start, white)[0]
            point = minimise(system, first, priors, machine=False).point
            system.guess = system.tip_force(point)[0]
        return [
            _corrected(handle, trial, log, (system, point, i), frame)
            for i, (handle, (trial, log)) in enumerate(zip(handles, pairs, strict=True))
        ]


def _corrected(
    handle: LogHandle, trial: Trial, log: FittedLog, fit: tuple[System, Point, int], frame: FrameCurve
) -> LogHandle:
    """One log in the displacement of the tip, by the force of the fitted law along it."""
    system, point, index = fit
    contact = handle.segmentation.contact
    assert contact is not None  # noqa: S101 -- a handle has a fitted log
    alone, _ = system.alone(blocks_of(handle, log, whole=True), index, point)
    samples = log.data.time_s[int(log.inserted) :]
    expected = alone.guess[np.searchsorted(alone.logs[0].time_s, samples)]
    measured = handle.segmentation.force_sign * (trial.force_N - contact.baseline_N)
    # the tool is in air before contact
    force = np.zeros_like(measured)
    stop = log.first + expected.size
    force[stop:] = uniform_filter1d(measured[stop:], UNLOADING_SAMPLES, mode="mirror")
    force[log.first : stop] = expected
    flag = _flag(frame, float(force.max()))
    return _moved(handle, handle.segmentation.compression_sign * deflection(frame, force), (flag,))


#: Stiffness of a small table-top machine with fixture and load cell, where nobody says: 1,000 N/mm is
#: towards the soft end of what makers print.
ASSUMED_FRAME_N_PER_MM = 1_000.0
#: Effects of the assumed frame below this are not worth a remark.
WORTH_SAYING = 0.02
#: A machine so many standard deviations of its prior off is none; nor is a frame that nobody stated, softer
#: than one standard deviation, that bends by more than this share of the travel.
UNLIKELY_SD, SOFT_SD, MOST_BENDING = 3.0, 1.0, 0.2


@dataclass(frozen=True, slots=True)
class FrameEffect:
    """Relative effect of a frame that is taken as rigid."""

    tau: float  # largest relative error of a relaxation time, > 0: too long
    viscosity: float  # relative error of the viscosity, < 0: too small


def _stiffnesses(fit: SpecimenFit) -> tuple[float, float]:
    """Largest branch stiffness at half depth, and secant static stiffness at half depth [N/mm]."""
    model = rebuilt(fit.model, fit.depth_mm)
    half = np.array([fit.depth_mm / 2.0])
    branch = float(model.stiffness(fit.theta, half).max(initial=0.0))
    static = float(model.static_force(fit.theta, half)[0] / half[0])
    return branch, max(static, 0.0)


def frame_effect(fit: SpecimenFit, frame_N_per_mm: float) -> FrameEffect:
    """Predict the effect of a frame of that stiffness on a fit that takes it as rigid."""
    branch, static = _stiffnesses(fit)
    share = frame_N_per_mm / (frame_N_per_mm + static)
    return FrameEffect(tau=branch / (frame_N_per_mm + static), viscosity=share**2 - 1.0)


def frame_flags(fit: SpecimenFit, frame: FrameCurve | None, stated: Mapping[str, Any]) -> list[Flag]:
    """The flags of a fit, with ``compliance_unknown`` as the study's ``[calibration]`` leaves it."""
    flags = [flag for flag in fit.flags if flag.code != "compliance_unknown"]
    if not fit.parameters or fit.model.branches == 0 or fit.axes.normalised:
        return flags
    # as estimated, identified or not
    shortest = float(rebuilt(fit.model, fit.depth_mm).times(fit.theta).min())
    if frame is not None:
        flags.append(_frame_sd(fit, frame))
    unknown = _unknown(fit, frame, stated, shortest)
    return flags if unknown is None else [*flags, unknown]


def machine_flags(
    machine: FloatArray, priors: Mapping[str, CalibrationPrior], *, force_N: float, depth_mm: float
) -> tuple[Flag, ...]:
    """``machine_implausible``: the optimum is behind a machine that what is known of it speaks against."""
    values = dict(zip(MACHINE, (float(one) for one in machine), strict=True))
    frame = "frame_compliance_mm_per_N"
    needed = {
        frame: f"a frame of {1.0 / max(values[frame], 1e-9):.3g} N/mm",
        "skew_s": f"channels {1e3 * abs(values['skew_s']):.3g} ms apart",
        "force_filter_s": f"a force filter of {1e3 * values['force_filter_s']:.3g} ms",
    }
    far = {name: abs(values[name] - priors[name].mean) / priors[name].sd for name in MACHINE}
    name = max(far, key=lambda one: far[one])
    share = values[frame] * force_N / depth_mm if not priors[frame].stated else 0.0
    if far[name] > UNLIKELY_SD:
        why = f"{far[name]:.1f} standard deviations off"
    elif share > MOST_BENDING and far[frame] > SOFT_SD:
        name, why = frame, f"which would take {100.0 * share:.0f} % of the travel"
    else:
        return ()
    told = {"name": name, "value": values[name], "deviations": far[name], "frame_share": share}
    return (Flag("machine_implausible", f"the fit needs {needed[name]}, {why}", told),)


def _unknown(
    fit: SpecimenFit, frame: FrameCurve | None, stated: Mapping[str, Any], tau_s: float
) -> Flag | None:
    """``compliance_unknown``: what of the machine was not stated and could matter."""
    channels = {"force_filter_s": "force filter", "skew_s": "time skew"} if tau_s < INSTRUMENT_TAU_S else {}
    missing = [name for key, name in channels.items() if key not in stated]
    left = [f"{name} of {stated[key]:g} s" for key, name in channels.items() if stated.get(key)]
    values: dict[str, Any] = {"tau_s": tau_s}
    effect = frame_effect(fit, ASSUMED_FRAME_N_PER_MM)
    if frame is None and (max(effect.tau, -effect.viscosity) > WORTH_SAYING or channels):
        by = f" ({ASSUMED_FRAME_N_PER_MM:g} N/mm: tau {100 * effect.tau:.1f} % too long)"
        missing.insert(0, "frame" if left else f"frame{by}")
        values["assumed_frame_N_per_mm"] = ASSUMED_FRAME_N_PER_MM
        values |= {"tau_bias": effect.tau, "viscosity_bias": effect.viscosity}
    if not missing and not left:
        return None
    short = "" if frame is None or left else f", for a tau of {tau_s:.3g} s"
    words = [f"not stated: {', '.join(missing)}{short}"] if missing else []
    words += [f"{' and '.join(left)} is kept in"] if left else []
    return Flag("compliance_unknown", "; ".join(words), values)


def _frame_sd(fit: SpecimenFit, frame: FrameCurve) -> Flag:
    """Shift of tau by the frame's own uncertainty: d ln tau_app = -K dk / (k + k_0)^2."""
    branch, static = _stiffnesses(fit)
    force = static * fit.depth_mm / 2.0
    k, sd = tangent_stiffness(frame, force), tangent_stiffness_sd(frame, force)
    share = branch * sd / (k + static) ** 2
    message = f"a frame of {k:.4g} N/mm (sd {sd:.2g}) was taken off; tau is uncertain by {100 * share:.2g} %"
    values = {"frame_stiffness_N_per_mm": k, "frame_stiffness_N_per_mm_sd": sd, "tau_sd_fraction": share}
    return Flag("frame_corrected", message, values)
