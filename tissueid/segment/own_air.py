"""Evidence of a recording's own air on its force: reading, scatter, start kicks, and the last of it.

The noise of successive samples says nothing of the slow wander of a load cell in air; the samples in air do.
A tool that starts pulls at its cell by its own mass: such a kick is over when the reading of the rest before
it is back, so it is no contact.
"""

from __future__ import annotations

import numpy as np

from tissueid.arrays import FloatArray

#: Samples from which a reading in air and its scatter are told.
FEWEST_SAMPLES = 5
#: Force has left the reading in air beyond so many sd of its own scatter there.
LEFT_SD = 4.0
#: Normal sd over the median absolute deviation.
NORMAL_SD_OVER_MAD = 1.4826
#: Air is no air where its force rises, from sample to sample, by more than this share of what it does after
#: contact ...
RISING_SHARE = 0.2
#: ... by so many standard errors; a drift of the load cell is as sure over so many samples at least.
SURE = 3.0
FEWEST_DRIFTING = 20
#: A kick is over within so many samples of the start, at least, or this share of the move; it leaves the
#: reading at rest by so many sd of it and comes back within so many, for as long as it lasted.
KICK_SAMPLES = 5
KICK_SHARE = 0.1
KICK_SD = 6.0
BACK_SD = 1.5
BACK_SAMPLES = 3


def _reading(force_N: FloatArray, noise_N: float) -> tuple[float, float]:
    """Median and robust sd of samples in air, the latter at least the white noise."""
    level = float(np.median(force_N))
    return level, max(NORMAL_SD_OVER_MAD * float(np.median(np.abs(force_N - level))), noise_N)


def without_kick(force_N: FloatArray, start: int, noise_N: float) -> FloatArray:
    """The force with the kick at the start of a move replaced by the reading at rest before it.

    ``force_N`` (n,): a standstill and the move after it; ``start``: first sample of the move.  Returns (n,),
    the force itself where no kick is told.
    """
    if start < FEWEST_SAMPLES:
        return force_N
    level, sd = _reading(force_N[:start], noise_N)
    off = np.abs(force_N[start : start + max(KICK_SAMPLES, int(KICK_SHARE * (force_N.size - start)))] - level)
    kicks = np.flatnonzero(off > KICK_SD * sd)
    if kicks.size == 0:
        return force_N
    first = int(kicks[0])
    back = np.flatnonzero(off[first:] <= BACK_SD * sd)
    if back.size == 0:
        return force_N
    over = first + int(back[0])
    after = force_N[start + over : start + over + max(BACK_SAMPLES, over - first)]
    if abs(float(np.median(after)) - level) > BACK_SD * sd:
        return force_N
    calm = force_N.copy()
    calm[start + first : start + over] = level
    return calm


def left_air(depth_mm: FloatArray, force_N: FloatArray, contact_mm: float, noise_N: float) -> float | None:
    """Depth of the first sample from which on the force stays above its reading in air.

    ``depth_mm``, ``force_N`` (n,): one loading move with what stands before it; ``contact_mm``: as estimated;
    the first half of what lies before it tells the reading in air.  Returns ``None`` where too few samples
    tell a reading in air.
    """
    before = int(np.argmax(depth_mm >= contact_mm))
    if before < 2 * FEWEST_SAMPLES:
        return None
    air = force_N[: before // 2]
    slope, error = _rise(air, noise_N)
    drift = slope if air.size >= FEWEST_DRIFTING and abs(slope) > SURE * error else 0.0
    calm = force_N - drift * np.arange(force_N.size)
    level, sd = _reading(calm[: before // 2], noise_N)
    inside = np.flatnonzero(calm <= level + LEFT_SD * sd)
    last = int(inside[-1]) if inside.size else 0
    return float(depth_mm[last + 1]) if last + 1 < depth_mm.size else None


def _rise(force_N: FloatArray, noise_N: float) -> tuple[float, float]:
    """Mean rise of the force from sample to sample, and its standard error."""
    along = np.arange(force_N.size) - 0.5 * (force_N.size - 1)
    spread = float(along @ along)
    return float(along @ force_N) / spread, noise_N / float(np.sqrt(spread))


def rises(before_N: FloatArray, after_N: FloatArray, noise_N: float) -> bool:
    """True where the force in what was taken for air rises as it does in tissue, so that it is none.

    ``before_N`` (n,), ``after_N`` (m,): forces of a move before and after its contact, in time order.
    """
    if before_N.size < 2 or after_N.size < 2:
        return False
    slope, error = _rise(before_N, noise_N)
    later, _ = _rise(after_N[: max(before_N.size, FEWEST_SAMPLES)], noise_N)
    return slope - SURE * error > RISING_SHARE * max(later, 0.0)
