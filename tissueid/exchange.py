"""Posterior draws as arviz knows them, for plots and comparisons that tissueid does not make.

Groups of one data set a specimen::

    posterior                theta of the contact model, thinned; every draw is passive.  The draws of all
                             walkers stand one after another; four quarters of them are its chains.
                             ``<name>_total``: with the calibration nuisances
    unconstrained_posterior  the coordinates that were sampled, each walker a chain, after burn-in, thinned
    sample_stats             ``lp``, the log density of those, where a chain was walked

arviz before 1.0 gets its ``InferenceData``, later ones the ``DataTree`` of xarray.  Both come with the extra
``tissueid[arviz]`` and are imported only here.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.errors import UsageError

#: What arviz compares needs more than one chain.
_QUARTERS = 4


def arviz_data(
    *,
    theta_names: Sequence[str],
    draws: FloatArray,
    draws_total: FloatArray | None,
    chain_names: Sequence[str],
    chain: FloatArray,
    log_density: FloatArray | None = None,
    attributes: Mapping[str, Any] | None = None,
) -> Any:
    """Put draws into the data structure of the arviz that is installed.

    ``theta_names``: with their units, as ``static_1_N_per_mm``; ``draws`` (n, p); ``draws_total`` (n, p);
    ``chain`` (chains, draws, d); ``log_density`` (chains, draws); ``attributes``: text or numbers that are
    kept with each group, as the specimen.  Returns both have ``to_netcdf``.  Raises UsageError: arviz is not
    installed.
    """
    arviz, xarray = _libraries()
    theta = dict(zip(theta_names, _quarters(draws), strict=True))
    if draws_total is not None:
        totals = [f"{name}_total" for name in theta_names]
        theta |= dict(zip(totals, _quarters(draws_total), strict=True))
    sampled = dict(zip(chain_names, chain.transpose(2, 0, 1), strict=True))
    groups = {
        "posterior": _data_set(xarray, theta, attributes),
        "unconstrained_posterior": _data_set(xarray, sampled, attributes),
    }
    if log_density is not None:
        groups["sample_stats"] = _data_set(xarray, {"lp": log_density}, attributes)
    if int(arviz.__version__.split(".")[0]) < 1:
        return arviz.InferenceData(**groups)
    return xarray.DataTree.from_dict(groups)


def _quarters(draws: FloatArray) -> FloatArray:
    """Draws of shape (n, p) as chains, shape (p, 4, n // 4); fewer than four are one chain."""
    chains = _QUARTERS if len(draws) >= _QUARTERS else 1
    kept = len(draws) - len(draws) % chains
    return draws[:kept].T.reshape(draws.shape[1], chains, -1)


def netcdf_bytes(data: Any) -> bytes:
    """The bytes of a NetCDF file of what :func:`arviz_data` made.

    Raises UsageError: no library that writes NetCDF is installed.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "draws.nc"
        try:
            data.to_netcdf(str(path))
        except (ImportError, ValueError) as error:
            msg = f"no NetCDF can be written ({error}); install a library for it by `pip install h5netcdf`"
            raise UsageError(msg) from error
        return path.read_bytes()


def _libraries() -> tuple[Any, Any]:
    try:
        with warnings.catch_warnings():
            # arviz 0.2x announces its next major version at every import
            warnings.simplefilter("ignore", FutureWarning)
            import arviz
            import xarray
    except ImportError as error:
        msg = f"arviz can't be imported ({error}); install it by `pip install 'tissueid[arviz]'`"
        raise UsageError(msg) from error
    return arviz, xarray


def _data_set(xarray: Any, variables: Mapping[str, FloatArray], attributes: Mapping[str, Any] | None) -> Any:
    """Variables of shape (chains, draws) side by side, as arviz names their dimensions."""
    chains, draws = next(iter(variables.values())).shape
    return xarray.Dataset(
        {name: (("chain", "draw"), values) for name, values in variables.items()},
        coords={"chain": np.arange(chains), "draw": np.arange(draws)},
        attrs={"inference_library": "tissueid", **(attributes or {})},
    )
