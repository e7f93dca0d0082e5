"""A specimen seen through an instrument that is known to its priors: delay, low-pass and frame on knots.

Coordinates are ln tau of each branch, skew, filter, compliance, and the spread of the gains where it is
free. Given those the tissue's coefficients are nearly normal: exactly for a rigid frame, and linearised at
their best values behind one that gives, because the frame is deflected by the tissue's own force.  Of a
long recording the noise is known far better than the instrument: its variance is taken anew at the mode of
all, its correlation is held at the estimate.  Else they are coordinates as well
(:mod:`tissueid.posterior.loose_noise`).

A gain of force or displacement is no coordinate.  Recorded as ``y = g_f F`` and ``x = g_x x'``, a tissue
a_k, b_k behind a frame c can't be told from ``a_k g_f / g_x^k``, ``b_k g_f / g_x^(k+1)`` and ``c g_x /
g_f`` behind perfect gains: see :mod:`tissueid.posterior.calibration`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.bernstein import is_passive
from tissueid.likelihood.cone import cone_least_squares
from tissueid.likelihood.instrument_kernels import EFFECTS, INSTRUMENT, TISSUE, Packed
from tissueid.likelihood.knot_terms import log_terms, without_effects
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.objective import cone_start
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt
from tissueid.posterior.linear_priors import FREE_FACTOR, Facts
from tissueid.posterior.loose_noise import LooseNoise
from tissueid.priors import CalibrationPrior, Priors

__all__ = ["INSTRUMENT_NAMES", "SMALLEST_GAIN", "Behind", "inverse"]

FloatArray = NDArray[np.float64]

#: Nuisances that are coordinates, in the order of the kernels.
INSTRUMENT_NAMES = ("skew_s", "force_filter_s", "frame_compliance_mm_per_N")
#: Rounds for theta behind a frame, and the step, in standard deviations squared, that is the last: Newton's
#: next one would be its square, and draws are weighted by the exact density anyway.
TISSUE_ROUNDS = 6
#: Gains below this fraction of the linearised one are taken as it.
SMALLEST_GAIN = 0.05
#: A spread of ln gain below this is none; its square would be lost.
SMALLEST_SPREAD = 1e-5
SETTLED = 0.5
RIDGE = 1e-12
#: Dual tolerance of the passive theta about which is linearised.
NEAR_ENOUGH = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Behind:
    """The tissue of a specimen behind its instrument, as a density.

    Attributes
    ----------
    data : Packed
        With effects linearised where they are likely.
    optimum : Optimum
    facts : Facts
    model : KelvinVoigt
    priors : Priors
    effects : tuple of str
    linear : tuple
        Prior of theta from :func:`tissueid.posterior.specimen_target.linear_prior`.
    count : int
        Samples.
    sigma2 : float
        Noise variance [N^2].
    theta : ndarray, shape (p,)
        At the mode, by powers of u.
    mode : ndarray, shape (d,)
    slope : ndarray, shape (p, d)
        How theta follows the coordinates.
    curvature : ndarray, shape (p + d, p + d)
        Of minus the log density at the mode, in theta and coordinates; without the spread of the gains.
    follow : ndarray, shape (logs, q, p + d)
        How gain and contact offset of each log follow them; empty before the mode is known.
    noise : LooseNoise or None
        Scale and correlation as coordinates; ``None`` holds them.
    """

    data: Packed
    optimum: Optimum
    facts: Facts
    model: KelvinVoigt
    priors: Priors
    effects: tuple[str, ...]
    linear: tuple[FloatArray, FloatArray, NDArray[np.bool_]]
    count: int
    sigma2: float
    theta: FloatArray
    mode: FloatArray
    slope: FloatArray
    curvature: FloatArray
    follow: FloatArray
    noise: LooseNoise | None = None

    @property
    def branches(self) -> int:
        """Relaxation branches."""
        return self.optimum.branches

    @property
    def names(self) -> tuple[str, ...]:
        """Coordinates."""
        spread = ("gain_sd",) if "gain" in self.effects else ()
        noise = () if self.noise is None else self.noise.names
        return (*(f"ln_tau_{j + 1}" for j in range(self.branches)), *INSTRUMENT_NAMES, *spread, *noise)

    @property
    def calibration(self) -> tuple[CalibrationPrior, ...]:
        """Priors of skew, filter and compliance."""
        return tuple(self.priors.calibration[name] for name in INSTRUMENT_NAMES)

    @property
    def cuts(self) -> tuple[FloatArray, FloatArray]:
        """Where each coordinate is cut, lower and upper."""
        low, high = self.facts.log_tau_bounds
        spread = [0.0] if "gain" in self.effects else []
        lower = np.array([low] * self.branches + [one.lower for one in self.calibration] + spread)
        upper = np.full(lower.size, np.inf)
        upper[: self.branches] = high
        if self.noise is None:
            return lower, upper
        first, last = self.noise.cuts(self.priors)
        return np.concatenate([lower, first]), np.concatenate([upper, last])

    @property
    def free(self) -> NDArray[np.bool_]:
        """Coordinates that are not known exactly."""
        out = np.ones(self.mode.size, dtype=np.bool_)
        out[self.branches : self.branches + INSTRUMENT] = [one.sd > 0.0 for one in self.calibration]
        return out

    @property
    def blocks(self) -> NDArray[np.int64]:
        """Sizes of theta's polynomial blocks."""
        size = self.optimum.degree + 1
        static = [STATIC_DEGREE] * bool(self.optimum.static)
        return np.array(static + [size] * self.branches, dtype=np.int64)

    def split(self, point: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Relaxation times (ln), instrument, and the standard deviation of the gains of one point."""
        tau = np.ascontiguousarray(point[: self.branches])
        instrument = np.ascontiguousarray(point[self.branches : self.branches + INSTRUMENT])
        at = self.branches + INSTRUMENT
        return tau, instrument, max(float(point[at]), SMALLEST_SPREAD) if "gain" in self.effects else 1.0

    def noise_of(self, point: FloatArray) -> FloatArray:
        """Ln sigma (and arctanh phi) of one point; empty where they are held."""
        return point[self.branches + INSTRUMENT + ("gain" in self.effects) :]

    def sigma2_of(self, point: FloatArray) -> float:
        """Noise variance at one point [N^2]."""
        return self.sigma2 if self.noise is None else math.exp(2.0 * float(self.noise_of(point)[0]))

    def tissue_prior(self, log_tau: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and precision of theta; a weak branch is known by its largest force."""
        mean, precision, weak = self.linear
        precision = precision.copy()
        size = self.optimum.degree + 1
        for j in np.flatnonzero(weak):
            length = self.facts.speed_mm_s * math.exp(log_tau[j])
            state = float(np.max(-length * np.expm1(-self.facts.depth_mm / length), initial=0.0))
            part = slice(self.optimum.static + j * size, self.optimum.static + (j + 1) * size)
            precision[part, part] *= state * state
        return mean, precision

    def effect_prior(self, gain_sd: float, data: Packed | None = None) -> tuple[FloatArray, FloatArray]:
        """Precision and mean of the effects, counted from where they are linearised; shapes (logs, q)."""
        data = self.data if data is None else data
        logs = data.gamma.size
        precision, mean = [], []
        if "gain" in self.effects:
            precision.append(np.full(logs, gain_sd**-2.0))
            mean.append(-data.gamma)
        if "offset" in self.effects:
            precision.append(self.facts.offset_sd_mm**-2.0)
            mean.append(self.facts.offset_mean_mm - data.delta)
        if "static" in self.effects:
            flat = (FREE_FACTOR * max(self.facts.force_N, 1e-300)) ** -2.0
            precision += [np.full(logs, flat)] * data.own.shape[1]
            mean += list(-data.own.T)
        if not mean:
            return np.zeros((logs, 0)), np.zeros((logs, 0))
        return np.ascontiguousarray(np.array(precision).T), np.ascontiguousarray(np.array(mean).T)

    def log_prior(self, point: FloatArray) -> float:
        """Of the coordinates; -inf outside their range."""
        tau, instrument, gain_sd = self.split(point)
        low, high = self.facts.log_tau_bounds
        if (tau < low).any() or (tau > high).any() or (np.diff(tau) <= 0.0).any():
            return -math.inf
        value = 0.0
        for at, stated in zip(tau, self.priors.relaxation_time_s, strict=False):
            value -= 0.5 * ((at - math.log(stated.median)) / stated.sd_ln) ** 2
        for at, prior in zip(instrument, self.calibration, strict=True):
            if at < prior.lower:
                return -math.inf
            if prior.sd > 0.0:
                value -= 0.5 * ((at - prior.mean) / prior.sd) ** 2
        if "gain" in self.effects:
            if point[self.branches + INSTRUMENT] < 0.0:
                return -math.inf
            value -= 0.5 * (gain_sd / self.priors.gain_sd) ** 2
        if self.noise is not None:
            at = self.noise_of(point)
            first, last = self.noise.cuts(self.priors)
            if (at < first).any() or (at > last).any():
                return -math.inf
            value += self.noise.log_weight(at, self.priors)
        return float(value)

    def _data_at(self, point: FloatArray, theta: FloatArray) -> Packed:
        """The logs with their gains and offsets linearised where they are likely for this theta.

        A gain multiplies theta: where the tissue is stiffer the gains of all logs are less.  To first order
        ``u = back . change``, with the tissue by a factor 1 - u; it is 1/(1 - u) that keeps their product.
        Without this 30 gains of 15 % would move the tissue by 2 %.
        """
        data = self.data if self.noise is None else self.noise.at(self.data, self.noise_of(point))
        if self.follow.size == 0:
            return data
        inner = self.branches + INSTRUMENT
        change = np.concatenate([theta - self.theta, (point - self.mode)[:inner]])
        moved = self.follow @ change
        at = 0
        if "gain" in self.effects:
            data = data._replace(gamma=data.gamma - np.log1p(-np.minimum(moved[:, 0], 1.0 - SMALLEST_GAIN)))
            at = 1
        if "offset" in self.effects:
            data = data._replace(delta=data.delta + moved[:, at])
        return data

    def _normal(
        self, point: FloatArray, theta: FloatArray, kind: int
    ) -> tuple[FloatArray, FloatArray, float]:
        """Curvature, slope and value of the log likelihood, effects integrated."""
        tau, instrument, gain_sd = self.split(point)
        data = self._data_at(point, theta)
        terms = log_terms(data, np.ascontiguousarray(theta), tau, instrument, kind)
        ones = np.ones(data.gamma.size)
        curvature, slope, value, _ = without_effects(
            *terms, ones, *self.effect_prior(gain_sd, data), self.sigma2_of(point)
        )
        return curvature, slope, float(value)

    def log_density(self, point: FloatArray, theta: FloatArray) -> float:
        """Joint log density of coordinates and theta, up to a constant; the passive cut is not looked at."""
        prior = self.log_prior(point)
        if not math.isfinite(prior):
            return -math.inf
        mean, precision = self.tissue_prior(point[: self.branches])
        away = theta - mean
        prior += 0.5 * float(np.linalg.slogdet(precision)[1]) - 0.5 * float(away @ precision @ away)
        value = prior + self._normal(point, theta, EFFECTS)[2]
        return value if math.isfinite(value) else -math.inf

    def conditional(self, point: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance of theta at one point, before it is cut to the passive set.

        Linearised where the cut normal has most of its mass, which may be far from that mean.
        """
        size = self.theta.size
        theta = self._nearest(self.theta + self.slope @ (point - self.mode), self.curvature[:size, :size])
        mean, precision = self.tissue_prior(point[: self.branches])
        rigid = point[self.branches + INSTRUMENT - 1] == 0.0
        for _ in range(TISSUE_ROUNDS):
            curvature, slope, _ = self._normal(point, theta, TISSUE)
            curvature = curvature + precision
            covariance = inverse(curvature)
            centre = theta + covariance @ (slope + precision @ (mean - theta))
            step = self._nearest(centre, curvature) - theta
            if rigid or float(step @ curvature @ step) < SETTLED:
                break
            theta = theta + step
        return centre, covariance

    def _nearest(self, centre: FloatArray, curvature: FloatArray) -> FloatArray:
        """The passive theta nearest to a centre: what is left of its normal lies there."""
        if is_passive(centre, self.blocks):
            return centre
        curvature = np.ascontiguousarray(curvature)
        pull = curvature @ centre
        return cone_least_squares(curvature, pull, self.blocks, cone_start(self.blocks), NEAR_ENOUGH)[0]


def inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a positive definite matrix, scaled first."""
    unit = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * unit * unit[:, None] + RIDGE * np.eye(unit.size)
    return np.asarray(np.linalg.inv(scaled) * unit * unit[:, None])
