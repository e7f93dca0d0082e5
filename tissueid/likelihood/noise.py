"""The noise of a specimen's force, estimated from the residuals of its logs: white, AR(1), or both together.

All three are one model, white noise plus AR(1), whose exact Gaussian likelihood is a scalar Kalman filter:
linear in the number of samples, for any steps, gaps and event rows.  The total variance is profiled, so two
numbers are sought at most: the correlation time of the AR(1) part and the white share of the variance.

On equal steps white plus AR(1) is an ARMA(1,1) process, ``r_n = phi r_(n-1) + e_n - theta e_(n-1)``.  Its
theta pre-filters the columns of :func:`~tissueid.likelihood.lag_sums.lag_sums`; what is left is AR(1) noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from tissueid.likelihood.chains import linked_samples
from tissueid.likelihood.lag_kernels import filter_chain
from tissueid.likelihood.sums import LogData

__all__ = [
    "NoiseChain",
    "NoiseEstimate",
    "correlation_times",
    "estimate_noise",
    "moving_average",
    "noise_chain",
    "phi_of",
    "white_part",
]

FloatArray = NDArray[np.float64]

#: Correlation times that are tried, in reference steps: phi from 4e-5 to 0.99999.
SHORTEST, LONGEST = 0.1, 1e5
#: Points of the first search in ln(correlation time); between them the likelihood has no room for a maximum.
GRID = 15
#: White shares of the variance that the first search tries beside each.
SHARES = (0.03, 0.2, 0.5, 0.8, 0.97)
#: Samples the first search looks at; what it finds is refined on all.
SEARCHED = 20_000
#: Steps of the refinement end below this in ln(correlation time) and in the logit of the share, and below
#: this in ln L: a hundredth of what one standard deviation would change.
FINE, FINE_LOG_L = 1e-3, 5e-3
#: First step and most evaluations of the refinement on a part, and of that on all samples: where there is no
#: white part its share has no end to be followed to.
ON_PART, ON_ALL = (0.3, 200), (0.03, 50)
#: Decimals of a step over the reference step: what is beyond them is the rounding of the time stamps, and
#: would keep the filter's gain from settling.
RATIO_DECIMALS = 9
#: White plus AR(1) is tried where this part of all links has the reference step, to which theta belongs.
UNIFORM_SHARE = 0.95
SAME_STEP = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class NoiseChain:
    """Residuals of one log, samples that take part only.

    Attributes
    ----------
    residual_N : ndarray, shape (n,)
    starts : ndarray of bool, shape (n,)
        True where a chain starts.
    ratio : ndarray, shape (n,)
        Step since the sample before over the reference step.
    """

    residual_N: FloatArray
    starts: NDArray[np.bool_]
    ratio: FloatArray


@dataclass(frozen=True, slots=True)
class NoiseEstimate:
    """Noise of maximum likelihood.

    Attributes
    ----------
    model : str
        ``white``, ``ar1`` or ``white+ar1``.
    sigma_N : float
        Standard deviation of the whole noise [N].
    phi : float
        Correlation of the AR(1) part over the reference step; 0 if white.
    moving_average : float
        theta of the ARMA(1,1) process; 0 unless ``white+ar1``.
    white_share : float
        White part of the variance: 1 if white, 0 if ``ar1``.
    log_likelihood : float
    """

    model: str
    sigma_N: float
    phi: float
    moving_average: float
    white_share: float
    log_likelihood: float

    @property
    def sigma_filtered_N(self) -> float:
        """Standard deviation of the AR(1) noise that pre-filtering leaves [N]; else ``sigma_N``."""
        return self.sigma_N * math.sqrt(white_part(self.phi, self.moving_average)[1])


def noise_chain(data: LogData, residual_N: FloatArray, *, reference_step_s: float) -> NoiseChain:
    """The noise of a log, from its residuals.

    Parameters
    ----------
    data : LogData
    residual_N : ndarray, shape (n,)
        Measured less modelled force at every sample of ``data`` [N].
    reference_step_s : float
        Step over which phi is the correlation [s].
    """
    used = data.include
    step = np.diff(data.time_s, prepend=data.time_s[0])
    return NoiseChain(
        residual_N=np.ascontiguousarray(residual_N[used]),
        starts=~linked_samples(data)[used],
        ratio=np.round(step[used] / reference_step_s, RATIO_DECIMALS),
    )


def moving_average(phi: float, white_share: float) -> float:
    """Theta of the ARMA(1,1) process that white noise plus AR(1) is on equal steps.

    ``(1 - phi L) r`` has variance ``c0`` and first autocovariance ``-theta v = -white phi``, where
    ``v (1 + theta^2) = c0``: theta is the smaller root of ``theta + 1/theta = c0 / (white phi)``.

    Parameters
    ----------
    phi : float
        Correlation of the AR(1) part over a step, in [0, 1).
    white_share : float
        White part of the variance.
    """
    lag_one = white_share * phi
    if lag_one <= 0.0:
        return 0.0
    half = ((1.0 - white_share) * (1.0 - phi**2) + white_share * (1.0 + phi**2)) / (2.0 * lag_one)
    return 1.0 / (half + math.sqrt(max(half**2 - 1.0, 0.0)))


def white_part(phi: float, theta: float) -> tuple[float, float]:
    """White share of the variance from phi and theta, and the variance of the AR(1) noise behind the filter.

    The inverse of :func:`moving_average`; the second is in units of the whole variance.

    Raises
    ------
    ValueError
        No white noise plus AR(1) has these: theta must lie in [0, phi).
    """
    if theta == 0.0:
        return 0.0, 1.0
    if not 0.0 < theta < phi < 1.0:
        msg = f"white noise plus AR(1) has 0 <= theta < phi < 1, not theta {theta} and phi {phi}"
        raise ValueError(msg)
    share = (1.0 - phi**2) / (phi * (theta + 1.0 / theta - 2.0 * phi))
    return share, 1.0 / (1.0 - 2.0 * phi * theta + theta**2)


def estimate_noise(
    chains: Sequence[NoiseChain], *, parameters: int = 0, model: str = "auto"
) -> NoiseEstimate:
    """Model and parameters of the noise, by maximum likelihood.

    A richer model is taken where it raises ln L by more than ``ln(N) / 2`` for its parameter (Schwarz 1978,
    doi 10.1214/aos/1176344136).  The price is low on purpose: a phi or a theta that is not there is
    estimated near zero and does no harm, one that is left out makes every interval too narrow.

    Parameters
    ----------
    chains : sequence of NoiseChain
        Of all logs of a specimen.
    parameters : int
        Parameters that were fitted to these residuals: the variance is divided by ``N - parameters``, and
        phi of ``ar1`` is freed of its bias ``-(2 phi + parameters (1 + phi)) / N`` to first order.  For a
        fitted mean that is the result of Marriott and Pope and of Kendall (1954, doi
        10.1093/biomet/41.3-4.390 and 403); for a few smooth regressors it is reconstructed.
    model : str
        ``auto``, or the one to take: ``white``, ``ar1`` or ``white+ar1``; where the samples can't carry it,
        the richest that they can.

    Raises
    ------
    ValueError
        There is no sample more than parameters.
    """
    samples = sum(chain.residual_N.size for chain in chains)
    if samples <= parameters:
        msg = f"{samples} residuals can't tell the noise of a fit with {parameters} parameters"
        raise ValueError(msg)
    found = [_fitted(chains, "white", 0.0, 1.0)]
    if model != "white" and found[0].sigma_N > 0.0 and any(not chain.starts.all() for chain in chains):
        part = _part(chains)
        found.append(_best_ar1(chains, part))
        if model != "ar1" and _uniform(chains):
            found.append(_best_mixture(chains, part))
    if model != "auto":
        return _freed(found[-1], samples, parameters)
    price = 0.5 * math.log(samples)
    chosen = max(enumerate(found), key=lambda pair: pair[1].log_likelihood - price * pair[0])[1]
    return _freed(chosen, samples, parameters)


def _log_likelihood(chains: Sequence[NoiseChain], phi: float, white: float) -> tuple[float, float]:
    """Profile ln L and the variance that reaches it."""
    square = log_det = 0.0
    for chain in chains:
        one, two = filter_chain(chain.residual_N, chain.starts, chain.ratio, phi, white)
        square += one
        log_det += two
    samples = sum(chain.residual_N.size for chain in chains)
    variance = square / samples
    if variance <= 0.0:
        return math.inf, 0.0
    return -0.5 * (samples * (math.log(2.0 * math.pi * variance) + 1.0) + log_det), variance


def _fitted(chains: Sequence[NoiseChain], model: str, phi: float, white: float) -> NoiseEstimate:
    log_likelihood, variance = _log_likelihood(chains, phi, white)
    theta = moving_average(phi, white) if model == "white+ar1" else 0.0
    return NoiseEstimate(model, math.sqrt(variance), phi, theta, white, log_likelihood)


def phi_of(log_time: float) -> float:
    """Correlation over a reference step from ln(correlation time / reference step)."""
    return math.exp(-math.exp(-min(max(log_time, math.log(SHORTEST)), math.log(LONGEST))))


def _share(logit: float) -> float:
    return 1.0 / (1.0 + math.exp(-logit))


def _part(chains: Sequence[NoiseChain]) -> list[NoiseChain]:
    """The head of every chain, together at most :data:`SEARCHED` samples."""
    samples = sum(chain.residual_N.size for chain in chains)
    share = min(SEARCHED / samples, 1.0)
    kept = []
    for chain in chains:
        stop = math.ceil(share * chain.residual_N.size)
        kept.append(NoiseChain(chain.residual_N[:stop], chain.starts[:stop], chain.ratio[:stop]))
    return kept


def _refined(
    chains: Sequence[NoiseChain], part: Sequence[NoiseChain], start: list[float], white: float | None
) -> list[float]:
    """Maximise on a part, from the best point of the search, and then on all samples."""
    at = np.array(start)
    for some, (reach, most) in ((part, ON_PART), (chains, ON_ALL)):

        def minus(at: FloatArray, some: Sequence[NoiseChain] = some) -> float:
            share = _share(float(at[1])) if white is None else white
            return -_log_likelihood(some, phi_of(float(at[0])), share)[0]

        simplex = at + np.vstack([np.zeros(at.size), reach * np.eye(at.size)])
        options: Any = {"initial_simplex": simplex, "xatol": FINE, "fatol": FINE_LOG_L, "maxfev": most}
        at = np.array(minimize(minus, at, method="Nelder-Mead", options=options).x, dtype=np.float64)
    return [float(value) for value in at]


def correlation_times() -> list[float]:
    """Points of the search in ln(correlation time / reference step)."""
    return [float(at) for at in np.linspace(math.log(SHORTEST), math.log(LONGEST), GRID)]


def _best_ar1(chains: Sequence[NoiseChain], part: Sequence[NoiseChain]) -> NoiseEstimate:
    start = max(correlation_times(), key=lambda at: _log_likelihood(part, phi_of(at), 0.0)[0])
    return _fitted(chains, "ar1", phi_of(_refined(chains, part, [start], 0.0)[0]), 0.0)


def _best_mixture(chains: Sequence[NoiseChain], part: Sequence[NoiseChain]) -> NoiseEstimate:
    points = [(at, share) for at in correlation_times() for share in SHARES]
    time, share = max(points, key=lambda at: _log_likelihood(part, phi_of(at[0]), at[1])[0])
    time, logit = _refined(chains, part, [time, math.log(share / (1.0 - share))], None)
    return _fitted(chains, "white+ar1", phi_of(time), _share(logit))


def _uniform(chains: Sequence[NoiseChain]) -> bool:
    """Whether nearly all links have the reference step."""
    ratio = np.concatenate([chain.ratio[~chain.starts] for chain in chains])
    return bool(np.mean(np.abs(ratio - 1.0) <= SAME_STEP) >= UNIFORM_SHARE)


def _freed(found: NoiseEstimate, samples: int, parameters: int) -> NoiseEstimate:
    """Without the bias that fitted parameters leave."""
    if parameters == 0:
        return found
    innovation = found.sigma_N**2 * samples / (samples - parameters)
    if found.model != "ar1":
        return replace(found, sigma_N=math.sqrt(innovation))
    phi = (found.phi + parameters / samples) / (1.0 - (2.0 + parameters) / samples)
    phi = min(phi, phi_of(math.log(LONGEST)))
    innovation *= (1.0 - found.phi**2) / (1.0 - phi**2)
    return replace(found, sigma_N=math.sqrt(innovation), phi=phi)
