"""The profile likelihood of a relaxation time: how the fit worsens as it moves, and where it is closed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.engine import Identified
from tissueid.inference.optimum import Optimum, minimise
from tissueid.inference.prior import prior_rows, time_bounds

#: 95 % point of chi-square with one degree of freedom, and the rise a curve is followed to.
LEVEL_95, LARGEST_RISE = 3.841458820694124, 15.0
#: Points on each side, steps of the fit at each, and the least and largest reach in ln tau.
POINTS, STEPS, LEAST_REACH, MOST_REACH = 5, 3, 1e-3, 4.0
#: Times the reach may be doubled.
DOUBLINGS = 4
DIGITS = 6


@dataclass(frozen=True, slots=True)
class ProfileInterval:
    """95 % profile-likelihood interval of one ln tau."""

    #: Ends in ln(tau / s); the bound of the search where open.
    low: float
    high: float
    #: True where the likelihood never falls far enough before the bound.
    open_low: bool
    open_high: bool

    @property
    def width(self) -> float:
        """Width in ln tau."""
        return self.high - self.low

    @property
    def closed(self) -> bool:
        """Both ends lie within the range of search."""
        return not (self.open_low or self.open_high)


def _held(identified: Identified, branch: int, value: float, start: Optimum) -> Optimum:
    """The optimum with one ln tau held, the machine where it is."""
    times = start.point.log_times.copy()
    times[branch] = value
    priors = identified.request.priors
    return minimise(
        identified.system,
        replace(start.point, log_times=times),
        lambda point: prior_rows(
            identified.system, identified.law, point, identified.scatter, priors, machine=False
        ),
        memory=identified.optimum.noise.memory,
        sigma_N=identified.optimum.noise.sigma_N,
        machine=False,
        steps=STEPS,
        held=np.array([branch]),
    )


def profile(identified: Identified, branch: int) -> tuple[ProfileInterval, dict[str, list[float]]]:
    """Profile of one relaxation time.

    ``branch``: place in the point's times.  Returns ``interval``; ``curve``: ``tau_s``, ``rise`` (of the
    deviance, in units of chi-square) and ``stiffness_N_per_mm``, ascending in tau.
    """
    optimum, law = identified.optimum, identified.law
    centre = float(optimum.point.log_times[branch])
    bounds = time_bounds(identified.system)
    sd = float(np.sqrt(optimum.covariance[branch, branch]))
    depth = (0.5 if law.degree else 1.0) ** np.arange(law.degree + 1.0)

    def stiffness(found: Optimum) -> float:
        if law.inside:
            ratio = np.exp(found.point.log_times[law.ratio_place(branch)])
            return float(ratio * found.point.linear[: law.static_size].sum()) / law.depth_mm
        block = next(one for one in law.blocks if one.branch == branch)
        return float(found.point.linear[block.at] @ depth) / law.depth_mm

    here = _held(identified, branch, centre, optimum)
    base = here.normal.objective
    rows = [(centre, 0.0, stiffness(here))]
    reach = float(np.clip(np.sqrt(LARGEST_RISE) * min(sd, 10.0), LEAST_REACH, MOST_REACH))
    for sign, end in ((-1.0, bounds[0]), (1.0, bounds[1])):
        step, last, at, rise = reach / POINTS, optimum, centre, 0.0
        for count in range(POINTS * (1 + DOUBLINGS)):
            if rise >= LARGEST_RISE or abs(at - end) < 1e-9:
                break
            step *= 1.0 if count < POINTS else 1.3
            at = float(np.clip(at + sign * step, *bounds))
            last = _held(identified, branch, at, last)
            rise = max(last.normal.objective - base, 0.0)
            rows.append((at, rise, stiffness(last)))
    rows.sort()
    place, height, stiff = np.array(rows).T
    low, open_low = _crossing(place, height, centre, -1)
    high, open_high = _crossing(place, height, centre, 1)
    columns = {"tau_s": np.exp(place), "rise": height, "stiffness_N_per_mm": stiff}
    curve = {
        name: [float(f"{value:.{DIGITS}g}") for value in values.tolist()] for name, values in columns.items()
    }
    return ProfileInterval(low, high, open_low, open_high), curve


def _crossing(place: FloatArray, height: FloatArray, centre: float, sign: int) -> tuple[float, bool]:
    """First crossing of the 95 % level on one side; the last place, open, where it never does."""
    order = np.argsort(sign * place)
    order = order[sign * (place[order] - centre) >= 0.0]
    x, y = place[order], np.sqrt(height[order])
    level = np.sqrt(LEVEL_95)
    beyond = np.flatnonzero(y >= level)
    if beyond.size == 0:
        return float(x[-1]), True
    k = int(beyond[0])
    share = (level - y[k - 1]) / max(y[k] - y[k - 1], 1e-300) if k else 0.0
    return float(x[k - 1] + share * (x[k] - x[k - 1])) if k else float(x[0]), False
