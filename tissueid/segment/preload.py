"""Distance before its first sample at which a record that starts under a force may have met the tissue.

A preload that was held has relaxed, so the static curve alone carries it, while the ramp that follows is
stiffer by what its branches add.  Branches that relax slower than the ramp runs can't be told from a static
curve there; the hold after the ramp shows them: its force falls at first by speed x stiffness of all
branches, as far as the ramp has driven them, and by all that they relax in the end.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.segment.motion import Piece, slope_of

#: Largest share of the stiffness at the start that may relax: taken where no hold tells.
LARGEST_SHARE = 0.75
#: Times the share that a hold shows: branches faster than its first part have relaxed before it is over, and
#: those slower than the mean are driven less.
MARGIN = 2.0
#: A hold begins where the tool moves by less than this share of its speed ...
STANDING_SPEED = 0.02
#: ... over this part of the ramp's time, and lasts until depth has changed by this share of the travel.
STANDING_TIME = 0.05
STANDING_TRAVEL = 0.01
#: Its first part, in times of the ramp, and the fewest samples of it.
FIRST_PART = 0.1
FEWEST = 8
#: Least share of a branch that a ramp is taken to have driven.
LEAST_DRIVEN = 0.01
#: Standard errors by which the fall of the force may be larger.
ERRORS = 2.0
#: Distances that differ by less than this share are one.
LEAST_RATIO = 1e-6


def relaxing_stiffness(
    record: tuple[FloatArray, FloatArray, FloatArray], move: Piece, noise_N: float
) -> float | None:
    """Stiffness that relaxes, as the hold after a move shows it [N/mm]; ``None`` where there is no hold.

    ``record``: time [s], depth [mm] and force [N], growing into the tissue.
    """
    time, depth, force = (values[move.stop :] for values in record)
    ramp_s = float(time[0] - record[0][move.start])
    travel = float(depth[0] - record[1][move.start])
    if ramp_s <= 0.0 or travel <= 0.0:
        return None
    later = np.searchsorted(time, time + STANDING_TIME * ramp_s)
    known = np.flatnonzero(later < time.size)
    moved = depth[later[known]] - depth[known]
    limit = STANDING_SPEED * travel / ramp_s * (time[later[known]] - time[known])
    standing = known[np.abs(moved) <= limit]
    if standing.size == 0:
        return None
    begin = int(standing[0])
    if (
        depth[begin] - depth[0] > travel
        or float(depth[:begin].max(initial=depth[0])) > depth[begin] + limit[0]
    ):
        return None  # it stands elsewhere, after another move
    away = np.flatnonzero(np.abs(depth[begin:] - depth[begin]) > STANDING_TRAVEL * travel)
    end = begin + int(away[0]) if away.size else time.size
    part = int(np.searchsorted(time, time[begin] + FIRST_PART * ramp_s, side="right"))
    last = min(end, max(part, begin + FEWEST))
    if last - begin < FEWEST or time[last - 1] <= time[begin]:
        return None
    slope, spread = slope_of(time[begin:last], force[begin:last])
    rate = max(ERRORS * noise_N / float(np.sqrt(spread)) - slope, 0.0)
    fallen = float(force[begin] - np.median(force[max(end - FEWEST, begin) : end]))
    relaxes_s = max(fallen, 0.0) / max(rate, 1e-300)
    # a ramp of t seconds has driven a branch by 1 - exp(-t / tau) of its stiffness
    driven = max(-float(np.expm1(-ramp_s / relaxes_s)), LEAST_DRIVEN) if relaxes_s > 0.0 else 1.0
    return rate * ramp_s / travel / driven


def with_relaxed(
    before_mm: float,
    sd_mm: float,
    force_N: float,
    stiffness: tuple[float, float],
    relaxing: float | None,
    reach_mm: float,
) -> tuple[float, float]:
    """Distance from the first sample back to contact, and its sd [mm], where part of the stiffness relaxes.

    ``before_mm``, ``sd_mm``: as the ramp alone says; ``force_N``: that the record starts under;
    ``stiffness``: at the first sample [N/mm], and the share of it that the ramp has shown to relax;
    ``relaxing``: what the hold shows, or ``None``.  Any share between the two is as likely.
    """
    slope, shown = stiffness
    share = LARGEST_SHARE if relaxing is None else min(MARGIN * relaxing / slope, LARGEST_SHARE)
    # what the ramp shows may be another curve of the static force
    furthest = max(before_mm * (1.0 - shown), force_N / slope) / (1.0 - share)
    ratio = min(furthest, reach_mm) / before_mm
    if ratio <= 1.0 + LEAST_RATIO:
        return before_mm, sd_mm
    # 1 / (1 - r) with r uniform from 0 to 1 - 1 / ratio: mean, and mean square
    mean = float(np.log(ratio)) / (1.0 - 1.0 / ratio)
    return before_mm * mean, float(np.hypot(sd_mm, before_mm * np.sqrt(max(ratio - mean * mean, 0.0))))
