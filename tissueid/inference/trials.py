"""The second pass over a log: its residuals in numbers, and the curve to be drawn.

NRMSD is RMSD over the range of the force (default), or over its mean, on a ramp about twice as large.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tissueid.arrays import FloatArray, kept_samples
from tissueid.flags import Flag
from tissueid.inference.window import FittedLog
from tissueid.measured.relaxation import NOISE_FACTOR, RESIDUAL_SHARE
from tissueid.result import Curve, Nrmsd, TrialFit
from tissueid.signal_noise import lag_one_correlation
from tissueid.trial import Segmentation, Trial


def nrmsd(force_N: FloatArray, model_N: FloatArray) -> Nrmsd:
    """NRMSD by range and by mean absolute force, and RMSE [N]."""
    force = np.asarray(force_N)
    rmse = float(np.sqrt(np.mean((force - model_N) ** 2)))
    return over_force(rmse, float(np.ptp(force)), float(np.abs(force).mean()))


def over_force(rmse: float, spread: float, mean: float) -> Nrmsd:
    """RMSE [N] over the range and over the mean of a force; infinite over none unless exact."""

    def over(denominator: float) -> float:
        if denominator > 0.0:
            return rmse / denominator
        return 0.0 if rmse == 0.0 else float("inf")

    return Nrmsd(range=over(spread), mean=over(mean), rmse_N=rmse)


#: Points a kept curve has at most: every sample of 100 s at 100 Hz, seven a pixel of a wide screen.  Of
#: longer logs the extremes of every bin are kept, so peaks and corners stay.
CURVE_POINTS = 10_000
#: Of them, behind the corner of a hold, evenly in the logarithm of the time since.
CORNER_POINTS = 32
#: Correlation of neighbouring residuals from which it is told.
CORRELATED = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Adjustment:
    """Difference of a log from its specimen's tissue."""

    gain: float = 1.0
    contact_offset_mm: float = 0.0  # against the contact point its depths are counted from
    contact_shift_mm: float = 0.0  # how far that contact point was moved since it was segmented
    time_ratio: float = 1.0  # relaxation times over those of the tissue


class ResidualTotals(NamedTuple):
    """Sums over the fitted samples of a log, for the NRMSD of its specimen."""

    squares: float
    force: float
    samples: int
    low: float
    high: float

    @classmethod
    def of(cls, force: FloatArray, model: FloatArray) -> ResidualTotals:
        """Sums of one log."""
        squares, whole = float(((force - model) ** 2).sum()), float(np.abs(force).sum())
        return cls(squares, whole, force.size, float(force.min()), float(force.max()))


def _after_corners(corners: Sequence[tuple[int, int]]) -> set[int]:
    """Samples at geometric distances behind each corner: relaxation is fastest there."""
    keep: set[int] = set()
    for start, stop in corners[: CURVE_POINTS // (3 * CORNER_POINTS)]:
        behind = np.geomspace(1.0, max(stop - start - 1, 1), CORNER_POINTS - 1).round().astype(np.int64)
        keep |= {start, *(start + behind).tolist()}
    return keep


def _left_out(trial: Trial, segmentation: Segmentation, log: FittedLog) -> list[Flag]:
    """Parts of the recording left out of the fit, with reasons."""
    size = int(trial.time_s.size)
    reach = log.first + log.data.time_s.size - int(log.inserted)
    words: list[str] = []
    if reach < size:
        if any(event.kind == "rupture" and event.index < reach for event in segmentation.events):
            since = "the first rupture"
        elif segmentation.phases and reach >= segmentation.phases[-1].stop:
            since = "the part that was asked for"
        else:
            since = "the tool first turned back"
        words.append(f"{size - reach} of {size} samples after {since}")
    cycles = sum(phase.kind == "cycle" for phase in segmentation.phases[: segmentation.test])
    if cycles:
        kept = log.first < segmentation.phases[segmentation.test].start
        how = "their state is carried on" if kept else "the tool had let go"
        words.append(f"{cycles} cycles before the test ({how})")
    if not words:
        return []
    values = {"left_out": size - reach, "cycles": cycles, "n_samples": size}
    return [Flag("unloading_left_out", f"not fitted: {' and '.join(words)}", values)]


def _trial_flags(
    trial: Trial, segmentation: Segmentation, log: FittedLog, *, worst_N: float, share: float, acf: float
) -> tuple[Flag, ...]:
    """Remarks on one trial: of its reader, its segmenter and its residual."""
    flags = [*trial.flags, *segmentation.flags, *_left_out(trial, segmentation, log)]
    if share > RESIDUAL_SHARE and worst_N > NOISE_FACTOR * segmentation.force_noise_N:
        words = f"the largest residual is {100 * share:.1f} % of the force range"
        flags.append(Flag("residual_large", words, {"max_residual_fraction": share}))
    if acf > CORRELATED:
        words = f"neighbouring residuals are correlated ({acf:.2f})"
        flags.append(Flag("residual_correlated", words, {"residual_acf1": acf}))
    return tuple(flags)


def summarise_trial(
    trial: Trial, segmentation: Segmentation, log: FittedLog, *, fitted: FloatArray, adjustment: Adjustment
) -> tuple[TrialFit, ResidualTotals]:
    """Residuals of one trial under its specimen's model, and their sums."""
    data, include = log.data, log.data.include
    force, predicted = data.force_N[include], fitted[include]
    residual = force - predicted
    spread = float(np.ptp(force))
    worst_N = float(np.abs(residual).max())
    share = worst_N / spread if spread > 0.0 else 0.0
    acf = lag_one_correlation(residual)
    first = log.first - int(log.inserted)
    corners = [(phase.start - first, phase.stop - first) for phase in segmentation.of_kind("hold")]
    fixed = {i for i in _after_corners(corners) if 0 <= i < data.force_N.size}
    keep = kept_samples((data.force_N, data.depth_mm), CURVE_POINTS, CURVE_POINTS - len(fixed), fixed)
    told = TrialFit(
        path=trial.source.path,
        sheet=trial.source.sheet,
        nrmsd=nrmsd(force, predicted),
        max_residual_fraction=share,
        residual_acf1=acf,
        gain=adjustment.gain,
        time_ratio=adjustment.time_ratio,
        contact_offset_mm=adjustment.contact_offset_mm + adjustment.contact_shift_mm,
        speed_mm_s=max(log.speeds_mm_s),
        depth_mm=log.depth_mm,
        n_samples=int(include.sum()),
        curve=Curve(
            time_s=data.time_s[keep] - data.time_s[0],
            depth_mm=(data.depth_mm if log.tool_mm is None else log.tool_mm)[keep],
            force_N=data.force_N[keep],
            model_N=fitted[keep],
            fitted=include[keep],
        ),
        flags=_trial_flags(trial, segmentation, log, worst_N=worst_N, share=share, acf=acf),
    )
    return told, ResidualTotals.of(force, predicted)
