"""The force of a hold at a stated time, and its standard deviation.

A parabola through the samples within a fifth of the time where there are enough of them, without those far
off it; else between the two neighbours.  Nothing is said beyond the hold, nor where no sample is near.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray

#: Half width of the window over the time, and fewest samples of a parabola.
SHARE, FEWEST = 0.2, 6
#: A hold that ends within this share before the time has reached it.
REACHED = 0.01
#: The nearest sample must lie within this factor of the time.
NEAR = 1.5
#: Samples farther off the parabola than this many of the middle deviations are left out, once.
FAR = 6.0


class ForceAt(NamedTuple):
    """Force and its standard deviation [N]; ``None`` with the reason where there is none."""

    force_N: float | None
    sd_N: float | None
    reason: str = ""


def force_at(time_s: FloatArray, force_N: FloatArray, at_s: float, noise_N: float) -> ForceAt:
    """The force so long after the start of a window.

    ``time_s``, ``force_N`` (n,): times from the start of the window, 0 first; ``noise_N``: standard deviation
    of a sample.
    """
    last = float(time_s[-1])
    if last < (1.0 - REACHED) * at_s:
        return ForceAt(None, None, f"the hold lasts {last:.4g} s")
    later = time_s[time_s > 0.0]
    if later.size == 0 or float(np.abs(np.log(later / at_s)).min()) > np.log(NEAR):
        wide = float(np.diff(time_s)[max(int(np.searchsorted(time_s, at_s)) - 1, 0)]) if later.size else last
        return ForceAt(None, None, f"samples are {wide:.3g} s apart at {at_s:g} s")
    near = np.abs(time_s - at_s) <= SHARE * at_s
    if int(near.sum()) < FEWEST:
        return ForceAt(float(np.interp(at_s, time_s, force_N)), noise_N)
    x, f = (time_s[near] - at_s) / (SHARE * at_s), force_N[near]
    design = x[:, None] ** np.arange(3.0)
    off = np.abs(f - design @ np.linalg.lstsq(design, f, rcond=None)[0])
    kept = off <= FAR * max(float(np.median(off)), noise_N, 1e-300)
    if int(kept.sum()) < FEWEST:
        kept = np.ones(x.size, dtype=np.bool_)
    inverse = np.linalg.pinv(design[kept])
    return ForceAt(float(inverse[0] @ f[kept]), noise_N * float(np.linalg.norm(inverse[0])))
