"""Numbers that people quote: frozen types for holds, cycles, functionals of a fit, spectra and moduli.

Every number stands with its standard error, and where it can't be given it is ``None`` with the reason:
nothing is extrapolated silently.  Standard errors are those of white force noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

from tissueid.documents import plain
from tissueid.documents.quantities import Spectrum
from tissueid.flags import Flag

#: From this slope d ln tau / d ln T on a relaxation time is one of its window, where the slope is known to
#: so many standard errors.
EFFECTIVE_SLOPE, EFFECTIVE_SD = 0.2, 2.6


@dataclass(frozen=True, slots=True)
class RelaxationWindow:
    """The relaxation time of the one-branch model, of holds cut to T, T/2 and T/4."""

    cut_s: tuple[float, ...]  # length of hold that was fitted [s], the whole first
    #: Relaxation time with its standard error under white noise [s].
    tau_s: tuple[float, ...]
    stderr_s: tuple[float, ...]
    #: d ln tau / d ln T: 0 for a property of the tissue, 1 for a property of the window.
    slope: float
    slope_stderr: float

    @property
    def effective(self) -> bool:
        """True where the relaxation time follows the length of the hold."""
        return self.slope > max(EFFECTIVE_SLOPE, EFFECTIVE_SD * self.slope_stderr)

    def as_json(self) -> dict[str, Any]:
        """The ``relaxation_window`` object of the schema."""
        return {**plain(self), "effective": self.effective}


@dataclass(frozen=True, slots=True)
class RelaxationRow:
    """One hold, described by one, two and three exponentials with a free plateau."""

    path: str
    sheet: str | None
    window_s: tuple[float, float]  # recorded times of the stop and of the end of the hold [s]
    #: Largest compressive force about the stop [N]: a crosshead brakes, and the force may fall meanwhile.
    peak_force_N: float
    tau_single_s: float | None
    nrmsd_single: float  # range-NRMSD of the single exponential over its window
    #: Ascending [s]; shorter where the data support fewer.
    tau_double_s: tuple[float, ...]
    tau_triple_s: tuple[float, ...]
    flags: tuple[Flag, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The ``relaxation`` object of the schema."""
        return {**plain(replace(self, flags=())), "flags": [flag.as_json() for flag in self.flags]}


#: Name of the slope of ln relaxation time on ln contact radius among the quantities of a model.
DEPTH_TEST = "relaxation_by_contact_radius"


@dataclass(frozen=True, slots=True)
class Quantity:
    """One number derived from a fit, or measured in a hold, at stated conditions."""

    name: str
    unit: str
    #: Conditions (``time_s``, ``frequency_Hz``, ``depth_mm``, ``path`` ...): numbers or words.
    at: Mapping[str, float | str]
    #: ``None`` where the data do not support it; ``reason`` then says why.
    value: float | None
    stderr: float | None = None
    reason: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "at", MappingProxyType(dict(self.at)))

    def as_json(self) -> dict[str, Any]:
        """The ``quantity`` object of ``schemas/quantities.schema.json``."""
        return {**plain(self), "reason": self.reason or None}


@dataclass(frozen=True, slots=True)
class QuotedNumbers:
    """Everything derived from one specimen's fit and its holds."""

    window_s: float  # longest hold (longest log where there is none): nothing later is said
    resolution_s: float  # two sampling intervals: nothing earlier is said
    model: tuple[Quantity, ...] = ()  # functionals of the fitted model, errors by the delta method
    moduli: tuple[Quantity, ...] = ()  # with tip (and thickness); empty where the tip is not known
    spectra: tuple[Spectrum, ...] = ()
    #: Tip, thickness and Poisson's ratio of the moduli; empty where there are none.
    assumptions: Mapping[str, float | str | None] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "assumptions", MappingProxyType(dict(self.assumptions)))

    def as_json(self) -> dict[str, Any]:
        """The ``quoted`` object of ``schemas/quantities.schema.json``."""
        return {
            "window_s": self.window_s,
            "resolution_s": self.resolution_s,
            "noise": "white",
            "model": [one.as_json() for one in self.model],
            "moduli": [one.as_json() for one in self.moduli],
            "spectra": plain(self.spectra),
            "assumptions": dict(self.assumptions),
        }


#: A force earlier than so many ramp times after the stop still knows the ramp.
RAMP_TIMES = 10.0
#: Ramp times are known to a sample or two: a time this little short of it counts.
ALMOST = 0.01


def beyond_ramp(time_s: float, ramp_time_s: float) -> bool:
    """True where a time after the stop is ten ramp times or later."""
    return time_s >= (1.0 - ALMOST) * RAMP_TIMES * ramp_time_s


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


def predicted_mean(mean: float | None, sd: float | None, count: int) -> tuple[float, float] | None:
    """95 % prediction interval of the next indentation, t on the log scale; ``None`` below two logs."""
    if mean is None or sd is None or mean <= 0.0 or count < 2:
        return None
    spread = math.sqrt(math.log1p((sd / mean) ** 2))
    return predicted(math.log(mean) - 0.5 * spread**2, spread, count)
