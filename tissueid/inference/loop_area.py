"""Viscosity for which a fitted tissue has the measured area of a loop, its relaxation times kept.

The closed form of :mod:`tissueid.measured.cycles` holds where the path is slow against the relaxation times.
Here the model itself walks the measured path, contact loss and all, with every K times the same factor;
the factor that gives the measured area, found on a grid, scales the viscosity of all branches together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from tissueid.arrays import FloatArray
from tissueid.inference.trials import Adjustment
from tissueid.measured.cycles import closed_area
from tissueid.model.channels import TissueModel
from tissueid.model.kelvin_voigt import KelvinVoigt
from tissueid.model.kernels import surface_path
from tissueid.quantities import CycleRow, Measure
from tissueid.trial import Segmentation, Trial, contact_frame

#: Factors of K that are tried: outside, the model has another kind of loop than the tissue.
FACTORS = np.geomspace(0.1, 10.0, 13)
#: Depth, as a share of the fitted one, at which viscosity is quoted where K varies.
REFERENCE_DEPTH = 0.5


def _ranges(time_s: FloatArray, rows: Sequence[CycleRow]) -> list[slice]:
    """Samples of each loop."""
    return [
        slice(int(np.searchsorted(time_s, row.start_s)), int(np.searchsorted(time_s, row.end_s, "right")))
        for row in rows
    ]


def with_model_viscosity(
    trial: Trial,
    segmentation: Segmentation,
    rows: Sequence[CycleRow],
    model: TissueModel,
    theta: FloatArray,
    adjustment: Adjustment,
) -> tuple[CycleRow, ...]:
    """Loops of one trial with ``viscosity_model_N_s_per_mm`` filled where the model reaches their area.

    ``trial``, ``segmentation``: the recording; has a contact; ``rows``: its loops; ``model``, ``theta``: the
    specimen's tissue; passive; ``adjustment``: gain and contact offset of this log.
    """
    if not rows or not isinstance(model, KelvinVoigt) or model.branches == 0:
        return tuple(rows)
    assert segmentation.contact is not None  # noqa: S101  (there are loops)
    depth, _ = contact_frame(trial, segmentation)
    ranges = _ranges(trial.time_s, rows)
    # from the last sample in air, so that the surface starts at rest where it is
    first = max(segmentation.contact.index - 1, 0)
    if ranges[0].start < first:  # preconditioning comes before the contact of the test
        air = np.flatnonzero(depth[: ranges[0].start + 1] <= 0.0)
        first = int(air[-1]) if air.size else 0
    weights = [closed_area(depth[one]) for one in ranges]
    static, stiffness, tau = model.split(theta)
    law = np.ascontiguousarray(depth - adjustment.contact_offset_mm)
    areas = np.empty((FACTORS.size, len(rows)))
    force = np.zeros(depth.size)
    for k, factor in enumerate(FACTORS):
        _, force[first:] = surface_path(
            np.concatenate([[0.0], static]),
            np.ascontiguousarray(factor * stiffness),
            np.ascontiguousarray(tau),
            model.depth_mm,
            trial.time_s[first:],
            law[first:],
        )
        areas[k] = [adjustment.gain * float(w @ force[one]) for w, one in zip(weights, ranges, strict=True)]
    reference = np.array([REFERENCE_DEPTH * model.depth_mm])
    eta = float((model.stiffness(theta, reference)[:, 0] * tau).sum())
    return tuple(_filled(row, areas[:, k], eta) for k, row in enumerate(rows))


def _filled(row: CycleRow, areas: FloatArray, eta: float) -> CycleRow:
    """One loop: the factor at which the area is the measured one, by interpolation in ln(area)."""
    wanted, spread = row.dissipated_mJ.value, row.dissipated_mJ.stderr
    grows = bool((np.diff(areas) > 0.0).all()) and areas[0] > 0.0
    if wanted is None or spread is None or not grows or not areas[0] <= wanted <= areas[-1]:
        return row
    logs, at = np.log(areas), float(np.log(wanted))
    curve = PchipInterpolator(logs, np.log(FACTORS))
    factor, slope = float(np.exp(curve(at))), float(curve(at, 1))
    error = eta * factor * slope * spread / wanted
    return replace(row, viscosity_model_N_s_per_mm=Measure(eta * factor, error))
