"""Posteriors whose moments and quantiles are known, as samplers see them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import integrate, optimize, stats

FloatArray = NDArray[np.float64]


@dataclass(eq=False)
class Plain:
    """A density over d coordinates; what is integrated in a specimen is no part of it."""

    mode: FloatArray
    covariance: FloatArray

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"x{k}" for k in range(len(self.mode)))

    def log_density(self, points: FloatArray) -> FloatArray:
        raise NotImplementedError

    def redraw(self, points: FloatArray, rng: np.random.Generator) -> Any:
        raise NotImplementedError

    def moments(self) -> tuple[FloatArray, FloatArray]:
        """Means and standard deviations."""
        raise NotImplementedError

    def quantile(self, coordinate: int, probability: float) -> float:
        raise NotImplementedError


class Normal(Plain):
    """Correlated normal with scales from 0.01 to 1."""

    def __init__(self, size: int, correlation: float = 0.95) -> None:
        scale = np.logspace(-2.0, 0.0, size)
        matrix = correlation * np.ones((size, size)) + (1.0 - correlation) * np.eye(size)
        super().__init__(np.linspace(-1.0, 3.0, size), matrix * np.outer(scale, scale))
        self.precision = np.linalg.inv(self.covariance)

    def log_density(self, points: FloatArray) -> FloatArray:
        apart = points - self.mode
        return -0.5 * np.einsum("ni,ij,nj->n", apart, self.precision, apart)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        return self.mode, np.sqrt(np.diag(self.covariance))

    def quantile(self, coordinate: int, probability: float) -> float:
        mean, sd = self.moments()
        return float(stats.norm.ppf(probability, mean[coordinate], sd[coordinate]))


class Banana(Plain):
    """x0 normal, x1 normal around bend (x0^2 - 1)."""

    def __init__(self, bend: float = 0.5) -> None:
        super().__init__(np.array([0.0, -bend]), np.eye(2))
        self.bend = bend

    def log_density(self, points: FloatArray) -> FloatArray:
        straight = points[:, 1] - self.bend * (points[:, 0] ** 2 - 1.0)
        return -0.5 * (points[:, 0] ** 2 + straight**2)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        # the variance of a chi-square with one degree of freedom is 2
        return np.zeros(2), np.array([1.0, np.sqrt(1.0 + 2.0 * self.bend**2)])

    def quantile(self, coordinate: int, probability: float) -> float:
        if coordinate == 0:
            return float(stats.norm.ppf(probability))

        def below(bound: float) -> float:
            value, _ = integrate.quad(
                lambda x: stats.norm.pdf(x) * stats.norm.cdf(bound - self.bend * (x * x - 1.0)), -9.0, 9.0
            )
            return float(value)

        return float(optimize.brentq(lambda bound: below(bound) - probability, -9.0, 40.0))


class AtBound(Plain):
    """x0 exponential, so that the mode is at the bound 0; x1 normal around x0."""

    def __init__(self) -> None:
        super().__init__(np.zeros(2), np.array([[1.0, 1.0], [1.0, 2.0]]))

    def log_density(self, points: FloatArray) -> FloatArray:
        inside = points[:, 0] >= 0.0
        return np.where(inside, -points[:, 0] - 0.5 * (points[:, 1] - points[:, 0]) ** 2, -np.inf)

    def moments(self) -> tuple[FloatArray, FloatArray]:
        return np.ones(2), np.array([1.0, np.sqrt(2.0)])

    def quantile(self, coordinate: int, probability: float) -> float:
        if coordinate == 0:
            return float(stats.expon.ppf(probability))
        return float(stats.exponnorm.ppf(probability, 1.0))


class LogSpread(Plain):
    """x0 is ln s of a half-normal s, skewed to the left for ever; x1 standard normal."""

    def __init__(self) -> None:
        super().__init__(np.zeros(2), np.diag([0.5, 1.0]))

    def log_density(self, points: FloatArray) -> FloatArray:
        with np.errstate(over="ignore"):
            return points[:, 0] - 0.5 * np.exp(2.0 * points[:, 0]) - 0.5 * points[:, 1] ** 2

    def moments(self) -> tuple[FloatArray, FloatArray]:
        # s^2 / 2 has a Gamma(1/2) distribution: ln s = (ln 2 + ln Gamma(1/2)) / 2, by digamma and trigamma
        mean = 0.5 * (np.log(2.0) - np.euler_gamma - 2.0 * np.log(2.0))
        return np.array([mean, 0.0]), np.array([0.5 * np.pi / np.sqrt(2.0), 1.0])

    def quantile(self, coordinate: int, probability: float) -> float:
        if coordinate == 1:
            return float(stats.norm.ppf(probability))
        return float(np.log(stats.halfnorm.ppf(probability)))


class Holed(Plain):
    """Standard normal without the disc of radius 1 around (1.5, 0); undefined where x1 < -3."""

    def __init__(self) -> None:
        super().__init__(np.zeros(2), np.eye(2))

    def log_density(self, points: FloatArray) -> FloatArray:
        values = -0.5 * np.einsum("ni,ni->n", points, points)
        values[np.hypot(points[:, 0] - 1.5, points[:, 1]) < 1.0] = -np.inf
        values[points[:, 1] < -3.0] = np.nan
        return values

    def moments(self) -> tuple[FloatArray, FloatArray]:
        def weighted(power: int) -> float:
            def strip(x: float) -> float:
                half = np.sqrt(max(0.0, 1.0 - (x - 1.5) ** 2))
                mass = 1.0 - stats.norm.cdf(-3.0) - (stats.norm.cdf(half) - stats.norm.cdf(-half))
                return float(x**power * stats.norm.pdf(x) * mass)

            return float(integrate.quad(strip, -9.0, 9.0, points=(0.5, 2.5), limit=200)[0])

        mass, first, second = (weighted(power) for power in range(3))
        mean = first / mass
        return np.array([mean]), np.array([np.sqrt(second / mass - mean**2)])
