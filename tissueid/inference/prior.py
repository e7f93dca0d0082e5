"""Priors as rows of a least-squares problem: of the machine, of linear parameters, and of each log's own.

Bernstein coefficients of F_s / x and of each K are normal around 0, so wide that the part alone would carry
:data:`tissueid.priors.WEAK_FACTOR` times the largest force.  A class of the instrument (ISO 7500-1, ISO 9513)
is a limit of error in percent, two standard deviations; of a known frame only its uncertainty is left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr, ndtri

from tissueid.arrays import FloatArray
from tissueid.inference.channel_law import ChannelLaw
from tissueid.inference.law import TINY
from tissueid.inference.system import MACHINE, SHAPE, Point, System
from tissueid.manifest import Calibration, FrameCurve
from tissueid.model.frame import deflection, deflection_sd
from tissueid.priors import CALIBRATION_DEFAULTS, WEAK_FACTOR, CalibrationPrior, Priors, SpreadPrior

#: Relaxation times are sought between a fifth of the shortest step and ten times the longest log.
BELOW_STEP, ABOVE_LENGTH = 0.2, 10.0
#: Step of a shape's logarithm.
SHAPE_STEP = 1e-5


@dataclass(frozen=True, slots=True)
class Scatter:
    """Standard deviations of what logs of one specimen have for themselves."""

    gain: float = 0.1  # of ln gain
    shape: float = 0.02  # of ln gain at lesser depths beside that at the largest
    time: float = 0.05  # of ln of the times of relaxation


def time_bounds(system: System) -> tuple[float, float]:
    """Bounds of ln tau."""
    step = min(float(np.median(one.step_s)) for one in system.logs)
    length = max(float(one.time_s[-1] - one.time_s[0]) for one in system.logs)
    return float(np.log(BELOW_STEP * step)), float(np.log(ABOVE_LENGTH * length))


@dataclass(frozen=True, slots=True, eq=False)
class PriorRows:
    """Gaussian priors and bounds."""

    #: (c, shared): standardised: ``|rows @ shared - target|^2`` is twice the negative log prior.
    rows: FloatArray
    target: FloatArray  # (c,)
    own: FloatArray  # (logs, q), precision of each log's own parameters, around 0
    cone: FloatArray  # (b, shared): ``cone @ shared >= least``
    least: FloatArray  # (b,)


def _linear_rows(law: ChannelLaw, largest: FloatArray, force: float) -> FloatArray:
    """Rows of the linear parameters around 0, which follow the largest states."""
    rows = np.zeros((law.linear, law.linear))
    for one in law.blocks:
        rows[one.at, one.at] = one.bernstein / (WEAK_FACTOR * force)
        if one.branch >= 0:
            rows[one.at, one.at] *= largest[one.branch]
    return rows


def stated_shapes(law: ChannelLaw, priors: Priors) -> dict[int, SpreadPrior]:
    """Priors that are stated of shapes, by their place among the engine's; a time's own comes first."""
    found = {j: priors.shapes.get(one.spec.name) for j, one in enumerate(law.shapes)}
    found |= {j: one for j, one in enumerate(priors.relaxation_time_s[: law.counts[0]]) if one is not None}
    return {j: one for j, one in found.items() if one is not None}


def _stated_rows(law: ChannelLaw, point: Point, priors: Priors) -> tuple[FloatArray, FloatArray]:
    """Rows of coefficients that a study states, in units of the field, which follow the shapes of a law."""
    t, m = law.times, len(MACHINE)
    rows, target = [], []
    log_times = point.log_times[None]
    for k, name in enumerate(law.linear_names):
        if name not in priors.linear:
            continue
        mean, sd = priors.linear[name]
        size = law.field(log_times)[0, k]
        row = np.zeros(t + m + law.linear)
        row[t + m + k] = size / sd
        for j in range(law.counts[0], t):
            step = np.zeros((1, t))
            step[0, j] = SHAPE_STEP
            rise = law.field(log_times + step)[0, k] - law.field(log_times - step)[0, k]
            row[j] = point.linear[k] * rise / (2.0 * SHAPE_STEP) / sd
        rows.append(row)
        off = (point.linear[k] * size - mean) / sd
        target.append(float(row @ point.shared) - off)
    return np.reshape(rows, (len(rows), t + m + law.linear)), np.array(target)


def prior_rows(system: System, scatter: Scatter, priors: Priors, point: Point, *, machine: bool) -> PriorRows:
    """Priors around a point, where the largest states of the branches are taken."""
    law = system.law
    t, m = law.times, len(MACHINE)
    force = float(np.abs(system.force).max())
    largest = law.largest_states(point.log_times, system.path(system.travel))
    linear = _linear_rows(law, largest, force)
    stated_rows, wanted = _stated_rows(law, point, priors)
    rows = [np.hstack([np.zeros((len(linear), t + m)), linear]), stated_rows]
    target = [np.zeros(len(linear)), wanted]

    def told(at: int, mean: float, sd: float) -> None:
        """Add a normal prior of one shared parameter."""
        row = np.zeros((1, t + m + law.linear))
        row[0, at] = 1.0 / sd
        rows.append(row)
        target.append(np.array([mean / sd]))

    low, high = law.bounds(*time_bounds(system))
    bounds = np.zeros((2 * t + 2, t + m + law.linear))
    bound = np.full(2 * t + 2, -1e300)
    for j in range(t):
        bounds[2 * j, j], bound[2 * j] = 1.0, low[j]
        bounds[2 * j + 1, j], bound[2 * j + 1] = -1.0, -high[j]
    for j, stated in stated_shapes(law, priors).items():
        told(j, float(np.log(stated.median)), stated.sd_ln)
    if machine:
        for j, name in enumerate(MACHINE):
            told(t + j, priors.calibration[name].mean, priors.calibration[name].sd)
        for i, j in enumerate((0, 2)):
            lower = priors.calibration[MACHINE[j]].lower
            bounds[2 * t + i, t + j] = 1.0
            bound[2 * t + i] = lower if np.isfinite(lower) else -1e300
    cone = np.hstack([np.zeros((len(law.cone), t + m)), law.cone])
    return PriorRows(
        rows=np.vstack(rows),
        target=np.concatenate(target),
        own=own_precision(system, scatter),
        cone=np.vstack([cone, bounds]),
        least=np.concatenate([np.zeros(len(cone)), bound]),
    )


def own_precision(system: System, scatter: Scatter) -> FloatArray:
    """Precisions of the logs' own parameters, (logs, q)."""
    effects, logs = system.effects, len(system.logs)
    columns = []
    if effects.gain:
        columns.append(np.full(logs, scatter.gain**-2))
    sd = np.array([one.contact_sd_mm for one in system.logs]) / system.depth_mm
    columns.append(sd**-2)
    if effects.time:
        columns.append(np.full(logs, scatter.time**-2))
    if effects.shape:
        columns += [np.full(logs, scatter.shape**-2)] * SHAPE
    return np.column_stack(columns)


#: A class in percent -> standard deviation of the gain.
CLASS_SD = 0.01 / 2.0
#: Share and floor of the sd of a stated delay without one (a sample or two of a controller's clock), and of a
#: filter's (a corner frequency is set in steps, and the filter's order is not said).
TIMES = (("skew_s", 0.2, 5e-4), ("force_filter_s", 0.2, 2e-4))
#: Of a stated frame stiffness without its sd: a maker's number leaves out the user's grips and fixture.
FRAME_SHARE = 0.25


def _frame_prior(frame: FrameCurve) -> CalibrationPrior:
    """Secant compliance that remains, at the largest force that was calibrated."""
    top = frame.range_N[1] if frame.range_N is not None else float(frame.force_N[-1])
    at = np.array([top])
    sd = float(deflection_sd(frame, at)[0]) / top
    if sd == 0.0:
        sd = FRAME_SHARE * float(deflection(frame, at)[0]) / top
    return CalibrationPrior(0.0, sd, stated=True)


#: Share of the travel by which a frame of which nothing is stated bends under the largest force, as one
#: standard deviation at most: a machine is chosen for its specimen.
FRAME_OF_TRAVEL = 0.15


def suited(priors: Priors, force_N: float, depth_mm: float) -> Priors:
    """Priors of which an unstated frame is no softer than suits the specimen."""
    frame = priors.calibration["frame_compliance_mm_per_N"]
    sd = frame.sd if frame.stated else min(frame.sd, FRAME_OF_TRAVEL * depth_mm / max(force_N, TINY))
    changed = {"frame_compliance_mm_per_N": replace(frame, sd=sd)}
    return replace(priors, calibration={**priors.calibration, **changed})


def calibration_priors(calibration: Calibration | None) -> Mapping[str, CalibrationPrior]:
    """Priors of gains, skew, filter and frame by their names, as a study's ``[calibration]`` has them."""
    if calibration is None:
        return CALIBRATION_DEFAULTS
    values, found = calibration.values, dict(CALIBRATION_DEFAULTS)
    for gain, key in (("force_gain", "load_cell_class"), ("displacement_gain", "displacement_class")):
        if (limit := values.get(key)) is not None:
            found[gain] = CalibrationPrior(found[gain].mean, CLASS_SD * limit, stated=True)
    for name, share, floor_s in TIMES:
        if (value := values.get(name)) is not None:
            sd = values.get(f"{name}_sd")
            spread = max(share * abs(float(value)), floor_s) if sd is None else float(sd)
            found[name] = CalibrationPrior(float(value), spread, found[name].lower, stated=True)
    if calibration.frame is not None:
        found["frame_compliance_mm_per_N"] = _frame_prior(calibration.frame)
    return found


def quantile(prior: CalibrationPrior, z: FloatArray) -> FloatArray:
    """Values of a cut normal at standard normal coordinates."""
    left = float(ndtr((prior.mean - prior.lower) / prior.sd))
    # by the upper tail, which keeps its digits
    upper = np.clip(ndtr(-z) * left, 1e-300, 1.0 - 1e-16)
    return np.asarray(np.maximum(prior.mean - prior.sd * ndtri(upper), prior.lower))


def coordinate(prior: CalibrationPrior, value: FloatArray) -> FloatArray:
    """Standard normal coordinates of values of a cut normal, kept from the ends."""
    left = float(ndtr((prior.mean - prior.lower) / prior.sd))
    upper = ndtr((prior.mean - value) / prior.sd) / left
    return np.asarray(-ndtri(np.clip(upper, 1e-6, 1.0 - 1e-6)))
