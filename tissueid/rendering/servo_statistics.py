"""Punctuality of a servo: the figures that every log carries, and when timing counts as degraded."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from tissueid.arrays import IntArray
from tissueid.rendering.servo_loop import BIN_NS, LATE_SHARE

#: Share of late ticks above which a session is labelled (haptics.md 1).
DEGRADED_SHARE = 0.01
_US = 1e-3


@dataclass(frozen=True, slots=True)
class PeriodStatistics:
    """Absolute period errors of a session."""

    #: Ticks run, and deadlines skipped.
    ticks: int
    missed: int
    period_us: float
    #: Of |measured period - period|; quantiles to 1 us.
    median_us: float
    p99_us: float
    p999_us: float
    max_us: float
    late_share: float  # share of ticks off by more than a tenth of the period; a skipped tick counts as one
    scheduling: str  # scheduling class the servo really had

    @property
    def degraded(self) -> bool:
        """True where the session is labelled "timing degraded"."""
        return self.late_share > DEGRADED_SHARE

    @property
    def label(self) -> str:
        """Label in console, viewer and log: "timing degraded" or "timing good"."""
        return "timing degraded" if self.degraded else "timing good"

    def as_dict(self) -> dict[str, Any]:
        """The figures for a log, with the label."""
        return {**asdict(self), "label": self.label}


def period_statistics(histogram: IntArray, missed: int, period_ns: int, scheduling: str) -> PeriodStatistics:
    """Figures from a loop's histogram.

    ``histogram`` (BINS + 1,): as :func:`tissueid.rendering.servo_loop.realtime_loop` filled it; ``missed``:
    deadlines skipped.
    """
    counts = histogram[:-1]
    total = int(counts.sum())
    passed = np.cumsum(counts)

    def quantile(share: float) -> float:
        """Lower end of the bin that holds this share [us]."""
        return float(np.searchsorted(passed, share * total)) * BIN_NS * _US if total else 0.0

    # errors above a tenth of the period, counted from the first bin that lies wholly above it
    first = period_ns // LATE_SHARE // BIN_NS + 1
    late = int(counts[first:].sum()) + missed
    return PeriodStatistics(
        ticks=total,
        missed=missed,
        period_us=period_ns * _US,
        median_us=quantile(0.5),
        p99_us=quantile(0.99),
        p999_us=quantile(0.999),
        max_us=float(histogram[-1]) * _US,
        late_share=late / (total + missed) if total else 0.0,
        scheduling=scheduling,
    )
