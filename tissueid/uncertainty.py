"""Posterior results: frozen types, free of any sampler's objects.

Two intervals stand for every parameter.  The *statistical* one knows the noise, the scatter between logs
and the contact points; the *total* one knows the calibration nuisances (gains, skew, filter, frame) as
well.  Both are calibrated for the stated model and noise, and say nothing where the model itself is
wrong: that is what :class:`MisfitAlarm` is for.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents import plain
from tissueid.documents.identification import (
    BudgetRow,
    MisfitAlarm,
    NoiseFit,
    PriorRow,
    SamplerReport,
)
from tissueid.errors import refuse
from tissueid.notebook import Shown

if TYPE_CHECKING:
    from tissueid.store.posteriors import StoredPosterior


def _finite(value: Any) -> Any:
    """The same value with ``None`` for numbers that JSON does not have."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(child) for key, child in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(child) for child in value]
    return value


_INTERVALS = ("ci95", "ci95_total", "prediction95")
#: Keys that a parameter gains, in the order of the file.
UNCERTAINTY = ("mean", "sd", *_INTERVALS, "ess_bulk", "ess_tail", "r_hat")


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

    def holding(self, low: float, high: float) -> ParameterUncertainty:
        """The same with intervals that reach to both ends of another one."""
        low, high = min(low, self.ci95[0]), max(high, self.ci95[1])
        ends = {name: getattr(self, name) for name in _INTERVALS}
        wide: dict[str, Any] = {
            name: own and (min(own[0], low), max(own[1], high)) for name, own in ends.items()
        }
        return replace(self, **wide, sd=max(self.sd, (high - low) / 4.0))

    def as_json(self) -> dict[str, Any]:
        """The keys that a parameter gains; a diagnostic or an end that has no value makes null of its own."""
        found = {key: _finite(getattr(self, key)) for key in UNCERTAINTY}
        total = found["ci95_total"]
        total = None if total is None or None in total else total
        return {**found, "mean": self.mean, "sd": self.sd, "ci95": list(self.ci95), "ci95_total": total}

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> ParameterUncertainty:
        """Read what :meth:`as_json` wrote; a diagnostic that is null is NaN again."""
        found = {key: document.get(key) for key in UNCERTAINTY}
        intervals = {key: value and tuple(value) for key, value in found.items() if key in _INTERVALS}
        diagnostics = {key: math.nan for key in ("ess_bulk", "ess_tail", "r_hat") if found[key] is None}
        return cls(**found | intervals | diagnostics)


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
    misfit: MisfitAlarm | None = None
    bands: Mapping[tuple[str, str | None], FloatArray] = field(default_factory=dict)
    log_density: FloatArray | None = None
    log_prior: FloatArray | None = None

    def to_arviz(self) -> Any:
        """The draws as arviz knows them, with the groups of :mod:`tissueid.uncertainty`.

        Raises UsageError: arviz, of the extra ``tissueid[arviz]``, is not installed.
        """
        return arviz_data(self)

    def as_json(self) -> dict[str, Any]:
        """The keys that a specimen gains."""
        return {
            "sampler": _finite(plain(self.sampler)),
            "noise": plain(self.noise),
            "priors": _finite(plain(self.priors)),
            "budget": _finite(plain(self.budget)),
            "misfit": _finite(plain(self.misfit)),
        }


#: What arviz compares needs more than one chain.
_QUARTERS = 4


def arviz_data(found: Posterior | StoredPosterior, **attributes: Any) -> Any:
    """Put draws into the data structure of the arviz that is installed.

    ``attributes``: text or numbers that are kept with each group, as the specimen.  Structures of all
    versions have ``to_netcdf``.  Raises UsageError: arviz is not installed.
    """
    arviz, xarray = _libraries()
    theta = dict(zip(found.theta_names, _quarters(found.draws), strict=True))
    if found.draws_total is not None:
        totals = [f"{name}_total" for name in found.theta_names]
        theta |= dict(zip(totals, _quarters(found.draws_total), strict=True))
    sampled = dict(zip(found.chain_names, found.chain.transpose(2, 0, 1), strict=True))
    groups = {
        "posterior": _data_set(xarray, theta, attributes),
        "unconstrained_posterior": _data_set(xarray, sampled, attributes),
    }
    if found.log_density is not None:
        groups["sample_stats"] = _data_set(xarray, {"lp": found.log_density}, attributes)
    if int(arviz.__version__.split(".")[0]) < 1:
        return arviz.InferenceData(**groups)
    return xarray.DataTree.from_dict(groups)


def _quarters(draws: FloatArray) -> FloatArray:
    """Draws of shape (n, p) as chains, shape (p, 4, n // 4); fewer than four are one chain."""
    chains = _QUARTERS if len(draws) >= _QUARTERS else 1
    kept = len(draws) - len(draws) % chains
    return draws[:kept].T.reshape(draws.shape[1], chains, -1)


def netcdf_bytes(data: Any) -> bytes:
    """The bytes of a NetCDF file of what :func:`arviz_data` made."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "draws.nc"
        try:
            data.to_netcdf(str(path))
        except (ImportError, ValueError) as error:
            refuse(f"no NetCDF can be written ({error}); install a library for it by `pip install h5netcdf`")
        return path.read_bytes()


def _libraries() -> tuple[Any, Any]:
    try:
        with warnings.catch_warnings():
            # arviz 0.2x announces its next major version at every import
            warnings.simplefilter("ignore", FutureWarning)
            import arviz
            import xarray
    except ImportError as error:
        refuse(f"arviz can't be imported ({error}); install it by `pip install 'tissueid[arviz]'`")
    return arviz, xarray


def _data_set(xarray: Any, variables: Mapping[str, FloatArray], attributes: Mapping[str, Any]) -> Any:
    """Variables of shape (chains, draws) side by side, as arviz names their dimensions."""
    chains, draws = next(iter(variables.values())).shape
    return xarray.Dataset(
        {name: (("chain", "draw"), values) for name, values in variables.items()},
        coords={"chain": np.arange(chains), "draw": np.arange(draws)},
        attrs={"inference_library": "tissueid", **attributes},
    )
