"""The posterior of one specimen over its relaxation times and scales: density, mode, exact redraw.

Built at the joint optimum of the fit (:mod:`tissueid.likelihood.linearise`).  The sampled coordinates are
ln tau of each branch (ascending), ln sigma, arctanh phi where the noise is correlated, and the ln of the
gains' standard deviation where logs are pooled partially.
"""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.linearised import Linearised
from tissueid.likelihood.marginal import conditionals, draw_effects, log_marginals, log_peaks
from tissueid.likelihood.marginal_lanes import FEW, log_marginals_together, log_peaks_together
from tissueid.likelihood.objective import cone_start
from tissueid.likelihood.passive_normal import draw_passive, passive
from tissueid.model.kelvin_voigt import STATIC_DEGREE, KelvinVoigt
from tissueid.posterior.linear_priors import Facts
from tissueid.posterior.surface import Surface
from tissueid.posterior.target import Redrawn
from tissueid.priors import Priors
from tissueid.processors import threads

__all__ = ["LOG_SIGMA_RANGE", "SpecimenTarget"]

FloatArray = NDArray[np.float64]

#: ln of the range of noise that is possible where nothing is stated: twelve decades.
LOG_SIGMA_RANGE = 12.0 * math.log(10.0)
ARCTANH_LIMIT = 12.0
#: Threads that redraw, and points they take at a time.
MAX_WORKERS = 4
PART = 1000
#: A spread of the gains below this is none; far below, its square is lost to rounding.
LEAST_LN_GAIN_SD = math.log(1e-9)


@dataclass(frozen=True, slots=True, eq=False)
class SpecimenTarget:
    """See :class:`tissueid.posterior.target.Target`.

    Attributes
    ----------
    data : Linearised
    optimum : Optimum
    model : KelvinVoigt
    priors : Priors
    facts : Facts
    effects : tuple of str
        Of every log.
    surface : Surface or None
        Smooth part of ln of the passive mass near the posterior (:mod:`tissueid.posterior.mass_surface`);
        ``None`` works the mass out at every point.
    """

    data: Linearised
    optimum: Optimum
    model: KelvinVoigt
    priors: Priors
    facts: Facts
    effects: tuple[str, ...]
    mode: FloatArray = field(default_factory=lambda: np.zeros(0))
    covariance: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    surface: Surface | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Sampled coordinates."""
        names = [f"ln_tau_{j + 1}" for j in range(self.data.branches)]
        names.append("ln_sigma")
        if self.data.has_phi:
            names.append("arctanh_phi")
        if self.data.has_gain:
            names.append("ln_gain_sd")
        return tuple(names)

    def log_prior(self, points: FloatArray) -> FloatArray:
        """Ln of the prior density of the sampled coordinates; -inf outside their range."""
        branches = self.data.branches
        low, high = self.facts.log_tau_bounds
        tau = points[:, :branches]
        nodes = self.data.nodes
        value = np.zeros(points.shape[0])
        inside = np.isfinite(points).all(axis=1) & (np.diff(tau, axis=1) > 0.0).all(axis=1)
        for j in range(branches):
            reach = _reach(nodes[j])
            inside &= (tau[:, j] >= max(low, reach[0])) & (tau[:, j] <= min(high, reach[1]))
            if j < len(self.priors.relaxation_time_s):
                stated = self.priors.relaxation_time_s[j]
                value += _log_normal(tau[:, j], math.log(stated.median), stated.sd_ln)
            else:
                value -= math.log(high - low)
        sigma = points[:, branches]
        if self.priors.sigma_N is None:
            value -= LOG_SIGMA_RANGE
        else:
            value += _log_normal(sigma, math.log(self.priors.sigma_N.median), self.priors.sigma_N.sd_ln)
        at = branches + 1
        if self.data.has_phi:
            first, last = self.priors.phi
            a = points[:, at]
            inside &= (a >= math.atanh(first)) & (a <= (math.atanh(last) if last < 1.0 else ARCTANH_LIMIT))
            # d phi / d a = 1 / cosh(a)^2
            value += -2.0 * np.log(np.cosh(np.clip(a, -ARCTANH_LIMIT, ARCTANH_LIMIT))) - math.log(
                last - first
            )
            at += 1
        if self.data.has_gain:
            inside &= points[:, at] >= LEAST_LN_GAIN_SD
            spread = np.exp(np.clip(points[:, at], -60.0, 60.0)) / self.priors.gain_sd
            value += points[:, at] + 0.5 * math.log(2.0 / math.pi) - math.log(self.priors.gain_sd)
            value -= 0.5 * spread**2
        return np.where(inside, value, -np.inf)

    def log_density(self, points: FloatArray) -> FloatArray:
        """Log posterior density, all constants kept; -inf outside."""
        points = np.ascontiguousarray(np.atleast_2d(points), dtype=np.float64)
        out = self.log_prior(points)
        inside = np.isfinite(out)
        count = int(inside.sum())
        if count:
            some = points[inside]
            if self.surface is None:
                out[inside] += (log_marginals if count < FEW else log_marginals_together)(self.data, some)
            else:
                peaks = log_peaks if count < FEW else log_peaks_together
                out[inside] += peaks(self.data, some, cone_start(self.data.blocks)) + self.surface(some)
        return out

    def redraw(self, points: FloatArray, rng: np.random.Generator) -> Redrawn:
        """Draw theta and the effects of every log for points of shape (n, d)."""
        data = self.data
        points = np.ascontiguousarray(points, dtype=np.float64)
        n, (logs, q) = points.shape[0], data.effect_mean.shape
        normal = rng.standard_normal((n, logs, q))
        with ThreadPoolExecutor(threads(MAX_WORKERS)) as pool:
            parts = [slice(first, first + PART) for first in range(0, n, PART)]
            found = list(pool.map(lambda part: conditionals(data, points[part]), parts))
            mean, covariance = (np.concatenate(one) for one in zip(*found, strict=True))
            theta, acceptance = draw_passive(mean, covariance, data.blocks, rng)
            drawn = pool.map(lambda part: draw_effects(data, points[part], theta[part], normal[part]), parts)
            effects = np.concatenate(list(drawn))
        linear = theta
        gain = np.ones((n, logs))
        offset = np.tile(self.optimum.delta, (n, 1))
        if "gain" in self.effects:
            # a change of all gains together is a change of theta: exactly, and not to first order
            common = effects[:, :, 0].mean(axis=1)
            exact = (theta + common[:, None] * self.optimum.theta) * np.exp(-common)[:, None]
            # at a bound the first order stands: it is passive, and differs by the square of the change
            theta = np.where(passive(exact, data.blocks)[:, None], exact, theta)
            gain = np.exp(self.optimum.gamma + effects[:, :, 0])
        if "offset" in self.effects:
            offset = self.optimum.delta + effects[:, :, q - 1]
        at = data.branches
        phi = np.tanh(points[:, at + 1]) if data.has_phi else np.full(n, data.phi)
        return Redrawn(
            theta=self.in_field_units(theta, points[:, : data.branches]),
            gain=gain,
            offset_mm=offset,
            sigma_N=np.exp(points[:, at]),
            phi=phi,
            linear=linear,
            acceptance=acceptance,
        )

    def in_field_units(self, theta: FloatArray, log_tau: FloatArray) -> FloatArray:
        """Coefficients by powers of u and ln tau -> theta of the contact model, shape (n, p)."""
        scale, size, static = self.optimum.scale, self.optimum.degree + 1, self.optimum.static
        n = theta.shape[0]
        out = np.zeros((n, STATIC_DEGREE + self.optimum.branches * self.model.block))
        if static:
            out[:, :STATIC_DEGREE] = theta[:, :STATIC_DEGREE] * scale ** -np.arange(1.0, STATIC_DEGREE + 1)
        for j in range(self.optimum.branches):
            first = STATIC_DEGREE + j * self.model.block
            block = theta[:, static + j * size : static + (j + 1) * size]
            out[:, first : first + size] = block * scale ** -np.arange(float(size))
            out[:, first + size] = np.exp(log_tau[:, j])
        return out


def _reach(nodes: FloatArray) -> tuple[float, float]:
    """The range that Chebyshev nodes were made for."""
    edge = math.cos(math.pi / (2.0 * nodes.size))
    middle, half = 0.5 * (nodes[0] + nodes[-1]), 0.5 * (nodes[-1] - nodes[0]) / edge
    return middle - half, middle + half


def _log_normal(x: FloatArray, mean: float, sd: float) -> FloatArray:
    return np.asarray(-0.5 * ((x - mean) / sd) ** 2 - math.log(sd) - 0.5 * math.log(2.0 * math.pi))
