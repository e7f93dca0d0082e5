"""Identified tissues as a MATLAB file: one struct a specimen, as MATLAB and Octave load it."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np

from tissueid.store.bundle import Bundle


def mat_bytes(bundles: Sequence[Bundle]) -> bytes:
    """Write specimens as ``tissueid``, a struct array of MATLAB's format 5.

    Returns fields: ``specimen``, ``length_unit`` and ``force_unit`` (what mm and N in a name stand for),
    ``branches``, ``stiffness_degree``, ``depth_mm``, ``speeds_mm_s``, ``tip_radius_mm`` (NaN where unknown),
    ``sigma_N``, ``theta_names``, ``theta``, ``covariance``, ``draws`` (a row a draw; empty without a
    posterior), and ``parameters``, a struct a reported number with ``name``, ``value``, ``stderr``, ``ci95``,
    ``ci95_total`` and ``identified``; NaN where nothing is known.
    """
    from scipy.io import savemat

    out = BytesIO()
    savemat(
        out,  # type: ignore[arg-type] # a file object, which the stubs leave out
        {"tissueid": _structs([_of(bundle) for bundle in bundles])},
        do_compression=True,
        oned_as="column",
        long_field_names=True,
    )
    return out.getvalue()


def _of(bundle: Bundle) -> dict[str, Any]:
    draws = np.empty((0, bundle.theta.size)) if bundle.draws is None else bundle.draws
    return {
        "specimen": bundle.specimen,
        "length_unit": bundle.units["length"],
        "force_unit": bundle.units["force"],
        "branches": float(bundle.model.branches),
        "stiffness_degree": float(bundle.model.stiffness_degree),
        "depth_mm": bundle.depth_mm,
        "speeds_mm_s": np.array(bundle.speeds_mm_s),
        "tip_radius_mm": np.nan if bundle.tip_radius_mm is None else bundle.tip_radius_mm,
        "sigma_N": bundle.sigma_N,
        "theta_names": np.array(bundle.theta_names, dtype=object),
        "theta": bundle.theta,
        "covariance": bundle.covariance,
        "draws": draws,
        "parameters": _structs([_parameter(one.as_json()) for one in bundle.parameters]),
    }


def _parameter(told: dict[str, Any]) -> dict[str, Any]:
    ends = np.full(2, np.nan)
    unknown: dict[str, Any] = {"value": np.nan, "stderr": np.nan, "ci95": ends, "ci95_total": ends}
    known = {key: np.asarray(told[key], dtype=float) for key in unknown if told.get(key) is not None}
    return {"name": told["name"], **unknown, **known, "identified": bool(told["identified"])}


def _structs(rows: Sequence[dict[str, Any]]) -> np.ndarray:
    """A column of structs; savemat takes records of objects for one."""
    names = list(rows[0]) if rows else []
    out = np.empty((len(rows), 1), dtype=[(name, object) for name in names])
    for place, row in enumerate(rows):
        out[place, 0] = tuple(row[name] for name in names)
    return out
