"""Likelihood of thresholds that scatter between specimens and from test to test, with censored tests.

In ln threshold, z_ki = m_k + e_ki, m_k ~ N(mu, b^2), e_ki ~ N(0, s^2 + v_ki), v the variance of
measurement. A test that did not rupture says z_ki > c_ki. The specimen's m_k is integrated out: in closed
form where all its tests ruptured, and by Gauss-Hermite quadrature about its normal given the ruptured ones
for the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

__all__ = ["Outcomes", "log_likelihood", "specimen_means"]

FloatArray = NDArray[np.float64]

#: Nodes of the quadrature over a specimen with censored tests.
QUADRATURE = 24
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(QUADRATURE)
_LN_WEIGHTS = np.log(_WEIGHTS / _WEIGHTS.sum())
LN_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes:
    """Outcomes of a cohort under one criterion.

    Attributes
    ----------
    z : ndarray, shape (n,)
        ln threshold that was reached, or a lower bound of it.
    variance : ndarray, shape (n,)
        Of its measurement.
    ruptured : ndarray of bool, shape (n,)
    specimen : ndarray of int, shape (n,)
        0 to the number of specimens - 1.
    """

    z: FloatArray
    variance: FloatArray
    ruptured: NDArray[np.bool_]
    specimen: NDArray[np.intp]

    def by_specimen(self) -> list[Outcomes]:
        """One for each specimen."""
        return [
            Outcomes(self.z[own], self.variance[own], self.ruptured[own], self.specimen[own])
            for own in (self.specimen == k for k in range(int(self.specimen.max()) + 1))
        ]


def _given_ruptured(own: Outcomes, mu: FloatArray, s: FloatArray, b: FloatArray) -> Sequence[FloatArray]:
    """Probability (ln) of the ruptured tests, then mean and variance of m given them."""
    total, precision, centre = np.zeros(np.shape(s)), np.zeros(np.shape(s)), np.zeros(np.shape(s))
    if own.ruptured.any():
        z, v = own.z[own.ruptured], own.variance[own.ruptured]
        weight = 1.0 / (s[..., None] ** 2 + v)
        precision = weight.sum(axis=-1)
        centre = (weight * z).sum(axis=-1) / precision
        far = (weight * (z - centre[..., None]) ** 2).sum(axis=-1)
        spread = b**2 + 1.0 / precision
        total = 0.5 * (np.log(weight).sum(axis=-1) - z.size * LN_2PI - far)
        total = total - 0.5 * (np.log(precision * spread) + (centre - mu) ** 2 / spread)
    variance = b**2 / (1.0 + b**2 * precision)
    return total, variance * precision * centre + mu / (1.0 + b**2 * precision), variance


def log_likelihood(tests: Sequence[Outcomes], mu: FloatArray, s: FloatArray, b: FloatArray) -> FloatArray:
    """Likelihood (ln) of a cohort.

    Parameters
    ----------
    tests : sequence of Outcomes
        One for each specimen.
    mu, s, b : ndarray
        Mean of ln threshold, sd from test to test, sd between specimens; broadcast against each other.

    Returns
    -------
    ndarray
        Of the broadcast shape.
    """
    found = np.zeros(np.broadcast_shapes(mu.shape, s.shape, b.shape))
    for own in tests:
        total, mean, variance = _given_ruptured(own, mu, s, b)
        found = found + total
        if not own.ruptured.all():
            found = found + np.logaddexp.reduce(_censored(own, mean, variance, s), axis=-1)
    return found


def _censored(own: Outcomes, mean: FloatArray, variance: FloatArray, s: FloatArray) -> FloatArray:
    """Weights (ln) of the nodes of m times the probability of the censored tests, a last axis of nodes."""
    nodes = mean[..., None] + np.sqrt(variance)[..., None] * _NODES
    terms = np.broadcast_to(_LN_WEIGHTS, nodes.shape).copy()
    for c, v in zip(own.z[~own.ruptured], own.variance[~own.ruptured], strict=True):
        terms += log_ndtr((nodes - c) / np.sqrt(s**2 + v)[..., None])
    return terms


def specimen_means(tests: Sequence[Outcomes], mu: float, s: float, b: float) -> FloatArray:
    """Mean of each specimen's ln threshold given its tests, shape (specimens,)."""
    at = (np.array(mu), np.array(s), np.array(b))
    found = []
    for own in tests:
        _, mean, variance = _given_ruptured(own, *at)
        if not own.ruptured.all():
            terms = _censored(own, mean, variance, at[1])
            share = np.exp(terms - np.logaddexp.reduce(terms, axis=-1))
            mean = mean + np.sqrt(variance) * (share * _NODES).sum()
        found.append(float(mean))
    return np.array(found)
