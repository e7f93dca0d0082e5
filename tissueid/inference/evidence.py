"""Correlation of residuals, noise that recordings show where nothing happens, and whether one is the other.

By restricted likelihood (doi 10.1093/biomet/58.3.545), slow forces and the fit in it.  Noise that a fit needs
beyond late holds, air and differences is a discrepancy of the model (doi 10.1111/1467-9868.00294).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tissueid.arrays import FloatArray
from tissueid.inference.noise import Memory, whitener
from tissueid.inference.optimum import Noise, Normal, normal_equations, whitener_of
from tissueid.inference.prior import PriorRows
from tissueid.inference.system import Derivatives, Point, System
from tissueid.inference.window import FittedLog
from tissueid.signal_noise import chain_breaks, quantum, white_noise_sd
from tissueid.trial import Segmentation, Trial, contact_frame

#: Part of a hold, from its end, that counts as quiet; degrees of what is taken off it and off the air.
LATE_SHARE, HOLD_DEGREE, AIR_DEGREE = 0.5, 3, 1
#: Part of the air that may carry the kick of the start.
KICK_SHARE = 0.1
#: Samples that are too few for a stretch, and most of a log that are looked at.
FEWEST, MOST = 16, 1_500
#: Level of the test, its free parameters (scale, memory, white share), and how many times the noise that a
#: recording shows a fit may need.
LEVEL, FREE, EXCESS = 0.001, 3, 1.5
#: A median of differences is known to so much over the root of their number.
MEDIAN_ERROR = 3.0
#: Correlation times over the step, and white shares, that are tried.
TIMES = np.geomspace(0.3, 3000.0, 14)
SHARES = (0.0, 0.03, 0.2, 0.5, 0.8, 0.97)


@dataclass(frozen=True, slots=True, eq=False)
class _Quiet:
    """A stretch while nothing happens: slow columns and what is left of the force, and its clock."""

    slow: FloatArray
    left_N: FloatArray
    step_s: FloatArray
    chain: NDArray[np.bool_]

    @property
    def freedom(self) -> int:
        return int(self.left_N.size - self.slow.shape[1])

    def restricted(self, memory: Memory) -> tuple[float, float]:
        """Sum of squares [N^2] and ln det of the restricted likelihood under noise of unit variance."""
        ones = np.ones(self.left_N.size)
        white = whitener(ones, self.step_s, self.step_s, self.chain, memory)
        columns = white(np.column_stack([self.slow, self.left_N]))
        gram = columns.T @ columns
        inner = gram[:-1, :-1]
        square = float(gram[-1, -1] - gram[-1, :-1] @ np.linalg.solve(inner, gram[:-1, -1]))
        return max(square, 0.0), white.log_det + float(np.linalg.slogdet(inner)[1])


@dataclass(frozen=True, slots=True, eq=False)
class LogEvidence:
    """Evidence of one recording on its noise."""

    quiet: tuple[_Quiet, ...]  # quiet stretches
    difference_N: float  # white noise that differences show [N]
    quantum_N: float  # step of the digits [N]
    samples: int


@dataclass(frozen=True, slots=True)
class NoiseVerdict:
    """Noise that a fit needs, against noise that its recordings show."""

    refuted: bool  # the recordings show that it is no noise
    measured_N: float  # standard deviation in quiet stretches, slow forces taken off, or of differences [N]


def _quiet(time_s: FloatArray, force_N: FloatArray, degree: int) -> _Quiet:
    span = float(np.ptp(time_s))
    u = np.linspace(-1.0, 1.0, time_s.size) if span <= 0.0 else 2.0 * (time_s - time_s[0]) / span - 1.0
    slow, _ = np.linalg.qr(np.polynomial.legendre.legvander(u, degree))
    step = np.diff(time_s, prepend=time_s[0] - (time_s[1] - time_s[0]))
    return _Quiet(slow, force_N - slow @ (slow.T @ force_N), np.maximum(step, 1e-12), chain_breaks(time_s))


def log_evidence(trial: Trial, segmentation: Segmentation, log: FittedLog) -> LogEvidence:
    """Evidence of one recording."""
    time, include, values = log.data.time_s, log.data.include, log.data.force_N
    found = []
    for hold in segmentation.of_kind("hold"):
        late = hold.end_s - LATE_SHARE * (hold.end_s - hold.start_s)
        # the sample of its corner may belong to the next move
        rows = np.flatnonzero((time >= late) & (time < hold.end_s) & include)[-MOST:]
        if rows.size >= FEWEST:
            found.append(_quiet(time[rows], values[rows], HOLD_DEGREE))
    if not found and segmentation.contact is not None:
        depth, force = contact_frame(trial, segmentation)
        before = np.flatnonzero(depth[: segmentation.contact.index] < -3.0 * segmentation.contact.sd_mm)
        rows = before[math.ceil(KICK_SHARE * before.size) :][-MOST:]
        if rows.size >= FEWEST:
            found.append(_quiet(trial.time_s[rows], force[rows], AIR_DEGREE))
    return LogEvidence(
        quiet=tuple(found),
        difference_N=white_noise_sd(time[include], values[include]),
        quantum_N=quantum(trial.force_N),
        samples=int(include.sum()),
    )


def _likelihood(
    stretches: Sequence[_Quiet], memory: Memory, least: float, variance: float | None = None
) -> tuple[float, float]:
    """Restricted ln L and its variance [N^2]: the given one, or the best that is not below ``least``."""
    parts = [one.restricted(memory) for one in stretches]
    square, freedom = sum(one[0] for one in parts), sum(one.freedom for one in stretches)
    if variance is None:
        variance = max(square / freedom, least)
    log_det = sum(one[1] for one in parts)
    return -0.5 * (freedom * math.log(variance) + log_det + square / variance), variance


@lru_cache(maxsize=1)
def _likeliest(stretches: tuple[_Quiet, ...], step_s: float, least: float) -> tuple[float, float]:
    """Restricted ln L and variance of the likeliest memory, whatever a fit needs: each of them asks."""
    memories = [Memory(time, share) for time in TIMES * step_s for share in SHARES]
    return max((_likelihood(stretches, one, least) for one in memories), key=_LIKELIEST)


def _expected_difference(noise: Noise, step_s: float) -> float:
    """Ratio of what :func:`~tissueid.signal_noise.white_noise_sd` shows of such noise to its sigma."""
    phi = noise.memory.phi(step_s)
    rho = [(1.0 - noise.memory.white) * phi**lag for lag in range(1, 5)]
    second = (1.5 - 2.0 * rho[0] + 0.5 * rho[1]) / 1.5
    fourth = (70.0 - 112.0 * rho[0] + 56.0 * rho[1] - 16.0 * rho[2] + 2.0 * rho[3]) / 70.0
    return math.sqrt(max(min(second, fourth), 0.0))


def verdict_on_noise(
    noise: Noise, logs: Sequence[LogEvidence], *, step_s: float, alone: bool = False
) -> NoiseVerdict:
    """Judge if the noise that residuals suggest is noise of the recordings.

    ``alone``: of one log nothing else tells correlated noise from what the model lacks.
    """
    stretches = [one for log in logs for one in log.quiet]
    digits = float(np.median([one.quantum_N for one in logs]))
    samples = sum(one.samples for one in logs)
    shown = max(float(np.median([one.difference_N for one in logs])), digits / math.sqrt(12.0))
    needed = noise.sigma_N * _expected_difference(noise, step_s)
    step_excess = needed / shown if shown > 0.0 else math.inf
    refuted = step_excess > EXCESS * (1.0 + MEDIAN_ERROR / math.sqrt(max(samples, 1)))
    if not stretches or noise.sigma_N <= 0.0:
        refuted |= alone and noise.memory.time_s > 0.0
        return NoiseVerdict(refuted and noise.sigma_N > 0.0, shown)
    least = max(digits**2 / 12.0, 1e-24)
    at_fit, _ = _likelihood(stretches, noise.memory, least, noise.sigma_N**2)
    same = _likelihood(stretches, noise.memory, least)
    best, quietest = max(same, _likeliest(tuple(stretches), step_s, least), key=_LIKELIEST)
    p_value = float(stats.chi2.sf(2.0 * (best - at_fit), FREE))
    excess = noise.sigma_N / math.sqrt(min(same[1], quietest))
    refuted |= p_value < LEVEL and excess > EXCESS
    power = sum(float(one.left_N @ one.left_N) for one in stretches)
    freedom = sum(one.freedom for one in stretches)
    measured = math.sqrt(max(power / freedom, least))
    return NoiseVerdict(refuted, measured)


#: Correlation times over the step, and white shares beside them, of a first look.
SCANNED_TIMES, SCANNED_SHARES = np.geomspace(0.35, 400.0, 11), (0.0, 0.3, 0.7)
#: Gain in ln L below which noise is white, and below which it has no white part.
WORTH, SHARE_WORTH = 5.0, 3.0
#: Restricted ln L of a correlation, and its sigma [N].
_Found = tuple[float, float, Memory]
_LIKELIEST = itemgetter(0)


def _squares_after(system: System, normal: Normal, move: FloatArray) -> float:
    """Sum of squares of the residual after a step of the shared parameters, own ones following it."""
    left = normal.residual - normal.shared @ move
    if normal.own.shape[1]:
        rest = normal.own_gradient - np.einsum("lqs,s->lq", normal.cross, move)
        own = np.einsum("lqr,lr->lq", normal.own_inverse, rest)
        left = left - (normal.own * own[system.log]).sum(axis=1)
    return float(left @ left)


def _restricted(
    system: System, point: Point, parts: Derivatives, prior: PriorRows, memory: Memory, rough_N: float
) -> tuple[float, float]:
    """Restricted ln L of a correlation, and its sigma [N]."""
    white = whitener_of(system, memory)
    normal = normal_equations(system, point, parts, white, rough_N, prior)
    # a machine that is not asked about has neither derivatives nor priors
    live = np.diag(normal.hessian) > 0.0
    scale = np.sqrt(np.diag(normal.hessian)[live])
    hessian = normal.hessian[np.ix_(live, live)] / scale / scale[:, None]
    gradient = normal.gradient[live] / scale
    move = np.linalg.solve(hessian + 1e-12 * np.eye(len(scale)), gradient)
    shared = np.zeros(live.size)
    shared[live] = move / scale
    square = max(_squares_after(system, normal, shared), 1e-12) * rough_N**2
    fitted = normal.shared.shape[1] - 3 + point.own.size
    freedom = max(system.force.size - fitted, 1)
    log_det = white.log_det + float(np.linalg.slogdet(hessian)[1]) + 2.0 * float(np.log(scale).sum())
    if normal.own.shape[1]:
        log_det -= float(np.linalg.slogdet(normal.own_inverse)[1].sum())
    variance = square / freedom
    return -0.5 * (freedom * np.log(variance) + log_det), float(np.sqrt(variance))


def scan_memory(
    system: System,
    point: Point,
    parts: Derivatives,
    prior: PriorRows,
    *,
    step_s: float,
    rough_N: float,
    model: str = "auto",
) -> Noise:
    """Best correlation: ``auto``, ``white``, ``ar1`` or ``white+ar1``; ``rough_N``: of residuals."""

    def look(memory: Memory) -> _Found:
        return (*_restricted(system, point, parts, prior, memory, rough_N), memory)

    plain, sigma, _ = look(Memory())
    if model == "white" or system.force.size < 12 or not np.isfinite(plain):
        # residuals that parameters take up show no noise
        return Noise(sigma)
    times = (SCANNED_TIMES * step_s).tolist()
    shares = (0.0,) if model == "ar1" else SCANNED_SHARES
    tried = [look(Memory(time, share)) for share in shares for time in times]
    best = _refined(max([(-np.inf, sigma, Memory()), *tried], key=_LIKELIEST), look, share=model != "ar1")
    if best[2].white > 0.0 and model == "auto":
        pure = _refined(max((look(Memory(time)) for time in times), key=_LIKELIEST), look, share=False)
        if best[0] - pure[0] < SHARE_WORTH:
            best = pure
    return Noise(sigma) if model == "auto" and best[0] - plain < WORTH else Noise(best[1], best[2])


def _refined(best: _Found, look: Callable[[Memory], _Found], *, share: bool) -> _Found:
    """The best of a finer and finer look around it."""
    width, spread = 0.5, 0.15
    for _ in range(4):
        _, _, at = best
        tried = [Memory(at.time_s * np.exp(d), at.white) for d in (-width, width)]
        if share and at.white > 0.0:
            tried += [Memory(at.time_s, float(np.clip(at.white + d, 0.0, 0.98))) for d in (-spread, spread)]
        best = max([best, *map(look, tried)], key=_LIKELIEST)
        width, spread = 0.6 * width, 0.6 * spread
    return best
