"""Where the sampled density of a specimen comes from: its fit, its logs, its priors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.logs import LogHandle
from tissueid.fit.specimen import FittedSpecimen
from tissueid.fit.whitening import Whitened
from tissueid.likelihood.linearise import Optimum
from tissueid.posterior.building import specimen_target
from tissueid.posterior.linear_priors import Facts
from tissueid.posterior.specimen_target import SpecimenTarget
from tissueid.priors import Priors

__all__ = ["posterior_target", "target_at"]

FloatArray = NDArray[np.float64]

#: First guess of the standard deviation of the ln of the gains' spread, times the root of the logs.
GAIN_GUESS = 0.8
#: Nearest a start may be to an end of its prior, as a fraction of the range.
EDGE = 0.02


def _facts(
    whitened: Whitened, optimum: Optimum, handles: Sequence[LogHandle], *, force_N: float, offsets: bool
) -> Facts:
    """What the priors need to know of the logs."""
    speeds = [
        (speed, one.facts.depth_mm) for one in handles for speed in one.facts.speeds_mm_s if speed > 0.0
    ]
    sd = np.array([one.contact_sd_mm for one in handles])
    floor = whitened.sums.offset_sd_mm[: len(handles)]
    return Facts(
        force_N=force_N,
        speed_mm_s=np.array([speed for speed, _ in speeds] or [1.0]),
        depth_mm=np.array([depth for _, depth in speeds] or [optimum.scale]),
        log_tau_bounds=whitened.sums.log_tau_bounds,
        offset_sd_mm=np.maximum(sd, floor) if offsets else np.zeros(len(handles)),
        offset_mean_mm=np.array([-one.contact_shift_mm for one in handles]),
    )


def posterior_target(fitted: FittedSpecimen, priors: Priors) -> SpecimenTarget:
    """The density that is sampled for a fitted specimen.

    Parameters
    ----------
    fitted : FittedSpecimen
    priors : Priors
    """
    return target_at(
        fitted.whitened,
        fitted.optimum,
        fitted.handles,
        priors,
        log_tau_sd=np.array([interval.width for interval in fitted.tissue.intervals]) / 4.0,
        force_N=max(float(np.abs(trial.curve.force_N).max()) for trial in fitted.told.trials),
    )


def target_at(
    whitened: Whitened,
    optimum: Optimum,
    handles: Sequence[LogHandle],
    priors: Priors,
    *,
    log_tau_sd: FloatArray,
    force_N: float,
) -> SpecimenTarget:
    """The density that is sampled at an optimum.

    Parameters
    ----------
    whitened : Whitened
    optimum : Optimum
    handles : sequence of LogHandle
    priors : Priors
    log_tau_sd : ndarray, shape (branches,)
        First guess of the standard deviation of each ln tau.
    force_N : float
        Largest measured force.
    """
    solution = whitened.solution
    pooling = solution.candidate.pooling
    correlated = whitened.noise.model != "white"
    count = sum(one.count for one in whitened.lags)
    sigma2, phi = solution.noise.sigma2, whitened.noise.phi
    start = [*solution.evaluation.log_tau, 0.5 * np.log(sigma2)]
    sd = [*np.clip(log_tau_sd, 1e-5, 1.5), 1.0 / np.sqrt(2.0 * count)]
    if correlated:
        # an estimate outside its stated prior is no place to start from
        low, high = priors.phi
        edge = EDGE * (high - low) if high < 1.0 else 1e-9
        phi = float(np.clip(phi, low + edge, high - edge))
        start.append(np.arctanh(phi))
        sd.append(1.0 / np.sqrt(count * max(1.0 - phi * phi, 1e-6)))
    if pooling == "partial":
        start.append(np.log(max(solution.noise.gain_sd, 1e-4)))
        sd.append(GAIN_GUESS / np.sqrt(len(handles)))
    single = len(handles) == 1 and pooling == "shared"
    offsets = pooling == "partial" or single
    return specimen_target(
        whitened.lags,
        whitened.sums.basis,
        optimum,
        centred=whitened.centred,
        facts=_facts(whitened, optimum, handles, force_N=force_N, offsets=offsets),
        priors=priors,
        pooling=pooling,
        correlated=correlated,
        start=np.array(start),
        start_sd=np.array(sd),
    )
