"""An independent fit of the modified Kelvin-Voigt model: lmfit on the samples, white residuals, other starts.

Relaxation times are searched by their logarithms, gains and contact offsets of the logs of one specimen
beside them, the latter with the prior of their contact points, and of a single log the machine's frame and
skew with theirs (a filter delays as skew does); F_s and K follow by least squares among the curves that are
not negative within the fitted depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import lmfit
import numpy as np
from numpy.typing import NDArray
from real_baselines import RAYS, Log, Paper, cone_weights, deepest, rms
from real_pooled import GAIN, OFFSET_MM, SHAPE, SLOWER, PooledProblem

Array = NDArray[np.float64]

#: Shortest and longest relaxation time of each start, as fractions of the logarithmic range of the samples.
STARTS = ((0.15, 0.9), (0.35, 0.7), (0.05, 0.6), (0.5, 0.95))
#: Starts where there are several logs, which cost a hundred times more.
POOLED_STARTS = 2
#: ln by which a relaxation time may leave that range.
BEYOND = 3.0
#: Squares that span a curve of one log: its lowest point is then off by 1.5 % of the depth at the most.
FINE_RAYS = 33
#: Depth, as a fraction of the fitted one, at which viscosity is quoted.
HALF = 0.5
EVALUATIONS = 800
#: Documented priors of a machine of which nothing is stated: standard deviations of the frame's compliance
#: [mm/N], which is none at least, and of the skew [s]; and the most of them that is searched.
FRAME, SKEW, MOST_SDS = 0.004, 0.002, 30.0


def _add_taus(
    parameters: lmfit.Parameters, logs: Sequence[Log], branches: int, span: tuple[float, float]
) -> None:
    """Relaxation times spread over a span of the range of the samples."""
    step = min(float(np.median(np.diff(log.time_s))) for log in logs)
    low, high = np.log(step), np.log(max(float(np.ptp(log.time_s)) for log in logs))
    places = np.linspace(*span, branches) if branches > 1 else [float(np.mean(span))]
    for j, place in enumerate(places):
        at = low + place * (high - low)
        parameters.add(f"lntau{j}", value=at, min=low - BEYOND, max=high + BEYOND)


def _parameters(
    problem: PooledProblem, span: tuple[float, float], *, contacts: bool, shaped: bool
) -> lmfit.Parameters:
    """Start of a search: relaxation times spread over a span, offsets 0."""
    parameters = lmfit.Parameters()
    _add_taus(parameters, problem.logs, problem.law.branches, span)
    several = len(problem.logs) > 1
    parameters.add("frame", value=0.0 if several else 0.01, min=0.0, max=MOST_SDS, vary=not several)
    parameters.add("skew", value=0.0 if several else 0.01, min=-MOST_SDS, max=MOST_SDS, vary=not several)
    for i, gain in enumerate(problem.gain_start()):
        parameters.add(f"lngain{i}", value=gain if several else 0.0, min=-GAIN, max=GAIN, vary=several)
        parameters.add(f"offset{i}", value=0.0, min=-OFFSET_MM, max=OFFSET_MM, vary=contacts)
        for k, most in enumerate((SLOWER, SHAPE, SHAPE)):
            parameters.add(f"shape{i}_{k}", value=0.0, min=-most, max=most, vary=several and shaped)
    return parameters


def _parts(parameters: lmfit.Parameters, problem: PooledProblem) -> tuple[Array, Array, Array, Array]:
    """Ascending ln tau, ln gains, offsets and shapes."""
    values = parameters.valuesdict()
    count = range(len(problem.logs))
    return (
        np.sort([values[f"lntau{j}"] for j in range(problem.law.branches)]),
        np.array([values[f"lngain{i}"] for i in count]),
        np.array([values[f"offset{i}"] for i in count]),
        np.array([[values[f"shape{i}_{k}"] for k in range(3)] for i in count]),
    )


def _recorded(problem: PooledProblem, parameters: lmfit.Parameters) -> PooledProblem:
    """The problem as the machine recorded it: force late by the skew, depth less what the frame gives."""
    frame, skew = parameters["frame"], parameters["skew"]
    if not (frame.vary or skew.vary):
        return problem
    (log,) = problem.logs
    late = np.interp(log.time_s - SKEW * skew.value, log.time_s, log.depth_mm)
    depth = np.maximum(late - FRAME * frame.value * log.force_N, 0.0)
    return PooledProblem(problem.law, [replace(log, depth_mm=depth)])


def named(law: Paper, weights: Array, ln_tau: Array) -> dict[str, float]:
    """Values by the names of ``identification.json``, branches by ascending relaxation time."""
    static, stiffness = law.coefficients(weights)
    found = {f"static_{k}_N_per_mm{'' if k == 1 else k}": float(static[k - 1]) for k in (1, 2, 3)}
    for j, curve in enumerate(stiffness):
        suffix = "" if j == 0 else f"_b{j + 1}"
        for k, value in enumerate(curve):
            found[f"stiffness_{k}_N_per_mm{'' if k == 0 else k + 1}{suffix}"] = float(value)
        tau = float(np.exp(ln_tau[j]))
        found[f"relaxation_time_s{suffix}"] = tau
        at = float(np.polynomial.polynomial.polyval(HALF * law.depth_mm, curve))
        found[f"viscosity_N_s_per_mm{suffix}"] = tau * at
    return found


def _best(problem: PooledProblem, unit: float, contact_sd: Array | None, *, shaped: bool) -> lmfit.Parameters:
    """Parameters of the best of all starts; contact points are searched if they have a standard deviation."""

    def residual(parameters: lmfit.Parameters) -> Array:
        parts, here = _parts(parameters, problem), _recorded(problem, parameters)
        scaled = here.residual(here.columns(*parts)) / unit
        priors = [parameters["frame"].value, parameters["skew"].value]
        return np.concatenate([scaled, priors, [] if contact_sd is None else parts[2] / contact_sd])

    several = len(problem.logs) > 1
    tried = [
        lmfit.minimize(
            residual,
            _parameters(problem, span, contacts=contact_sd is not None, shaped=shaped),
            method="least_squares",
            calc_covar=False,
            max_nfev=EVALUATIONS,
            diff_step=1e-5,
            x_scale="jac",
        )
        for span in STARTS[: POOLED_STARTS if several else None]
    ]
    return min(tried, key=lambda one: float(one.chisqr)).params


def independent_fit(
    logs: Sequence[Log],
    order: tuple[int, int],
    *,
    sigma_N: float,
    contact_sd_mm: Sequence[float] | None,
    shaped: bool = False,
) -> tuple[dict[str, float], float]:
    """Fit the model of an order (branches, degree of K) to one specimen from other starts, and keep the best.

    ``sigma_N``: standard deviation of the force that the priors of contact offsets are weighed against;
    ``contact_sd_mm``: one a log, contact points are not searched without; ``shaped``: the gain of each of
    several logs is a curve of depth, and each relaxes at its own rate.  Returns values by their names in
    ``identification.json``, and the RMSE over the counted samples [N].
    """
    law = Paper(*order, deepest(logs), rays=RAYS if len(logs) > 1 else FINE_RAYS)
    problem = PooledProblem(law, logs)
    sd = None if contact_sd_mm is None else np.maximum(contact_sd_mm, 1e-9)
    best = _best(problem, max(sigma_N, 1e-300), sd, shaped=shaped)
    parts, problem = _parts(best, problem), _recorded(problem, best)
    columns = problem.columns(*parts)
    weights = cone_weights(columns, problem.force)
    return named(law, weights, parts[0]), rms(problem.residual(columns))
