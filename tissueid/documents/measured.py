"""Measures of one recording, no model."""

from __future__ import annotations

from typing import Literal

from tissueid.documents.base import Count, Document, PositiveCount, Text


class Base(Document, frozen=True):
    """Recorded force that forces count from: in air, at rest before the first move, or the record's zero."""

    recorded_N: float
    source: Literal["air", "rest", "recorded"]


class MeasuredPeak(Document, frozen=True):
    """Largest force from max(0.5 s, braking) before the stop to 0.1 s after it, or of a move without hold.

    A mean over a few samples where they are noisy.
    """

    time_s: float  # As recorded
    force_N: float
    recorded_N: float


class MeasuredModulus(Document, frozen=True):
    """Young's modulus where the tip is known."""

    formula: str
    doi: str
    tip: str
    depth_mm: float
    contact_mm: float | None  # Contact radius
    loading_kPa: float | None  # Least squares of the formula over the loading
    held_kPa: float | None  # From the last force of the hold
    refused: str | None  # Limit that is passed, with its number; null within the range


class MeasuredDepth(Document, frozen=True):
    """Force while loading at one depth below contact."""

    depth_mm: float
    force_N: float
    sd_N: float  # By white noise


class MeasuredPush(Document, frozen=True):
    """One loading move."""

    start_s: float  # Begin of loading in contact, as recorded
    stop_s: float
    ramp_time_s: float  # stop_s - start_s
    speed_mm_s: float
    travel_mm: float  # Of the whole move, through air too
    depth_mm: float | None  # Below contact at the stop; null where no contact was found
    braking_s: float | None  # From the corner to the stop; null where there is no corner
    peak: MeasuredPeak
    modulus: MeasuredModulus | None
    forces: tuple[MeasuredDepth, ...] = ()  # At the last round depths that were passed


class MeasuredForce(Document, frozen=True):
    """The force at one time of a hold."""

    time_s: float  # After the stop, or after the peak
    after_stop_N: float | None  # Force so long after the stop, above the base; null with the reason
    sd_N: float | None  # By white noise
    recorded_N: float | None
    after_peak_N: float | None  # Force so long after the peak, above the base
    over_10s: float | None  # after_stop_N over that at 10 s
    #: after_peak_N over the peak. Depends on the ramp: another ramp to the same depth gives another number
    over_peak: float | None
    beyond_ramp: bool  # The time is ten ramp times or later; earlier values are not compared between programs
    reason: str | None


class MeasuredTau(Document, frozen=True):
    """Relaxation times, which hold for their window alone."""

    window_s: tuple[float, float]  # Recorded times of the stop and of the end of the hold
    single_s: float | None  # One exponential with a free plateau; null where the force does not relax
    double_s: tuple[float, ...]
    nrmsd_single: float
    #: d ln tau / d ln T by halving the window: above 0.2 the time is the window's as much as the tissue's
    log_slope: float | None


class MeasuredHold(Document, frozen=True):
    """Hold, measured from its samples."""

    start_s: float  # The stop, as recorded
    end_s: float
    #: force: the load is held and the tool creeps, so that no forces are stated
    control: Literal["position", "force"]
    push: MeasuredPush | None  # The loading before it; null after another move
    forces: tuple[MeasuredForce, ...]
    end_N: float  # Last force, above the base
    creep_mm: float  # Way of the tool during the hold
    tau: MeasuredTau | None
    after_rupture: bool

    @property
    def length_s(self) -> float:
        """Time from the stop to the last sample [s]."""
        return self.end_s - self.start_s

    def at(self, time_s: float) -> MeasuredForce | None:
        """Force at one of the stated times; ``None`` where there is none."""
        found = next((one for one in self.forces if one.time_s == time_s), None)
        return None if found is None or found.after_stop_N is None else found


class MeasuredLoop(Document, frozen=True):
    """One load-unload loop, closed."""

    number: PositiveCount
    kind: str
    depth_mm: float
    area_mJ: float | None
    sd_mJ: float | None
    hysteresis: float | None


class Measured(Document, frozen=True):
    """Forces from the base, growing with loading; recorded_N is the same force as the recording has it."""

    base: Base
    push: MeasuredPush | None  # The loading with the largest peak, loops apart; null where there is none
    holds: tuple[MeasuredHold, ...]  # In time order
    loops: tuple[MeasuredLoop, ...]


class Spread(Document, frozen=True):
    """One measured number over the logs of a specimen."""

    name: Text  # peak, depth, travel, speed, ramp_time, modulus_loading, force, relaxation_time ...
    unit: str
    #: Logs of one speed and depth; those with holds first and the deepest of them first
    program: PositiveCount
    hold: Count  # 1 for the first hold of each log, or for the first loop; 0 for logs without a hold
    time_s: float | None  # After the stop
    ramp_time_s: tuple[float, float] | None  # Shortest and longest ramp of the logs
    count: Count
    mean: float | None  # null where logs of several programs may not be pooled
    sd: float | None  # Between logs; null for fewer than two
    reason: str | None
    #: 95 % prediction interval of the next indentation [low, high]: Student's t on the log scale over the
    #: logs; null where too few logs show how much sites differ
    prediction95: tuple[float, float] | None = None
    depth_mm: float | None = None  # Below contact, of a force while loading

    @property
    def at(self) -> float | None:
        """Time [s] or depth [mm] of a force that has either."""
        return self.depth_mm if self.time_s is None else self.time_s
