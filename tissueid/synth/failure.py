"""Tissue that breaks: where along a path a measure of the contact force reaches its threshold.

The measures are taken of the force that the tool feels, step by step along the path, as a test machine that
knew them would: work by the trapezoid rule, energy of a branch by the antiderivative of K(y) (y - x_d),
both on a grid of :data:`GRID` times. After the rupture a share of the force is left.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.synth.path import Path, contact_path
from tissueid.synth.recipe import Branch, Rupture
from tissueid.synth.response import branch_extension, static_force

#: Times at which the measure is looked at; the depth of rupture is then good to 1e-7 of the travel.
GRID = 20_001


@dataclass(frozen=True, slots=True)
class Broken:
    """End of a test, broken or not."""

    ruptured: bool
    #: Of the rupture; of the end of the program where there is none.
    time_s: float
    depth_mm: float
    force_N: float
    work_N_mm: float
    threshold: float  # of this test

    def as_truth(self) -> Mapping[str, float]:
        """Entries of ``truth`` of a log."""
        return {
            "ruptured": float(self.ruptured),
            "rupture_time_s": self.time_s,
            "rupture_depth_mm": self.depth_mm,
            "rupture_force_N": self.force_N,
            "rupture_work_N_mm": self.work_N_mm,
            "threshold": self.threshold,
        }


def rupture_of(
    rupture: Rupture,
    threshold: float,
    travel: Path,
    *,
    offset_mm: float,
    static: tuple[float, ...],
    branches: tuple[Branch, ...],
) -> Broken:
    """Find where a test breaks the tissue.

    ``rupture``: criterion and weight; ``threshold``: of this test; ``travel``: crosshead travel, a loading
    program; ``offset_mm``: travel of first contact; ``static``, ``branches``: the law; gains are already in
    it.
    """
    depth = contact_path(travel, offset_mm)
    time_s = np.union1d(np.linspace(0.0, travel.time_s[-1], GRID), depth.time_s)
    x = depth.at(time_s)
    elastic = static_force(static, x)
    extensions = [branch_extension(depth, branch.tau_s, time_s) for branch in branches]
    dynamic = sum((_at(b.stiffness, x) * s for b, s in zip(branches, extensions, strict=True)), 0.0 * x)
    force = np.maximum(elastic + dynamic, 0.0)
    work = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(x))])
    if rupture.criterion == "work":
        measure = work
    elif rupture.criterion == "weighted-force":
        measure = elastic + rupture.weight * dynamic
    elif rupture.criterion == "stored-energy":
        measure = sum(
            (_spring(b.stiffness, x, s) for b, s in zip(branches, extensions, strict=True)),
            static_force(tuple(a / (k + 2) for k, a in enumerate(static)), x) * x,
        )
    else:
        measure = x
    reached = measure >= threshold
    k = max(int(np.argmax(reached)), 1) if reached.any() else measure.size - 1
    share = (threshold - measure[k - 1]) / (measure[k] - measure[k - 1]) if reached.any() else 1.0
    at = [float(one[k - 1] + share * (one[k] - one[k - 1])) for one in (time_s, x, force, work)]
    return Broken(
        ruptured=bool(reached.any()),
        time_s=at[0],
        depth_mm=at[1],
        force_N=at[2],
        work_N_mm=at[3],
        threshold=threshold,
    )


def _at(coefficients: tuple[float, ...], x: FloatArray) -> FloatArray:
    return np.asarray(np.polynomial.polynomial.polyval(x, coefficients))


def _spring(stiffness: tuple[float, ...], x: FloatArray, extension: FloatArray) -> FloatArray:
    """Energy int_{x_d}^{x} K(y) (y - x_d) dy of a spring whose damper stands at x_d = x - s [N mm]."""
    damper = x - extension
    energy = np.zeros_like(x)
    for power, k in enumerate(stiffness):
        upper, lower = power + 2, power + 1
        energy += k * ((x**upper - damper**upper) / upper - damper * (x**lower - damper**lower) / lower)
    return energy


def after_rupture(broken: Broken, residual: float, time_s: FloatArray, force_N: FloatArray) -> FloatArray:
    """The force with what is left of it from the rupture on, shape (n,)."""
    if not broken.ruptured:
        return force_N
    return np.where(time_s > broken.time_s, residual * force_N, force_N)
