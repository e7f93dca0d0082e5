"""Priors of the instrument's nuisances from [calibration] of a study; defaults else.

A class is a limit of error in percent of the reading (ISO 7500-1 for force, ISO 9513 for displacement),
taken as two standard deviations.  A frame that is known has been taken off the displacement already
(:mod:`tissueid.inference.tip`): what remains is a compliance around zero, of either sign, as uncertain as its
calibration.  A delay and a filter are taken off by nobody: their priors are around what was stated.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tissueid.manifest import Calibration, FrameCurve
from tissueid.model.frame import deflection, deflection_sd
from tissueid.priors import CALIBRATION_DEFAULTS, CalibrationPrior

#: A class in percent -> standard deviation of the gain.
CLASS_SD = 0.01 / 2.0
#: Of a stated filter without its sd: a corner frequency is set in steps, and the filter's order is not said.
FILTER_SHARE, FILTER_FLOOR_S = 0.2, 2e-4
#: Of a stated delay without its sd: a sample or two of a controller's clock.
SKEW_SHARE, SKEW_FLOOR_S = 0.2, 5e-4
#: Of a stated frame stiffness without its sd: a maker's number leaves out the user's grips and fixture.
FRAME_SHARE = 0.25


def _class_prior(name: str, stated: float | None) -> CalibrationPrior:
    default = CALIBRATION_DEFAULTS[name]
    return default if stated is None else CalibrationPrior(default.mean, CLASS_SD * stated, stated=True)


def _time_prior(
    name: str, calibration: Calibration, share: float, floor_s: float, lower: float
) -> CalibrationPrior:
    value = calibration.values.get(name)
    if value is None:
        return CALIBRATION_DEFAULTS[name]
    sd = calibration.values.get(f"{name}_sd")
    spread = max(share * abs(float(value)), floor_s) if sd is None else float(sd)
    return CalibrationPrior(float(value), spread, lower, stated=True)


def _frame_prior(frame: FrameCurve) -> CalibrationPrior:
    """Secant compliance that remains, at the largest force that was calibrated."""
    top = frame.range_N[1] if frame.range_N is not None else float(frame.force_N[-1])
    at = np.array([top])
    sd = float(deflection_sd(frame, at)[0]) / top
    if sd == 0.0:
        sd = FRAME_SHARE * float(deflection(frame, at)[0]) / top
    return CalibrationPrior(0.0, sd, stated=True)


def calibration_priors(calibration: Calibration | None) -> Mapping[str, CalibrationPrior]:
    """Priors of force gain, displacement gain, skew, force filter and frame compliance.

    ``calibration``: ``None`` without a study.  Returns the names of
    :data:`tissueid.priors.CALIBRATION_DEFAULTS`, for ``Priors.calibration``.
    """
    if calibration is None:
        return CALIBRATION_DEFAULTS
    values = calibration.values
    frame = "frame_compliance_mm_per_N"
    return {
        "force_gain": _class_prior("force_gain", values.get("load_cell_class")),
        "displacement_gain": _class_prior("displacement_gain", values.get("displacement_class")),
        "skew_s": _time_prior("skew_s", calibration, SKEW_SHARE, SKEW_FLOOR_S, float("-inf")),
        "force_filter_s": _time_prior("force_filter_s", calibration, FILTER_SHARE, FILTER_FLOOR_S, 0.0),
        frame: CALIBRATION_DEFAULTS[frame] if calibration.frame is None else _frame_prior(calibration.frame),
    }
