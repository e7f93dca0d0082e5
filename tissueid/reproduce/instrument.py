"""Could an instrument alone give a relaxation time?  An elastic tissue behind a crosshead that overshoots.

A hold that is fitted by itself, as the paper did, sees a force that decays.  It does not see whether the
tissue relaxed, or the crosshead settled and the load channel followed with its filter.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq, least_squares

from tissueid.arrays import FloatArray
from tissueid.reproduce.published import Ledger
from tissueid.reproduce.readings import Readings
from tissueid.reproduce.tissue import HOLD_SPEED_MM_MIN, branch_force, cubic_through_peaks, read_branch

#: Time constant of the load channel's filter [s]: common in test machines.
FILTER_S = 0.005
#: Window of the exponential after the corner, and its step [s].
WINDOW_S, STEP_S = 0.5, 1e-4
#: Largest overshoot that is looked for [mm]; more would be a machine in need of repair.
MOST_OVERSHOOT_MM = 0.5
#: Settling times that are looked for [s].
SETTLING_S = (1e-3, 0.5)


def settling_force(
    static: tuple[float, ...], depth_mm: float, overshoot_mm: float, settling_s: float
) -> tuple[FloatArray, FloatArray]:
    """Filtered force of an elastic tissue in a hold whose crosshead comes back from an overshoot.

    ``static``: powers of depth, from the first [N/mm, ...]; ``depth_mm``, ``overshoot_mm``, ``settling_s``:
    depth ``d + o exp(-t / settling)`` from the corner on; the channel's filter has settled before.  Returns
    ``time_s, force_N``.
    """
    time = np.arange(0.0, WINDOW_S, STEP_S)
    depth = depth_mm + overshoot_mm * np.exp(-time / settling_s)
    force = np.polynomial.polynomial.polyval(depth, [0.0, *static])
    kept = np.exp(-STEP_S / FILTER_S)
    filtered = np.empty_like(time)
    filtered[0] = force[0]
    for n in range(1, time.size):
        filtered[n] = kept * filtered[n - 1] + (1.0 - kept) * force[n]
    return time, filtered


def hold_exponential(time_s: FloatArray, force_N: FloatArray) -> tuple[float, float]:
    """Amplitude [N] and time constant [s] of one exponential and a plateau: the hold by itself."""

    def residual(p: FloatArray) -> FloatArray:
        return np.asarray(p[0] + p[1] * np.exp(-time_s / np.exp(p[2])) - force_N)

    start = [force_N[-1], force_N[0] - force_N[-1], np.log(0.02)]
    found = least_squares(residual, start, x_scale=np.maximum(np.abs(start), 1.0)).x
    return float(found[1]), float(np.exp(found[2]))


def elastic_imitation(ledger: Ledger, readings: Readings, depth: int) -> str:
    """Overshoot and settling time of a crosshead that give a printed relaxation time without any branch.

    ``ledger``: of a row of its own: the printed time is what is aimed at; ``depth``: [mm].
    """
    key = f"table-1/tau-{depth}mm"
    branch = read_branch(ledger, readings, key)
    if readings.relaxation == "rate":
        return "not looked for: the time would be longer than the record"
    static = cubic_through_peaks(ledger, branch)
    drop = branch_force(branch, depth, HOLD_SPEED_MM_MIN)

    def height(overshoot: float) -> float:
        beyond = depth + overshoot
        return sum(a * (beyond**k - float(depth) ** k) for k, a in enumerate(static, start=1)) - drop

    if height(MOST_OVERSHOOT_MM) < 0.0:
        return f"not with an overshoot of {MOST_OVERSHOOT_MM} mm or less"
    overshoot = float(brentq(height, 0.0, MOST_OVERSHOOT_MM))

    def miss(ln_settling: float) -> float:
        found = hold_exponential(*settling_force(static, depth, overshoot, np.exp(ln_settling)))
        return found[1] - branch.tau_s

    low, high = np.log(SETTLING_S)
    if miss(low) * miss(high) > 0.0:
        return "no: no settling time gives it"
    settling = float(np.exp(brentq(miss, low, high, xtol=1e-3)))
    amplitude, tau = hold_exponential(*settling_force(static, depth, overshoot, settling))
    return (
        f"yes: an elastic tissue, {overshoot:.2f} mm of overshoot that settles within "
        f"{1e3 * settling:.0f} ms and a filter of {1e3 * FILTER_S:.0f} ms give {amplitude:.1f} N and "
        f"{tau:.4f} s when the hold is fitted by itself"
    )
