"""The noise of a specimen, sums that know it, and the fit under it.

A first fit takes the noise as white.  Its residuals tell whether neighbouring samples are correlated; one
more pass over the logs then sums the residuals at that optimum for every correlation at once
(:mod:`tissueid.likelihood.lag_sums`), and the fit is finished under the whitened sums: generalised least
squares, with standard errors, profile intervals and verdicts under the noise that there is.

Where the recordings refute that noise (:mod:`tissueid.fit.noise_evidence`), the weights stay white.  The sums
of a single log are then tempered: all but the sum of squares at the optimum is divided by the number of
samples that one independent sample stands for (:mod:`tissueid.fit.discrepancy`), so that value, standard
errors, profile intervals and posterior are of these same sums.  Draws of several logs are stretched instead
(:mod:`tissueid.posterior.stretched`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Solution, SpecimenSums, refit
from tissueid.fit.discrepancy import samples_per_independent
from tissueid.fit.logs import MAX_WORKERS, LogHandle
from tissueid.fit.noise_evidence import (
    FEWEST,
    MOST,
    QuietStretch,
    quiet_stretches,
    verdict_on_noise,
)
from tissueid.fit.residual_blocks import OWN_POWERS, residual_blocks
from tissueid.fit.trials import Adjustment, model_force
from tissueid.likelihood.basis import KernelBasis
from tissueid.likelihood.lag_sums import LagSums, lag_sums
from tissueid.likelihood.linearise import Optimum, centre
from tissueid.likelihood.noise import NoiseChain, NoiseEstimate, estimate_noise, noise_chain
from tissueid.likelihood.sums import N_STATIC
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.processors import threads
from tissueid.signal_noise import quantum, white_noise_sd
from tissueid.uncertainty import NoiseFit

__all__ = ["Whitened", "for_all_degrees", "optimum_of", "whiten"]

FloatArray = NDArray[np.float64]

#: Correlation below which the noise counts as white.
NO_CORRELATION = 1e-3
#: Effects of a log that is pooled partially.
GAIN_AND_OFFSET = 2


@dataclass(frozen=True, slots=True, eq=False)
class Whitened:
    """A specimen under its noise.

    Attributes
    ----------
    noise : NoiseFit
    lags : tuple of LagSums
        One a log, centred at ``centred``; for the chosen degree of K where nothing but the posterior needs
        them (:func:`for_all_degrees`).
    centred : Optimum
        Whose residuals stand in the sums: that of the first fit.
    sums : SpecimenSums
        Whitened at the estimated correlation, where there is one.
    solution : Solution
        The fit under them.
    tempering : float
        Samples that one counts for in these sums.
    """

    noise: NoiseFit
    lags: tuple[LagSums, ...]
    centred: Optimum
    sums: SpecimenSums
    solution: Solution
    tempering: float = 1.0


def optimum_of(solution: Solution, adjustments: Sequence[Adjustment], scale: float) -> Optimum:
    """Where a specimen is linearised: its solution, and how each log differs from it."""
    own = np.zeros((len(adjustments), N_STATIC))
    for i, one in enumerate(adjustments):
        if one.static is not None:
            own[i] = one.static
    return Optimum(
        theta=solution.evaluation.theta,
        log_tau=solution.evaluation.log_tau,
        gamma=np.log([one.gain for one in adjustments]),
        delta=np.array([one.contact_offset_mm for one in adjustments]),
        own=own,
        scale=scale,
        degree=solution.candidate.degree,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Residuals:
    """Residuals of all logs under the first fit: as chains of noise, and what is quiet in them."""

    chains: list[NoiseChain]
    quiet: list[QuietStretch]
    differences_N: list[float]
    quantum_N: float


def _residuals(
    handles: Sequence[LogHandle],
    model: KelvinVoigt,
    theta: FloatArray,
    adjustments: Sequence[Adjustment],
    step_s: float,
) -> _Residuals:
    """One pass over the logs."""
    found = _Residuals([], [], [], 0.0)
    quanta = []
    for handle, adjustment in zip(handles, adjustments, strict=True):
        trial, log = handle.fitted()
        residual = log.data.force_N - model_force(model, theta, log, adjustment)
        found.chains.append(noise_chain(log.data, residual, reference_step_s=step_s))
        most = max(MOST // len(handles), FEWEST)
        found.quiet.extend(
            quiet_stretches(trial, handle.segmentation, log, residual, step_s=step_s, most=most)
        )
        used = log.data.include
        found.differences_N.append(white_noise_sd(log.data.time_s[used], log.data.force_N[used]))
        quanta.append(quantum(trial.force_N))
    return replace(found, quantum_N=float(np.median(quanta)))


def _worth(
    handles: Sequence[LogHandle],
    model: KelvinVoigt,
    theta: FloatArray,
    adjustments: Sequence[Adjustment],
    sigma_N: float,
) -> float:
    """Samples that one independent sample stands for, where the model misses more than the noise."""
    blocks = []
    for handle, adjustment in zip(handles, adjustments, strict=True):
        _, log = handle.fitted()
        fitted = model_force(model, theta, log, adjustment)
        blocks.append(residual_blocks(handle.segmentation, log, model, theta, adjustment, fitted))
    own = 0 if len(handles) == 1 else OWN_POWERS if adjustments[0].static is not None else GAIN_AND_OFFSET
    return samples_per_independent(blocks, sigma_N, own=own)


def _sums_of_lags(
    handles: Sequence[LogHandle],
    basis: KernelBasis,
    degree: int,
    step_s: float,
    centred: Optimum,
    noise: NoiseEstimate | NoiseFit,
) -> tuple[LagSums, ...]:
    """One pass over the logs; loaded one after the other, summed in threads."""
    running: deque[Future[LagSums]] = deque()
    out: list[LagSums] = []
    workers = threads(min(len(handles), MAX_WORKERS))
    with ThreadPoolExecutor(workers) as pool:
        for i, handle in enumerate(handles):
            _, log = handle.fitted()
            running.append(
                pool.submit(
                    lag_sums,
                    log.data,
                    basis,
                    degree=degree,
                    reference_step_s=step_s,
                    center=centre(basis, degree, centred, i),
                    moving_average=noise.moving_average,
                    phi=noise.phi,
                )
            )
            while len(running) > workers:
                out.append(running.popleft().result())
        out += [one.result() for one in running]
    return tuple(out)


def _with_force(gram: FloatArray, weights: FloatArray) -> FloatArray:
    """The same Gram matrix with the force in the last column, not the residual that was centred."""
    to = np.eye(gram.shape[0])
    to[:-1, -1] = weights
    return np.asarray(to.T @ gram @ to)


def _whitened_sums(sums: SpecimenSums, lags: Sequence[LagSums], phi: float, centred: Optimum) -> SpecimenSums:
    """Sums of the logs under noise of one correlation, the force in the last column."""
    gram = [
        _with_force(one.whitened(phi)[0], centre(sums.basis, one.degree, centred, i))
        for i, one in enumerate(lags)
    ]
    return replace(
        sums,
        gram=np.stack(gram),
        count=np.array([one.count for one in lags], dtype=np.int64),
        offset_sd_mm=sums.offset_sd_mm[: len(lags)],
        single=False,
        logs=np.arange(len(lags)),
    )


def whiten(
    handles: Sequence[LogHandle],
    sums: SpecimenSums,
    solution: Solution,
    model: KelvinVoigt,
    theta: FloatArray,
    adjustments: Sequence[Adjustment],
    tick: Callable[[str], None],
    *,
    noise: str = "auto",
) -> Whitened:
    """Estimate the noise, sum the logs for it, and finish the fit under it.

    Parameters
    ----------
    handles : sequence of LogHandle
    sums, solution
        The fit under white noise.
    model, theta
        Its tissue in the units of the field.
    adjustments : sequence of Adjustment
        One a log.
    tick : callable
    noise : str
        ``auto``, ``white``, ``ar1`` or ``white+ar1``.

    Returns
    -------
    Whitened
    """
    tick("noise")
    step = sums.step_s
    left = _residuals(handles, model, theta, adjustments, step)
    samples = sum(chain.residual_N.size for chain in left.chains)
    # more parameters than half the residuals leave no noise to look at
    parameters = min(solution.candidate.n_parameters, samples // 2)
    found: NoiseEstimate = estimate_noise(left.chains, parameters=parameters, model=noise)
    worth, measured = 1.0, None
    if noise == "auto":
        verdict = verdict_on_noise(
            found,
            left.quiet,
            left.differences_N,
            quantum_N=left.quantum_N,
            samples=samples,
            alone=len(handles) == 1 and bool(handles[0].segmentation.phases),
        )
        measured = verdict.measured_N
        if verdict.refuted:
            found = estimate_noise(left.chains, parameters=parameters, model="white")
            worth = _worth(handles, model, theta, adjustments, found.sigma_N)
    # of several logs the spread between them stretches the draws; their own effects are known as they are
    tempering = worth if len(handles) == 1 else 1.0
    centred = optimum_of(solution, adjustments, sums.depth_mm)
    known = found.phi > NO_CORRELATION or tempering > 1.0
    tick("sums for correlated noise")
    degree = sums.columns_degree if known else solution.candidate.degree
    lags = _sums_of_lags(handles, sums.basis, degree, step, centred, found)
    lags = tuple(one.tempered(tempering) for one in lags)
    if known:
        sums = _whitened_sums(sums, lags, found.phi, centred)
        solution = refit(sums, solution)
    return Whitened(
        noise=NoiseFit(
            model=found.model,
            sigma_N=found.sigma_N,
            phi=found.phi,
            reference_step_s=step,
            moving_average=found.moving_average,
            measured_N=measured,
            samples_per_independent=worth,
        ),
        lags=lags,
        centred=centred,
        sums=sums,
        solution=solution,
        tempering=tempering,
    )


def for_all_degrees(whitened: Whitened, handles: Sequence[LogHandle]) -> Whitened:
    """The same with sums of every degree of K that was looked at: one more pass, where they are not there.

    Parameters
    ----------
    whitened : Whitened
    handles : sequence of LogHandle
        Those of :func:`whiten`.
    """
    sums, noise = whitened.sums, whitened.noise
    if whitened.lags[0].degree == sums.columns_degree:
        return whitened
    lags = _sums_of_lags(
        handles, sums.basis, sums.columns_degree, noise.reference_step_s, whitened.centred, noise
    )
    return replace(whitened, lags=tuple(one.tempered(whitened.tempering) for one in lags))
