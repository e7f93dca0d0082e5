"""Correlation of the residuals, by restricted likelihood with the fit in it.

Every correlation time is judged after the step that the fit would take under it, with the determinant of what
is fitted: noise with a long memory is not mistaken for a tissue, nor the tissue for noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissueid.inference.noise import Memory
from tissueid.inference.optimum import Noise, normal_equations, whitener_of
from tissueid.inference.prior import PriorRows
from tissueid.inference.system import Derivatives, Point, System

#: Correlation times over the step, and white shares beside them, of a first look.
TIMES, SHARES = np.geomspace(0.35, 400.0, 11), (0.0, 0.3, 0.7)
#: Gain in ln L below which noise is white, and below which it has no white part.
WORTH, SHARE_WORTH = 5.0, 3.0


@dataclass(frozen=True, slots=True)
class MemoryScan:
    """The best correlation, and how much it gains over white noise in ln L."""

    noise: Noise
    gain: float


def _restricted(
    system: System, point: Point, parts: Derivatives, prior: PriorRows, memory: Memory, rough_N: float
) -> tuple[float, float]:
    """Restricted ln L of a correlation, and its sigma [N]."""
    white = whitener_of(system, memory)
    normal = normal_equations(system, point, parts, white, rough_N, prior)
    # a machine that is not asked about has neither derivatives nor priors
    live = np.diag(normal.hessian) > 0.0
    scale = np.sqrt(np.diag(normal.hessian)[live])
    hessian = normal.hessian[np.ix_(live, live)] / scale / scale[:, None]
    gradient = normal.gradient[live] / scale
    move = np.linalg.solve(hessian + 1e-12 * np.eye(len(scale)), gradient)
    off = float(gradient @ move)
    if normal.own.shape[1]:
        off += float(np.einsum("lq,lqr,lr->", normal.own_gradient, normal.own_inverse, normal.own_gradient))
    square = max(float(normal.residual @ normal.residual) - off, 1e-12) * rough_N**2
    fitted = normal.shared.shape[1] - 3 + point.own.size
    freedom = max(system.force.size - fitted, 1)
    log_det = white.log_det + float(np.linalg.slogdet(hessian)[1]) + 2.0 * float(np.log(scale).sum())
    if normal.own.shape[1]:
        log_det -= float(np.linalg.slogdet(normal.own_inverse)[1].sum())
    variance = square / freedom
    return -0.5 * (freedom * np.log(variance) + log_det), float(np.sqrt(variance))


def scan_memory(
    system: System,
    point: Point,
    parts: Derivatives,
    prior: PriorRows,
    *,
    step_s: float,
    rough_N: float,
    model: str = "auto",
) -> MemoryScan:
    """Correlation of the noise under a law.

    ``system``, ``point``, ``parts``, ``prior``: a fit, its derivatives (machine closed) and priors;
    ``step_s``: sampling interval [s]; ``rough_N``: size of the residuals [N]; ``model``: ``auto``, ``white``,
    ``ar1`` or ``white+ar1``.
    """
    look: Callable[[Memory], tuple[float, float]] = lambda memory: _restricted(  # noqa: E731
        system, point, parts, prior, memory, rough_N
    )
    plain, sigma = look(Memory())
    if model == "white" or system.force.size < 12 or not np.isfinite(plain):
        # residuals that parameters take up show no noise
        return MemoryScan(Noise(sigma), 0.0)
    best = (-np.inf, sigma, Memory())
    for share in (0.0,) if model == "ar1" else SHARES:
        for time in TIMES * step_s:
            value, scale = look(Memory(float(time), share))
            if value > best[0]:
                best = (value, scale, Memory(float(time), share))
    best = _refined(best, look, share=model != "ar1")
    if best[2].white > 0.0 and model == "auto":
        pure = _refined(
            max(((*look(Memory(float(t))), Memory(float(t))) for t in TIMES * step_s), key=_first),
            look,
            share=False,
        )
        if best[0] - pure[0] < SHARE_WORTH:
            best = pure
    gain = float(best[0] - plain)
    if model == "auto" and gain < WORTH:
        return MemoryScan(Noise(sigma), gain)
    return MemoryScan(Noise(best[1], best[2]), gain)


_Found = tuple[float, float, Memory]


def _first(found: _Found) -> float:
    return found[0]


def _refined(best: _Found, look: Callable[[Memory], tuple[float, float]], *, share: bool) -> _Found:
    """The best of a finer and finer look around it."""
    width, spread = 0.5, 0.15
    for _ in range(4):
        _, _, at = best
        tried = [Memory(at.time_s * np.exp(d), at.white) for d in (-width, width)]
        if share and at.white > 0.0:
            tried += [Memory(at.time_s, float(np.clip(at.white + d, 0.0, 0.98))) for d in (-spread, spread)]
        for memory in tried:
            value, scale = look(memory)
            if value > best[0]:
                best = (value, scale, memory)
        width, spread = 0.6 * width, 0.6 * spread
    return best
