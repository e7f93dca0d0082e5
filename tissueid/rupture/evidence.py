"""One criterion against the tests of a cohort: maximum likelihood, interval of the threshold, evidence.

Densities are of the depth at which each test broke, so that no criterion gains by its unit: every measure
is divided by its typical growth with depth; there the mean is flat, the sd from test to test log-uniform,
that between specimens half-Cauchy.  In ln threshold, z_ki = m_k + e_ki, m_k ~ N(mu, b^2), e_ki ~ N(0, s^2 +
v_ki), v the variance of measurement; a test that did not rupture says z_ki > c_ki.  m_k is integrated out,
where tests are censored by Gauss-Hermite quadrature about its normal given the ruptured ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import log_ndtr
from scipy.stats import f as f_distribution

from tissueid.arrays import FloatArray
from tissueid.documents.rupture import Criterion, Threshold, Unit
from tissueid.documents.rupture import Test as Failure
from tissueid.rupture_law import THRESHOLD_UNITS

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

    def membership(self) -> FloatArray:
        """1 where a ruptured test is of a specimen, shape (ruptured tests, specimens)."""
        own = self.specimen[self.ruptured]
        return np.asarray((own[:, None] == np.arange(int(self.specimen.max()) + 1)).astype(np.float64))


def given_ruptured(
    tests: Outcomes, mu: FloatArray, s: FloatArray, b: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Log likelihood of each specimen's ruptured tests, and mean and variance of m_k given them."""
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
    return ln, (between * precision * centre + mu) / shrunk, between / shrunk


def log_likelihood(tests: Outcomes, mu: FloatArray, s: FloatArray, b: FloatArray) -> FloatArray:
    """Likelihood (ln) of a cohort."""
    ln, mean, variance = given_ruptured(tests, mu, s, b)
    found = ln.sum(axis=-1)
    for k in np.unique(tests.specimen[~tests.ruptured]):
        found = found + np.logaddexp.reduce(_censored(tests, mean, variance, k, s), axis=-1)
    return np.asarray(found)


def _censored(tests: Outcomes, mean: FloatArray, variance: FloatArray, k: int, s: FloatArray) -> FloatArray:
    """Weights (ln) of the nodes of m_k times the probability of its censored tests, a last axis of nodes."""
    nodes = mean[..., k, None] + np.sqrt(variance[..., k, None]) * _NODES
    terms = np.broadcast_to(_LN_WEIGHTS, nodes.shape)
    own = ~tests.ruptured & (tests.specimen == k)
    for c, v in zip(tests.z[own], tests.variance[own], strict=True):
        terms = terms + log_ndtr((nodes - c) / np.sqrt(s**2 + v)[..., None])
    return np.asarray(terms)


def specimen_means(tests: Outcomes, mu: float, s: float, b: float) -> FloatArray:
    """Mean of each specimen's ln threshold given its tests, shape (specimens,)."""
    sd = np.array(s)
    _, mean, variance = given_ruptured(tests, np.array(mu), sd, np.array(b))
    found = np.array(mean, dtype=np.float64)
    for k in np.unique(tests.specimen[~tests.ruptured]):
        terms = _censored(tests, mean, variance, k, sd)
        share = np.exp(terms - np.logaddexp.reduce(terms, axis=-1))
        found[k] += np.sqrt(variance[k]) * (share * _NODES).sum()
    return found


#: Ends of the log-uniform prior of the sd from test to test, in ln depth.
TEST_SD = (0.002, 1.0)
#: Scale of the half-Cauchy prior of the sd between specimens, in ln depth.
SPECIMEN_SD_SCALE = 0.1
#: Ends of the grid of the sd between specimens: below the first it is none, in ln depth.
SPECIMEN_SD = (1e-4, 3.0)
#: Points of the grids: 40 instead of 28 move ln evidence by less than 0.01.
TEST_POINTS, SPECIMEN_POINTS = 28, 28
#: Nodes over the mean, about its normal given the ruptured tests, widened by this for the censored ones.
MEAN_POINTS, MEAN_WIDER = 25, 1.5
#: The optimum is settled to this in ln depth, and in ln likelihood.
MEAN_SETTLED, LIKELIHOOD_SETTLED = 1e-4, 1e-6
MOST_STEPS = 600
#: An sd between specimens that draws no specimen toward the others.
FLAT = 1e6
#: Speeds of a specimen that differ by less than this in ln are one.
ONE_SPEED = 0.05
INTERVAL = (0.025, 0.975)


def standardised(failures: Sequence[Failure], criterion: str) -> tuple[Outcomes, float, float]:
    """Outcomes in ln depth, typical growth of the measure, and ln of the density's factor."""
    measures = [getattr(one.measures, criterion.replace("-", "_")) for one in failures]
    ruptured = np.array([one.ruptured for one in failures])
    ln_growth = np.log([one.growth for one in measures])
    typical = float(np.exp(ln_growth[ruptured].mean()))
    names = list(dict.fromkeys(one.specimen for one in failures))
    tests = Outcomes(
        z=np.log([one.value for one in measures]) / typical,
        variance=(np.array([one.sd_ln for one in measures]) / typical) ** 2,
        ruptured=ruptured,
        specimen=np.array([names.index(one.specimen) for one in failures]),
    )
    return tests, typical, float((ln_growth[ruptured] - np.log(typical)).sum())


def _on_a_grid(tests: Outcomes) -> tuple[FloatArray, FloatArray, float]:
    """Likeliest (mu, ln s, ln b), ends of the equal-tailed 95 % interval of the mean, and ln evidence."""
    s = np.geomspace(*TEST_SD, TEST_POINTS)[:, None, None]
    b = np.geomspace(*SPECIMEN_SD, SPECIMEN_POINTS)[None, :, None]
    ln_prior = (
        -np.log(TEST_POINTS)
        + np.log(2.0 / np.pi / SPECIMEN_SD_SCALE / (1.0 + (b / SPECIMEN_SD_SCALE) ** 2))
        + np.log(b)
        + np.log(np.log(SPECIMEN_SD[1] / SPECIMEN_SD[0]) / (SPECIMEN_POINTS - 1))
    )
    # the mean's own normal given the ruptured tests: a flat start, specimens weighed by what they know
    weight = (1.0 / (s[..., None] ** 2 + tests.variance[tests.ruptured])) @ tests.membership()
    told = given_ruptured(tests, np.zeros((1, 1, 1)), s, np.full((1, 1, 1), FLAT))[1]
    joint = weight / (1.0 + b[..., None] ** 2 * weight)
    precision = joint.sum(axis=-1)
    centre = (joint * told).sum(axis=-1) / precision
    nodes, weights = np.polynomial.hermite_e.hermegauss(MEAN_POINTS)
    width = MEAN_WIDER / np.sqrt(precision)
    mean = centre + width * nodes
    # the integral over the mean: Gauss-Hermite, its own weight taken out
    ln_step = np.log(weights) + 0.5 * nodes**2 + np.log(width)
    ln_likelihood = log_likelihood(tests, mean, s, b)
    ln_mass = ln_likelihood + ln_prior + ln_step
    at = np.unravel_index(int(np.argmax(ln_likelihood)), ln_mass.shape)
    best = np.array([mean[at], np.log(s[at[0], 0, 0]), np.log(b[0, at[1], 0])])
    ln_evidence = float(np.logaddexp.reduce(ln_mass, axis=None))
    order = np.argsort(mean, axis=None)
    mass = np.exp(ln_mass.ravel()[order] - ln_evidence)
    return best, np.interp(INTERVAL, np.cumsum(mass) - 0.5 * mass, mean.ravel()[order]), ln_evidence


def _most_likely(
    tests: Outcomes, start: FloatArray, covariate: FloatArray | None = None
) -> tuple[FloatArray, float]:
    """Maximum likelihood of (mu, ln s, ln b[, slope by a covariate]), and ln likelihood there."""

    def negative(at: FloatArray) -> float:
        s, b = (np.exp(np.clip(at[1:3], np.log(1e-5), np.log(10.0)))).reshape(2, 1)
        moved = tests if covariate is None else replace(tests, z=tests.z - float(at[3]) * covariate)
        return -float(log_likelihood(moved, at[:1], s, b)[0])

    s = float(np.exp(start[1]))
    steps = [s, 0.3, 0.5] if covariate is None else [s, 0.3, 0.5, 0.5 * s]
    first = np.append(start, np.zeros(len(steps) - start.size))
    simplex = np.vstack([first, first + np.diag(steps)])
    found = minimize(
        negative,
        first,
        method="Nelder-Mead",
        options={
            "initial_simplex": simplex,
            "xatol": MEAN_SETTLED,
            "fatol": LIKELIHOOD_SETTLED,
            "maxiter": MOST_STEPS,
        },
    )
    return np.asarray(found.x), -float(found.fun)


def _trend(
    failures: Sequence[Failure], tests: Outcomes, fitted: tuple[FloatArray, float]
) -> tuple[float, float | None]:
    """Slope by ln speed that is left in ln depth, and its p value.

    The ratio of likelihoods is read as an F statistic with the degrees of freedom that specimens leave: of
    18 tests of 6 specimens chi-squared would be exceeded four times too often at 1 %.
    """
    at, ln_likelihood = fitted
    speeds = np.log([one.speed_mm_s for one in failures])
    speeds = speeds - speeds.mean()
    specimens = int(tests.specimen.max()) + 1
    broken = sum(one.ruptured for one in failures)
    left = broken - specimens - 1
    if left < 1 or all(np.ptp(speeds[tests.specimen == k]) < ONE_SPEED for k in range(specimens)):
        return 0.0, None
    with_slope, higher = _most_likely(tests, at, speeds)
    statistic = left * float(np.expm1(2.0 * max(higher - ln_likelihood, 0.0) / broken))
    return float(with_slope[3]), float(f_distribution.sf(statistic, 1, left))


def threshold_of(failures: Sequence[Failure], criterion: str) -> Threshold:
    """Fit the threshold of one criterion."""
    tests, growth, ln_factor = standardised(failures, criterion)
    best, ends, ln_evidence = _on_a_grid(tests)
    fitted = _most_likely(tests, best)
    mu, s, b = (float(value) for value in (fitted[0][0], *np.exp(fitted[0][1:])))
    trend, p = _trend(failures, tests, fitted)
    low, high = np.exp(growth * ends).tolist()
    names = list(dict.fromkeys(one.specimen for one in failures))
    means = specimen_means(tests, mu, s, b)
    return Threshold(
        criterion=cast("Criterion", criterion),
        unit=cast("Unit", THRESHOLD_UNITS[criterion]),
        median=float(np.exp(growth * mu)),
        ci95=(low, high),
        sd_ln=growth * s,
        specimen_sd_ln=growth * b,
        ln_evidence=ln_evidence + ln_factor,
        growth=growth,
        trend=growth * trend,
        trend_p=p,
        specimens={name: float(np.exp(growth * m)) for name, m in zip(names, means, strict=True)},
    )
