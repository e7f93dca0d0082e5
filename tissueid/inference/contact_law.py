"""k, n and e of Hertz's law with the damping of Flores, from recordings (:mod:`tissueid.model.impact`).

::

    F = b_i + k (x - d_i)^n (1 + chi r),    r = d' / v0,    chi = 8 (1 - e) / (5 e)

One k, n and chi a specimen; every log i has a contact point d_i and a reading in air b_i of its own, bound by
nothing but the size of its depth and force: a power and a contact point are told apart by the same samples,
and a segmenter that took the power for another has placed the contact elsewhere.  The parameters are found
by Levenberg-Marquardt (lmfit).

The noise of a record has a memory.  Residuals are whitened by an autoregression of their own before the final
fit, and its covariance is the sandwich of Newey & West (1987, doi 10.2307/1913610) on what is left (Andrews &
Monahan 1992, doi 10.2307/2951574), which bears a memory that it misses and a variance that changes along a
record.  Of 100 seeded records with white and AR(1) noise, 50 to 300 independent samples each, 95 % intervals
hold the truth in 87 to 95 %.  They say nothing of a law that is wrong: the NRMSD and the correlation of the
residuals stand beside them.

The floor of v0 that holds while rendering is not applied: a test machine is slower than it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import lmfit
import numpy as np
from numpy.typing import NDArray

from tissueid.inference.autoregression import Autoregression, autoregression, newey_west, whiten
from tissueid.inference.contact_path import ContactLog
from tissueid.inference.metrics import lag_one_correlation, nrmsd
from tissueid.model.impact import LEAST_RESTITUTION, damping_factor, reached_restitution

__all__ = ["ContactLaw", "LawParameter", "fit_contact_law"]

FloatArray = NDArray[np.float64]

#: Bounds of n, those of the contact model.
EXPONENTS = (0.5, 4.0)
MOST_CHI = damping_factor(LEAST_RESTITUTION)
#: Widest 95 % intervals that count as identified: of ln k (as of a relaxation time), of n (half of what tells
#: a flat punch, 1, from a cone, 2), of e.
WIDEST = {"stiffness_N_per_mm_n": 1.0, "exponent": 0.5, "restitution": 0.25}
#: Without samples slower than this share of the speed at contact, k and e are one number, k (1 + chi).
SLOW = 0.5
FEWEST_SLOW = 0.02
NORMAL_95 = 1.959963984540054
#: Flat punch, sphere, cone.
SIMPLE_POWERS = (1.0, 1.5, 2.0)
#: Rounds of residual correlation and fit; the second changes nothing that is printed.
ROUNDS = 2
#: Directions of less than this share of the information are none: rounding is of that size.
NO_INFORMATION = 1e-9
#: Noise below this share of the force is that of arithmetic.
ROUNDING = 1e-9
TOLERANCE = 1e-12
#: A step of the search may overshoot; beyond this no double holds the force.
LARGEST_LN_K = 300.0


@dataclass(frozen=True, slots=True)
class LawParameter:
    """One number of the law.

    Attributes
    ----------
    name, symbol, unit : str
    value, stderr : float or None
        None where it is not identified.
    interval : tuple of float or None
        95 %.
    reason : str or None
        Why it is not identified.
    """

    name: str
    symbol: str
    unit: str
    value: float | None
    stderr: float | None
    interval: tuple[float, float] | None
    reason: str | None


@dataclass(frozen=True, slots=True, eq=False)
class ContactLaw:
    """A fitted law.

    Attributes
    ----------
    parameters : tuple of LawParameter
        k, n, e.
    theta : ndarray, shape (3,)
        k [N/mm^n], n and chi where the fit ended, identified or not.
    loading : float
        k (1 + chi) [N/mm^n]: the stiffness of a contact that goes on as fast as it began.
    returned : float or None
        Speed of a free mass after the contact over that before, which is not e; None with e.
    offsets_mm : ndarray, shape (logs,)
        Of the contact points, against the segmented ones.
    depth_mm : float
        Largest fitted depth.
    nrmsd : float
        Of the range of force.
    correlation : float
        Of neighbouring residuals.
    left_correlation : float
        The same after whitening.
    samples : int
    converged : bool
    """

    parameters: tuple[LawParameter, ...]
    theta: FloatArray
    loading: float
    returned: float | None
    offsets_mm: FloatArray
    depth_mm: float
    nrmsd: float
    correlation: float
    left_correlation: float
    samples: int
    converged: bool

    @property
    def identified(self) -> bool:
        """True if all three are."""
        return all(one.value is not None for one in self.parameters)


def law_force(theta: FloatArray, offset_mm: float, log: ContactLog) -> FloatArray:
    """Force of the law along a log [N]; theta is k, n, chi."""
    depth = np.maximum(log.depth_mm - offset_mm, 0.0)
    return np.asarray(theta[0] * depth ** theta[1] * np.maximum(1.0 + theta[2] * log.ratio, 0.0))


def fit_contact_law(logs: Sequence[ContactLog]) -> ContactLaw:
    """Identify the law behind the recordings of one specimen.

    Parameters
    ----------
    logs : sequence of ContactLog
        At least one.

    Returns
    -------
    ContactLaw

    References
    ----------
    Pires et al., Haptic Positioning Environment for the Hip Resurfacing Surgery, equation (1).
    """
    noise, breaks = _first_noise(logs), _breaks(logs)
    # a contact that the record does not show may be anywhere: from one power alone its search may go astray
    found = min((_searched(start, logs, noise) for start in _starts(logs)), key=lambda one: one.chisqr)
    for round_ in range(1 + ROUNDS):
        if round_:
            found = _searched(found.params, logs, noise)
        raw = _residuals(found.params, logs)
        noise = autoregression(raw, breaks)
        noise = replace(noise, sd=_above_rounding(noise.sd, logs))
    parameters = found.params
    values = np.array([parameters[name].value for name in parameters])
    covariance = _covariance(parameters, logs, noise)
    force = np.concatenate([log.force_N for log in logs])
    theta = _unpacked(parameters)[0]
    restitution = 8.0 / (8.0 + 5.0 * theta[2])
    estimates = _estimates(values[:3], covariance[:3, :3], logs)
    return ContactLaw(
        parameters=estimates,
        theta=theta,
        loading=theta[0] * (1.0 + theta[2]),
        returned=None if estimates[2].value is None else reached_restitution(damping_factor(restitution)),
        offsets_mm=values[3 : 3 + len(logs)],
        depth_mm=max(float(log.depth_mm.max()) for log in logs),
        nrmsd=nrmsd(force, force - raw).range,
        correlation=lag_one_correlation(raw),
        left_correlation=lag_one_correlation(whiten(raw, breaks, noise.phi)),
        samples=int(force.size),
        converged=bool(found.success),
    )


def _searched(
    parameters: lmfit.Parameters, logs: Sequence[ContactLog], noise: Autoregression
) -> lmfit.minimizer.MinimizerResult:
    """The optimum near a start."""
    return lmfit.minimize(
        _whitened, parameters, args=(logs, noise), Dfun=_slopes, ftol=TOLERANCE, xtol=TOLERANCE
    )


def _starts(logs: Sequence[ContactLog]) -> list[lmfit.Parameters]:
    """From the power that a line through ln F over ln depth has, and from those of simple tips."""
    depth = np.maximum(np.concatenate([log.depth_mm for log in logs]), 0.0)
    force = np.concatenate([log.force_N for log in logs])
    ratio = np.concatenate([log.ratio for log in logs])
    known = (force > 0.05 * force.max()) & (depth > 0.0) & (ratio >= 0.0)
    slope, level = 1.5, math.log(max(float(force.max()), 1e-9) / float(depth.max()) ** 1.5)
    if int(known.sum()) > 2 and np.ptp(depth[known]) > 0.0:
        slope, level = np.polyfit(np.log(depth[known]), np.log(force[known]), 1)
    return [
        _start(float(np.clip(n, 0.6, 3.9)), depth, force, ratio, float(level), len(logs))
        for n in (slope, *SIMPLE_POWERS)
    ]


def _start(
    slope: float, depth: FloatArray, force: FloatArray, ratio: FloatArray, level: float, logs: int
) -> lmfit.Parameters:
    """The law of a known power that is nearest to the samples, contact where it was found."""
    power = depth**slope
    # for a known power the law is linear in k and k chi
    (elastic, damped), *_ = np.linalg.lstsq(np.column_stack([power, power * ratio]), force, rcond=None)
    chi = damped / elastic if elastic > 0.0 else 0.0
    parameters = lmfit.Parameters()
    parameters.add("ln_k", math.log(elastic) if elastic > 0.0 else level)
    parameters.add("n", slope, min=EXPONENTS[0], max=EXPONENTS[1])
    # off the bounds, where the coordinates of lmfit have no slope
    parameters.add("chi", float(np.clip(chi, 0.02, 0.9 * MOST_CHI)), min=0.0, max=MOST_CHI)
    for what in ("contact", "air"):
        for number in range(logs):
            parameters.add(f"{what}_{number}", 0.0)
    return parameters


def _unpacked(parameters: lmfit.Parameters) -> tuple[FloatArray, FloatArray, FloatArray]:
    """k, n, chi; contact points; readings in air."""
    values = np.array([one.value for one in parameters.values()])
    contacts, air = values[3:].reshape(2, -1)
    return np.array([math.exp(min(values[0], LARGEST_LN_K)), values[1], values[2]]), contacts, air


def _residuals(parameters: lmfit.Parameters, logs: Sequence[ContactLog]) -> FloatArray:
    """Force less the law, log after log [N]."""
    theta, contacts, air = _unpacked(parameters)
    return np.concatenate(
        [
            log.force_N - reading - law_force(theta, contact, log)
            for log, contact, reading in zip(logs, contacts, air, strict=True)
        ]
    )


def _prior_sd(logs: Sequence[ContactLog]) -> FloatArray:
    """So wide that it only keeps what no sample determines finite."""
    sizes = [log.depth_mm.max() for log in logs], [np.abs(log.force_N).max() for log in logs]
    return np.concatenate(sizes).astype(np.float64)


def _whitened(parameters: lmfit.Parameters, logs: Sequence[ContactLog], noise: Autoregression) -> FloatArray:
    """Whitened residuals over their standard deviation, and contact points and readings over theirs."""
    _, contacts, air = _unpacked(parameters)
    left = whiten(_residuals(parameters, logs), _breaks(logs), noise.phi)
    return np.concatenate([left / noise.sd, np.concatenate([contacts, air]) / _prior_sd(logs)])


def _first_noise(logs: Sequence[ContactLog]) -> Autoregression:
    """White noise of the size of the force's second differences."""
    steps = np.concatenate([np.diff(log.force_N, 2) for log in logs])
    sd = 1.4826 * float(np.median(np.abs(steps - np.median(steps)))) / math.sqrt(6.0)
    return Autoregression(np.zeros(0), _above_rounding(sd, logs))


def _breaks(logs: Sequence[ContactLog]) -> NDArray[np.bool_]:
    return np.concatenate([log.breaks for log in logs])


def _above_rounding(sd: float, logs: Sequence[ContactLog]) -> float:
    return max(sd, ROUNDING * max(float(np.abs(log.force_N).max()) for log in logs))


def _jacobian(parameters: lmfit.Parameters, logs: Sequence[ContactLog]) -> FloatArray:
    """Derivative of the law by ln k, n, chi, contact points and readings, shape (samples, 3 + 2 logs)."""
    theta, contacts, _ = _unpacked(parameters)
    columns = np.zeros((sum(log.depth_mm.size for log in logs), 3 + 2 * len(logs)))
    first = 0
    for number, (log, offset) in enumerate(zip(logs, contacts, strict=True)):
        own = slice(first, first + log.depth_mm.size)
        first = own.stop
        depth = np.maximum(log.depth_mm - offset, 0.0)
        force = law_force(theta, offset, log)
        touching = depth > 0.0
        pushing = 1.0 + theta[2] * log.ratio > 0.0
        columns[own, 0] = force
        columns[own, 1] = force * np.log(depth, out=np.zeros_like(depth), where=touching)
        columns[own, 2] = theta[0] * depth ** theta[1] * log.ratio * pushing
        columns[own, 3 + number] = -force * np.divide(
            theta[1], depth, out=np.zeros_like(depth), where=touching
        )
        columns[own, 3 + len(logs) + number] = 1.0
    return columns


def _slopes(parameters: lmfit.Parameters, logs: Sequence[ContactLog], noise: Autoregression) -> FloatArray:
    """Derivative of :func:`_whitened`."""
    rows = -whiten(_jacobian(parameters, logs), _breaks(logs), noise.phi) / noise.sd
    prior = np.zeros((2 * len(logs), rows.shape[1]))
    prior[:, 3:] = np.diag(1.0 / _prior_sd(logs))
    return np.vstack([rows, prior])


def _covariance(
    parameters: lmfit.Parameters, logs: Sequence[ContactLog], noise: Autoregression
) -> FloatArray:
    """Covariance of ln k, n, chi, contact points, readings; infinite along what no sample determines."""
    rows = whiten(_jacobian(parameters, logs), _breaks(logs), noise.phi) / noise.sd
    left = whiten(_residuals(parameters, logs), _breaks(logs), noise.phi) / noise.sd
    prior = np.zeros(rows.shape[1])
    prior[3:] = _prior_sd(logs) ** -2.0
    information = rows.T @ rows + np.diag(prior)
    size = np.sqrt(np.diag(information))
    size[size == 0.0] = 1.0
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    known = values > NO_INFORMATION * values[-1]
    inverse = (vectors[:, known] / values[known]) @ vectors[:, known].T / np.outer(size, size)
    ends = np.cumsum([log.depth_mm.size for log in logs])[:-1]
    meat = sum(newey_west(own) for own in np.split(rows * left[:, None], ends)) + np.diag(prior)
    # correlated samples count as fewer, and so many parameters were taken from them
    worth = left.size * noise.worth(float(np.var(_residuals(parameters, logs))))
    covariance = inverse @ meat @ inverse * worth / max(worth - prior.size, 1.0)
    lost = (np.abs(vectors[:, ~known]) > 1e-3).any(axis=1)
    covariance[lost, lost] = np.inf
    return np.asarray(covariance)


def _estimates(
    values: FloatArray, covariance: FloatArray, logs: Sequence[ContactLog]
) -> tuple[LawParameter, ...]:
    """k, n and e with intervals, or why there is none."""
    sd = np.sqrt(np.diag(covariance))
    slow = _slow_share(logs)
    k_ends = tuple(math.exp(min(values[0] + side * NORMAL_95 * sd[0], LARGEST_LN_K)) for side in (-1.0, 1.0))
    n_ends = tuple(float(values[1] + side * NORMAL_95 * sd[1]) for side in (-1.0, 1.0))
    e_ends = tuple(
        8.0 / (8.0 + 5.0 * min(max(values[2] + side * NORMAL_95 * sd[2], 0.0), MOST_CHI))
        for side in (1.0, -1.0)
    )
    stiffness = math.exp(min(values[0], LARGEST_LN_K))
    restitution = 8.0 / (8.0 + 5.0 * values[2])
    one_speed = (
        f"{100.0 * slow:.2g} % of the samples are slower than half of the speed at contact: only "
        "k (1 + chi) is determined; record holds or unloading"
    )
    confounded = one_speed if slow < FEWEST_SLOW else None
    found = (
        ("stiffness_N_per_mm_n", "k", "N/mm^n", stiffness, stiffness * sd[0], k_ends,
         2.0 * NORMAL_95 * sd[0], confounded),
        ("exponent", "n", "1", values[1], sd[1], n_ends, n_ends[1] - n_ends[0], _at_bound(values[1])),
        ("restitution", "e", "1", restitution, 0.625 * restitution**2 * sd[2], e_ends, e_ends[1] - e_ends[0],
         confounded),
    )  # fmt: skip
    return tuple(_estimate(*one) for one in found)


def _estimate(
    name: str,
    symbol: str,
    unit: str,
    value: float,
    stderr: float,
    ends: tuple[float, ...],
    width: float,
    reason: str | None,
) -> LawParameter:
    if reason is None and not width <= WIDEST[name]:
        of = "ln k" if symbol == "k" else symbol
        reason = f"the 95 % interval of {of} is {width:.2g} wide, more than {WIDEST[name]:g}"
    if reason is not None:
        return LawParameter(name, symbol, unit, None, None, None, reason)
    return LawParameter(name, symbol, unit, float(value), float(stderr), (ends[0], ends[1]), None)


def _at_bound(exponent: float) -> str | None:
    low, high = EXPONENTS
    near = min(exponent - low, high - exponent) < 1e-3
    return (
        f"it lies at the end of its range, {low:g} to {high:g}: the law does not describe this"
        if near
        else None
    )


def _slow_share(logs: Sequence[ContactLog]) -> float:
    ratio = np.concatenate([log.ratio[log.depth_mm > 0.0] for log in logs])
    return float((ratio < SLOW).mean())
