"""Priors of tissue, noise, scatter and calibration, as frozen data.

Everything has a documented, proper default; a study file replaces what it names ([priors] and
[calibration] of study.toml).  Units are those of the parameters' names.

The **linear** parameters (coefficients of F_s and of each K) have independent normal priors, cut to the
passive set.  A parameter without a stated prior is *weak*: coefficients of F_s/x and K in the Bernstein basis
of [0, depth] are normal around 0 with a standard deviation at which that part alone would carry
:data:`WEAK_FACTOR` times the largest measured force (of a branch: at its largest state for the relaxation
time in question, so that for short times the prior is one of viscosity and not of stiffness).
"""

from __future__ import annotations

import copyreg
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from types import MappingProxyType
from typing import Any


def _frozen(items: dict[str, Any]) -> MappingProxyType[str, Any]:
    return MappingProxyType(items)


# worker processes need priors, options and studies, which are frozen, mappings included: pickle knows no such
copyreg.pickle(MappingProxyType, lambda proxy: (_frozen, (dict(proxy),)))

#: Standard deviation of a weak coefficient, in forces: so many times the largest measured one.
WEAK_FACTOR = 2.0


@dataclass(frozen=True, slots=True)
class SpreadPrior:
    """Log-normal prior of a positive quantity."""

    median: float  # in the unit of the quantity
    sd_ln: float  # standard deviation of its natural logarithm


@dataclass(frozen=True, slots=True)
class CalibrationPrior:
    """Prior of one calibration nuisance: a normal, in the unit of the name."""

    mean: float
    sd: float
    lower: float = float("-inf")  # the normal is cut here; 0 with a mean of 0 is half-normal
    stated: bool = False  # by the study; else it is a documented default


#: Where nothing is stated. Gains: the limits of error of class 1 (ISO 7500-1, ISO 9513: 1 %) as two
#: standard deviations, doubled, because an unstated class may be worse. Skew: two channels of one machine
#: are apart by single milliseconds. Filter: load channels of test machines have corner frequencies from
#: some 15 Hz up. Compliance: frame, load cell and fixture of small machines have 200 to 10,000 N/mm.
CALIBRATION_DEFAULTS: Mapping[str, CalibrationPrior] = {
    "force_gain": CalibrationPrior(mean=1.0, sd=0.01),
    "displacement_gain": CalibrationPrior(mean=1.0, sd=0.01),
    "skew_s": CalibrationPrior(mean=0.0, sd=0.002),
    "force_filter_s": CalibrationPrior(mean=0.0, sd=0.005, lower=0.0),
    "frame_compliance_mm_per_N": CalibrationPrior(mean=0.0, sd=0.004, lower=0.0),
}


@dataclass(frozen=True, slots=True)
class PopulationPriors:
    """Priors of the population that specimens are drawn from, in natural logarithms of its quantities."""

    #: The mean is normal around 0 (1 N, 1 N s/mm, 1 s): a value within nine decades of it is no surprise.
    mean_sd: float = 10.0
    #: The change by one standard deviation of a covariate, or from one group to another, is normal around 0.
    effect_sd: float = 1.0
    #: Between specimens; 0.05 to 0.8 in its central 95 %: coefficients of variation reported of soft tissues.
    between: SpreadPrior = field(default_factory=lambda: SpreadPrior(0.2, 0.7))
    level: SpreadPrior = field(default_factory=lambda: SpreadPrior(0.1, 0.7))  # donors, sites, operators
    correlation_shape: float = 2.0  # of the LKJ distribution; 1 is uniform, 2 leans to none
    #: Gamma distribution of the degrees of freedom of a t, cut to 1 and above (Juarez & Steel 2010, J Bus
    #: Econ Stat 28:52, doi 10.1198/jbes.2009.07145).
    tail_shape: float = 2.0
    tail_rate: float = 0.1

    def as_json(self) -> dict[str, Any]:
        """All priors in use, as ``[population]`` of study.toml."""
        return {
            "mean_sd": self.mean_sd,
            "effect_sd": self.effect_sd,
            "between": asdict(self.between),
            "level": asdict(self.level),
            "correlation_shape": self.correlation_shape,
            "tails": {"shape": self.tail_shape, "rate": self.tail_rate},
        }


@dataclass(frozen=True, slots=True)
class Priors:
    """Priors of one specimen.

    Attributes
    ----------
    linear : mapping
        Parameter name (``static_1_N_per_mm``, ``stiffness_0_N_per_mm_b2``, ...) -> (mean, sd); names that are
        missing are weak.
    relaxation_time_s : tuple of SpreadPrior or None
        One a branch by ascending time; branches without one are uniform in ln tau on [h/5, 10 T].
    shapes : mapping
        Name of a shape of a law -> SpreadPrior; those that are missing are uniform in their logarithm.
    sigma_N : SpreadPrior or None
        Standard deviation of the noise; ``None`` is uniform in its logarithm over twelve decades.
    phi : tuple of float
        The lag-one correlation of the noise is uniform between these.
    gain_sd : float
        Scale of the half-normal prior of the standard deviation of a log's ln gain.
    calibration : mapping
        Names of :data:`CALIBRATION_DEFAULTS`.
    """

    linear: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    relaxation_time_s: tuple[SpreadPrior | None, ...] = ()
    shapes: Mapping[str, SpreadPrior] = field(default_factory=dict)
    sigma_N: SpreadPrior | None = None
    phi: tuple[float, float] = (0.0, 1.0)
    gain_sd: float = 0.3
    calibration: Mapping[str, CalibrationPrior] = field(default_factory=lambda: CALIBRATION_DEFAULTS)

    def __post_init__(self) -> None:
        object.__setattr__(self, "linear", MappingProxyType(dict(self.linear)))
        object.__setattr__(self, "shapes", MappingProxyType(dict(self.shapes)))
        object.__setattr__(
            self, "calibration", MappingProxyType({**CALIBRATION_DEFAULTS, **self.calibration})
        )

    def as_json(self) -> dict[str, Any]:
        """Stated priors of tissue and noise, with the defaults in use, as ``[priors]`` of study.toml."""
        linear: dict[str, Any] = {name: {"mean": mean, "sd": sd} for name, (mean, sd) in self.linear.items()}
        times = [None if one is None else asdict(one) for one in self.relaxation_time_s]
        return {
            **linear,
            **{name: asdict(one) for name, one in self.shapes.items()},
            **({"relaxation_time_s": times} if times else {}),
            **({} if self.sigma_N is None else {"sigma_N": asdict(self.sigma_N)}),
            "phi": {"low": self.phi[0], "high": self.phi[1]},
            "gain_sd": {"scale": self.gain_sd},
        }
