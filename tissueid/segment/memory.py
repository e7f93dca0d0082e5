"""Scatter of a mean of samples over that of white noise by which neighbours would differ as much.

Differences of neighbours show the noise of single samples, and less of it where it goes on from sample to
sample.  The contact is told by means over many samples: of those the long-run variance counts, the variance
of a mean times its samples, in the limit of many.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.segment.hinge import STEP
from tissueid.segment.motion import Piece
from tissueid.signal_noise import quantum, white_noise_sd

#: Last share of a standstill that counts as quiet, and powers of time that are taken off it as relaxation.
LATE_SHARE = 1.0 / 3.0
SLOW_POWERS = 3
#: Fewest samples of a quiet stretch.
FEWEST = 48
#: The last sample of a standstill, its corner, belongs to the next move where it is so many sd of the rest
#: away: friction turns, or the tool darts off.
CORNER_SD = 30.0
#: Shares of the samples that a swing leaves out on either side, and its reserve: of white noise 7 sd.
SWING_SHARES, SWING = (0.01, 0.99), 1.5
#: Fewest means by which a variance and a correlation are judged.
FEWEST_MEANS = 32
#: ... and of one stretch: of fewer, what is taken off it leaves little to vary.
FEWEST_IN_ONE = SLOW_POWERS + 2
#: Standard errors beyond which neighbouring means are correlated, and those beyond which a correlation that
#: is left at the longest means counts.
SURE = 3.5
LEFT = 1.0
#: Largest correlation of neighbouring means that is believed.
LARGEST = 0.95
#: Residuals below this share of the step of a quantised signal show the step, no noise.
COARSE = 0.5
#: ... and those below this share of the force its arithmetic.
ROUNDING = 1e-12


def quiet_stretches(time_s: FloatArray, force_N: FloatArray, found: Sequence[Piece]) -> list[FloatArray]:
    """Residuals (n,) of the force [N] while the tool stands, late enough for relaxation to be slow."""
    stretches = []
    for piece in found:
        if piece.direction != 0:
            continue
        late = time_s[piece.stop] - LATE_SHARE * (time_s[piece.stop] - time_s[piece.start])
        rows = slice(int(np.searchsorted(time_s, late)), piece.stop + 1)
        left = without_slow(time_s[rows], force_N[rows])
        if left is not None and abs(float(left[-1])) > CORNER_SD * float(np.std(left[:-1])):
            left = without_slow(time_s[rows][:-1], force_N[rows][:-1])
        if left is not None:
            stretches.append(left)
    return stretches


def swing_of(stretches: Sequence[FloatArray]) -> float:
    """Way of the force from one side of quiet stretches to the other, of a hum or of the noise [N]."""
    return max((SWING * float(np.ptp(np.quantile(one, SWING_SHARES))) for one in stretches), default=0.0)


def without_slow(time_s: FloatArray, force_N: FloatArray) -> FloatArray | None:
    """The force without a polynomial of time, ``None`` where too few samples are left, or its step shows."""
    span = float(np.ptp(time_s)) if time_s.size else 0.0
    if time_s.size < FEWEST or span <= 0.0:
        return None
    slow = np.polynomial.legendre.legvander(2.0 * (time_s - time_s[0]) / span - 1.0, SLOW_POWERS)
    basis, _ = np.linalg.qr(slow)
    left = force_N - basis @ (basis.T @ force_N)
    sd = float(np.sqrt(left @ left / (left.size - SLOW_POWERS - 1)))
    step = quantum(force_N)
    shown = max(COARSE * step, ROUNDING * float(np.abs(force_N).max()))
    # where most neighbours are equal, what is left does not show how they scatter
    hidden = _neighbours_sd(left) < step / STEP
    return None if hidden or sd <= shown else np.asarray(left)


def _neighbours_sd(left: FloatArray) -> float:
    return white_noise_sd(np.arange(float(left.size)), left)


def long_run_ratio(stretches: Sequence[FloatArray]) -> float:
    """Long-run sd of noise over what the differences of neighbours show, at least 1; 1 for white noise.

    Residuals of quiet stretches, (n,) each.  Means over 1, 2, 4, .. samples are compared; beyond the longest
    of which there are enough, their correlation is taken to fall as a power.
    """
    samples = sum(one.size for one in stretches)
    differences = sum(one.size * _neighbours_sd(one) ** 2 for one in stretches)
    if differences <= 0.0:
        return 1.0
    size, correlated, ratio = 1, False, 1.0
    while True:
        kept = [one for one in stretches if one.size >= FEWEST_IN_ONE * size]
        if sum(one.size // size for one in kept) < FEWEST_MEANS:
            break
        square, product, means = 0.0, 0.0, 0
        for one in kept:
            whole = one[: one.size // size * size].reshape(-1, size).mean(axis=1)
            square += float(whole @ whole)
            product += float(whole[1:] @ whole[:-1])
            means += whole.size
        free = means - (SLOW_POWERS + 1) * len(kept)
        # what is taken off leaves neighbours correlated by so much less
        rho = product / square + (means - free) / means
        correlated = correlated or rho > SURE / np.sqrt(means)
        rho = min(rho, LARGEST) if rho > LEFT / np.sqrt(means) else 0.0
        ratio = size * square / free * (1.0 + rho) / (1.0 - rho) * samples / differences
        size *= 2
    return max(float(np.sqrt(ratio)), 1.0) if correlated else 1.0


def largest_ratio(stretches: Sequence[FloatArray], samples: float) -> float:
    """Ratio of a mean over so many samples at the most: it scatters by no more than one of them."""
    square = sum(float(one @ one) for one in stretches)
    differences = sum(one.size * _neighbours_sd(one) ** 2 for one in stretches)
    return max(float(np.sqrt(samples * square / differences)), 1.0) if differences > 0.0 else 1.0
