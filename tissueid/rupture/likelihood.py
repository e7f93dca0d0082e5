"""Likelihood of thresholds that scatter between specimens and from test to test, with censored tests.

In ln threshold, z_ki = m_k + e_ki, m_k ~ N(mu, b^2), e_ki ~ N(0, s^2 + v_ki), v the variance of measurement.
A test that did not rupture says z_ki > c_ki.  The specimen's m_k is integrated out: in closed form where all
its tests ruptured, and by Gauss-Hermite quadrature about its normal given the ruptured ones for the others.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from tissueid.arrays import FloatArray

#: Nodes of the quadrature over a specimen with censored tests.
QUADRATURE = 24
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(QUADRATURE)
_LN_WEIGHTS = np.log(_WEIGHTS / _WEIGHTS.sum())
LN_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class Outcomes:
    """Tests of a cohort under one criterion."""

    z: FloatArray  # (n,), ln threshold that was reached, or a lower bound of it
    variance: FloatArray  # (n,), of its measurement
    ruptured: NDArray[np.bool_]  # (n,)
    specimen: NDArray[np.intp]  # (n,), 0 to the number of specimens - 1

    def shifted(self, by: FloatArray) -> Outcomes:
        """The same less something of each test, shape (n,)."""
        return replace(self, z=self.z - by)

    def membership(self) -> FloatArray:
        """1 where a ruptured test is of a specimen, shape (ruptured tests, specimens)."""
        own = self.specimen[self.ruptured]
        return np.asarray((own[:, None] == np.arange(int(self.specimen.max()) + 1)).astype(np.float64))


@dataclass(frozen=True, slots=True, eq=False)
class Given:
    """Specimens given their ruptured tests; a last axis of specimens."""

    ln_probability: FloatArray  # of those tests
    #: Of m_k.
    mean: FloatArray
    variance: FloatArray


def given_ruptured(tests: Outcomes, mu: FloatArray, s: FloatArray, b: FloatArray) -> Given:
    """Log likelihood of the ruptured tests of each specimen.

    ``mu``, ``s``, ``b``: broadcast against each other.
    """
    member = tests.membership()
    z, v = tests.z[tests.ruptured], tests.variance[tests.ruptured]
    weight = 1.0 / (s[..., None] ** 2 + v)
    precision = weight @ member
    # a specimen without a rupture has no centre, and no weight anywhere below
    some = np.maximum(precision, np.finfo(float).tiny)
    centre = (weight * z) @ member / some
    far = (weight * (z - centre @ member.T) ** 2) @ member
    mu, between = mu[..., None], b[..., None] ** 2
    shrunk = 1.0 + between * precision
    ln = 0.5 * ((np.log(weight) - LN_2PI) @ member - far)
    ln = ln - 0.5 * (np.log(shrunk) + precision * (centre - mu) ** 2 / shrunk)
    return Given(ln, (between * precision * centre + mu) / shrunk, between / shrunk)


def log_likelihood(tests: Outcomes, mu: FloatArray, s: FloatArray, b: FloatArray) -> FloatArray:
    """Likelihood (ln) of a cohort.

    ``mu``, ``s``, ``b``: mean of ln threshold, sd from test to test, sd between specimens; broadcast against
    each other.  Returns of the broadcast shape.
    """
    given = given_ruptured(tests, mu, s, b)
    found = given.ln_probability.sum(axis=-1)
    for k in np.unique(tests.specimen[~tests.ruptured]):
        found = found + np.logaddexp.reduce(_censored(tests, given, k, s), axis=-1)
    return np.asarray(found)


def _censored(tests: Outcomes, given: Given, k: int, s: FloatArray) -> FloatArray:
    """Weights (ln) of the nodes of m_k times the probability of its censored tests, a last axis of nodes."""
    nodes = given.mean[..., k, None] + np.sqrt(given.variance[..., k, None]) * _NODES
    terms = np.broadcast_to(_LN_WEIGHTS, nodes.shape)
    own = ~tests.ruptured & (tests.specimen == k)
    for c, v in zip(tests.z[own], tests.variance[own], strict=True):
        terms = terms + log_ndtr((nodes - c) / np.sqrt(s**2 + v)[..., None])
    return np.asarray(terms)


def specimen_means(tests: Outcomes, mu: float, s: float, b: float) -> FloatArray:
    """Mean of each specimen's ln threshold given its tests, shape (specimens,)."""
    at = (np.array(mu), np.array(s), np.array(b))
    given = given_ruptured(tests, *at)
    found = np.array(given.mean, dtype=np.float64)
    for k in np.unique(tests.specimen[~tests.ruptured]):
        terms = _censored(tests, given, k, at[1])
        share = np.exp(terms - np.logaddexp.reduce(terms, axis=-1))
        found[k] += np.sqrt(given.variance[k]) * (share * _NODES).sum()
    return found
