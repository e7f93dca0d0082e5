"""Unloading held against loading and holds: as their fit predicts it, and as a fit that takes it in moves.

A convolution describes a contact that grows or stands (Lee & Radok 1960, doi 10.1115/1.3644020); a curved
tip's contact that shrinks it does not (Ting 1966, doi 10.1115/1.3625192).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tissueid.arrays import FloatArray
from tissueid.documents.quantities import UnloadingMiss
from tissueid.flags import Flag
from tissueid.inference.engine import Identified
from tissueid.inference.estimates import REFERENCE_DEPTH
from tissueid.inference.logs import LogHandle, blocks_of
from tissueid.inference.system import Point

#: Phases in which the tool turns back.
TURNED = ("retract", "cycle")
#: Change of a number by unloading that is told: in standard errors of loading, and over its size.
MOVED_SD, MOVED_SHARE = 2.6, 0.05


def _turns(handle: LogHandle) -> bool:
    """True where the tool turned back behind what was fitted."""
    last = float(handle.facts.data.time_s[-1])
    return any(phase.kind in TURNED and phase.end_s > last for phase in handle.segmentation.phases)


def _missed(
    identified: Identified, handle: LogHandle, index: int, point: Point
) -> tuple[FloatArray, FloatArray] | None:
    """Measured less predicted force over its range, and samples, of blocks in contact behind the turn."""
    whole = replace(handle, unloading=True, surface=None)
    _, log = whole.fitted()
    blocks = blocks_of(whole, log)
    after = blocks.mid_s > float(handle.facts.data.time_s[-1])
    spread = float(np.ptp(blocks.force_N))
    if not after.any() or spread <= 0.0:
        return None
    system, own = identified.system.alone(blocks, index, point)
    # a law without adhesion lets go where its convolution would pull
    missed = blocks.force_N - np.maximum(system.predict(own), 0.0)
    return missed[after] / spread, blocks.count[after].astype(np.float64)


def unloading_miss(
    identified: Identified, handles: Sequence[LogHandle], point: Point
) -> UnloadingMiss | None:
    """Unloading as a fit of loading and holds predicts it; ``None`` where no tool turned back in contact."""
    each = [
        _missed(identified, handle, index, point) for index, handle in enumerate(handles) if _turns(handle)
    ]
    found = [one for one in each if one is not None]
    if not found:
        return None
    missed, count = (np.concatenate([one[k] for one in found]) for k in (0, 1))
    worst = max(float(np.sqrt(np.average(one**2, weights=many))) for one, many in found)
    return UnloadingMiss(
        logs=len(found),
        samples=int(count.sum()),
        nrmsd=float(np.sqrt(np.average(missed**2, weights=count))),
        nrmsd_worst=worst,
        mean=float(np.average(missed, weights=count)),
    )


def _numbers(found: Identified) -> tuple[list[str], FloatArray, FloatArray]:
    """Relaxation times and K_j at half depth: names, values, and standard errors over the values."""
    law, point = found.law, found.optimum.point
    times, first = law.counts[0], law.times + 3 + law.static_size
    powers = REFERENCE_DEPTH ** np.arange(float(law.powers))
    rows = np.zeros((times + law.branches, found.system.size))
    rows[:times, :times] = np.eye(times)
    for j in range(law.branches):
        rows[times + j, first + j * law.powers : first + (j + 1) * law.powers] = powers
    values = rows @ point.shared
    error = np.sqrt(np.maximum(((rows @ found.optimum.covariance) * rows).sum(axis=1), 0.0))
    error[times:] /= np.maximum(np.abs(values[times:]), 1e-300)
    values[:times] = np.exp(values[:times])
    values[times:] /= law.depth_mm
    names = [f"tau{j + 1 if j else ''} [s]" for j in range(times)]
    names += [f"K{j + 1 if j else ''} at half depth [N/mm]" for j in range(law.branches)]
    return names, values, error


def unloading_disagrees(loaded: Identified, whole: Identified, worth: float) -> tuple[Flag, ...]:
    """Flag where taking unloading in moves a relaxation time or K; both fits of one order.

    ``worth``: samples of loading that count as one.  More data of one law move an estimate by no more than
    its own error (Hausman 1978, doi 10.2307/1913827).
    """
    names, before, sd = _numbers(loaded)
    _, after, _ = _numbers(whole)
    share = np.abs(np.log(np.maximum(after, 1e-300) / np.maximum(before, 1e-300)))
    moved = np.where(share > MOVED_SHARE, share / np.maximum(np.sqrt(worth) * sd, 1e-12), 0.0)
    k = int(np.argmax(moved))
    if moved[k] <= MOVED_SD:
        return ()
    both = f"{after[k]:.3g} with the unloading, {before[k]:.3g} without"
    values = {"loading": float(before[k]), "whole": float(after[k]), "standard_errors": float(moved[k])}
    return (Flag("unloading_disagrees", f"{names[k]} is {both}: {moved[k]:.0f} standard errors", values),)
