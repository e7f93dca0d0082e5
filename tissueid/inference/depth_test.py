"""Drainage or viscosity, by holds at several depths.

Fluid drains from under a contact of radius a in a time that grows as a^2; a viscous tissue does not know the
contact (Hu, Zhao, Vlassak & Suo 2010, doi 10.1063/1.3370354).  The slope of ln tau on ln a tells them apart,
where a tip is known, is not buried, and holds of one length stand at two depths or more.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.stats import t

from tissueid.arrays import FloatArray
from tissueid.flags import Flag
from tissueid.measured.geometry import Geometry
from tissueid.model.moduli import formulas_for
from tissueid.quantities import DEPTH_TEST, Quantity

UNIT = "1"
#: Slopes of ln tau on ln contact radius of a viscous tissue and of one that drains.
VISCOUS, DRAINAGE = 0.0, 2.0
#: Ratio of the largest to the smallest contact radius, depth over tip radius, and holds, that can decide.
FEWEST_RATIO, BURIED, FEWEST_HOLDS = 1.1, 0.5, 3
#: Least standard deviation of ln tau: two holds at one site agree no better.
LEAST_SD = 0.02


def depth_test(
    geometry: Geometry | None, depths_mm: Sequence[float], tau_s: Sequence[float]
) -> tuple[Quantity | None, tuple[Flag, ...]]:
    """Slope of ln tau on ln contact radius, and its flag.

    ``geometry``: tip; without one, or with a flat punch, nothing is tested; ``depths_mm``, ``tau_s``: depth
    and relaxation time of a hold each, of one length.  Returns value and standard error of the slope, with
    ``verdict`` and 95 % interval among its conditions; ``poroelastic`` where the slope is that of drainage.
    """
    if geometry is None or geometry.indenter.shape == "flat" or len(depths_mm) < FEWEST_HOLDS:
        return None, ()
    formula = formulas_for(geometry.indenter, geometry.thickness_mm)[0]
    contacts = [geometry.contact(formula, depth) for depth in depths_mm]
    radius = np.array([np.nan if one is None else one.contact_mm for one in contacts])
    if not np.isfinite(radius).all() or radius.max() < FEWEST_RATIO * radius.min():
        return None, ()
    deepest = float(max(depths_mm))
    at: dict[str, float | str] = {"depth_mm": deepest, "holds": float(len(depths_mm))}
    tip = geometry.indenter.radius_mm
    if geometry.indenter.shape == "sphere" and tip is not None and deepest > BURIED * tip:
        reason = f"the tip is buried: {deepest:.3g} mm of depth, {tip:.3g} mm of radius"
        return Quantity(DEPTH_TEST, UNIT, at, None, None, reason), ()
    slope, error, half = _slope(np.log(radius), np.log(tau_s))
    verdict = _verdict(slope - half, slope + half)
    at |= {"low": slope - half, "high": slope + half, "verdict": verdict}
    flags: tuple[Flag, ...] = ()
    if verdict == "drainage":
        words = (
            f"relaxation times grow as the contact radius to the power {slope:.2f} [{slope - half:.2f}, "
            f"{slope + half:.2f}] to {deepest:.3g} mm: fluid drains"
        )
        flags = (Flag("poroelastic", words, {"slope": slope, "stderr": error}),)
    return Quantity(DEPTH_TEST, UNIT, at, slope, error), flags


def _slope(x: FloatArray, y: FloatArray) -> tuple[float, float, float]:
    """Slope of a line, its standard error, and half its 95 % interval."""
    off, freedom = x - x.mean(), x.size - 2
    slope = float(off @ y / (off @ off))
    rest = y - y.mean() - slope * off
    sd = max(float(np.sqrt(rest @ rest / freedom)), LEAST_SD)
    error = sd / float(np.sqrt(off @ off))
    return slope, error, float(t.ppf(0.975, freedom)) * error


def _verdict(low: float, high: float) -> str:
    """One of drainage, viscous, neither, can't decide."""
    viscous, drains = low <= VISCOUS <= high, low <= DRAINAGE <= high
    if viscous == drains:
        return "can't decide" if viscous else "neither"
    return "viscous" if viscous else "drainage"
