"""Curves that a posterior follows, where whitened coordinates know the tangent at the optimum.

Memory and scatter of gains are drawn by quantiles of their own density; at a scatter all else is as uncertain
as noise leaves it, and a common scale as much more as a mean of gains that scatter so much.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import PchipInterpolator
from scipy.special import ndtri

from tissueid.arrays import FloatArray
from tissueid.inference.optimum import covariance_of, pinned

if TYPE_CHECKING:
    from tissueid.inference.target import SpecimenTarget

#: Ln of scatters, and steps of ln memory about the optimum, at which the density is tabulated.
SCATTERS, MEMORIES = np.linspace(-13.9, 5.0, 64), np.linspace(-5.0, 5.0, 51)
#: Scatter that noise makes, to begin with; parabolas in turn; widths that one moves at the most; curvature
#: over a width that is enough to go by; share of a density beyond each end of its curve.
LEAST_SCATTER, PARABOLAS, FARTHEST, LEAST_BEND, TAIL = 1e-4, 4, 10.0, 0.1, 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Ridges:
    """Curves that a posterior follows."""

    #: Coordinates by their places, over standard normal ones.
    quantiles: Mapping[int, PchipInterpolator]
    #: Along the scatter of gains: root of the covariance of all but the machine, (r, r); best common scale.
    widths: PchipInterpolator | None = None
    ln_scale: PchipInterpolator | None = None


def straight_beyond(curve: PchipInterpolator, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A curve, continued straight beyond its ends, and the logarithm of its slope; (...,) -> (...,)."""
    inside = np.clip(value, curve.x[0], curve.x[-1])
    slope = curve(inside, 1)
    return np.asarray(curve(inside) + (value - inside) * slope), np.log(np.maximum(slope, 1e-300))


def _by_density(values: FloatArray, level: FloatArray) -> PchipInterpolator:
    """A coordinate of such log densities (n,), over a standard normal one of the same quantiles."""
    density = np.exp(level - level.max())
    below = cumulative_simpson(density, x=values, initial=0.0)
    share = np.clip(below / below[-1], TAIL, 1.0 - TAIL)
    normal, first = np.unique(ndtri(share), return_index=True)
    return PchipInterpolator(normal, values[first])


def ridges_of(target: SpecimenTarget) -> Ridges:
    """Memory and scatter of gains by quantiles, and all else along the scatter."""
    quantiles, places = {}, target.places
    if "ln_memory" in places:
        at, x = places["ln_memory"], np.tile(target.mode, (MEMORIES.size, 1))
        x[:, at] += MEMORIES
        level, _ = target.levels(x, np.zeros((len(x), target.size)))
        quantiles[at] = _by_density(x[:, at], level if np.isfinite(level).any() else target.density(x))
    if "ln_gain_sd" not in places:
        return Ridges(quantiles)
    at = places["ln_gain_sd"]
    ln_scale, level = _common_scale(target, at)
    quantiles[at] = _by_density(SCATTERS, level)
    widths, scales = (PchipInterpolator(SCATTERS, one) for one in (_roots(target), ln_scale))
    return Ridges(quantiles, widths, scales)


def _common_scale(target: SpecimenTarget, at: int) -> tuple[FloatArray, FloatArray]:
    """Ln of the best common scale of several logs at :data:`SCATTERS`, and log densities, (n,), (n,)."""
    linear, middle = target.linear_places, np.zeros(SCATTERS.size)
    width = np.sqrt((np.exp(2.0 * SCATTERS) + LEAST_SCATTER**2) / len(target.system.logs))

    def level_at(scales: FloatArray) -> FloatArray:
        x = np.tile(target.mode, (*scales.shape, 1))
        x[..., at] = SCATTERS
        x[..., linear] *= np.exp(scales)[..., None]
        return target.density(x.reshape(-1, x.shape[-1])).reshape(scales.shape)

    # by parabolas in the density
    for _ in range(PARABOLAS):
        low, level, high = level_at(middle + np.outer([-1.0, 0.0, 1.0], width))
        with np.errstate(invalid="ignore"):
            bend = 2.0 * level - low - high
            known = np.isfinite(bend) & (bend > LEAST_BEND)
            step = np.where(known, 0.5 * (high - low) / np.where(known, bend, 1.0), 0.0)
        middle = middle + np.clip(step, -FARTHEST, FARTHEST) * width
        width = width / np.sqrt(np.where(known, bend, 1.0))
    return middle, level_at(middle) + np.log(width)


def _roots(target: SpecimenTarget) -> FloatArray:
    """Roots of the covariance of all but the machine at :data:`SCATTERS`, (n, r, r)."""
    rest, scale = target.still_places, np.zeros(target.mode.size)
    scale[target.linear_places] = target.mode[target.linear_places]
    found, centred = target.optimum, target.system.centred
    normal = replace(found.normal, hessian=pinned(found.normal, found.point, centred=centred))
    hessian, _ = target.curvature(replace(found, normal=normal))
    more = np.exp(2.0 * SCATTERS)[:, None, None] / len(target.system.logs)
    known = covariance_of(hessian[np.ix_(rest, rest)]) + more * np.outer(scale[rest], scale[rest])
    return np.asarray(np.linalg.cholesky(known), dtype=np.float64)
