"""When a chain is long enough, and which part of it counts.

The integrated autocorrelation time tau of each coordinate follows Sokal (1997, *Monte Carlo Methods in
Statistical Mechanics*, equations 3.16-3.19): the sum of the autocorrelation up to five times itself.  It is
estimated from all walkers at once, around their common mean: around the mean of each walker it comes out
too small for chains of a few tau, which is where it matters.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissueid.posterior.diagnostics import Diagnostics

__all__ = ["LEAST_TAUS", "R_HAT_BOUND", "Memory", "memory_of", "next_look", "shortfalls"]

FloatArray = NDArray[np.float64]

#: A chain shorter than this many tau says little about tau itself (emcee's rule).
LEAST_TAUS = 50.0

#: Above it the walkers do not agree (Vehtari et al. 2021).
R_HAT_BOUND = 1.01

#: Steps that are dropped at the start, in tau: exp(-10) of where the walkers came from is left.
_BURN_IN_TAUS = 10.0

#: Every so many tau one step is kept: closer ones repeat each other.
_THIN_TAUS = 0.5

#: However long the memory, so many steps are kept: diagnostics need some.
_LEAST_KEPT = 16

#: The window of the sum, in tau (Sokal: bias against noise).
_WINDOW_TAUS = 5.0

#: tau of the last half and of the whole chain agree within this, or within the noise of the two estimates:
#: three standard errors, or chance alone would keep a good chain running.
_STABLE = 0.01
_STABLE_ERRORS = 3.0

#: A chain is looked at when it has grown by this factor.
_GROWTH = 1.15

#: No chain is looked at before.
_FIRST_LOOK = 64


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """How long a chain remembers.

    Attributes
    ----------
    tau : ndarray, shape (d,)
        Integrated autocorrelation time [steps] after the burn-in.
    tau_half : ndarray, shape (d,)
        The same of the last half of the chain.
    tolerance : ndarray, shape (d,)
        How far the two may be apart.
    burn_in, thin : int
        Steps to drop, and the distance of kept steps.
    """

    tau: FloatArray
    tau_half: FloatArray
    tolerance: FloatArray
    burn_in: int
    thin: int


def next_look(steps: int, first: int, last: int) -> int:
    """Steps at the look after the one at ``steps`` (0 before the first), up to ``last``."""
    return min(last, max(first, _FIRST_LOOK, math.ceil(_GROWTH * steps)))


def memory_of(chain: FloatArray) -> Memory:
    """Estimate the memory of a chain of shape (steps, walkers, d)."""
    steps, walkers, _ = chain.shape
    half = chain[steps // 2 :]
    tau_half, window = _integrated_time(half)
    burn_in = min(math.ceil(_BURN_IN_TAUS * tau_half.max()), steps // 2)
    kept = chain[burn_in:]
    tau, _ = _integrated_time(kept)
    # variance of an estimate from n samples: 2 (2 window + 1) / n of its square (Sokal, equation 3.19); that
    # of the difference to an estimate from a part of them is the difference of the two variances
    spare = 1.0 / len(half) - 1.0 / len(kept)
    noise = np.sqrt(2.0 * (2.0 * window + 1.0) / walkers * spare)
    tolerance = np.maximum(_STABLE, _STABLE_ERRORS * noise) * tau
    thin = max(1, min(int(_THIN_TAUS * tau.max()), len(kept) // _LEAST_KEPT))
    return Memory(tau, tau_half, tolerance, burn_in, thin)


def shortfalls(
    memory: Memory,
    kept_steps: int,
    walkers: int,
    draws: int,
    diagnostics: Mapping[str, Diagnostics] | None,
    names: Sequence[str],
) -> tuple[str, ...]:
    """Say what a chain still lacks; nothing for a chain that has converged.

    Parameters
    ----------
    memory : Memory
    kept_steps : int
        After the burn-in, before thinning.
    walkers : int
    draws : int
        Effective draws asked for.
    diagnostics : mapping or None
        Of the kept draws by coordinate; ``None`` for a first, cheap answer.
    names : sequence of str
        Of the coordinates.

    Returns
    -------
    tuple of str
        Plain sentences with their numbers.
    """
    lacking = []
    slowest = int(np.argmax(memory.tau))
    tau = float(memory.tau[slowest])
    if kept_steps < LEAST_TAUS * tau:
        lacking.append(
            f"{kept_steps} steps are less than {LEAST_TAUS:.0f} autocorrelation times of {names[slowest]} "
            f"({tau:.1f} steps)"
        )
    drift = np.abs(memory.tau_half - memory.tau) - memory.tolerance
    if drift.max() > 0.0:
        worst = int(np.argmax(drift / memory.tau))
        lacking.append(
            f"the autocorrelation time of {names[worst]} has not settled: {memory.tau_half[worst]:.1f} steps "
            f"in the last half, {memory.tau[worst]:.1f} in all"
        )
    if diagnostics is None:
        effective = kept_steps * walkers / tau
        return (*lacking, *([f"{effective:.0f} of {draws} effective draws"] if effective < draws else []))
    for name, one in diagnostics.items():
        if one.r_hat >= R_HAT_BOUND:
            lacking.append(f"R-hat of {name} is {one.r_hat:.3f}, not below {R_HAT_BOUND}")
        if min(one.ess_bulk, one.ess_tail) < draws:
            lacking.append(
                f"{name} has {one.ess_bulk:.0f} effective draws in the bulk and {one.ess_tail:.0f} in the "
                f"tails of {draws} asked for"
            )
    return tuple(lacking)


def _integrated_time(chain: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Autocorrelation time and its window [steps] of each coordinate; one that never moved has no end."""
    from scipy.fft import irfft, next_fast_len, rfft

    steps = len(chain)
    centred = (chain - chain.mean(axis=(0, 1))).transpose(2, 1, 0)
    padded = next_fast_len(2 * steps, real=True)
    power = np.abs(rfft(centred, padded, axis=-1)) ** 2
    covariance = irfft(power.mean(axis=1), padded, axis=-1)[:, :steps] / np.arange(steps, 0, -1)
    moved = covariance[:, 0] > 0.0
    covariance[~moved] = 1.0
    sums = 2.0 * np.cumsum(covariance / covariance[:, :1], axis=-1) - 1.0
    closed = np.arange(steps) >= _WINDOW_TAUS * sums
    window = np.where(closed.any(axis=-1), closed.argmax(axis=-1), steps - 1)
    return np.maximum(sums[np.arange(len(sums)), window], 1.0 / steps), window.astype(np.float64)
