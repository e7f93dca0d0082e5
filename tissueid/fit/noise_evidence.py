"""Noise that a recording shows where nothing happens, and whether the noise of a fit can be it.

Correlation that is found in residuals is noise only where the recording shows such noise: late in its holds,
or in air where it has none.  Slow forces are taken off there by a polynomial, and off the likelihood in the
same step (restricted maximum likelihood; Patterson & Thompson 1971, doi 10.1093/biomet/58.3.545), so that
noise with a long memory is not mistaken for less noise.  Everywhere, second and fourth differences of the
force bound what is new from sample to sample.  Noise that a fit needs beyond either is none: what is left is
a discrepancy of the model (Kennedy & O'Hagan 2001, doi 10.1111/1467-9868.00294).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.fit.window import FittedLog
from tissueid.likelihood.chains import chain_breaks
from tissueid.likelihood.lag_kernels import filter_chain
from tissueid.likelihood.noise import NoiseEstimate, correlation_times, phi_of
from tissueid.trial import Segmentation, Trial, contact_frame

__all__ = ["FEWEST", "MOST", "NoiseVerdict", "QuietStretch", "quiet_stretches", "verdict_on_noise"]

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

#: Part of a hold, from its end, that counts as quiet, and the degrees of the polynomials that are taken off
#: it and off the air.
LATE_SHARE = 0.5
HOLD_DEGREE, AIR_DEGREE = 3, 1
#: Part of the air that may carry the kick of the start.
KICK_SHARE = 0.1
#: Samples that are too few for a stretch, and most of all logs that are looked at.
FEWEST, MOST = 16, 20_000
#: Level of the test, its free parameters (scale, memory, white share), and how many times the noise that a
#: recording shows a fit may need.
LEVEL, FREE, EXCESS = 0.001, 3, 1.5
#: A median of differences is known to so much over the root of their number.
MEDIAN_ERROR = 3.0
#: White shares of the variance that are tried beside each correlation time.
SHARES = (0.0, 0.03, 0.2, 0.5, 0.8, 0.97)


@dataclass(frozen=True, slots=True, eq=False)
class QuietStretch:
    """Samples of one log while nothing happens.

    Attributes
    ----------
    columns : ndarray, shape (k + 1, n)
        Orthonormal slow columns, and the force less its fit last, in units of ``scale_N``.
    scale_N : float
    starts : ndarray of bool, shape (n,)
        True where a chain of noise starts.
    ratio : ndarray, shape (n,)
        Step since the sample before over the reference step.
    """

    columns: FloatArray
    scale_N: float
    starts: BoolArray
    ratio: FloatArray

    @property
    def freedom(self) -> int:
        """Samples less what was taken off."""
        return int(self.columns.shape[1] - self.columns.shape[0] + 1)

    def restricted(self, phi: float, white: float) -> tuple[float, float]:
        """Sum of squares [N^2] and ln det of the restricted likelihood under noise of unit variance."""
        k = self.columns.shape[0]
        gram, log_det = np.empty((k, k)), 0.0
        for i, row in enumerate(self.columns):
            gram[i, i], log_det = filter_chain(row, self.starts, self.ratio, phi, white)
        for i, j in combinations(range(k), 2):
            both = np.ascontiguousarray(self.columns[i] + self.columns[j])
            square = filter_chain(both, self.starts, self.ratio, phi, white)[0]
            gram[i, j] = gram[j, i] = 0.5 * (square - gram[i, i] - gram[j, j])
        slow = gram[:-1, :-1]
        square = float(gram[-1, -1] - gram[-1, :-1] @ np.linalg.solve(slow, gram[:-1, -1]))
        return max(square, 0.0) * self.scale_N**2, log_det + float(np.linalg.slogdet(slow)[1])


@dataclass(frozen=True, slots=True)
class NoiseVerdict:
    """Noise that a fit needs, against noise that its recordings show.

    Attributes
    ----------
    refuted : bool
        The recordings show that it is no noise.
    measured_N : float
        Standard deviation in their quiet stretches, slow forces taken off, or of their differences [N].
    excess : float
        Needed over shown, in the measure that tells most.
    p_value : float
        Of the quiet stretches; 1 without any.
    """

    refuted: bool
    measured_N: float
    excess: float
    p_value: float


def _stretch(time_s: FloatArray, force_N: FloatArray, degree: int, step_s: float) -> QuietStretch | None:
    """A stretch with polynomials of time taken off; ``None`` where nothing is left of it."""
    u = np.linspace(-1.0, 1.0, time_s.size) if np.ptp(time_s) <= 0.0 else (
        2.0 * (time_s - time_s[0]) / np.ptp(time_s) - 1.0
    )  # fmt: skip
    slow, _ = np.linalg.qr(np.polynomial.legendre.legvander(u, degree))
    left = force_N - slow @ (slow.T @ force_N)
    norm = float(np.linalg.norm(left))
    if norm <= 1e-14 * float(np.linalg.norm(force_N)):
        norm = 0.0
    return QuietStretch(
        columns=np.ascontiguousarray(np.vstack([slow.T, left / norm if norm > 0.0 else left * 0.0])),
        scale_N=norm,
        starts=chain_breaks(time_s),
        ratio=np.round(np.diff(time_s, prepend=time_s[0]) / step_s, 9),
    )


def quiet_stretches(
    trial: Trial,
    segmentation: Segmentation,
    log: FittedLog,
    residual_N: FloatArray,
    *,
    step_s: float,
    most: int,
) -> list[QuietStretch]:
    """Late parts of the holds of one log, or its air where no hold is long enough.

    Parameters
    ----------
    trial, segmentation, log
        The recording, its phases and its fitted part.
    residual_N : ndarray, shape (n,)
        Measured less modelled force at every sample of ``log`` [N].
    step_s : float
        Step over which phi is the correlation [s].
    most : int
        Samples that are looked at, the last ones of each stretch.
    """
    time = log.data.time_s
    found = []
    for hold in segmentation.of_kind("hold"):
        late = hold.end_s - LATE_SHARE * (hold.end_s - hold.start_s)
        rows = np.flatnonzero((time >= late) & (time <= hold.end_s) & log.data.include)[-most:]
        if rows.size >= FEWEST:
            found.append(_stretch(time[rows], residual_N[rows], HOLD_DEGREE, step_s))
    if not found and segmentation.contact is not None:
        depth, force = contact_frame(trial, segmentation)
        before = np.flatnonzero(depth[: segmentation.contact.index] < -3.0 * segmentation.contact.sd_mm)
        rows = before[math.ceil(KICK_SHARE * before.size) :][-most:]
        if rows.size >= FEWEST:
            found.append(_stretch(trial.time_s[rows], force[rows], AIR_DEGREE, step_s))
    return [one for one in found if one is not None]


def _likelihood(
    stretches: Sequence[QuietStretch], phi: float, white: float, least: float, variance: float | None = None
) -> tuple[float, float]:
    """Restricted ln L and its variance [N^2]: the given one, or the best that is not below ``least``."""
    parts = [one.restricted(phi, white) for one in stretches]
    square, freedom = sum(one[0] for one in parts), sum(one.freedom for one in stretches)
    if variance is None:
        variance = max(square / freedom, least)
    log_det = sum(one[1] for one in parts)
    return -0.5 * (freedom * math.log(variance) + log_det + square / variance), variance


def _expected_difference(found: NoiseEstimate) -> float:
    """What :func:`~tissueid.signal_noise.white_noise_sd` shows of such noise, over its sigma."""
    rho = [(1.0 - found.white_share) * found.phi**lag for lag in range(1, 5)]
    second = (1.5 - 2.0 * rho[0] + 0.5 * rho[1]) / 1.5
    fourth = (70.0 - 112.0 * rho[0] + 56.0 * rho[1] - 16.0 * rho[2] + 2.0 * rho[3]) / 70.0
    return math.sqrt(max(min(second, fourth), 0.0))


def verdict_on_noise(
    found: NoiseEstimate,
    stretches: Sequence[QuietStretch],
    differences_N: Sequence[float],
    *,
    quantum_N: float,
    samples: int,
    alone: bool = False,
) -> NoiseVerdict:
    """Whether the noise that residuals suggest is noise of the recordings.

    Parameters
    ----------
    found : NoiseEstimate
        Of the residuals.
    stretches : sequence of QuietStretch
        Of all logs.
    differences_N : sequence of float
        White noise that the differences of each log's force show [N].
    quantum_N : float
        Step of the force's digits [N]; noise is not below a twelfth of its square.
    samples : int
        Fitted samples of all logs.
    alone : bool
        One log is all there is: of correlation that nothing quiet shows, it can't tell noise from what the
        model lacks.
    """
    seen = float(np.median(differences_N))
    shown = max(seen, quantum_N / math.sqrt(12.0))
    needed = found.sigma_N * _expected_difference(found)
    step_excess = needed / shown if shown > 0.0 else math.inf
    refuted = step_excess > EXCESS * (1.0 + MEDIAN_ERROR / math.sqrt(max(samples, 1)))
    if not stretches or found.sigma_N <= 0.0:
        refuted |= alone and found.model != "white"
        return NoiseVerdict(refuted and found.sigma_N > 0.0, shown, step_excess, 1.0)
    least = max(quantum_N**2 / 12.0, 1e-24)
    at_fit, _ = _likelihood(stretches, found.phi, found.white_share, least, found.sigma_N**2)
    best, same_shape = _likelihood(stretches, found.phi, found.white_share, least)
    quietest = same_shape
    for time in correlation_times():
        for share in SHARES:
            value, variance = _likelihood(stretches, phi_of(time), share, least)
            if value > best:
                best, quietest = value, variance
    p_value = float(stats.chi2.sf(2.0 * (best - at_fit), FREE))
    excess = found.sigma_N / math.sqrt(min(same_shape, quietest))
    refuted |= p_value < LEVEL and excess > EXCESS
    power, freedom = sum(one.scale_N**2 for one in stretches), sum(one.freedom for one in stretches)
    return NoiseVerdict(refuted, math.sqrt(max(power / freedom, least)), max(excess, step_excess), p_value)
