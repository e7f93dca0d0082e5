"""The one relaxation time of the publication, and how it follows the length of the hold.

Real tissue relaxes over decades of time: one exponential then finds a relaxation time near the length of the
window it was shown, and two laboratories with two holds publish two numbers.  The one-branch model is fitted
to the whole hold, its first half and its first quarter, and the slope d ln tau / d ln T says which it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.inference.channel_law import kelvin_voigt_law
from tissueid.inference.engine import Identified
from tissueid.inference.logs import LogHandle, blocks_of
from tissueid.inference.noise import Memory
from tissueid.inference.optimum import minimise, whitener_of
from tissueid.inference.prior import prior_rows, time_bounds
from tissueid.inference.search import starting_points
from tissueid.inference.system import Point, System
from tissueid.quantities import RelaxationWindow

#: The hold is cut to these shares of its length.
SHARES = (1.0, 0.5, 0.25)
#: Sampling intervals that the shortest window has at least.
FEWEST_STEPS = 8
#: Distance from the ends of the search in ln tau at which a relaxation time is not known.
EDGE = 0.05
STEPS = 12


def _hold_s(handle: LogHandle) -> float:
    """Length of the longest hold of a log [s]."""
    return max((hold.end_s - hold.start_s for hold in handle.segmentation.of_kind("hold")), default=0.0)


def _ln_tau(identified: Identified, handles: Sequence[LogHandle], share: float) -> tuple[float, float] | None:
    """Ln of the one relaxation time with its standard error, ``None`` at the ends of the search."""
    blocks = []
    for handle in handles:
        cut = replace(handle, hold_share=share)
        _, log = cut.fitted()
        blocks.append(blocks_of(cut, log))
    found, request = identified.optimum.point, identified.request
    law = kelvin_voigt_law(1, identified.law.degree, identified.system.depth_mm)
    system = System(blocks, law, identified.system.depth_mm, identified.system.effects)
    at = Point(np.zeros(1), found.machine, np.zeros(law.linear), found.own)
    best = None
    for start in starting_points(system, law, at, whitener_of(system, Memory()))[:1]:
        best = minimise(
            system,
            start,
            lambda point: prior_rows(system, law, point, identified.scatter, request.priors, machine=False),
            machine=False,
            steps=STEPS,
        )
    low, high = time_bounds(system)
    if best is None or not low + EDGE < best.point.log_times[0] < high - EDGE:
        return None
    error = float(np.sqrt(best.covariance[0, 0]))
    return (float(best.point.log_times[0]), error) if np.isfinite(error) else None


def relaxation_window(
    handles: Sequence[LogHandle], identified: Identified, tick: Callable[[str], None]
) -> RelaxationWindow | None:
    """Relaxation time of the one-branch model with the hold cut to T, T/2 and T/4.

    ``handles``: logs of one specimen; ``identified``: their fit: its degree of K, machine and logs' own
    parameters are kept; ``tick``: told what is being done.  Returns ``None`` without a hold, where a quarter
    of it is too short to be fitted, or where the whole of it does not determine a relaxation time.
    """
    holds = [length for handle in handles if (length := _hold_s(handle)) > 0.0]
    step = max(handle.facts.step_s for handle in handles)
    if not holds:
        return None
    shares = tuple(share for share in SHARES if share * min(holds) >= FEWEST_STEPS * step)
    if len(shares) < 2:
        return None
    tick("relaxation time of shorter windows")
    found = [_ln_tau(identified, handles, share) for share in shares]
    known = [(share, *pair) for share, pair in zip(shares, found, strict=True) if pair is not None]
    if found[0] is None or len(known) < 2:
        return None
    cut, ln_tau, error = np.array(known).T
    slope, slope_error = _slope(np.log(cut), ln_tau, error)
    return RelaxationWindow(
        cut_s=tuple((float(np.median(holds)) * cut).tolist()),
        tau_s=tuple(np.exp(ln_tau).tolist()),
        stderr_s=tuple((np.exp(ln_tau) * error).tolist()),
        slope=slope,
        slope_stderr=slope_error,
    )


def _slope(ln_cut: FloatArray, ln_tau: FloatArray, error: FloatArray) -> tuple[float, float]:
    """Slope of the line through the windows, with the error that theirs give it were they independent."""
    weight = ln_cut - ln_cut.mean()
    weight /= weight @ weight
    return float(weight @ ln_tau), float(np.sqrt(weight**2 @ error**2))
