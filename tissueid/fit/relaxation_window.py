"""The one relaxation time of the publication, and how it follows the length of the hold.

Real tissue relaxes over decades of time: one exponential then finds a relaxation time near the length of the
window it was shown, and two laboratories with two holds publish two numbers.  The one-branch model is fitted
to the whole hold, its first half and its first quarter, and the slope d ln tau / d ln T says which it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tissueid.fit.candidates import Candidate, SpecimenSums, fit_candidate
from tissueid.fit.logs import LogHandle, specimen_sums
from tissueid.fit.search import unbounded_covariance
from tissueid.quantities import RelaxationWindow

__all__ = ["relaxation_window"]

FloatArray = NDArray[np.float64]

#: The hold is cut to these shares of its length.
SHARES = (1.0, 0.5, 0.25)
#: Sampling intervals that the shortest window has at least.
FEWEST_STEPS = 8
#: Samples from which on they are thinned.
THINNED_TO = 50_000
#: Cells of the search at the ends of its range: a relaxation time there is not known.
EDGE = 0.05


def _hold_s(handle: LogHandle) -> float:
    """Length of the longest hold of a log [s]."""
    return max((hold.end_s - hold.start_s for hold in handle.segmentation.of_kind("hold")), default=0.0)


def _cut_sums(
    handles: Sequence[LogHandle], shares: Sequence[float], degree: int, tick: Callable[[str], None]
) -> Iterator[SpecimenSums]:
    """Sums of the logs with their holds cut to each share; a log is loaded for all shares at once."""
    cut = [replace(handle, hold_share=share) for handle in handles for share in shares]
    samples = sum(handle.facts.n_samples for handle in handles)
    sums = specimen_sums(cut, degree, tick, thin=max(1, samples // THINNED_TO), cut=False)
    for index in range(len(shares)):
        own = slice(index, None, len(shares))
        yield replace(
            sums,
            gram=sums.gram[own],
            count=sums.count[own],
            offset_sd_mm=sums.offset_sd_mm[own],
            logs=np.arange(len(handles)),
        )


def _ln_tau(sums: SpecimenSums, candidate: Candidate) -> tuple[float, float] | None:
    """ln of the one relaxation time with its standard error, ``None`` at the ends of the search."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        solution = fit_candidate(sums, candidate)
        found = solution.evaluation
        inverse, _ = unbounded_covariance(found, solution.objective.blocks)
        error = float(np.sqrt(inverse[-1, -1] * solution.noise.sigma2))
    at = float(found.log_tau[0])
    low, high = sums.log_tau_bounds
    if not np.isfinite(error) or not low + EDGE < at < high - EDGE:
        return None
    return at, error


def relaxation_window(
    handles: Sequence[LogHandle], candidate: Candidate, tick: Callable[[str], None]
) -> RelaxationWindow | None:
    """Relaxation time of the one-branch model with the hold cut to T, T/2 and T/4.

    Parameters
    ----------
    handles : sequence of LogHandle
        Logs of one specimen, their contact points as fitted.
    candidate : Candidate
        The model that was chosen: its degree of K and pooling are kept.
    tick : callable
        Told what is being done.

    Returns
    -------
    RelaxationWindow or None
        ``None`` without a hold, where a quarter of it is too short to be fitted, or where the whole of it
        does not determine a relaxation time.
    """
    holds = [length for handle in handles if (length := _hold_s(handle)) > 0.0]
    step = max(handle.facts.step_s for handle in handles)
    if not holds or candidate.branches < 1:
        return None
    length = float(np.median(holds))
    shares = tuple(share for share in SHARES if share * min(holds) >= FEWEST_STEPS * step)
    if len(shares) < 2:
        return None
    tick("relaxation time of shorter windows")
    one = replace(candidate, branches=1)
    found = [_ln_tau(sums, one) for sums in _cut_sums(handles, shares, candidate.degree, tick)]
    known = [(share, *pair) for share, pair in zip(shares, found, strict=True) if pair is not None]
    if found[0] is None or len(known) < 2:
        return None
    cut, ln_tau, error = np.array(known).T
    slope, slope_error = _slope(np.log(cut), ln_tau, error)
    return RelaxationWindow(
        cut_s=tuple((length * cut).tolist()),
        tau_s=tuple(np.exp(ln_tau).tolist()),
        stderr_s=tuple((np.exp(ln_tau) * error).tolist()),
        slope=slope,
        slope_stderr=slope_error,
    )


def _slope(ln_cut: FloatArray, ln_tau: FloatArray, error: FloatArray) -> tuple[float, float]:
    """Slope of the line through the windows, with the error that theirs give it were they independent."""
    weight = ln_cut - ln_cut.mean()
    weight /= weight @ weight
    return float(weight @ ln_tau), float(np.sqrt(weight**2 @ error**2))
