"""Results: frozen types, free of any optimiser's or sampler's objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissueid.arrays import FloatArray
from tissueid.documents import members, plain
from tissueid.documents.identification import Exit, Model, Relaxation, RelaxationWindow, TipGeometry, Validity
from tissueid.documents.identification import Nrmsd as Nrmsd
from tissueid.documents.measured import Measured, Spread
from tissueid.documents.quantities import Cycle, Quoted, UnloadingMiss
from tissueid.errors import InputError
from tissueid.flags import Flag
from tissueid.notebook import Shown
from tissueid.trial import MM_N, Axes
from tissueid.uncertainty import UNCERTAINTY, ParameterUncertainty, Posterior


@dataclass(frozen=True, slots=True, eq=False)
class ResidualSummary:
    """Measured less modelled force of one log, over the samples that take part in the likelihood."""

    start_s: float  # clock of the recording where the time of its kept curve is zero [s]
    step_s: float  # median sampling interval [s]
    edges_N: FloatArray  # (b + 1,), edges of the bins of its histogram [N]
    #: (b + 2,): samples below the first edge, in every bin, and from the last edge on.
    counts: NDArray[np.int64]
    lags: NDArray[np.int64]  # (k,), in samples, ascending
    correlation: FloatArray  # (k,), autocorrelation at these lags
    #: (m,): middle (geometric) of a block of a hold, in time since the corner, and mean residual over it.
    hold_since_s: FloatArray
    hold_mean_N: FloatArray  # (m,)
    hold_count: NDArray[np.int64]  # (m,), samples of each


#: Members of a parameter as they are, in the order of the file.
_OF_ESTIMATE = ("name", "symbol", "unit", "value", "stderr", "identified")
#: What a parameter says of its uncertainty where nothing was sampled or nothing is identified.
_NOT_SAMPLED = dict.fromkeys(UNCERTAINTY)

#: What a specimen says of a posterior it does not have.
_NO_POSTERIOR: dict[str, Any] = {"sampler": None, "noise": None, "priors": [], "budget": [], "misfit": None}


@dataclass(frozen=True, slots=True)
class Estimate(Shown):
    """One parameter.

    Attributes
    ----------
    name, symbol, unit : str
    value : float or None
        ``None`` where the data do not identify it; the number then stands under ``detail["estimate"]``.
    stderr : float or None
        Standard error under white noise [same unit]; ``None`` where a bound is active.
    identified : bool
    detail : mapping
        Numbers behind the verdict (estimate, interval, width in ln tau).
    uncertainty : ParameterUncertainty or None
        From the posterior, where one was sampled.  Of a parameter that is not identified it stands in
        ``detail["posterior"]`` of the JSON, never as an interval of its own: it is the prior's as much as
        the data's.
    """

    name: str
    symbol: str
    unit: str
    value: float | None
    stderr: float | None
    identified: bool
    detail: Mapping[str, Any] = field(default_factory=dict)
    uncertainty: ParameterUncertainty | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "detail", MappingProxyType(dict(self.detail)))

    def as_json(self) -> dict[str, Any]:
        """The object of ``schemas/identification.schema.json``."""
        sampled = None if self.uncertainty is None else self.uncertainty.as_json()
        aside = {} if self.identified or sampled is None else {"posterior": sampled}
        return {
            **{key: getattr(self, key) for key in _OF_ESTIMATE},
            **(sampled if sampled is not None and self.identified else _NOT_SAMPLED),
            "detail": {**self.detail, **aside},
        }

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Estimate:
        """Read what :meth:`as_json` wrote."""
        plain = {key: value for key, value in document.items() if key not in _NOT_SAMPLED}
        detail = dict(plain.pop("detail"))
        sampled = detail.pop("posterior", None) or (None if document["mean"] is None else document)
        uncertainty = None if sampled is None else ParameterUncertainty.from_json(sampled)
        return cls(**plain, detail=detail, uncertainty=uncertainty)


@dataclass(frozen=True, slots=True)
class ModelChoice:
    """Model that was fitted: its key, the name it was asked for by, and nodes of the yardstick [s]."""

    key: str
    branches: int
    static_degree: int
    stiffness_degree: int
    static_pooling: str
    name: str = ""
    range_s: tuple[float, float] | None = None
    inside_s: tuple[float, ...] = ()
    outside_s: tuple[float, ...] = ()

    @classmethod
    def of(cls, found: Model) -> ModelChoice:
        """A choice from a document."""
        known = {one.name: getattr(found, one.name) for one in fields(cls)}
        nodes = {key: known[key] or () for key in ("inside_s", "outside_s")}
        return cls(**known | nodes | {"name": found.name or ""})

    def as_json(self) -> dict[str, Any]:
        """The ``model`` object of the schema."""
        found = plain(self)
        nodes = {key: found.pop(key) for key in ("inside_s", "outside_s")}
        first = {"key": self.key, "name": self.name or self.key, "range_s": found["range_s"]}
        return {**first, **found, **first, **{key: one for key, one in nodes.items() if one}}


@dataclass(frozen=True, slots=True)
class Curve:
    """A recording with its model, every sample of it or, of a long one, the extremes of its bins."""

    #: (m,): time from contact [s], depth [mm] and measured and modelled compressive force [N].
    time_s: FloatArray
    depth_mm: FloatArray  # (m,)
    force_N: FloatArray  # (m,)
    model_N: FloatArray  # (m,)
    fitted: NDArray[np.bool_]  # (m,), false where a sample took no part in the likelihood


#: Numbers of a trial, in the order of the file.
_OF_TRIAL = (
    *("max_residual_fraction", "residual_acf1", "gain", "contact_offset_mm", "speed_mm_s", "depth_mm"),
    *("n_samples", "time_ratio"),
)


@dataclass(frozen=True, slots=True)
class TrialFit:
    """Fit of the specimen's model to one of its trials."""

    path: str
    sheet: str | None
    nrmsd: Nrmsd
    max_residual_fraction: float
    residual_acf1: float
    gain: float
    contact_offset_mm: float
    speed_mm_s: float
    depth_mm: float
    n_samples: int
    curve: Curve
    flags: tuple[Flag, ...] = ()
    residual: ResidualSummary | None = None
    measured: Measured | None = None
    time_ratio: float = 1.0

    def as_json(self) -> dict[str, Any]:
        """The ``trials`` object of the schema: ``nrmsd`` is by range (curves are kept in HDF5, not here)."""
        return {
            "path": self.path,
            "sheet": self.sheet,
            "nrmsd": self.nrmsd.range,
            "nrmsd_mean": self.nrmsd.mean,
            "rmse_N": self.nrmsd.rmse_N,
            **{key: getattr(self, key) for key in _OF_TRIAL},
            "measured": plain(self.measured),
            "flags": plain(self.flags),
        }


#: Members of a specimen as they are, in the order of the file.
_OF_SPECIMEN = (
    *("relaxation", "relaxation_window", "cycles", "measured", "quoted", "unloading", "unloading_predicted"),
    *("optimisers", "selection"),
)


@dataclass(frozen=True, slots=True)
class SpecimenFit(Shown):
    """The identified contact model of one specimen.

    Attributes
    ----------
    specimen : str
    model : ModelChoice
    parameters : tuple of Estimate
        What is reported: static, dynamic, relaxation times and viscosities.
    theta_names : tuple of str
    theta : ndarray, shape (p,)
        Vector of the contact model (see :class:`tissueid.model.channels.ChannelModel`).
    covariance : ndarray, shape (p, p)
        Of theta, under white noise; rows of parameters at a bound are zero.
    depth_mm : float
        Largest fitted depth: the model is claimed on [0, depth_mm].
    speeds_mm_s : tuple of float
        Slowest and fastest fitted loading speed.
    tip_radius_mm : float or None
    tip : TipGeometry or None
        Shape of the tip, where it was stated.
    sigma_N : float
        Residual standard deviation [N].
    n_samples : int
        Samples in the likelihood.
    nrmsd : Nrmsd
        Over all fitted samples.
    trials : tuple of TrialFit
    relaxation : tuple of Relaxation
    relaxation_window : RelaxationWindow or None
        The one relaxation time of the publication, of the whole hold and of shorter ones.
    optimisers : mapping
        What Levenberg-Marquardt and variable projection reached, and whether they agree.
    selection : tuple of mapping
        One row a candidate model: branches, stiffness_degree, score, stderr, chosen.
    flags : tuple of Flag
    axes : Axes
        Every ``unit`` in the JSON is written in these; keys keep their names.
    unloading : mapping or None
        How the fit of unloading went; ``None`` where only loading was fitted.
    unloading_predicted : UnloadingMiss or None
        Unloading as the fit of loading and holds predicts it; ``None`` where no tool turned back.
    cycles : tuple of Cycle
    measured : tuple of Spread
        What was measured, no model, with the spread between logs.
    quoted : Quoted or None
    posterior : Posterior or None
        ``None`` where nothing was sampled.
    """

    specimen: str
    model: ModelChoice
    parameters: tuple[Estimate, ...]
    theta_names: tuple[str, ...]
    theta: FloatArray
    covariance: FloatArray
    depth_mm: float
    speeds_mm_s: tuple[float, float]
    tip_radius_mm: float | None
    sigma_N: float
    n_samples: int
    nrmsd: Nrmsd
    trials: tuple[TrialFit, ...]
    relaxation: tuple[Relaxation, ...]
    optimisers: Mapping[str, Any]
    selection: tuple[Mapping[str, Any], ...]
    tip: TipGeometry | None = None
    relaxation_window: RelaxationWindow | None = None
    flags: tuple[Flag, ...] = ()
    axes: Axes = MM_N
    unloading: Mapping[str, Any] | None = None
    unloading_predicted: UnloadingMiss | None = None
    cycles: tuple[Cycle, ...] = ()
    measured: tuple[Spread, ...] = ()
    quoted: Quoted | None = None
    posterior: Posterior | None = None

    def parameter(self, name: str) -> Estimate:
        """The reported parameter of that name (``KeyError`` where there is none)."""
        return {estimate.name: estimate for estimate in self.parameters}[name]

    def as_json(self) -> dict[str, Any]:
        """The ``specimens`` object of the schema."""
        document = {
            "specimen": self.specimen,
            "units": self.axes.as_json(),
            "model": self.model.as_json(),
            "parameters": [estimate.as_json() for estimate in self.parameters],
            "nrmsd": plain(self.nrmsd),
            "sigma_N": self.sigma_N,
            "n_samples": self.n_samples,
            "validity": plain(Validity(**members(self, Validity))),
            "trials": [trial.as_json() for trial in self.trials],
            **{key: plain(getattr(self, key)) for key in _OF_SPECIMEN},
            **(_NO_POSTERIOR if self.posterior is None else self.posterior.as_json()),
            "flags": plain(self.flags),
        }
        return in_units(document, self.axes) if self.axes.normalised else document


def in_units(document: Any, axes: Axes) -> Any:
    """The same document with every ``unit`` written in the units of normalised axes."""
    if isinstance(document, list):
        return [in_units(entry, axes) for entry in document]
    if not isinstance(document, dict):
        return document
    return {
        key: axes.unit(value) if key == "unit" and isinstance(value, str) else in_units(value, axes)
        for key, value in document.items()
    }


@dataclass(frozen=True, slots=True)
class Refusal:
    """An input that was not used, and why."""

    path: str
    sheet: str | None
    code: str
    message: str
    line: int | None = None
    column: int | None = None

    @classmethod
    def of(cls, error: InputError) -> Refusal:
        """The refusal that an error of reading states."""
        return cls(error.path, error.sheet, error.code, error.message, error.line, error.column)

    def __str__(self) -> str:
        return str(self.as_error())

    def as_error(self) -> InputError:
        """The same as an error to raise."""
        return InputError(
            self.code, self.message, path=self.path, sheet=self.sheet, line=self.line, column=self.column
        )

    def as_json(self) -> dict[str, Any]:
        """``{path, sheet, error: {code, message, line, column}}``, as ``inspect`` prints it."""
        error = plain(self)
        return {"path": error.pop("path"), "sheet": error.pop("sheet"), "error": error}


@dataclass(frozen=True, slots=True)
class Identification(Shown):
    """Everything ``tissueid fit`` found in one run.

    Attributes
    ----------
    specimens : tuple of SpecimenFit
    refused : tuple of Refusal
    exit : Exit
    provenance : mapping
        Versions, options, seed and the inputs with their hashes.
    study : mapping or None
        The ``study`` object of the schema: covariates, calibration, exclusions; ``None`` without a study.
    unfitted_cycles : tuple of Cycle
        Loops of trials that were read but could not be fitted.
    exclusions : tuple of mapping
        Recordings that were left out, each with its reason; the study repeats them in the document.
    """

    specimens: tuple[SpecimenFit, ...]
    refused: tuple[Refusal, ...]
    exit: Exit
    provenance: Mapping[str, Any] = field(default_factory=dict)
    study: Mapping[str, Any] | None = None
    unfitted_cycles: tuple[Cycle, ...] = ()
    exclusions: tuple[Mapping[str, Any], ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "provenance", MappingProxyType(dict(self.provenance)))

    def as_json(self) -> dict[str, Any]:
        """The document of ``schemas/identification.schema.json``."""
        return {
            "schema": "tissueid/identification/1",
            "specimens": [specimen.as_json() for specimen in self.specimens],
            "refused": [refusal.as_json() for refusal in self.refused],
            "unfitted_cycles": plain(self.unfitted_cycles),
            "study": None if self.study is None else dict(self.study),
            "provenance": dict(self.provenance),
            "exit": plain(self.exit),
        }
