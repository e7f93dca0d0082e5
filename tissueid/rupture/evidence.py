"""One criterion against the tests of a cohort: maximum likelihood, interval of the threshold, evidence.

Criteria are compared as densities of what was seen, the depth at which each test broke: the density of the
measure's logarithm times d ln(measure)/d ln(depth). So that no criterion gains by its unit (a depth that
scatters by 5 % is a work that scatters by 20 % in a cubic), priors are those of ln depth: every measure is
divided by its typical growth with depth, and there the mean is flat, the sd from test to test log-uniform,
and that between specimens half-Cauchy.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.stats import f as f_distribution

from tissueid.arrays import FloatArray
from tissueid.rupture.failures import Failure
from tissueid.rupture.likelihood import Outcomes, given_ruptured, log_likelihood, specimen_means

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


@dataclass(frozen=True, slots=True)
class Threshold:
    """Evidence of the tests on one criterion."""

    criterion: str
    median: float  # over specimens and tests, by maximum likelihood
    ci95: tuple[float, float]  # of the median, with the uncertainty of both spreads
    #: Of ln threshold, from test to test and between specimens, by maximum likelihood.
    sd_ln: float
    specimen_sd_ln: float
    ln_evidence: float  # of the depths of rupture
    growth: float  # typical d ln(measure)/d ln(depth)
    #: Change of ln threshold per unit of ln speed that the criterion leaves, 0 where one speed was used.
    trend: float
    trend_p: float | None  # its p value; ``None`` where it can't be told
    specimens: Mapping[str, float]  # median over tests of each specimen


def standardised(failures: Sequence[Failure], criterion: str) -> tuple[Outcomes, float, float]:
    """Outcomes in ln depth: values, typical growth, and ln of the density's factor.

    Returns ln measure over its typical growth; ``growth``: geometric mean over the ruptured tests of d
    ln(measure)/d ln(depth); ``ln_factor``: sum over ruptured tests of ln(growth of the test / typical
    growth).
    """
    measures = [one.measures[criterion] for one in failures]
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


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Points over (s, b, mu) with the ln of their posterior mass."""

    mean: FloatArray
    ln_mass: FloatArray
    best: tuple[float, float, float]

    @property
    def ln_evidence(self) -> float:
        return float(np.logaddexp.reduce(self.ln_mass, axis=None))

    def interval(self) -> tuple[float, float]:
        """Equal-tailed 95 % interval of the mean."""
        order = np.argsort(self.mean, axis=None)
        mass = np.exp(self.ln_mass.ravel()[order] - self.ln_evidence)
        share = np.cumsum(mass) - 0.5 * mass
        low, high = np.interp(INTERVAL, share, self.mean.ravel()[order])
        return float(low), float(high)


def _grid(tests: Outcomes) -> _Grid:
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
    told = given_ruptured(tests, np.zeros((1, 1, 1)), s, np.full((1, 1, 1), FLAT)).mean
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
    best = (float(mean[at]), float(s[at[0], 0, 0]), float(b[0, at[1], 0]))
    return _Grid(mean, ln_mass, best)


def _most_likely(
    tests: Outcomes,
    start: tuple[float, float, float],
    covariate: FloatArray | None = None,
) -> tuple[FloatArray, float]:
    """Maximum likelihood of (mu, ln s, ln b[, slope by a covariate]), and ln likelihood there."""

    def negative(at: FloatArray) -> float:
        s, b = (np.exp(np.clip(at[1:3], np.log(1e-5), np.log(10.0)))).reshape(2, 1)
        moved = tests if covariate is None else tests.shifted(float(at[3]) * covariate)
        return -float(log_likelihood(moved, at[:1], s, b)[0])

    mu, s, b = start
    extra = [] if covariate is None else [0.0]
    first = np.array([mu, np.log(s), np.log(b), *extra])
    step = np.diag([s, 0.3, 0.5, *[0.5 * s for _ in extra]])
    simplex = np.vstack([first, first + step])
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
    speeds = np.log([one.test.speed_mm_s for one in failures])
    speeds = speeds - speeds.mean()
    names = list(dict.fromkeys(one.specimen for one in failures))
    broken = sum(one.ruptured for one in failures)
    left = broken - len(names) - 1
    if left < 1 or all(np.ptp(speeds[tests.specimen == k]) < ONE_SPEED for k in range(len(names))):
        return 0.0, None
    start = (float(at[0]), float(np.exp(at[1])), float(np.exp(at[2])))
    with_slope, higher = _most_likely(tests, start, speeds)
    statistic = left * float(np.expm1(2.0 * max(higher - ln_likelihood, 0.0) / broken))
    return float(with_slope[3]), float(f_distribution.sf(statistic, 1, left))


def threshold_of(failures: Sequence[Failure], criterion: str) -> Threshold:
    """Fit the threshold of one criterion.

    ``failures``: one of them at least ruptured.
    """
    tests, growth, ln_factor = standardised(failures, criterion)
    grid = _grid(tests)
    fitted = _most_likely(tests, grid.best)
    mu, s, b = float(fitted[0][0]), float(np.exp(fitted[0][1])), float(np.exp(fitted[0][2]))
    trend, p = _trend(failures, tests, fitted)
    low, high = grid.interval()
    names = list(dict.fromkeys(one.specimen for one in failures))
    means = specimen_means(tests, mu, s, b)
    return Threshold(
        criterion=criterion,
        median=float(np.exp(growth * mu)),
        ci95=(float(np.exp(growth * low)), float(np.exp(growth * high))),
        sd_ln=growth * s,
        specimen_sd_ln=growth * b,
        ln_evidence=grid.ln_evidence + ln_factor,
        growth=growth,
        trend=growth * trend,
        trend_p=p,
        specimens={name: float(np.exp(growth * m)) for name, m in zip(names, means, strict=True)},
    )
