"""Deflection of machine, load cell and fixture, from recordings of a rigid block: all travel is the frame's.

``x = x_0 + u(F)`` is linear in the compliances at knots of force: non-negative least squares through means of
short stretches, since the noise of F would flatten the slope of x over F.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import nnls

from tissueid import __version__
from tissueid.arrays import FloatArray
from tissueid.errors import InputError
from tissueid.manifest import FrameCurve
from tissueid.model.frame import deflection, deflection_basis, deflection_sd
from tissueid.segment import segment
from tissueid.trial import Segmentation, Trial

#: Stretches of a loading whose means are fitted.
BINS = 60
#: Pieces of compliance at most; their knots lie at squares, closest where joints close.
PIECES = 6
#: Narrowest piece, in standard deviations of the binned force.
NARROWEST_SD = 10.0
#: Weight of equal neighbours beside the forces: they decide where a loading begins above the first knots.
LEVEL = 1e-3
#: A loading counts where it reaches this share of the largest force, and has so many samples.
FULL_LOADING = 0.5
FEWEST_SAMPLES = 12
#: Repeatability that is assumed where there is one loading only, as a share of the compliance.
UNKNOWN_REPEATABILITY = 0.05
#: A block whose force falls by this share in a hold is not rigid: joints creep by less than a per cent.
RELAXES = 0.02
#: Samples at the start of a hold, and standard deviations that a fall must exceed.
FEW, SURE_SD = 5, 5.0
#: A block softer than this is not rigid: a load cell of 10 N gives some 0.25 mm [N/mm].
SOFTEST_N_PER_MM = 20.0
#: A load cell at this stiffness deflects 1 micrometre under 100 N: nothing is left to correct.
STIFFEST_N_PER_MM = 1e5


@dataclass(frozen=True, slots=True)
class Loading:
    """One loading of the block: binned compressive force [N] and travel [mm], both of shape (n,)."""

    force_N: FloatArray
    travel_mm: FloatArray
    force_sd_N: float


def _refuse(trial: Trial, message: str) -> InputError:
    return InputError(code="not_rigid", message=message, path=trial.source.path, sheet=trial.source.sheet)


def _loading(force: FloatArray, travel: FloatArray, force_noise_N: float) -> Loading | None:
    """The rising part of a phase, binned; ``None`` where it is too short."""
    size = int(np.argmax(force)) + 1 if force.size else 0
    if size < FEWEST_SAMPLES:
        return None
    rows = np.array_split(np.arange(size), min(BINS, size // 2))
    return Loading(
        np.array([force[row].mean() for row in rows]),
        np.array([travel[row].mean() for row in rows]),
        force_noise_N / float(np.sqrt(size / len(rows))),
    )


def _refuse_relaxing(trial: Trial, segmentation: Segmentation, force: FloatArray) -> None:
    """Refuse a block whose force falls while the crosshead stands, beyond noise and the creep of joints."""
    for hold in segmentation.of_kind("hold"):
        held = force[hold.start : hold.stop]
        first, last = float(held[:FEW].mean()), float(held[-max(FEW, held.size // 10) :].mean())
        noise = SURE_SD * segmentation.force_noise_N / float(np.sqrt(FEW))
        if first > 0.0 and first - last > max(RELAXES * first, noise):
            message = (
                f"the force falls by {100 * (1 - last / first):.1f} % in a hold, from {first:.4g} to "
                f"{last:.4g} N: this is no rigid block; press the tip on steel"
            )
            raise _refuse(trial, message)


def loadings_of(trial: Trial) -> list[Loading]:
    """Every ramp, and way in of a cycle, of a rigid block; InputError ``not_rigid`` where there is none."""
    segmentation = segment(trial)
    contact = segmentation.contact
    if contact is None:
        raise _refuse(trial, "no contact with a block was found: the force never rises with the travel")
    force = segmentation.force_sign * (trial.force_N - contact.baseline_N)
    travel = segmentation.compression_sign * trial.displacement_mm
    _refuse_relaxing(trial, segmentation, force)
    phases = (*segmentation.of_kind("ramp"), *segmentation.of_kind("cycle"))
    ways = sorted((max(phase.start, contact.index), phase.stop) for phase in phases)
    loadings = (_loading(force[a:b], travel[a:b], segmentation.force_noise_N) for a, b in ways)
    found = [one for one in loadings if one is not None]
    if not found:
        raise _refuse(trial, f"no loading of {FEWEST_SAMPLES} samples or more was found")
    return found


def _knots(loadings: Sequence[Loading], top_N: float) -> FloatArray:
    """Knots at squares, so many that the first piece is wide against the noise and holds two bins."""
    noise = max(one.force_sd_N for one in loadings)
    narrowest = max(NARROWEST_SD * noise, min(float(one.force_N[1]) for one in loadings))
    pieces = PIECES
    while pieces > 1 and top_N / pieces**2 < narrowest:
        pieces -= 1
    return np.asarray(top_N * (np.arange(pieces + 1) / pieces) ** 2)


def _centred(knots: FloatArray, loading: Loading) -> tuple[FloatArray, FloatArray]:
    """Design and travel of one loading without its x_0."""
    basis = deflection_basis(knots, loading.force_N)
    return basis - basis.mean(axis=0), loading.travel_mm - loading.travel_mm.mean()


def _stacked(parts: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Design of every loading, and that above rows that make neighbours equal where no force tells them."""
    design = np.concatenate([part[0] for part in parts])
    weight = LEVEL * float(np.sqrt((design**2).sum(axis=0)).max())
    return design, np.concatenate([design, weight * np.diff(np.eye(design.shape[1]), axis=0)])


def _solve(parts: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    """Compliances >= 0 and the residual of every bin."""
    design, stacked = _stacked(parts)
    travel = np.concatenate([part[1] for part in parts])
    scale = np.sqrt((stacked**2).sum(axis=0))
    found, _ = nnls(stacked / scale, np.pad(travel, (0, len(stacked) - len(design))))
    compliance = found / scale
    return compliance, travel - design @ compliance


def _noise_covariance(
    parts: Sequence[tuple[FloatArray, FloatArray]], compliance: FloatArray, residual: FloatArray
) -> FloatArray:
    """Covariance of the compliances under the residual, its correlation from bin to bin included."""
    _, stacked = _stacked(parts)
    free = compliance > 0.0
    used = int(free.sum()) + len(parts)
    variance = float((residual**2).sum()) / max(residual.size - used, 1)
    power = float((residual**2).sum())
    acf = float(np.clip(residual[:-1] @ residual[1:] / power, 0.0, 0.95)) if power > 0.0 else 0.0
    covariance = np.zeros((compliance.size, compliance.size))
    inverse = np.linalg.pinv(stacked[:, free].T @ stacked[:, free], hermitian=True)
    covariance[np.ix_(free, free)] = inverse * variance * (1.0 + acf) / (1.0 - acf)
    return covariance


def _repeatability(
    parts: Sequence[tuple[FloatArray, FloatArray]], compliance: FloatArray
) -> tuple[FloatArray, bool]:
    """Covariance of one loading's compliances about the mean curve, and whether it was measured."""
    if len(parts) < 2:
        share = UNKNOWN_REPEATABILITY * compliance
        return np.outer(share, share), False
    each = np.array([_solve([part])[0] for part in parts])
    return np.atleast_2d(np.cov(each, rowvar=False, ddof=1)), True


def calibrate_frame(trials: Sequence[Trial]) -> dict[str, Any]:
    """The document of ``schemas/frame.schema.json`` of recordings of a rigid block; InputError ``not_rigid``.

    The covariance holds the noise of the mean curve and the scatter of single loadings about it: a test
    is one more loading.
    """
    every = [one for trial in trials for one in loadings_of(trial)]
    top = max(float(one.force_N.max()) for one in every)
    loadings = [one for one in every if one.force_N.max() >= FULL_LOADING * top]
    knots = _knots(loadings, top)
    parts = [_centred(knots, one) for one in loadings]
    compliance, residual = _solve(parts)
    repeatability, measured = _repeatability(parts, compliance)
    covariance = _noise_covariance(parts, compliance, residual) + repeatability
    frame = FrameCurve(knots, compliance, covariance)
    scatter = float(deflection_sd(FrameCurve(knots, compliance, repeatability), np.array([top]))[0])
    give = deflection(frame, np.array([top / 2.0, top]))
    stiffness = (top / 2.0) / max(float(give[1] - give[0]), top / 2.0 / STIFFEST_N_PER_MM)
    if stiffness < SOFTEST_N_PER_MM:
        raise _refuse(
            trials[0],
            f"the block gives {1.0 / stiffness:.3g} mm a newton ({stiffness:.3g} N/mm), softer than any "
            "machine: press the tip on steel",
        )
    return {
        "schema": "tissueid/frame/1",
        "tissueid": __version__,
        "force_N": knots.tolist(),
        "compliance_mm_per_N": compliance.tolist(),
        "covariance": covariance.tolist(),
        "deflection_mm": deflection(frame, knots).tolist(),
        "sd_mm": deflection_sd(frame, knots).tolist(),
        "range_N": [max(0.0, min(float(one.force_N.min()) for one in loadings)), top],
        "stiffness_N_per_mm": stiffness,
        "noise_sd_mm": float(np.sqrt(np.mean(residual**2))),
        "repeatability_sd_mm": scatter if measured else None,
        "loadings": len(loadings),
        "sources": [
            {"path": trial.source.path, "sheet": trial.source.sheet, "sha256": trial.source.sha256}
            for trial in trials
        ],
    }
