"""Gains of the force and displacement channels: exact changes of scale, drawn from their priors.

A draw of the tissue behind known channels is that behind drawn ones after a change of scale; what the priors
of tissue and frame say of the scaled values is the weight of the pair of gains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.instrument_density import tissue_precisions
from tissueid.likelihood.instrument_kernels import INSTRUMENT
from tissueid.likelihood.passive_normal import passive
from tissueid.model.kelvin_voigt import STATIC_DEGREE
from tissueid.posterior.common_static import common_static
from tissueid.posterior.instrument import Behind
from tissueid.priors import CalibrationPrior

__all__ = ["CHANNELS", "Gains", "drawn_gains", "scaled_by", "static_of_logs"]

FloatArray = NDArray[np.float64]

#: Nuisances that are gains, force first.
CHANNELS = ("force_gain", "displacement_gain")
#: A channel keeps its sign.
SMALLEST_GAIN = 1e-3


def _log_normal(value: FloatArray, prior: CalibrationPrior) -> FloatArray:
    """Ln density of a prior, up to its constant; -inf below the cut."""
    if prior.sd <= 0.0:
        return np.zeros_like(value)
    density = -0.5 * ((value - prior.mean) / prior.sd) ** 2
    return np.where(value >= prior.lower, density, -np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """Drawn gains of force and displacement, and what they do to coefficients by powers of u."""

    force: FloatArray
    displacement: FloatArray
    static: int
    size: int
    branches: int

    def some(self, rows: NDArray[np.int64]) -> Gains:
        """Those of some of the draws."""
        return replace(self, force=self.force[rows], displacement=self.displacement[rows])

    def powers(self) -> FloatArray:
        """Logarithm of the factor of every coefficient of theta, shape (n, p)."""
        force, displacement = np.log(self.force)[:, None], np.log(self.displacement)[:, None]
        static = np.arange(1.0, self.static + 1)
        branch = np.tile(np.arange(1.0, self.size + 1), self.branches)
        return np.asarray(displacement * np.concatenate([static, branch]) - force)


def drawn_gains(behind: Behind, n: int, rng: np.random.Generator) -> Gains:
    """Gains from their priors, positive; n pairs."""
    force, displacement = (
        np.maximum(prior.mean + prior.sd * rng.standard_normal(n), SMALLEST_GAIN)
        for prior in (behind.priors.calibration[name] for name in CHANNELS)
    )
    return Gains(force, displacement, behind.optimum.static, behind.optimum.degree + 1, behind.branches)


def scaled_by(
    behind: Behind, points: FloatArray, theta: FloatArray, gains: Gains
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Theta and compliance behind the drawn gains, and ln of what their priors say more of them."""
    log_factor = gains.powers()
    scaled = theta * np.exp(log_factor)
    at = behind.branches + INSTRUMENT - 1
    ratio = gains.force / gains.displacement
    compliance = points[:, at] * ratio
    prior = behind.calibration[-1]
    more = _log_normal(compliance, prior) - _log_normal(points[:, at], prior)
    if prior.sd > 0.0:
        more += np.log(ratio)
    # by the prior of theta, which depends on the relaxation times that draws of one point share
    times, which = np.unique(points[:, : behind.branches], axis=0, return_inverse=True)
    precision = tissue_precisions(behind.density(), times)[which]
    before, after = theta - behind.linear[0], scaled - behind.linear[0]
    for sign, off in ((0.5, before), (-0.5, after)):
        more += sign * (off * (precision @ off[:, :, None])[:, :, 0]).sum(axis=1)
    more += log_factor.sum(axis=1)
    more = np.where(passive(scaled, behind.blocks), more, -np.inf)
    return scaled, compliance, more


def _passive_or_scaled(static: FloatArray, scaled: FloatArray) -> FloatArray:
    """Curves behind their gains; the unscaled one where a stretch of depth leaves it not passive."""
    blocks = np.array([STATIC_DEGREE], dtype=np.int64)
    return np.where(passive(scaled, blocks)[:, None], scaled, static)


def static_of_logs(
    behind: Behind,
    points: FloatArray,
    theta: FloatArray,
    source: NDArray[np.int64],
    gains: Gains,
    rng: np.random.Generator,
) -> FloatArray:
    """Static coefficients, in their units, of logs with a curve each: gains divide them as any other."""
    used, which = np.unique(source, return_inverse=True)
    static = common_static(behind, points[used], theta[used], rng)[which]
    powers = np.arange(1.0, STATIC_DEGREE + 1)
    factor = np.outer(np.log(gains.displacement), powers) - np.log(gains.force)[:, None]
    return _passive_or_scaled(static, static * np.exp(factor)) * behind.optimum.scale**-powers
