"""Result of `tissueid fit` (identification.json)."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta, field

from tissueid.documents.base import (
    Count,
    Document,
    Fraction,
    JsonSchema,
    NonNegative,
    OfSheet,
    Placed,
    Positive,
    Sha256,
    Text,
)
from tissueid.documents.inspect import Refusal, Units
from tissueid.documents.measured import Measured, Spread
from tissueid.documents.quantities import Cycle, Quoted, Unloading, UnloadingMiss
from tissueid.documents.study import Population, Priors, Study, Tip
from tissueid.flags import Flag


class Model(Document, frozen=True):
    """Contact model of a specimen."""

    key: Text
    branches: Annotated[int, Meta(ge=0, le=12)]
    static_degree: Annotated[int, Meta(ge=1, le=3)]
    stiffness_degree: Literal[0, 1, 2]
    #: `per-log` stands in documents of earlier versions only
    static_pooling: Literal["scaled", "partial", "shared", "per-log"]
    #: The model as it was asked for: a whole name, or STATIC * [STIFFNESS *] RELAXATION
    name: Text | None = None
    inside_s: tuple[Positive, ...] | None = None  # Nodes of the yardstick inside the convolution [s]
    outside_s: tuple[Positive, ...] | None = None  # Nodes of the yardstick outside it [s]
    #: Resolution and window of the recordings [s], between which a relaxation that is no exponential was
    #: looked at; null of a Kelvin-Voigt law
    range_s: tuple[Positive, Positive] | None = None


class Estimate(Document, frozen=True):
    """One parameter. `value` is null where `identified` is false."""

    RULES: ClassVar[JsonSchema] = {
        "if": {"properties": {"identified": {"const": False}}},
        "then": {
            "properties": {
                key: {"type": "null"}
                for key in ("mean", "sd", "ci95", "ci95_total", "ess_bulk", "ess_tail", "r_hat")
            }
        },
        "else": {"properties": {"value": {"type": "number"}}},
        "allOf": [
            {
                "if": {
                    "properties": {
                        "identified": {"const": False},
                        "detail": {"not": {"required": ["withheld"]}},
                    }
                },
                "then": {"properties": {"value": {"type": "null"}}},
            }
        ],
    }

    #: As the model declares it: tissueid models lists them; viscosity_N_s_per_mm of a branch is derived
    name: Annotated[str, Meta(pattern="^(static|stiffness|relaxation|viscosity|damping)_[a-zA-Z0-9_]+$")]
    symbol: str
    unit: str
    value: float | None
    stderr: NonNegative | None  # At the optimum, under the noise of the specimen, in the unit of the value
    identified: bool
    #: Posterior mean, in the unit of the value; null without a posterior and where not identified
    mean: float | None
    sd: NonNegative | None  # Posterior standard deviation, in the unit of the value
    #: Statistical 95 % interval, in the unit of the value: noise, scatter between logs, contact points
    ci95: tuple[float, float] | None
    #: Total 95 % interval: the calibration of the machine as well; null for normalised recordings
    ci95_total: tuple[float, float] | None
    ess_bulk: NonNegative | None  # Effective draws in the bulk; null where it is not defined
    ess_tail: NonNegative | None  # Effective draws in the tails
    r_hat: NonNegative | None  # Rank-normalised R-hat, 1 where chains agree
    #: Numbers behind the verdict; of a parameter that is not identified the estimate stands under `estimate`,
    #: and what was sampled under `posterior`: its interval is the prior's as much as the data's
    detail: dict[str, Any]
    #: 95 % prediction interval of the next indentation [low, high]: Student's t on the log scale over the
    #: logs; null where too few logs show how much sites differ
    prediction95: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Refuse what :attr:`RULES` refuse."""
        sampled = (self.mean, self.sd, self.ci95, self.ci95_total, self.ess_bulk, self.ess_tail, self.r_hat)
        if self.identified and self.value is None:
            raise ValueError(f"{self.name} is identified and has no value")
        if not self.identified and any(one is not None for one in sampled):
            raise ValueError(f"{self.name} is not identified and has numbers of a posterior")
        if not self.identified and self.value is not None and "withheld" not in self.detail:
            raise ValueError(f"{self.name} is not identified and has a value")


class TipGeometry(Document, frozen=True):
    """Shape of the tip, where it was stated; without it nothing is known of the shape."""

    shape: Literal["sphere", "flat", "cone"]
    half_angle_deg: Annotated[float, Meta(gt=0, lt=90)] | None  # Of a cone, between its axis and its side


class Validity(Document, frozen=True):
    """Claim of the model: depths up to depth_mm, loading speeds between the fitted ones, this tip."""

    depth_mm: NonNegative
    speeds_mm_s: tuple[float, float]
    tip_radius_mm: Positive | None
    tip: TipGeometry | None = None


class Input(OfSheet, frozen=True):
    """One trial that was read."""

    sha256: Sha256  # Of the bytes of the file; empty for a trial that was handed over as arrays
    recipe: str
    columns: dict[str, str]
    specimen: str
    n_samples: Count


class Frame(Document, frozen=True):
    """Deflection that was taken off the displacement: knots, du/dF and its covariance."""

    path: str | None
    sha256: str | None
    force_N: tuple[float, ...]
    compliance_mm_per_N: tuple[float, ...]
    covariance: tuple[tuple[float, ...], ...]
    range_N: tuple[float, ...] | None


class Calibration(Document, frozen=True):
    """Statements on the channels; null: not stated."""

    load_cell_capacity_N: float | None
    load_cell_class: float | None
    verified_from_N: float | None
    displacement_class: float | None
    displacement_resolution_mm: float | None
    sampling_Hz: float | None
    force_filter_s: float | None
    force_filter_s_sd: float | None
    skew_s: float | None
    skew_s_sd: float | None
    frame_stiffness_N_per_mm: float | None
    frame_stiffness_N_per_mm_sd: float | None
    frame: Frame | None


class StudyInputs(Document, frozen=True):
    """Study file a run was made under."""

    path: str
    sha256: str
    calibration: Calibration
    priors: Priors


class Provenance(Document, frozen=True):
    """Inputs and options to repeat the run by; no time stamps: the same run gives the same numbers."""

    tissueid: str  # Version that wrote this
    options: dict[str, Any]  # Options of the run that change its numbers, the seed among them
    inputs: tuple[Input, ...]
    #: Reading of the inputs as the user asked for it; null where nothing was said
    reading: dict[str, str | None] | None = None
    versions: dict[str, str] | None = None  # Versions of the libraries
    study: StudyInputs | None = None  # The study file, and the calibration and priors its numbers rest on


class Nrmsd(Document, frozen=True):
    """Root-mean-square deviation: over the range of the force and its mean (fractions), and in N."""

    range: NonNegative
    mean: NonNegative
    rmse_N: NonNegative


class Trial(OfSheet, frozen=True):
    """Fit of one log."""

    nrmsd: NonNegative  # RMSD over the range of the measured force, a fraction
    nrmsd_mean: NonNegative  # RMSD over the mean size of the measured force, a fraction
    rmse_N: NonNegative  # RMSD [N]
    max_residual_fraction: NonNegative  # Largest absolute residual over the range of the force
    residual_acf1: Annotated[float, Meta(ge=-1, le=1)]  # Lag-one autocorrelation of the residual
    gain: float
    contact_offset_mm: float
    speed_mm_s: float
    depth_mm: float
    n_samples: Count
    flags: tuple[Flag, ...]
    measured: Measured | None = None
    time_ratio: float = 1.0  # Relaxation times of the log over those of the specimen


class Relaxation(OfSheet, frozen=True):
    """Exponentials of one hold, without a contact model."""

    window_s: tuple[float, float]  # Recorded times of the stop and of the end of the hold
    peak_force_N: float
    tau_single_s: NonNegative | None
    nrmsd_single: NonNegative
    tau_double_s: Annotated[tuple[NonNegative, ...], Meta(max_length=2)]
    tau_triple_s: Annotated[tuple[NonNegative, ...], Meta(max_length=3)]
    flags: tuple[Flag, ...]


class RelaxationWindow(Document, frozen=True):
    """Relaxation time by length of the hold."""

    #: Length of hold that was fitted [s], the whole first
    cut_s: Annotated[tuple[Positive, ...], Meta(min_length=2, max_length=3)]
    tau_s: Annotated[tuple[Positive, ...], Meta(min_length=2, max_length=3)]  # Relaxation time of each [s]
    #: Its standard error under white noise [s]
    stderr_s: Annotated[tuple[Positive, ...], Meta(min_length=2, max_length=3)]
    slope: float  # d ln tau / d ln T: 0 for a property of the tissue, 1 for one of the window
    slope_stderr: NonNegative
    effective: bool  # True where the slope is above 0.2, beyond its error


class Optimisers(Document, frozen=True, forbid_unknown_fields=False):
    """Optima of Levenberg-Marquardt and variable projection, and their agreement."""

    agree: bool | None
    method: str | None = None


class Selection(Document, frozen=True):
    """A candidate model and its held-out score: log predictive density less the best's; larger is better."""

    branches: Annotated[int, Meta(ge=0, le=12)]
    stiffness_degree: Literal[0, 1, 2]
    score: float | None
    stderr: float | None
    chosen: bool
    model: str | None = None  # Law, where several were tried
    tau_s: float | None = None


class SamplerReport(Document, frozen=True, omit_defaults=False):
    """Sampling of a posterior."""

    name: Literal["emcee", "exact"]  # `exact` stands in documents of earlier versions only
    converged: bool  # Stopping rule was reached
    draws: Count  # Draws kept, of all walkers
    acceptance: Fraction  # Accepted proposals, a fraction
    detail: dict[str, Any]  # Steps, walkers, autocorrelation time, seed, and why it is not converged


class NoiseFit(Document, frozen=True, omit_defaults=False):
    """Noise of the force."""

    model: Literal["white", "ar1", "white+ar1"]
    sigma_N: NonNegative  # Standard deviation of the whole noise [N]
    phi: Fraction  # Correlation of its correlated part over one reference step
    reference_step_s: NonNegative  # Reference step [s]
    #: Coefficient of the innovation before, in the innovations of white noise beside AR(1); 0 unless the
    #: model is white+ar1
    moving_average: float = 0.0
    #: Standard deviation that quiet stretches of the recordings show [N]; null where nobody looked
    measured_N: NonNegative | None = None
    #: Samples that one independent sample stands for; above 1 where the model misses more than the noise of
    #: the recordings, and sigma_N is then the size of that miss
    samples_per_independent: Annotated[float, Meta(ge=1)] = 1.0

    @property
    def discrepant(self) -> bool:
        """True where the model misses more than the noise of the recordings."""
        return self.samples_per_independent > 1.0


class PriorRow(Document, frozen=True, omit_defaults=False):
    """One prior beside its posterior."""

    name: Text  # A parameter or a calibration nuisance
    prior: Text  # In words, with its numbers and units
    stated: bool  # False for a documented default
    posterior_mean: float | None  # In the unit of the name
    posterior_sd: NonNegative | None  # In the unit of the name
    shrinkage: float | None  # 1 - posterior sd / prior sd; below 0.1 the data said little


#: Source of uncertainty
Source = Literal[
    "noise", "scatter between logs", "contact points", "force gain", "displacement gain", "time skew",
    "force filter", "frame", "total", "cluster bootstrap",
]  # fmt: skip


class BudgetRow(Document, frozen=True, omit_defaults=False):
    """Share of one source in the uncertainty of one parameter."""

    parameter: Text
    source: Source  # `total` and `cluster bootstrap` stand beside the sources
    #: Standard deviation, in the unit of the parameter; null where it could not be worked out
    sd: NonNegative | None
    share: NonNegative | None  # Of the total variance; null for rows that are no part of the sum


class MisfitCheck(Document, frozen=True, omit_defaults=False):
    """One check."""

    name: Text
    statistic: float | None  # Measured statistic; null where it has no value
    p_value: Fraction | None  # Probability of as large a statistic under the fitted model and noise
    message: Text
    raised: bool


class MisfitAlarm(Document, frozen=True, omit_defaults=False):
    """Posterior predictive checks."""

    raised: bool  # Any check was raised: the intervals then can't be believed
    checks: tuple[MisfitCheck, ...] = ()


class Specimen(Document, frozen=True):
    """Fit of one specimen."""

    specimen: Text
    units: Units
    model: Model
    parameters: tuple[Estimate, ...]  # None of the yardstick
    nrmsd: Nrmsd
    sigma_N: NonNegative
    n_samples: Count
    validity: Validity
    trials: Annotated[tuple[Trial, ...], Meta(min_length=1)]
    relaxation: tuple[Relaxation, ...]
    cycles: tuple[Cycle, ...]  # Load-unload loops of its trials
    quoted: Quoted | None
    unloading: Unloading | None  # null where only loading was fitted
    optimisers: Optimisers
    selection: tuple[Selection, ...]
    sampler: SamplerReport | None  # Sampling of the posterior; null where none was
    noise: NoiseFit | None  # Noise of the force in the posterior; null where none was sampled
    priors: tuple[PriorRow, ...]  # Priors beside their posteriors
    budget: tuple[BudgetRow, ...]  # Share of each source in the uncertainty of each parameter
    #: Checks of residuals for what the model and its noise can't make; null where it was not looked at
    misfit: MisfitAlarm | None
    flags: tuple[Flag, ...]
    #: Of the one-branch model with holds cut to T, T/2 and T/4; null where no hold determines it
    relaxation_window: RelaxationWindow | None = None
    measured: tuple[Spread, ...] | None = None  # Measured, no model, with the spread between logs
    #: Unloading that was not fitted, as loading and holds predict it; null where no tool turned back
    unloading_predicted: UnloadingMiss | None = None


class Exit(Document, frozen=True):
    """Exit code and its reasons."""

    code: Literal[0, 1, 2, 3, 4, 5, 6, 7, 130]
    reasons: tuple[str, ...]


class StatedSpecimen(Document, frozen=True):
    """Row of a specimen in the study file."""

    specimen: str
    species: str | None
    tissue: str | None
    donor: str | None
    sex: str | None
    age_years: float | None
    age_group: str | None
    side: str | None
    thickness_mm: float | None
    thickness_mm_sd: float | None
    storage: str | None
    freeze_thaw_cycles: int | None
    hydration: str | None
    temperature_C: float | None
    time_post_mortem_h: float | None
    support: str | None
    site: str | None
    notes: str | None


class StatedTrial(Placed, frozen=True):
    """Row of a log in the study file."""

    specimen: str
    site: str | None
    protocol: str | None
    run: int | None
    rest_s: float | None
    listed: bool  # False for a recording that study.toml does not name
    overridden: tuple[str, ...]  # Keys the user decided
    because: str | None
    notes: str | None


class WithIt(Document, frozen=True):
    """One parameter without an excluded log and with it."""

    name: str
    symbol: str
    unit: str
    without: float | None
    without_stderr: float | None
    with_it: float | None = field(name="with")
    with_stderr: float | None


class Exclusion(Placed, frozen=True):
    """Log that was left out, and what it would have changed."""

    specimen: str | None
    because: str
    note: str | None
    #: The specimen's parameters fitted again with this trial; null where the data do not determine one
    with_it: tuple[WithIt, ...]


class StudyRecord(Document, frozen=True):
    """Rows that study.toml adds, flat, so that a table can be joined on path, sheet and specimen."""

    path: str  # study.toml as it was named
    sha256: Sha256
    study: Study
    tip: Tip
    calibration: Calibration
    priors: Priors
    #: One row a fitted or listed specimen; `specimen` is the name used everywhere else. Null: not stated
    specimens: tuple[StatedSpecimen, ...]
    #: One row a trial that was fitted; `path` and `sheet` are those of its fit
    trials: tuple[StatedTrial, ...]
    exclusions: tuple[Exclusion, ...]  # Recordings that were not fitted because the user said so
    population: Population | None = None


class Identification(Document, frozen=True):
    """Result of a fit: every number of every specimen."""

    schema: Literal["tissueid/identification/1"]
    specimens: tuple[Specimen, ...]
    refused: tuple[Refusal, ...]
    provenance: Provenance
    exit: Exit
    study: StudyRecord | None  # From study.toml; null without one
    unfitted_cycles: tuple[Cycle, ...]  # Loops of recordings that were read but could not be fitted
