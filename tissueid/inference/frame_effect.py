"""Effect of a compliant frame on the numbers: as a remark where none is known, as an sd where one is.

A hold behind a frame of stiffness k_f relaxes with ``tau_app = tau (1 + K / (k_f + k_0))``, k_0 the static
stiffness: while the force falls the frame gives back and the tip moves on.  In a ramp tip speed and force
are each less by ``k_f / (k_f + k_0)``, so that ``eta_app = eta (k_f / (k_f + k_0))^2``.  Both are linearised
about half depth, and derived for this project; they say how large the effect is, not what to correct by.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.inference.system import MACHINE
from tissueid.manifest import FrameCurve
from tissueid.model.frame import tangent_stiffness, tangent_stiffness_sd
from tissueid.model.grammar import rebuilt
from tissueid.priors import CalibrationPrior
from tissueid.result import SpecimenFit

#: Stiffness of a small table-top machine with fixture and load cell, where nobody says: 1,000 N/mm is
#: towards the soft end of what makers print.
ASSUMED_FRAME_N_PER_MM = 1_000.0
#: Effects of the assumed frame below this are not worth a remark.
WORTH_SAYING = 0.02
#: A machine so many standard deviations of its prior off is none; nor is a frame that nobody stated, softer
#: than one standard deviation, that bends by more than this share of the travel.
UNLIKELY_SD, SOFT_SD, MOST_BENDING = 3.0, 1.0, 0.2
#: Relaxation times below this are moved by force filters and time skew of ordinary size [s].
INSTRUMENT_TAU_S = 0.2


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
    """The flags of a fit, with ``compliance_unknown`` as the study leaves it.

    ``frame``: what was taken off the displacement; ``stated``: ``[calibration]`` of the study.
    """
    flags = [flag for flag in fit.flags if flag.code != "compliance_unknown"]
    if not fit.parameters or fit.model.branches == 0 or fit.axes.normalised:
        return flags
    short = _shortest(fit)
    if frame is not None:
        flags.append(_frame_sd(fit, frame))
    unknown = _unknown(fit, frame, stated, short)
    return flags if unknown is None else [*flags, unknown]


def machine_flag(
    machine: FloatArray, priors: Mapping[str, CalibrationPrior], *, force_N: float, depth_mm: float
) -> Flag | None:
    """``machine_implausible``: the optimum is behind a machine that what is known of it speaks against.

    ``machine`` (3,): compliance of the frame [mm/N], skew and force filter [s], at the optimum; ``priors``:
    by their names in :data:`tissueid.priors.CALIBRATION_DEFAULTS`; ``force_N``, ``depth_mm``: the largest
    recorded.
    """
    values = dict(zip(MACHINE, (float(one) for one in machine), strict=True))
    words = {
        "frame_compliance_mm_per_N": lambda value: f"a frame of {1.0 / max(value, 1e-9):.3g} N/mm",
        "skew_s": lambda value: f"channels {1e3 * abs(value):.3g} ms apart",
        "force_filter_s": lambda value: f"a force filter of {1e3 * value:.3g} ms",
    }
    far = {name: abs(values[name] - priors[name].mean) / priors[name].sd for name in MACHINE}
    name = max(far, key=lambda one: far[one])
    frame = "frame_compliance_mm_per_N"
    share = values[frame] * force_N / depth_mm if not priors[frame].stated else 0.0
    if far[name] > UNLIKELY_SD:
        why = f"{far[name]:.1f} standard deviations off"
    elif share > MOST_BENDING and far[frame] > SOFT_SD:
        name, why = frame, f"which would take {100.0 * share:.0f} % of the travel"
    else:
        return None
    return Flag(
        "machine_implausible",
        f"the fit needs {words[name](values[name])}, {why}",
        {"name": name, "value": values[name], "deviations": far[name], "frame_share": share},
    )


def _shortest(fit: SpecimenFit) -> float:
    """Shortest relaxation time, as estimated, identified or not [s]."""
    return float(rebuilt(fit.model, fit.depth_mm).times(fit.theta).min())


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
        values |= {
            "assumed_frame_N_per_mm": ASSUMED_FRAME_N_PER_MM,
            "tau_bias": effect.tau,
            "viscosity_bias": effect.viscosity,
        }
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
    k = tangent_stiffness(frame, force)
    sd = tangent_stiffness_sd(frame, force)
    share = branch * sd / (k + static) ** 2
    message = f"a frame of {k:.4g} N/mm (sd {sd:.2g}) was taken off; tau is uncertain by {100 * share:.2g} %"
    values = {"frame_stiffness_N_per_mm": k, "frame_stiffness_N_per_mm_sd": sd, "tau_sd_fraction": share}
    return Flag("frame_corrected", message, values)
