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

from tissueid.likelihood.instrument_density import (
    SMALLEST_GAIN,
    SMALLEST_SPREAD,
    Density,
    effect_prior,
    log_likelihood,
    tissue_precision,
)
from tissueid.likelihood.instrument_kernels import INSTRUMENT, Packed
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
RIDGE = 1e-12


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

    def density(self) -> Density:
        """The same for the kernels."""
        noise = self.noise
        few = noise is not None and noise.phi.size > 0
        mean, precision, weak = self.linear
        offset = self.facts.offset_sd_mm if "offset" in self.effects else np.ones(self.data.gamma.size)
        none = np.zeros((0, 0))
        return Density(
            data=self.data,
            sigma2=self.sigma2,
            theta=self.theta,
            mode=self.mode,
            slope=np.ascontiguousarray(self.slope),
            curvature=np.ascontiguousarray(self.curvature),
            follow=np.ascontiguousarray(self.follow) if self.follow.size else np.zeros((0, 0, 0)),
            prior_mean=mean,
            prior_precision=precision,
            weak=weak,
            # columns of a table where there are several ramps: kernels would be compiled once more for them
            speed_mm_s=np.ascontiguousarray(self.facts.speed_mm_s),
            reach_mm=np.ascontiguousarray(self.facts.depth_mm),
            offset_precision=offset**-2.0,
            offset_mean=np.asarray(self.facts.offset_mean_mm, dtype=np.float64),
            free_precision=(FREE_FACTOR * max(self.facts.force_N, 1e-300)) ** -2.0,
            blocks=self.blocks,
            start=cone_start(self.blocks),
            phi=noise.phi if few else np.zeros(0),  # type: ignore[union-attr]
            pulls=noise.pull if few else none,  # type: ignore[union-attr]
            bands=noise.band if few else np.zeros((0, 0, 0)),  # type: ignore[union-attr]
            squares=noise.square if few else none,  # type: ignore[union-attr]
            loose=noise is not None,
        )

    def tissue_prior(self, log_tau: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and precision of theta; a weak branch is known by its largest force."""
        return self.linear[0], tissue_precision(self.density(), log_tau)

    def effect_prior(self, gain_sd: float) -> tuple[FloatArray, FloatArray]:
        """Precision and mean of the effects, counted from where they are linearised; shapes (logs, q)."""
        return effect_prior(self.density(), self.data, gain_sd)

    def log_priors(self, points: FloatArray) -> FloatArray:
        """Of the coordinates of points of shape (n, d); -inf outside their range."""
        tau = points[:, : self.branches]
        low, high = self.facts.log_tau_bounds
        inside = np.asarray(((tau >= low) & (tau <= high)).all(axis=1))
        inside &= (np.diff(tau, axis=1) > 0.0).all(axis=1)
        value = np.zeros(points.shape[0])
        for at, stated in zip(tau.T, self.priors.relaxation_time_s, strict=False):
            value -= 0.5 * ((at - math.log(stated.median)) / stated.sd_ln) ** 2
        for k, prior in enumerate(self.calibration):
            at = points[:, self.branches + k]
            inside &= at >= prior.lower
            if prior.sd > 0.0:
                value -= 0.5 * ((at - prior.mean) / prior.sd) ** 2
        if "gain" in self.effects:
            at = points[:, self.branches + INSTRUMENT]
            inside &= at >= 0.0
            value -= 0.5 * (np.maximum(at, SMALLEST_SPREAD) / self.priors.gain_sd) ** 2
        if self.noise is not None:
            first, last = self.noise.cuts(self.priors)
            for i in np.flatnonzero(inside):
                here = self.noise_of(points[i])
                inside[i] = ((here >= first) & (here <= last)).all()
                if inside[i]:
                    value[i] += self.noise.log_weight(here, self.priors)
        return np.where(inside, value, -math.inf)

    def log_density(self, point: FloatArray, theta: FloatArray) -> float:
        """Joint log density of coordinates and theta, up to a constant; the passive cut is not looked at."""
        prior = float(self.log_priors(point[None])[0])
        if not math.isfinite(prior):
            return -math.inf
        value = prior + log_likelihood(self.density(), point, np.ascontiguousarray(theta))
        return value if math.isfinite(value) else -math.inf


def inverse(matrix: FloatArray) -> FloatArray:
    """Inverse of a positive definite matrix, scaled first."""
    unit = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * unit * unit[:, None] + RIDGE * np.eye(unit.size)
    return np.asarray(np.linalg.inv(scaled) * unit * unit[:, None])
