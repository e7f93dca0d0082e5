"""The Bayesian bootstrap over logs: what the scatter between whole logs says of the uncertainty.

Each replicate weighs the logs with a draw of a flat Dirichlet distribution (Rubin 1981, doi
10.1214/aos/1176345338) and fits them again: log by log, so that whatever makes one log differ from the
next, correlated noise or a wrong model or another site, is counted without being named.  With n logs the
weights scatter a little less than resampled ones, and n is small: deviations are stretched by
``sqrt((n + 1) / (n - 1))`` and by Student's t over the normal.

Replicates are refitted on knots from the optimum, by Gauss and Newton's steps, relaxation times included.
The instrument is held: this is a check of the statistical interval.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from tissueid.likelihood.knots import KnotSums, packed
from tissueid.likelihood.linearise import Optimum
from tissueid.likelihood.reweighted import refits
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.posterior.budget import reported, reported_names
from tissueid.posterior.calibration import SMALLEST_GAIN_SD, field_units
from tissueid.posterior.instrument import INSTRUMENT_NAMES, Behind
from tissueid.posterior.instrument_mode import instrument_mode
from tissueid.posterior.linear_priors import Facts
from tissueid.priors import CalibrationPrior, Priors
from tissueid.uncertainty import BudgetRow

__all__ = ["CLUSTER", "MIN_LOGS", "ClusterBootstrap", "cluster_bootstrap", "refitted"]

FloatArray = NDArray[np.float64]

CLUSTER = "cluster bootstrap"
#: Fewer logs than this say nothing about their scatter.
MIN_LOGS = 5
REPLICATES = 400
NORMAL_975 = 1.959963984540054


@dataclass(frozen=True, slots=True, eq=False)
class ClusterBootstrap:
    """Spread of the reported parameters over reweighted logs.

    Attributes
    ----------
    names : tuple of str
    sd : ndarray, shape (r,)
    ci95 : ndarray, shape (r, 2)
    rows : tuple of BudgetRow
        One a parameter, without a share.
    """

    names: tuple[str, ...]
    sd: FloatArray
    ci95: FloatArray
    rows: tuple[BudgetRow, ...]


def refitted(behind: Behind, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Theta by powers of u and ln tau of replicates, started at the mode, the instrument as it is there.

    Parameters
    ----------
    behind : Behind
    weights : ndarray, shape (n, logs)

    Returns
    -------
    theta : ndarray, shape (n, p)
    log_tau : ndarray, shape (n, branches)
    """
    _, instrument, gain_sd = behind.split(behind.mode)
    mean, precision = np.zeros((2, behind.branches))
    for j, stated in enumerate(behind.priors.relaxation_time_s[: behind.branches]):
        mean[j], precision[j] = math.log(stated.median), stated.sd_ln**-2.0
    bounds = (float(behind.facts.log_tau_bounds[0]), float(behind.facts.log_tau_bounds[1]))
    weights = np.ascontiguousarray(weights, dtype=np.float64)
    theta, log_tau = refits(behind.density(), weights, (instrument, gain_sd), (mean, precision), bounds)
    return theta, log_tau


def cluster_bootstrap(
    knots: Sequence[KnotSums],
    optimum: Optimum,
    facts: Facts,
    model: KelvinVoigt,
    priors: Priors,
    *,
    effects: tuple[str, ...],
    gain_sd: float,
    seed: int,
    replicates: int = REPLICATES,
) -> ClusterBootstrap | None:
    """Refit a specimen with random weights of its logs.

    Parameters
    ----------
    knots, optimum, facts, model, priors, effects, gain_sd
        As in :func:`tissueid.posterior.calibration.total_posterior`.
    seed : int
    replicates : int

    Returns
    -------
    ClusterBootstrap or None
        ``None`` for fewer than :data:`MIN_LOGS` logs.
    """
    n = len(knots)
    if n < MIN_LOGS:
        return None
    known = {name: CalibrationPrior(0.0, 0.0) for name in INSTRUMENT_NAMES}
    behind = instrument_mode(
        packed(knots, optimum, effects),
        optimum,
        facts,
        model,
        replace(priors, calibration={**priors.calibration, **known}),
        effects,
        count=sum(one.count for one in knots),
        gain_sd=max(gain_sd, SMALLEST_GAIN_SD),
    )
    weights = n * np.random.default_rng(seed).dirichlet(np.ones(n), replicates)
    draws = reported(model, field_units(behind, *refitted(behind, weights)))
    log_tau = behind.mode[: behind.branches]
    centre = reported(model, field_units(behind, behind.theta[None], log_tau[None]))[0]
    wider = math.sqrt((n + 1.0) / (n - 1.0))
    sd = wider * draws.std(axis=0, ddof=1)
    ends = np.quantile(draws, [0.025, 0.975], axis=0)
    stretch = wider * float(student.ppf(0.975, n - 1)) / NORMAL_975
    ci95 = (centre + stretch * (ends - centre)).T
    names = reported_names(model)
    rows = tuple(BudgetRow(name, CLUSTER, float(one), None) for name, one in zip(names, sd, strict=True))
    return ClusterBootstrap(names=names, sd=sd, ci95=np.asarray(ci95), rows=rows)
