"""Measures of one recording, no model: frozen types for pushes, holds and forces at stated times.

Forces count from the base: the reading in air where the record shows it, else the force at rest before the
first move.  They grow with compression (with pull, in tension).  ``recorded_N`` is the same force in the
recording's own sign and zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from tissueid.documents.measured import Spread

#: A force earlier than so many ramp times after the stop still knows the ramp.
RAMP_TIMES = 10.0
#: Plain numbers of a push.
_PUSH = ("start_s", "stop_s", "ramp_time_s", "speed_mm_s", "travel_mm", "depth_mm", "braking_s")
#: Ramp times are known to a sample or two: a time this little short of it counts.
ALMOST = 0.01


def beyond_ramp(time_s: float, ramp_time_s: float) -> bool:
    """True where a time after the stop is ten ramp times or later."""
    return time_s >= (1.0 - ALMOST) * RAMP_TIMES * ramp_time_s


@dataclass(frozen=True, slots=True)
class Base:
    """The recorded force from which forces count."""

    recorded_N: float  # as recorded
    #: ``air`` (the tool before contact), ``rest`` (standing before the first move, in contact) or
    #: ``recorded`` (the record shows neither: its own zero).
    source: str

    def as_json(self) -> dict[str, Any]:
        """``{"recorded_N", "source"}``."""
        return {"recorded_N": self.recorded_N, "source": self.source}


@dataclass(frozen=True, slots=True)
class MeasuredPeak:
    """Force at its largest from max(0.5 s, braking) before the stop to 0.1 s after it; else of the move."""

    time_s: float  # as recorded
    #: Above the base, and as recorded.
    force_N: float
    recorded_N: float

    def as_json(self) -> dict[str, float]:
        """``{"time_s", "force_N", "recorded_N"}``."""
        return {"time_s": self.time_s, "force_N": self.force_N, "recorded_N": self.recorded_N}


@dataclass(frozen=True, slots=True)
class MeasuredModulus:
    """Young's modulus by the formula of the tip, from loading and from the end of the hold."""

    formula: str
    doi: str
    tip: str  # shape, size, tissue and Poisson's ratio in words
    depth_mm: float
    contact_mm: float | None = None  # contact radius at that depth
    #: Least squares over the loading, and from the last force of the hold; ``None`` where refused.
    loading_kPa: float | None = None
    held_kPa: float | None = None
    refused: str = ""  # limit that is passed, with its number; empty within the range

    def as_json(self) -> dict[str, Any]:
        """The ``modulus`` object of ``schemas/measured.schema.json``."""
        return {
            "formula": self.formula,
            "doi": self.doi,
            "tip": self.tip,
            "depth_mm": self.depth_mm,
            "contact_mm": self.contact_mm,
            "loading_kPa": self.loading_kPa,
            "held_kPa": self.held_kPa,
            "refused": self.refused or None,
        }


@dataclass(frozen=True, slots=True)
class MeasuredPush:
    """One loading move: depth, speed, ramp time and peak."""

    #: Where the loading begins in contact, and its stop, as recorded.
    start_s: float
    stop_s: float
    ramp_time_s: float  # between the two
    speed_mm_s: float
    travel_mm: float  # of the whole move, through air too
    depth_mm: float | None  # below contact at the stop; ``None`` where no contact was found
    braking_s: float | None  # from the corner to the stop; ``None`` where the move has no corner
    peak: MeasuredPeak
    modulus: MeasuredModulus | None = None  # ``None`` where the tip is not known

    @classmethod
    def of_json(cls, document: Mapping[str, Any]) -> MeasuredPush:
        """The push of a log, without its modulus."""
        return cls(**{name: document[name] for name in _PUSH}, peak=MeasuredPeak(**document["peak"]))

    def as_json(self) -> dict[str, Any]:
        """The ``push`` object of ``schemas/measured.schema.json``."""
        document: dict[str, Any] = {name: getattr(self, name) for name in _PUSH}
        document["peak"] = self.peak.as_json()
        document["modulus"] = None if self.modulus is None else self.modulus.as_json()
        return document


@dataclass(frozen=True, slots=True)
class MeasuredForce:
    """The force at one time of a hold."""

    time_s: float  # after the stop, which is what counts; ``after_peak_N``: after the peak
    #: Force so long after the stop above the base, its standard deviation by white noise, and as recorded.
    after_stop_N: float | None = None
    sd_N: float | None = None
    recorded_N: float | None = None
    after_peak_N: float | None = None  # force so long after the peak above the base
    over_10s: float | None = None  # ``after_stop_N`` over that at 10 s
    #: ``after_peak_N`` over the peak, as relaxation is often quoted.  It depends on the ramp.
    over_peak: float | None = None
    #: Whether the time is ten ramp times or later: earlier ones are compared within a program only.
    beyond_ramp: bool = False
    reason: str = ""  # why there is no force

    def as_json(self) -> dict[str, Any]:
        """The ``force`` object of ``schemas/measured.schema.json``."""
        return {
            "time_s": self.time_s,
            "after_stop_N": self.after_stop_N,
            "sd_N": self.sd_N,
            "recorded_N": self.recorded_N,
            "after_peak_N": self.after_peak_N,
            "over_10s": self.over_10s,
            "over_peak": self.over_peak,
            "beyond_ramp": self.beyond_ramp,
            "reason": self.reason or None,
        }


@dataclass(frozen=True, slots=True)
class MeasuredTau:
    """Relaxation times of a hold with a free plateau, which hold for their window alone."""

    window_s: tuple[float, float]  # recorded times of the stop and of the end of the hold
    single_s: float | None
    double_s: tuple[float, ...]
    nrmsd_single: float  # of the single exponential, over the range of the force
    #: d ln tau / d ln T by halving the window; above 0.2 the single time is the window's as much as the
    #: tissue's.
    log_slope: float | None = None

    def as_json(self) -> dict[str, Any]:
        """The ``tau`` object of ``schemas/measured.schema.json``."""
        return {
            "window_s": list(self.window_s),
            "single_s": self.single_s,
            "double_s": list(self.double_s),
            "nrmsd_single": self.nrmsd_single,
            "log_slope": self.log_slope,
        }


@dataclass(frozen=True, slots=True)
class MeasuredHold:
    """A hold, and the push before it."""

    #: The stop, and the last sample, as recorded.
    start_s: float
    end_s: float
    #: ``position``, or ``force`` where the load is held and the tool creeps: such a hold has no forces.
    control: str
    push: MeasuredPush | None  # ``None`` where another move than loading came before
    forces: tuple[MeasuredForce, ...]  # at :data:`tissueid.measured.TIMES_S` after the stop
    end_N: float  # last force, above the base
    creep_mm: float  # how far the tool went on during the hold
    tau: MeasuredTau | None = None
    after_rupture: bool = False  # whether the tissue broke before its end

    @property
    def length_s(self) -> float:
        """From the stop to the last sample [s]."""
        return self.end_s - self.start_s

    def at(self, time_s: float) -> MeasuredForce | None:
        """The force at one of the stated times; ``None`` where there is none."""
        found = next((one for one in self.forces if one.time_s == time_s), None)
        return None if found is None or found.after_stop_N is None else found

    def as_json(self) -> dict[str, Any]:
        """The ``hold`` object of ``schemas/measured.schema.json``."""
        return {
            "start_s": self.start_s,
            "end_s": self.end_s,
            "control": self.control,
            "push": None if self.push is None else self.push.as_json(),
            "forces": [one.as_json() for one in self.forces],
            "end_N": self.end_N,
            "creep_mm": self.creep_mm,
            "tau": None if self.tau is None else self.tau.as_json(),
            "after_rupture": self.after_rupture,
        }


@dataclass(frozen=True, slots=True)
class MeasuredLoop:
    """Area of one load-unload loop [mJ = N mm]."""

    number: int
    kind: str
    depth_mm: float
    area_mJ: float | None
    sd_mJ: float | None
    hysteresis: float | None

    def as_json(self) -> dict[str, Any]:
        """The ``loop`` object of ``schemas/measured.schema.json``."""
        plain = ("number", "kind", "depth_mm", "area_mJ", "sd_mJ", "hysteresis")
        return {name: getattr(self, name) for name in plain}


@dataclass(frozen=True, slots=True)
class Measured:
    """Measures of one recording, no model."""

    base: Base
    push: MeasuredPush | None = None  # the one with the largest peak; ``None`` where nothing was loaded
    holds: tuple[MeasuredHold, ...] = ()  # in time order
    loops: tuple[MeasuredLoop, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The object of ``schemas/measured.schema.json``."""
        return {
            "base": self.base.as_json(),
            "push": None if self.push is None else self.push.as_json(),
            "holds": [one.as_json() for one in self.holds],
            "loops": [one.as_json() for one in self.loops],
        }


#: 97.5 % points of Student's t with 1, 2, ... degrees of freedom; the normal's beyond.
_T_975 = (
    12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
    2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
)  # fmt: skip
_NORMAL_975 = 1.96


def predicted(mean_ln: float, sd_ln: float, count: int) -> tuple[float, float] | None:
    """95 % prediction interval of one more value, from mean and standard deviation of logarithms."""
    if count < 2:
        return None
    t = _T_975[count - 2] if count - 2 < len(_T_975) else _NORMAL_975
    half = t * sd_ln * math.sqrt(1.0 + 1.0 / count)
    if not math.isfinite(half) or half > 20.0:
        return None
    return math.exp(mean_ln - half), math.exp(mean_ln + half)


@dataclass(frozen=True, slots=True)
class SpreadRow:
    """One measured number over the logs of a specimen."""

    name: str
    unit: str
    #: 1 for the first: logs of one speed and depth, those with holds first and the deepest of them first.
    program: int
    hold: int  # 1 for the first hold of each log; 0 for what is not of a hold
    time_s: float | None  # after the stop
    ramp_time_s: tuple[float, float] | None  # shortest and longest ramp time of the logs
    count: int  # logs that have the number
    mean: float | None  # ``None`` where logs of several ramps may not be pooled
    sd: float | None  # between logs; ``None`` for fewer than two
    reason: str = ""

    @classmethod
    def of(cls, row: Spread) -> SpreadRow:
        """The row of ``specimens[].measured``."""
        known = {one.name: getattr(row, one.name) for one in fields(cls)}
        return cls(**known | {"reason": row.reason or ""})

    def as_json(self) -> dict[str, Any]:
        """The ``spread`` object of ``schemas/measured.schema.json``."""
        return {
            "name": self.name,
            "unit": self.unit,
            "program": self.program,
            "hold": self.hold,
            "time_s": self.time_s,
            "ramp_time_s": None if self.ramp_time_s is None else list(self.ramp_time_s),
            "count": self.count,
            "mean": self.mean,
            "sd": self.sd,
            "prediction95": None if self.prediction95 is None else list(self.prediction95),
            "reason": self.reason or None,
        }

    @property
    def prediction95(self) -> tuple[float, float] | None:
        """Interval of the next indentation: t on the log scale; ``None`` with fewer than two logs."""
        if self.mean is None or self.sd is None or self.mean <= 0.0 or self.count < 2:
            return None
        spread = math.sqrt(math.log1p((self.sd / self.mean) ** 2))
        return predicted(math.log(self.mean) - 0.5 * spread**2, spread, self.count)


def spread_json(rows: Sequence[SpreadRow]) -> list[dict[str, Any]]:
    """The ``measured`` array of a specimen."""
    return [row.as_json() for row in rows]
