"""Posterior results: frozen types, free of any sampler's objects.

Two intervals stand for every parameter.  The *statistical* one knows the noise, the scatter between logs
and the contact points; the *total* one knows the calibration nuisances (gains, skew, filter, frame) as
well.  Both are calibrated for the stated model and noise, and say nothing where the model itself is
wrong: that is what :class:`MisfitAlarm` is for.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tissueid.arrays import FloatArray
from tissueid.notebook import Shown


def _finite(value: Any) -> Any:
    """The same value with ``None`` for numbers that JSON does not have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(child) for key, child in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(child) for child in value]
    return value


@dataclass(frozen=True, slots=True)
class NoiseFit:
    """The noise of a specimen's force."""

    model: str  # ``white``, ``ar1`` or ``white+ar1``
    sigma_N: float  # standard deviation of the whole noise [N]
    phi: float  # correlation of the correlated part over one reference step
    reference_step_s: float
    #: theta of e_n = r_n - phi r_(n-1) + theta e_(n-1); 0 unless the model is ``white+ar1``.
    moving_average: float = 0.0
    #: Standard deviation that quiet stretches of the recordings show [N]; ``None`` where nobody looked.
    measured_N: float | None = None
    #: Samples that one independent sample stands for; above 1 where the model misses more than the noise of
    #: the recordings, and ``sigma_N`` is then the size of that miss.
    samples_per_independent: float = 1.0

    @property
    def discrepant(self) -> bool:
        """True where the model misses more than the noise of the recordings."""
        return self.samples_per_independent > 1.0

    def as_json(self) -> dict[str, Any]:
        """The ``noise`` object of the schema."""
        return {
            "model": self.model,
            "sigma_N": self.sigma_N,
            "phi": self.phi,
            "reference_step_s": self.reference_step_s,
            "moving_average": self.moving_average,
            "measured_N": self.measured_N,
            "samples_per_independent": self.samples_per_independent,
        }


@dataclass(frozen=True, slots=True)
class SamplerReport:
    """Sampling of a posterior."""

    name: str  # ``emcee``; ``exact`` in sets of earlier versions
    converged: bool
    draws: int  # draws kept (of all walkers)
    acceptance: float  # accepted proposals, as a fraction
    #: steps, walkers, autocorrelation time, seed, wall time, the reason where not converged.
    detail: Mapping[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """The ``sampler`` object of the schema."""
        return {
            "name": self.name,
            "converged": self.converged,
            "draws": self.draws,
            "acceptance": self.acceptance,
            "detail": _finite(self.detail),
        }


@dataclass(frozen=True, slots=True)
class ParameterUncertainty:
    """Posterior of one reported parameter, in its unit.

    Attributes
    ----------
    mean, sd : float
    ci95 : tuple of float
        Central 95 % interval, statistical.
    ci95_total : tuple of float or None
        With the calibration nuisances (:mod:`tissueid.inference.posterior`); ``None`` where recordings
        are normalised, or too few draws carry it.
    ess_bulk, ess_tail, r_hat : float
        Rank-normalised (Vehtari et al. 2021, doi 10.1214/20-BA1221).
    prediction95 : tuple of float or None
        Of the next indentation (:mod:`tissueid.inference.reported`); ``None`` where too few logs show how
        much sites differ.
    """

    mean: float
    sd: float
    ci95: tuple[float, float]
    ci95_total: tuple[float, float] | None
    ess_bulk: float
    ess_tail: float
    r_hat: float
    prediction95: tuple[float, float] | None = None

    def as_json(self) -> dict[str, Any]:
        """The keys that a parameter gains; a diagnostic or an end that has no value makes null of its own."""
        total = None if self.ci95_total is None else _finite(self.ci95_total)
        return {
            "mean": self.mean,
            "sd": self.sd,
            "ci95": list(self.ci95),
            "ci95_total": None if total is None or None in total else total,
            "prediction95": None if self.prediction95 is None else list(self.prediction95),
            "ess_bulk": _finite(self.ess_bulk),
            "ess_tail": _finite(self.ess_tail),
            "r_hat": _finite(self.r_hat),
        }

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> ParameterUncertainty:
        """Read what :meth:`as_json` wrote; a diagnostic that is null is NaN again."""
        diagnostics = {
            key: math.nan if document[key] is None else float(document[key])
            for key in ("ess_bulk", "ess_tail", "r_hat")
        }
        low, high = document["ci95"]
        total, later = document["ci95_total"], document.get("prediction95")
        return cls(
            mean=document["mean"],
            sd=document["sd"],
            ci95=(low, high),
            ci95_total=None if total is None else (total[0], total[1]),
            prediction95=None if later is None else (later[0], later[1]),
            **diagnostics,
        )


@dataclass(frozen=True, slots=True)
class PriorRow:
    """One prior beside its posterior."""

    name: str  # a parameter or a calibration nuisance
    prior: str  # in words, with its numbers
    stated: bool  # true where the study states it, False for a default
    posterior_mean: float
    posterior_sd: float
    shrinkage: float  # 1 - (posterior sd / prior sd); below 0.1 the data said little

    def as_json(self) -> dict[str, Any]:
        """The ``priors`` row of the schema."""
        return {
            "name": self.name,
            "prior": self.prior,
            "stated": self.stated,
            "posterior_mean": _finite(self.posterior_mean),
            "posterior_sd": _finite(self.posterior_sd),
            "shrinkage": _finite(self.shrinkage),
        }


@dataclass(frozen=True, slots=True)
class BudgetRow:
    """Share of one source in the uncertainty of one parameter."""

    parameter: str  # its name
    #: ``noise``, ``scatter between logs``, ``contact points``, ``force gain``, ``displacement gain``, ``time
    #: skew``, ``force filter`` or ``frame``; ``total`` stands beside them, and ``cluster bootstrap`` in sets
    #: of earlier versions.
    source: str
    sd: float  # standard deviation [unit of the parameter]
    #: Of the total variance; NaN-free, ``None`` in JSON for rows that are no part of a sum.
    share: float | None

    def as_json(self) -> dict[str, Any]:
        """The ``budget`` row of the schema."""
        return {
            "parameter": self.parameter,
            "source": self.source,
            "sd": _finite(self.sd),
            "share": _finite(self.share),
        }


@dataclass(frozen=True, slots=True)
class ComparisonRow:
    """One model beside the others."""

    model: str  # in words: ``1 branch, K of degree 1, partial static``
    #: Natural logarithm of the marginal likelihood, difference to the best, and its Monte-Carlo error.
    log_evidence: float | None
    log_evidence_se: float | None
    #: Log predictive density of held-out logs, and of held-out speeds, difference to the best.
    elpd_log: float | None
    elpd_log_se: float | None
    elpd_speed: float | None
    elpd_speed_se: float | None
    #: ``chosen``, ``undecided`` (as good as the chosen one) or ``worse``; ``beside`` for models that can't be
    #: rendered and are compared only.
    verdict: str

    def as_json(self) -> dict[str, Any]:
        """The ``model_comparison`` row of the schema."""
        return {
            "model": self.model,
            "log_evidence": _finite(self.log_evidence),
            "log_evidence_se": _finite(self.log_evidence_se),
            "elpd_log": _finite(self.elpd_log),
            "elpd_log_se": _finite(self.elpd_log_se),
            "elpd_speed": _finite(self.elpd_speed),
            "elpd_speed_se": _finite(self.elpd_speed_se),
            "verdict": self.verdict,
        }


@dataclass(frozen=True, slots=True)
class MisfitCheck:
    """One posterior predictive check."""

    name: str  # what is looked at, as ``early hold``
    statistic: float
    p_value: float
    message: str  # one plain sentence
    raised: bool

    def as_json(self) -> dict[str, Any]:
        """A row of ``misfit.checks``."""
        return {
            "name": self.name,
            "statistic": _finite(self.statistic),
            "p_value": _finite(self.p_value),
            "message": self.message,
            "raised": self.raised,
        }


@dataclass(frozen=True, slots=True)
class MisfitAlarm:
    """Alarm of residuals that the model and its noise can't make."""

    raised: bool
    checks: tuple[MisfitCheck, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The ``misfit`` object of the schema."""
        return {"raised": self.raised, "checks": [check.as_json() for check in self.checks]}


@dataclass(frozen=True, slots=True, eq=False)
class Posterior(Shown):
    """The posterior of one specimen.

    Attributes
    ----------
    sampler : SamplerReport
    noise : NoiseFit
    parameters : mapping
        Name of a reported parameter -> its :class:`ParameterUncertainty`.
    theta_names : tuple of str
    draws : ndarray, shape (n, p)
        Thinned statistical draws of the contact model's theta; every one is passive.
    draws_total : ndarray, shape (n, p) or None
        The same with the calibration nuisances.
    covariance : ndarray, shape (p, p)
        Of all statistical draws.
    chain_names : tuple of str
        Coordinates that were sampled.
    chain : ndarray, shape (chains, draws, d)
        The sampled coordinates after burn-in, thinned.
    priors : tuple of PriorRow
    budget : tuple of BudgetRow
    comparison : tuple of ComparisonRow
    misfit : MisfitAlarm or None
    bands : mapping
        (path, sheet) of a trial -> predictive band, ndarray of shape (3, m): low, median, high [N] at the
        samples of its curve.
    log_density : ndarray, shape (chains, draws), or None
        Log posterior density of the chain's draws, where a chain was walked.
    log_prior : ndarray, shape (n,), or None
        Log prior density of the rows of ``draws``, up to a constant: what another prior is divided by.
    """

    sampler: SamplerReport
    noise: NoiseFit
    parameters: Mapping[str, ParameterUncertainty]
    theta_names: tuple[str, ...]
    draws: FloatArray
    draws_total: FloatArray | None
    covariance: FloatArray
    chain_names: tuple[str, ...]
    chain: FloatArray
    priors: tuple[PriorRow, ...] = ()
    budget: tuple[BudgetRow, ...] = ()
    comparison: tuple[ComparisonRow, ...] = ()
    misfit: MisfitAlarm | None = None
    bands: Mapping[tuple[str, str | None], FloatArray] = field(default_factory=dict)
    log_density: FloatArray | None = None
    log_prior: FloatArray | None = None

    def to_arviz(self) -> Any:
        """The draws as arviz knows them, with the groups of :mod:`tissueid.exchange`.

        Raises
        ------
        UsageError
            arviz, of the extra ``tissueid[arviz]``, is not installed.
        """
        from tissueid.exchange import arviz_data

        return arviz_data(
            theta_names=self.theta_names,
            draws=self.draws,
            draws_total=self.draws_total,
            chain_names=self.chain_names,
            chain=self.chain,
            log_density=self.log_density,
        )

    def as_json(self) -> dict[str, Any]:
        """The keys that a specimen gains."""
        return {
            "sampler": self.sampler.as_json(),
            "noise": self.noise.as_json(),
            "priors": [row.as_json() for row in self.priors],
            "budget": [row.as_json() for row in self.budget],
            "model_comparison": [row.as_json() for row in self.comparison],
            "misfit": None if self.misfit is None else self.misfit.as_json(),
        }
